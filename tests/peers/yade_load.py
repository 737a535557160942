"""Load a specimen in Yade by walls that move at a constant speed; run by `grain_forces.py`.

    CASE=IN.npz RESULT=OUT.npz yade -n -x -j1 yade_load.py

Lengths in mean radii, forces in k_n times the mean radius. IN holds the grains (x, y, radius),
their contacts with shear forces (a, b, shear), the walls before and after (box, box_end), the
shear stiffness `ks` over the normal one, the `friction`, whether the contacts are `bonded`, the
`steps` of the walls' way and the unbalanced `ratio` to reach then; for bonds also the stiffness of
each listed contact (spring_kn, spring_kr against rotation) and the overlap at which it bears no
normal force (spring_unloaded). OUT holds the contact forces, and the moments of bonds.
"""

import math
import os

import numpy as np
import yade
from yade import (
    Bo1_Sphere_Aabb,
    Bo1_Wall_Aabb,
    CohFrictMat,
    ForceResetter,
    FrictMat,
    Ig2_Sphere_Sphere_ScGeom,
    Ig2_Sphere_Sphere_ScGeom6D,
    Ig2_Wall_Sphere_ScGeom,
    InsertionSortCollider,
    InteractionLoop,
    Ip2_CohFrictMat_CohFrictMat_CohFrictPhys,
    Ip2_FrictMat_FrictMat_FrictPhys,
    Law2_ScGeom6D_CohFrictPhys_CohesionMoment,
    Law2_ScGeom_FrictPhys_CundallStrack,
    MatchMaker,
    NewtonIntegrator,
    O,
    PyRunner,
    Vector3,
    utils,
)

case = np.load(os.environ["CASE"])
friction, ks, bonded = float(case["friction"]), float(case["ks"]), bool(case["bonded"])
x, y, radius = case["x"], case["y"], case["radius"]
n = len(x)

common = {"young": 1.0, "poisson": 0.5, "density": 1.0}
kind = {}
if bonded:
    kind = {"normalCohesion": 1e9, "shearCohesion": 1e9, "isCohesive": True}
    kind |= {"momentRotationLaw": True, "etaRoll": -1.0, "etaTwist": -1.0}
O.materials.append(
    (CohFrictMat if bonded else FrictMat)(
        frictionAngle=math.atan(friction), label="grain", **common, **kind
    )
)
O.materials.append(FrictMat(frictionAngle=0.0, label="wall", **common))
for k in range(n):
    body = utils.sphere((x[k], y[k], 0.0), radius[k], material="grain")
    body.state.blockedDOFs = "zXY"
    body.state.mass = 1.0
    body.state.inertia = Vector3(1, 1, 1) * radius[k] ** 2
    O.bodies.append(body)
walls = [
    O.bodies.append(
        utils.wall(float(place), axis=side // 2, sense=1 - 2 * (side % 2), material="wall")
    )
    for side, place in enumerate(case["box"])
]
equal = {"kn": MatchMaker(algo="val", val=1.0), "ks": MatchMaker(algo="val", val=ks)}
spheres = Ig2_Sphere_Sphere_ScGeom6D() if bonded else Ig2_Sphere_Sphere_ScGeom()
physics = [Ip2_FrictMat_FrictMat_FrictPhys(**equal)]
laws = [Law2_ScGeom_FrictPhys_CundallStrack()]
if bonded:
    physics.append(Ip2_CohFrictMat_CohFrictMat_CohFrictPhys(setCohesionNow=True))
    laws.append(Law2_ScGeom6D_CohFrictPhys_CohesionMoment())
O.engines = [
    ForceResetter(),
    InsertionSortCollider([Bo1_Sphere_Aabb(), Bo1_Wall_Aabb()], verletDist=0.3),
    InteractionLoop([spheres, Ig2_Wall_Sphere_ScGeom()], physics, laws),
    NewtonIntegrator(damping=float(case["damping"])),
]


pairs = np.column_stack([case["a"], case["b"]]).tolist()
springs = zip(case["spring_kn"], case["spring_kr"], case["spring_unloaded"], strict=True)
spring_of = {
    (a, b): tuple(map(float, spring)) for (a, b), spring in zip(pairs, springs, strict=True)
}


def equal_stiffness():
    """Give contacts between bondable grains, which Yade makes from a modulus, ours instead."""
    for contact in O.interactions:
        a, b = sorted((contact.id1, contact.id2))
        kn, kr, unloaded = spring_of.get((a, b), (1.0, 0.0, 0.0))
        if b < n and contact.phys.kn != kn:
            contact.phys.kn, contact.phys.ks, contact.phys.kr = kn, ks * kn, kr
            contact.phys.unp = unloaded


if bonded:
    O.engines += [PyRunner(command="equal_stiffness()", iterPeriod=10)]

# a step of no time finds the contacts, which then get their shear forces
O.dt = 1e-15
O.step()
shear_of = {(a, b): force for (a, b), force in zip(pairs, case["shear"].tolist(), strict=True)}
if bonded:
    equal_stiffness()
for contact in O.interactions:
    a, b = sorted((contact.id1, contact.id2))
    if b < n:
        nx, ny = (x[b] - x[a], y[b] - y[a]) / np.hypot(x[b] - x[a], y[b] - y[a])
        force = shear_of.get((a, b), 0.0) * (1 if contact.id1 == a else -1)
        contact.phys.shearForce = Vector3(-ny, nx, 0.0) * force

O.dt = 0.3
steps = int(case["steps"])
for side, body in enumerate(walls):
    speed = (case["box_end"][side] - case["box"][side]) / (steps * O.dt)
    O.bodies[body].state.vel = Vector3(speed * (side < 2), speed * (side >= 2), 0.0)
O.run(steps, True)
for body in walls:
    O.bodies[body].state.vel = Vector3(0, 0, 0)


def ratio():
    """Mean unbalanced over mean contact force, as the model measures it."""
    free = np.mean([O.forces.f(k).norm() for k in range(n)])
    held = np.mean([(i.phys.normalForce + i.phys.shearForce).norm() for i in O.interactions])
    return free / held


while ratio() > float(case["ratio"]) and O.iter < 50 * steps:
    O.run(500, True)

rows = []
for contact in O.interactions:
    a, b = sorted((contact.id1, contact.id2))
    if b < n:
        sign = 1 if contact.id1 == a else -1
        normal = contact.geom.normal * sign
        tangent = Vector3(-normal[1], normal[0], 0)
        compression = contact.phys.normalForce.dot(contact.geom.normal)
        moment = contact.phys.moment_bending[2] if bonded else 0.0
        rows.append((a, b, compression, contact.phys.shearForce.dot(tangent) * sign, moment))
order = np.array(sorted(rows))
np.savez(
    os.environ["RESULT"],
    a=order[:, 0].astype(int),
    b=order[:, 1].astype(int),
    normal=order[:, 2],
    shear=order[:, 3],
    moment=order[:, 4],
    walls=np.array([abs(O.forces.f(body)[side // 2]) for side, body in enumerate(walls)]),
    ratio=ratio(),
    steps=O.iter,
    version=yade.config.version,
)
