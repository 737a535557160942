"""Marches through breaking bonds: books that balance, and how they end."""

from functools import cache

import numpy as np
import pytest

from demflow.model.coupling import breaking
from demflow.model.coupling.balance import Fluid, balanced
from demflow.model.coupling.setting import setting
from demflow.model.coupling.skeleton import (
    borne,
    broken,
    damped_energy,
    load_factors,
    stored_energy,
)
from demflow.model.mechanics.packing.packing import pack
from demflow.model.products import build, named
from demflow.model.scene import Bonds
from demflow.model.scene.lines import RefinedPlace
from tests.coupling.bored import BONDS, REGION, packed, rock, run, well, wet

pytestmark = pytest.mark.slow

WEAK = Bonds(kind="parallel", tensile_strength=0.0, shear_strength=0.0)


@cache
def reference():
    """A run to fracture and beyond."""
    return run(packed(), rock(), wet(), times=(0.3, 0.5, 0.65), record_map=True)


def test_a_run_to_fracture_keeps_its_books():
    found = reference()
    kept, events = found.records, found.events
    assert len(events.time) >= 5
    assert np.all(np.diff(events.time) >= 0.0)
    moved = np.abs(kept.injected) + np.abs(kept.let_in).sum(axis=1)
    assert np.all(np.abs(kept.stored - kept.injected - kept.let_in.sum(axis=1)) < 1e-12 * moved)
    np.testing.assert_allclose(kept.injected, 4e-3 * kept.time, rtol=1e-12)
    assert found.unbalanced < 1e-9
    work, viscous, slip, released, astray, jerks = kept.energies.T
    assert np.all(astray < 1e-9 * np.abs(work).max())
    assert np.all(np.abs(jerks) < 1e-3 * np.abs(work).max())
    assert np.all(np.diff(viscous) > 0.0)
    assert np.all(slip > -1e-6 * viscous.max())
    assert np.all(events.energy > 0.0)
    assert released[-1] == pytest.approx(events.energy[events.time > 0.0].sum())
    assert np.all(np.diff(kept.crack_length) >= 0.0)
    assert kept.well_pressure.max() > 10e6
    assert found.highest[0] > 1.01 * kept.well_pressure.max()  # between outputs
    assert found.aperture.max() > 5e-5  # opened twice as wide as it was, and more
    lowest = float(found.state.p.min()) * 20e9
    assert lowest < -1e4  # what opens sucks, below any liquid


def test_a_march_goes_on_from_what_is_stored_with_the_same_bits():
    rocks, fluid = rock(), wet()
    first = run(packed(), rocks, fluid, times=(0.2, 0.4))
    stored = build(type(first), {k: np.asarray(v) for k, v in named(first).items()})
    later = [
        run(packed(), rocks, fluid, times=(0.5, 0.6), start=0.4, before=one)
        for one in (first, stored)
    ]
    for name, one in named(later[0]).items():
        np.testing.assert_array_equal(np.asarray(one), np.asarray(named(later[1])[name]), name)
    assert len(later[0].records.time) == 4
    whole = run(packed(), rocks, fluid, times=(0.2, 0.4, 0.5, 0.6))
    np.testing.assert_allclose(
        later[0].records.well_pressure, whole.records.well_pressure, rtol=1e-3
    )


def test_a_break_sets_free_what_the_bond_stored_and_half_of_its_force_times_its_parting():
    """Where nothing else changes its state the rock is linear: Betti's theorem says how much."""
    grains = packed()
    given = setting(grains, None, rock=rock(friction=100.0), wet=wet(), wells=(well(grains),))
    case, s = given.case, given.case.skeleton
    d = len(case.storage)
    nothing = np.zeros(d, bool)
    mass = case.pull @ given.u
    before = borne(s, given.hold, given.u)
    tension = load_factors(s, given.hold, before)[0]
    tried = 0
    for k in np.argsort(-tension)[:8]:
        hold = broken(s, given.hold, before, given.u, int(k), 1)
        after = balanced(
            case, hold, given.u, np.zeros(d), mass, Fluid(0.0, np.zeros(d), nothing), nothing
        )
        assert after.reached
        if np.any(after.found.closed != before.closed) or np.any(after.found.slips):
            continue
        tried += 1
        free = stored_energy(s, given.hold, before, given.u) + case.load @ (after.u - given.u)
        free -= stored_energy(s, hold, after.found, after.u) + 0.5 * case.storage @ after.p**2
        free -= damped_energy(hold, after.u)
        bend = s.bending @ (after.u - given.u)
        force = np.array([before.cement_n[k], before.cement_s[k], before.cement_m[k]])
        ways = np.array([after.found.part - before.part, after.found.slide - before.slide, bend])
        stiff = np.array([s.cn[k], s.cs[k], s.cm[k]])
        expected = 0.5 * np.sum(force**2 / stiff) - 0.5 * force @ ways[:, k]
        assert free == pytest.approx(expected, rel=1e-6)
    assert tried > 2


