"""Smooth joints in linear coupling: springs in series with the rock, across them and along them."""

import dataclasses
from functools import cache

import numpy as np
import pytest

from demflow.model.coupling.frame import frame_of
from demflow.model.coupling.skeleton import skeleton_of
from demflow.model.mechanics.specimen.rock import build_specimen
from demflow.model.region import Rectangle
from demflow.model.scene import (
    Bonds,
    Coupling,
    Fluid,
    Grains,
    Joint,
    JointLine,
    Matrix,
    Scene,
    SceneError,
    Solver,
    Stress,
    Trace,
)
from demflow.model.stages import simulate
from tests.coupling.bored import packed

pytestmark = pytest.mark.usefixtures("packed_once")

STIFF = Joint(normal_stiffness=1e9, shear_stiffness=4e8, friction=0.6)
PLAIN = Scene(
    region=Rectangle(2.0, 2.0),
    grains=Grains(count=250, porosity=0.16, seed=1, modulus=2e10),
    matrix=Matrix(aperture=2e-5),
    fluid=Fluid(1e-3, 2.2e9),
    bonds=Bonds(kind="parallel", tensile_strength=1e9, shear_strength=1e9),
    stress=Stress(1e7, 1e7),
    boundaries=(("top", 0.0),),
    initial_pressure=0.0,
    coupling=Coupling(method="linear", load_yy=1e6),
    times=(1e-3, 1.0, 1e6),
    observe=("wall_displacement", "effective_stress"),
)


def jointed(**fields):
    trace = Trace(name="plane", start=(-1.2, 0.01), end=(1.2, 0.01), joint=STIFF)
    return dataclasses.replace(PLAIN, fractures=(trace,), **fields)


@cache
def done(kind: str):
    return simulate(PLAIN if kind == "plain" else jointed())


@pytest.mark.slow
def test_a_soft_joint_closes_by_the_load_over_the_stiffness_of_its_contacts():
    plain, found = done("plain"), done("jointed")
    line = JointLine((-1.2, 0.01), (1.2, 0.01), STIFF)
    grains = packed()
    specimen = build_specimen(grains, 2e10, 2.5, 0.5, PLAIN.bonds, (line,))
    s, hold = skeleton_of(specimen)
    length = (
        2.0 * float(grains.radius.mean()) * s.half_width[s.joint & (hold.overlap > -1e-9)].sum()
    )
    box = grains.box
    closure = 1e6 * (box[1] - box[0]) / (STIFF.normal_stiffness * length)
    more = plain["wall_displacement"][3, -1] - found["wall_displacement"][3, -1]
    assert more == pytest.approx(closure, rel=0.05)
    assert found["mass_balance_error"] <= 1e-11
    assert found["residual"] <= 1e-9
    # the stress before is met to a thousandth, by the explicit solver
    np.testing.assert_allclose(found["effective_stress"][1, -1], 1.1e7, rtol=2e-3)


@pytest.mark.slow
def test_both_solvers_agree():
    krylov = done("jointed")
    march = simulate(jointed(solver=Solver(method="implicit", tolerance=1e-4)))
    size = np.abs(krylov["wall_displacement"]).max()
    off = np.abs(march["wall_displacement"] - krylov["wall_displacement"]).max()
    assert off <= 1e-3 * size


def test_the_stiffness_is_that_of_contacts_in_small_displacements():
    """The march of breaking bonds states the same springs by other matrices."""
    soft, stiff = (Joint(normal_stiffness=k, shear_stiffness=0.7, friction=0.6) for k in (1.0, 3.0))
    grains, cement = packed(), PLAIN.bonds.elastic(2e10)
    lines = [JointLine((-0.9, -0.7), (0.9, 0.8), one) for one in (soft, stiff)]
    frames = [
        frame_of(grains, stiffness_ratio=2.5, friction=0.5, bonds=cement, joints=(line,))
        for line in lines
    ]
    specimen = build_specimen(grains, 1.0, 2.5, 0.5, cement, (lines[1],))
    s, hold = skeleton_of(specimen)
    kept = s.joint & (hold.overlap > -1e-9)
    n, free = len(grains.x), frames[0].free
    way, u = np.random.default_rng(1).standard_normal(len(free)), np.zeros(3 * n + 2)
    u[np.where(free >= 3 * n, (free + 3 * n) // 2, free)] = way  # walls: right and top
    energies = [float(way @ (frame.between @ way)) for frame in frames]
    share = 2.0 / 3.0 * s.kn[kept]
    wanted = float(share @ (s.parting @ u)[kept] ** 2)
    assert energies[1] - energies[0] == pytest.approx(wanted, rel=1e-9)


def test_apertures_that_follow_forces_refuse_joints():
    with pytest.raises(SceneError, match="where a joint is two springs, or breaking"):
        jointed(
            coupling=Coupling(method="apertures"), matrix=Matrix(aperture=2e-5, half_stress=1e7)
        )
