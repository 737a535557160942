"""Cost of a step in Yade, run as `yade -n -x -j1 yade_steps.py` by `tests.peers.yade`.

The discs x, y, radius of CASE lie in a periodic box `size`, as a monolayer of spheres. `bonded`
takes bonds with moments (CohFrict), else frictional contacts (CundallStrack). Leaves seconds of
each of `repeats` runs of `steps` steps, and the number of contacts.
"""

import math
import os
import time

import numpy as np
from yade import (
    Bo1_Sphere_Aabb,
    CohFrictMat,
    ForceResetter,
    FrictMat,
    Ig2_Sphere_Sphere_ScGeom,
    Ig2_Sphere_Sphere_ScGeom6D,
    InsertionSortCollider,
    InteractionLoop,
    Ip2_CohFrictMat_CohFrictMat_CohFrictPhys,
    Ip2_FrictMat_FrictMat_FrictPhys,
    Law2_ScGeom6D_CohFrictPhys_CohesionMoment,
    Law2_ScGeom_FrictPhys_CundallStrack,
    NewtonIntegrator,
    O,
    utils,
)

case = np.load(os.environ["CASE"])
O.periodic = True
width, height = case["size"]
O.cell.setBox(width, height, 20.0)
angle = math.atan(float(case["friction"]))
if bool(case["bonded"]):
    O.materials.append(
        CohFrictMat(
            young=1.0,
            poisson=0.4,
            frictionAngle=angle,
            density=1.0,
            normalCohesion=1e3,
            shearCohesion=1e3,
            momentRotationLaw=True,
            alphaKr=0.1,
            alphaKtw=0.1,
        )
    )
    loop = InteractionLoop(
        [Ig2_Sphere_Sphere_ScGeom6D()],
        [Ip2_CohFrictMat_CohFrictMat_CohFrictPhys(setCohesionNow=True)],
        [Law2_ScGeom6D_CohFrictPhys_CohesionMoment()],
    )
else:
    O.materials.append(FrictMat(young=1.0, poisson=0.4, frictionAngle=angle, density=1.0))
    loop = InteractionLoop(
        [Ig2_Sphere_Sphere_ScGeom()],
        [Ip2_FrictMat_FrictMat_FrictPhys()],
        [Law2_ScGeom_FrictPhys_CundallStrack()],
    )
for x, y, r in zip(case["x"], case["y"], case["radius"], strict=True):
    body = utils.sphere((float(x), float(y), 10.0), float(r))
    body.state.blockedDOFs = "zXY"
    O.bodies.append(body)
O.engines = [
    ForceResetter(),
    InsertionSortCollider([Bo1_Sphere_Aabb()], verletDist=0.15),
    loop,
    NewtonIntegrator(damping=0.2),
]
O.dt = 0.2
O.run(200, True)
seconds = []
for _ in range(int(case["repeats"])):
    start = time.process_time()
    O.run(int(case["steps"]), True)
    seconds.append(time.process_time() - start)
np.savez(os.environ["RESULT"], seconds=seconds, contacts=O.interactions.countReal())
