"""Hard cases of coupled rock, each with the outcome that docs/model.md states for it.

Those of marches through breaking bonds stand in test_breaking.
"""

import dataclasses
import math

import numpy as np
import pytest

from demflow.model.coupling import consolidation
from demflow.model.coupling.balance import Fluid, balanced
from demflow.model.coupling.march import Stepper
from demflow.model.coupling.setting import setting
from demflow.model.region import Rectangle
from demflow.model.scene import Bonds, Coupling, Grains, Matrix, Scene, SceneError, Solver
from demflow.model.scene import Fluid as SceneFluid
from demflow.model.scene.coupling import COUPLED
from demflow.model.stages import simulate
from tests.coupling.bored import packed, rock, run, well, wet
from tests.coupling_rocks import random_packing, specimen_of

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("packed_once")]

STRONG = Bonds(kind="parallel", tensile_strength=1e12, shear_strength=1e12)
SCENE = Scene(
    region=Rectangle(2.0, 1.5),
    grains=Grains(count=300, porosity=0.17, seed=2, modulus=2e10),
    matrix=Matrix(aperture=2e-5),
    fluid=SceneFluid(1e-3, 2.2e9),
    bonds=Bonds(kind="contact", tensile_strength=1e9, shear_strength=1e9),
    boundaries=(("top", 0.0),),
    initial_pressure=0.0,
    coupling=Coupling(method="linear", load_yy=1e6),
    times=(1e-3, 1.0, 1e5),
    observe=("wall_displacement", "effective_stress"),
)


def test_a_step_far_too_long_for_a_split_is_stable_for_fluid_and_frame_are_solved_at_once():
    """Solid and fluid in turns would grow: the split of drained rock by its largest ratio."""
    stiff = specimen_of(random_packing(), sides=("top",), fluid=1e12).rock
    rng = np.random.default_rng(3)
    p = rng.standard_normal(stiff.system.n)
    for _ in range(30):  # the largest eigenvalue of C⁻¹ AᵀK⁻¹A
        grown = stiff.squeeze.T @ stiff.frame.moved(stiff.squeeze @ p) / stiff.storage
        growth, p = np.linalg.norm(grown) / np.linalg.norm(p), grown / np.linalg.norm(grown)
    assert growth > 20.0
    u = stiff.frame.moved(stiff.squeeze @ p)
    before = p @ stiff.stored(p, u)
    stepper = Stepper(stiff)
    for step in (1e-9, 1e-3, 1e3, 1e9):
        after, moved = stepper.solve(step, stiff.stored(p, u))
        assert after @ stiff.stored(after, moved) <= before * (1.0 + 1e-9)
    assert np.abs(after).max() <= 1e-6 * np.abs(p).max()  # drained, at last


def test_no_split_is_offered():
    for given in ("split", "drained", "fixed_stress"):
        with pytest.raises(SceneError):
            Coupling(method=given)
        with pytest.raises(SceneError):
            Solver(method=given)
    with pytest.raises(SceneError, match="explicit solves no coupled transient"):
        dataclasses.replace(SCENE, solver=Solver(method="explicit"))


def test_a_first_step_far_too_long_is_shortened_until_the_break_is_found():
    """Outputs do not choose steps: the first bond breaks when it does, asked for or not."""
    often = run(packed(120), rock(), wet(), rate=-1e-2, times=(0.1, 0.2, 0.3, 0.35))
    once = run(packed(120), rock(), wet(), rate=-1e-2, times=(0.35,))
    assert once.events.contact[0] == often.events.contact[0]
    assert once.events.time[0] == pytest.approx(often.events.time[0], rel=1e-3)
    assert once.unbalanced < 1e-9


@pytest.mark.parametrize("porosity", [0.165, 0.19])
def test_mechanisms_of_contact_bonds_bear_their_load_and_give_in_more(porosity):
    """Bonds without bending leave grains that roll on one neighbour, which springs hold."""
    grains = dataclasses.replace(SCENE.grains, porosity=porosity)
    found = simulate(dataclasses.replace(SCENE, grains=grains))
    bent = dataclasses.replace(SCENE.bonds, kind="parallel")
    stiff = simulate(dataclasses.replace(SCENE, grains=grains, bonds=bent))
    assert found["mass_balance_error"] <= 1e-11
    assert found["residual"] <= 1e-9
    assert found["effective_stress"][1, -1] == pytest.approx(1e6, rel=1e-6)
    top, firm = found["wall_displacement"][3, -1], stiff["wall_displacement"][3, -1]
    assert 4.0 * firm < top < firm < 0.0


@pytest.mark.parametrize("fluid", [1e3, 1e12])
def test_gases_and_fluids_that_do_not_give_in_keep_their_volume(fluid):
    """In the end grains bear all; a gas bears nothing at once, a stiff fluid all that it can."""
    bent = dataclasses.replace(SCENE.bonds, kind="parallel")
    found = simulate(
        dataclasses.replace(SCENE, fluid=SceneFluid(1e-3, fluid), bonds=bent, times=(1e-6, 1e9))
    )
    _, yy, _ = found["effective_stress"]
    assert found["mass_balance_error"] <= 1e-9
    assert yy[-1] == pytest.approx(1e6, rel=1e-6)
    assert yy[0] > 0.99e6 if fluid == 1e3 else yy[0] < 0.8e6


@pytest.mark.parametrize("bulk_modulus", [1e9, 1e11, 1e13])
def test_sealed_rock_finds_its_balance_whatever_its_fluid(bulk_modulus):
    grains = packed(seed=2)
    given = setting(
        grains, None, rock=rock(STRONG), wet=wet(bulk_modulus=bulk_modulus, sides=()),
        wells=(well(grains),),
    )  # fmt: skip
    case, d = given.case, len(given.case.storage)
    still, none = np.zeros(d), np.zeros(d, bool)
    mass = case.pull @ given.u
    heavier = case.load.copy()
    heavier[-2:] *= 2.0
    found = balanced(
        case._replace(load=heavier), given.hold, given.u, still, mass, Fluid(0.0, still, none), none
    )
    assert found.reached
    assert found.off <= 1e-8
    assert np.all(np.isfinite(found.p))
    # fluid and grains share the load
    assert 0.0 < found.p.mean() * case.stiffness < 2.0 * 10e6
    assert math.isclose((case.storage * found.p + case.pull @ found.u).sum(), mass.sum(),
                        rel_tol=1e-9)  # fmt: skip


def test_sealed_rock_of_a_stiff_fluid_breaks_and_keeps_its_books():
    found = run(packed(120), rock(), wet(bulk_modulus=1e11, sides=()), rate=-2e-2, times=(0.06,))
    assert str(found.state.stopped) == ""
    assert len(found.events.time) > 0
    assert found.unbalanced < 1e-9


def test_a_scene_takes_the_solvers_that_couple_and_no_other():
    assert set(consolidation.SOLVERS) == set(COUPLED)
