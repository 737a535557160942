"""Cemented contacts that hold: states by superposition, what they cost, when they are refused."""

from __future__ import annotations

import numpy as np
import pytest

from demflow.model.mechanics.contact.bonds import (
    BROKEN_IN_SHEAR,
    BROKEN_IN_TENSION,
    INTACT,
    install,
)
from demflow.model.mechanics.contact.grains import at_rest
from demflow.model.mechanics.contact.law import Linear
from demflow.model.mechanics.contact.neighbours import Pairs
from demflow.model.mechanics.loading.stress import load, unit_loads
from demflow.model.mechanics.motion.equilibrium import NEVER, Specimen
from demflow.model.mechanics.motion.servo import STANDING
from demflow.model.mechanics.specimen.rock import build_specimen, cemented, elasticity, scaled
from demflow.model.mechanics.static import static, wall_contacts
from demflow.model.mechanics.static.displaced import FrictionalTrial
from demflow.model.mechanics.static.sticking import StickingTrial
from demflow.model.outcome import ModelError
from demflow.model.products import StressState, UnitLoads
from demflow.model.scene import Bonds, Stress
from tests.mechanics.rocks import net_forces, packed

KN = 40e9
BRIDGED = Bonds(kind="contact", tensile_strength=1e9, shear_strength=1e9, installation_gap=0.02)
PARALLEL = Bonds(kind="parallel", tensile_strength=1e9, shear_strength=1e9)
GRAINS = {"stiffness_ratio": 2.5, "friction": 0.5}


def responses(bonds: Bonds) -> UnitLoads:
    return unit_loads(packed(), bonds=bonds.elastic(KN), **GRAINS)


def loaded(units: UnitLoads | None, bonds: Bonds, xx: float, yy: float, **how) -> StressState:
    target = Stress(xx=xx * 1e6, yy=yy * 1e6, **how)
    return load(packed(), units, normal_stiffness=KN, bonds=bonds, stress=target, **GRAINS)


def trials(bonds: Bonds, units: UnitLoads) -> tuple[StickingTrial, FrictionalTrial]:
    """The same rock by the law of contacts that hold, and by the true one."""
    _, x, y, radius, box, _ = scaled(packed())
    a, b = units.contact_a, units.contact_b
    elastic = elasticity(None, KN, 2.5, 0.5, 0.0)
    cement = cemented(bonds, radius[a], radius[b], units.contact_distance, elastic, 2.5, 0)
    law = Linear(1.0, 0.4, 0.5)
    held = StickingTrial(at_rest(x, y, radius, np.ones(len(x))), box, law, cement, units)
    return held, FrictionalTrial(build_specimen(packed(), KN, 2.5, 0.5, bonds), units)


@pytest.mark.parametrize(("xx", "yy", "angle"), [(20, 20, 0.0), (24, 18, 0.0), (24, 18, 0.5)])
def test_a_state_is_in_balance_to_round_off(xx: float, yy: float, angle: float) -> None:
    """By the forces, places and walls that the product names, not by the solver's own sums."""
    rock, units = packed(), responses(BRIDGED)
    state = loaded(units, BRIDGED, xx, yy, angle=angle, method="static", tolerance=1e-10)
    assert int(state.steps) <= 4
    assert float(state.unbalanced_ratio) <= 1e-10
    if angle == 0.0:
        np.testing.assert_allclose(state.wall_stress, 1e6 * np.array([xx, xx, yy, yy]), rtol=1e-9)
        force, torque = net_forces(state, rock.radius, KN)
        mean = np.hypot(state.normal_force, state.shear_force).mean()
        assert np.hypot(*force.T).mean() <= 1e-9 * mean
        assert np.abs(torque / rock.radius).mean() <= 1e-9 * mean


def test_it_is_the_state_that_the_explicit_solver_finds() -> None:
    units = responses(BRIDGED)
    one = loaded(units, BRIDGED, 24, 18, method="static", tolerance=1e-8)
    other = loaded(None, BRIDGED, 24, 18, method="explicit", tolerance=1e-6)
    forces = [np.r_[state.normal_force, state.shear_force] for state in (one, other)]
    np.testing.assert_array_equal(one.contact_a, other.contact_a)
    assert np.linalg.norm(forces[0] - forces[1]) <= 1e-4 * np.linalg.norm(forces[1])
    np.testing.assert_allclose(np.diff(one.box)[::2], np.diff(other.box)[::2], rtol=1e-6)


def test_loads_add_up_but_for_the_moved_geometry() -> None:
    """What a sum leaves unbalanced away from walls: added stress times that and the packed one."""
    units = responses(BRIDGED)
    held, _ = trials(BRIDGED, units)
    added = np.array([8e6, 4e6, 0.0]) / KN
    left = []
    for part in (1.0, 0.5, 0.25):
        wanted = units.packed + part * added
        residual, _ = held.forces(units.base + part * added @ units.displacement, 0.0, wanted)
        on_grains = residual[:-2].reshape(-1, 3)
        left.append(np.linalg.norm(np.delete(on_grains, units.wall_grain, axis=0)))
    second = 2.0 * (left[0] - 2.0 * left[1])
    first = left[0] - second
    assert second > 0.0
    assert left[2] == pytest.approx(first / 4.0 + second / 16.0, rel=0.03)
    mean = held.sums.force / held.sums.contacts
    assert left[2] / np.sqrt(len(packed().x)) < 1e-3 * mean