def test_fluid_stays_in_its_pore_while_a_bond_breaks():
    grains = packed()
    given = setting(grains, None, rock=rock(), wet=wet(), wells=(well(grains),))
    case, s = given.case, given.case.skeleton
    d = len(case.storage)
    nothing = np.zeros(d, bool)
    before = borne(s, given.hold, given.u)
    k = int(np.argmax(load_factors(s, given.hold, before)[0]))
    mass = case.pull @ given.u
    after = balanced(
        case, broken(s, given.hold, before, given.u, k, 1), given.u, np.zeros(d), mass,
        Fluid(0.0, np.zeros(d), nothing), nothing,
    )  # fmt: skip
    assert np.abs(case.storage * after.p + case.pull @ after.u - mass).max() < 1e-12
    assert after.p.min() < 0.0  # what opens is filled by what is there, at less pressure


def test_a_step_of_first_order_converges_as_such():
    grains, strong = packed(), Bonds(kind="parallel", tensile_strength=1e12, shear_strength=1e12)
    given = setting(grains, None, rock=rock(strong), wet=wet(), wells=(well(grains),))
    found = []
    for steps in (8, 16, 32, 64):
        state = breaking.start(given, 1)
        u, p, mass = state.u, state.p, state.mass
        inflow = np.zeros(len(p))
        inflow[given.well] = 1e-3 / given.case.unit**2
        nothing = np.zeros(len(p), bool)
        for _ in range(steps):
            now = balanced(
                given.case, given.hold, u, p, mass, Fluid(0.2 / steps, inflow, nothing), nothing
            )
            u, p, mass = now.u, now.p, mass + now.net
        found.append(float(p[given.well[0]]))
    closer = np.abs(np.diff(found))
    assert np.log2(closer[:-1] / closer[1:]) == pytest.approx(1.0, abs=0.15)


# Hard cases, each with the outcome that is stated for it.


def test_injection_far_faster_than_the_rock_drains_breaks_it_and_keeps_its_books():
    found = run(packed(), rock(), wet(sides=()), rate=-0.1, times=(1e-3, 0.02))
    assert found.unbalanced < 1e-9
    assert len(found.events.time) > 0
    assert found.records.stored[-1] == pytest.approx(found.records.injected[-1], rel=1e-12)


@pytest.mark.parametrize("bulk_modulus", [1e3, 1e12])
def test_soft_and_stiff_fluids_keep_their_books(bulk_modulus):
    found = run(packed(), rock(), wet(bulk_modulus=bulk_modulus), times=(0.1, 0.3))
    assert str(found.state.stopped) == ""
    assert found.unbalanced < 1e-9
    kept = found.records
    assert abs(kept.stored[-1] - kept.injected[-1] - kept.let_in[-1].sum()) < 1e-12
    if bulk_modulus == 1e3:  # a gas takes it all: nothing happens
        assert kept.well_pressure[-1, 0] < 1e4


def test_bonds_without_strength_break_at_once_and_the_rock_comes_apart():
    found = run(packed(90), rock(WEAK), wet(), rate=-1e-6, times=(1e-3,))
    assert np.all(found.events.time == 0.0)
    assert len(found.events.time) > 20
    assert any(word in str(found.state.stopped) for word in ("apart", "free", "ran away"))
    assert len(found.records.time) == 0


def test_three_to_one_breaks_at_time_zero_and_then_along_the_larger_stress():
    found = run(packed(), rock(stress=(15e6, 5e6)), wet(), times=(0.4,))
    assert np.count_nonzero(found.events.time == 0.0) >= 1
    late = found.events.time > 0.0
    assert late.sum() >= 4
    assert np.abs(found.events.x[late]).mean() > 2.0 * np.abs(found.events.y[late]).mean()
    assert found.records.energies[0, 3] < found.events.energy.sum()  # books begin at time zero
    work, astray = found.records.energies[0, [0, 4]]
    assert astray < 1e-6 * abs(work)


def test_suction_stops_where_the_liquid_turns_to_vapour():
    found = run(packed(), rock(), wet(least_pressure=-1e4), times=(0.3, 0.5, 0.65))
    assert float(found.state.p.min()) * 20e9 >= -1e4 * (1 + 1e-9)
    assert found.records.lowest.min() >= -1e4 * (1 + 1e-9)
    assert found.unbalanced < 1e-9
    assert len(found.events.time) >= 5


def test_without_gap_factor_cracks_conduct_no_better():
    found = run(packed(), rock(), wet(gap_factor=0.0), times=(0.65,))
    assert found.aperture.max() == pytest.approx(2e-5)
    assert len(found.events.time) > 0


