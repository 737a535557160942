"""Consolidate and shear loose discs in Yade by its periodic servo; run by the checks.

    CASE=IN.npz RESULT=OUT.npz yade -n -x -j1 yade_servo.py

IN holds discs (x, y, radius; mean radius 1) in a periodic cell `size`, the `goals` (xx, yy) of
each phase over k_n, the `friction` and the `ratio` and relative stress `error` to reach. OUT
holds for each phase its seconds, steps, unbalanced ratio and stresses. The masses of the cell
and the damping were tuned for fewest steps.
"""

import math
import os
import time

import numpy as np
from yade import (
    Bo1_Sphere_Aabb,
    ForceResetter,
    FrictMat,
    GlobalStiffnessTimeStepper,
    Ig2_Sphere_Sphere_ScGeom,
    InsertionSortCollider,
    InteractionLoop,
    Ip2_FrictMat_FrictMat_FrictPhys,
    Law2_ScGeom_FrictPhys_CundallStrack,
    NewtonIntegrator,
    O,
    PeriTriaxController,
    utils,
)

MOST_SECONDS = 120.0
DEPTH = 20.0  # of the cell, in which discs are spheres held in a plane

case = np.load(os.environ["CASE"])
width, height = (float(value) for value in case["size"])
O.periodic = True
O.cell.setBox(width, height, DEPTH)
O.materials.append(
    FrictMat(young=1.0, poisson=0.4, frictionAngle=math.atan(float(case["friction"])), density=1.0)
)
mass = 0.0
for x, y, radius in zip(case["x"], case["y"], case["radius"], strict=True):
    body = utils.sphere((x, y, 0.5 * DEPTH), radius)
    body.state.blockedDOFs = "zXY"
    O.bodies.append(body)
    mass += body.state.mass
servo = PeriTriaxController(
    goal=(0.0, 0.0, 0.0),
    stressMask=3,
    maxUnbalanced=float(case["ratio"]),
    relStressTol=float(case["error"]),
    globUpdate=10,
    maxStrainRate=(5e-4, 5e-4, 0.0),
    dynCell=True,
    mass=0.02 * mass,
    growDamping=0.25,
    doneHook="O.pause()",
)
O.engines = [
    ForceResetter(),
    InsertionSortCollider([Bo1_Sphere_Aabb()], verletDist=0.25),
    InteractionLoop(
        [Ig2_Sphere_Sphere_ScGeom()],
        [Ip2_FrictMat_FrictMat_FrictPhys()],
        [Law2_ScGeom_FrictPhys_CundallStrack()],
    ),
    GlobalStiffnessTimeStepper(
        timestepSafetyCoefficient=0.8, timeStepUpdateInterval=50, defaultDt=0.3, maxDt=1.0
    ),
    servo,
    NewtonIntegrator(damping=0.2),
]
O.dt = 0.3
found = {"seconds": [], "steps": [], "ratio": [], "stress": []}
for xx, yy in case["goals"]:
    servo.goal = (-xx / DEPTH, -yy / DEPTH, 0.0)
    first, start = O.iter, time.perf_counter()
    while time.perf_counter() - start < MOST_SECONDS:
        O.run(1000, True)
        stress = np.array([-servo.stress[0], -servo.stress[1]]) * DEPTH
        off = np.max(np.abs(stress / (xx, yy) - 1.0))
        if off <= 1.05 * float(case["error"]) and utils.unbalancedForce() <= float(case["ratio"]):
            break
    found["seconds"].append(time.perf_counter() - start)
    found["steps"].append(O.iter - first)
    found["ratio"].append(utils.unbalancedForce())
    found["stress"].append(stress)
np.savez(os.environ["RESULT"], **found)