@pytest.mark.parametrize("bonds", [BRIDGED, PARALLEL], ids=["contact", "parallel"])
def test_the_unbalance_that_is_told_bounds_the_true_one(bonds: Bonds) -> None:
    units = responses(bonds)
    held, true = trials(bonds, units)
    for added in ((0.0, 0.0), (1.0, 1.0), (4.0, -1.0)):
        wanted = units.packed + np.array([*added, 0.0]) * 1e6 / KN
        found = static.superpose(held, units, wanted, 10.0)
        grains, box = held.grains, held.box - held.first_box
        u = np.r_[np.column_stack([grains.vx, grains.vy, grains.spin]).ravel(), box[1], box[3]]
        assert found.corrections == 0
        assert true.forces(u, 0.0, wanted)[1] <= 1.05 * found.ratio + 1e-9


def test_contacts_that_slip_or_close_are_not_taken_for_held() -> None:
    units = responses(PARALLEL)
    near = loaded(units, PARALLEL, 20, 14, method="static", tolerance=1e-3)
    assert int(near.steps) > 0
    bare = Bonds(kind="contact", tensile_strength=1e9, shear_strength=1e9)
    held, _ = trials(bare, responses(bare))
    wanted = np.array([20e6, 20e6, 0.0]) / KN
    found = static.superpose(held, responses(bare), wanted, 1e-3)
    assert not found.reached
    assert "close" in found.why


def test_a_bond_over_its_strength_goes_to_the_explicit_solver() -> None:
    weak = Bonds(kind="contact", tensile_strength=2e6, shear_strength=4e6, installation_gap=0.02)
    state = loaded(responses(weak), weak, 24, 12)
    assert int(state.static) == 0
    assert int(state.broken_bonds) > 0


def bridge(**strengths) -> Specimen:
    """Two discs a tenth of a radius apart, joined by a contact bond."""
    radius, x = np.ones(2), np.array([-1.05, 1.05])
    bonds = install(
        "contact", modulus=0.5, stiffness_ratio=2.5, radius_a=radius[:1], radius_b=radius[1:],
        distance=np.array([2.1]), **strengths,
    )  # fmt: skip
    known = Pairs(
        np.array([0, 1, 1]), np.array([0], np.int32), np.array([1], np.int32),
        np.zeros(1), np.zeros(1), np.zeros(1, np.int32), x, np.zeros(2),
    )  # fmt: skip
    grains = at_rest(x, np.zeros(2), radius, np.full(2, np.inf))
    box = 1e3 * np.array([-1.0, 1.0, -1.0, 1.0])
    return Specimen(grains, box, Linear(1.0, 0.4, 0.5), bonds=bonds, known=known)


@pytest.mark.parametrize("way", [-0.01, 0.01])
def test_cement_across_a_gap_bears_nothing_at_first_and_then_as_a_contact(way: float) -> None:
    specimen = bridge(tensile_strength=np.ones(1), shear_strength=np.ones(1))
    for shift in (0.0, way):
        specimen.grains.x[1] = 1.05 + shift
        specimen.relax(STANDING, NEVER, damping=0.0, steps=0)
        assert specimen.grains.fx[1] == pytest.approx(-shift, abs=1e-15)


@pytest.mark.parametrize(
    ("slide", "mode"), [((0.04, 0.0), BROKEN_IN_TENSION), ((0.0, 0.1), BROKEN_IN_SHEAR)]
)
def test_cement_across_a_gap_breaks_at_its_strengths(slide, mode) -> None:
    """A bond of width 2 R̄ = 2 under 0.04 k_n of tension, or 0.04 k_n of shear at k_s = 0.4."""
    for strength, state in ((0.0201, INTACT), (0.0199, mode)):
        specimen = bridge(
            tensile_strength=np.full(1, strength), shear_strength=np.full(1, strength)
        )
        grains = specimen.grains
        grains.vx[1], grains.vy[1] = 1e-3 * np.array(slide) / specimen.dt
        specimen.relax(STANDING, NEVER, damping=0.0, steps=1000)
        grains.vx[:] = grains.vy[:] = 0.0
        assert specimen.bonds.state[0] == state
        if state != INTACT:  # what does not touch bears nothing
            specimen.relax(STANDING, NEVER, damping=0.0, steps=1)
            assert grains.fx[1] == grains.fy[1] == 0.0


def test_iterations_that_meet_their_bound_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    units = responses(PARALLEL)
    assert float(units.base_ratio) <= static.BASE_TOLERANCE
    held, _ = trials(PARALLEL, units)
    elastic, wanted = static.Elastic(units, held), np.array([1e-3, 2e-4, 0.0])
    elastic.superposed(wanted, 0.0)
    assert elastic.walls.settled
    assert elastic.doubts() == ""
    monkeypatch.setattr(wall_contacts, "MOST_CHANGES", 1)
    elastic.superposed(wanted, 0.0)
    assert not elastic.walls.settled
    assert "contacts with the walls open and close" in elastic.doubts()
    monkeypatch.setattr(static, "BASE_CORRECTIONS", 0)
    rough = responses(PARALLEL)
    assert float(rough.base_ratio) > static.BASE_TOLERANCE
    monkeypatch.setattr(static, "MOST_CORRECTIONS", 0)
    monkeypatch.setattr(static, "MOST_HELD", 0)
    with pytest.raises(ModelError, match=r"packed state .* has an unbalance of .* left"):
        loaded(rough, PARALLEL, 40.0, 8.0, method="static", tolerance=1e-8)