def test_contact_bonds_break_too():
    found = run(packed(), rock(BONDS["contact"]), wet(), times=(1.0,))
    assert len(found.events.time) > 3
    assert found.unbalanced < 1e-9


def test_a_well_at_a_pressure_gives_what_its_rock_takes():
    found = run(packed(), rock(), wet(), pressure=3e6, times=(10.0, 1000.0, 1001.0))
    kept = found.records
    np.testing.assert_allclose(kept.well_pressure, 3e6, rtol=1e-12)
    assert kept.injected[-1] == 0.0
    rate = kept.let_in[2, 1] - kept.let_in[1, 1]
    assert -kept.well_rate[-1, 0] == pytest.approx(rate, rel=1e-6)
    assert kept.side_flow[-1, 0] == pytest.approx(-rate, rel=1e-6)


def test_graded_grains_conduct_as_coarse_ones_until_what_opens_is_as_long_as_it_is():
    grains = pack(
        region=REGION, count=250, mean_radius=None, packing="random", radius_ratio=1.66,
        porosity=0.16, seed=1, specimen=True,
        refine=(RefinedPlace((0.0, 0.0), (0.0, 0.0), 0.3, 0.4),),
    )  # fmt: skip
    assert np.ptp(grains.scale) > 0.4
    given = setting(grains, None, rock=rock(), wet=wet(), wells=(well(grains, 0.1),))
    c, net = given.case.conduits, given.network
    within = (given.side[net.pipe_from] < 0) & (given.side[net.pipe_to] < 0)
    unit = given.case.unit**2 * 12.0 * 1e-3 / given.case.stiffness
    np.testing.assert_allclose(
        c.factor * c.wide**3 * unit, 2e-5**3 / net.pipe_length[within], rtol=1e-12
    )
    known = c.contact >= 0
    reach = net.grain_radius[net.pipe_grain_a] + net.grain_radius[net.pipe_grain_b]
    np.testing.assert_allclose((c.factor * unit)[known], 1.0 / reach[within][known], rtol=1e-12)


def test_what_opens_conducts_by_its_width_until_the_fluid_loses_nothing_in_it():
    grains, rate = packed(), 1e-3
    for viscosity in (1e-9, 1e-3, 100.0):
        fluid = wet()._replace(viscosity=viscosity, largest_rate=rate)
        case = setting(grains, None, rock=rock(), wet=fluid, wells=(well(grains),)).case
        lost = 12.0 * viscosity * 2.0 * case.unit * rate / case.widest**3  # Pa in a pipe
        assert lost <= 1.001e-4 * 10e6 or case.widest >= breaking.RUNAWAY * case.unit


def test_a_pore_squeezed_to_nothing_ends_the_march():
    grains = packed()
    given = setting(grains, None, rock=rock(), wet=wet(), wells=(well(grains),))
    march, state = breaking.March(given, given.u, 1, 1e-2), breaking.start(given, 1)
    volume = given.network.volume[given.pore] / given.case.unit**2
    k = int(np.argmin(volume))
    row = given.case.pull[[k]].toarray()[0]
    way = -row * volume[k] / (row @ row)
    assert march._ends(state._replace(u=given.u + 0.99 * way)) == ""
    assert "squeezed to nothing" in march._ends(state._replace(u=given.u + way))


def test_a_well_that_empties_its_pore_squeezes_it_and_what_came_before_is_kept():
    """Nothing flows to it, and its fluid does not give in: the grains around have to make room."""
    grains, strong = packed(), Bonds(kind="parallel", tensile_strength=1e12, shear_strength=1e12)
    rate, times = float(grains.radius.mean()) ** 2, tuple(np.arange(0.05, 1.01, 0.05))
    found = run(
        grains, rock(strong), wet(sides=(), aperture=1e-9, bulk_modulus=1e12), rate=rate,
        radii=0.01, times=times,
    )  # fmt: skip
    assert "a pore was squeezed to nothing" in str(found.state.stopped)
    kept = found.records
    assert 5 < len(kept.time) < len(times)
    np.testing.assert_allclose(kept.stored, -rate * kept.time, rtol=1e-9)
    assert np.all(np.diff(kept.well_pressure[:, 0]) < 0.0)
    assert found.unbalanced < 1e-9


def test_a_grain_without_contact_in_a_pore_stays_where_it_is():
    grains = packed()
    given = setting(grains, None, rock=rock(), wet=wet(), wells=(well(grains),))
    taken = np.hypot(grains.x, grains.y) < well(grains).radius
    floats = ~given.grains & ~taken
    assert floats.any()
    rows = (3 * np.flatnonzero(floats)[:, None] + np.arange(2)).ravel()
    assert abs(given.case.push[rows]).max() < 1e-12  # fluid presses on it from all sides alike
    found = reference()
    np.testing.assert_allclose(found.state.u[rows], given.u[rows], atol=1e-9)
