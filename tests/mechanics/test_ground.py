"""Holes in a rock under stress, a pressure in them, and the rock's own weight."""

from functools import cache

import numpy as np
import pytest

from demflow.model.analytic.holes import kirsch_stresses, lithostatic_stress
from demflow.model.mechanics.loading.stress import load, unit_loads
from demflow.model.outcome import ModelError
from demflow.model.products import StressState, UnitLoads
from demflow.model.region import Circle, Hole, Rectangle
from demflow.model.scene import Bonds, Ground, Stress
from tests.mechanics.rocks import net_forces, packed
from tests.shells import kirsch_rings, ring_stresses

KN = 40e9
STRONG = Bonds(kind="parallel", tensile_strength=1e12, shear_strength=1e12)
FAR, DENSITY, GRAVITY = 20e6, 2650.0, 5000.0  # a weight that tells in a rock of two metres


def state(
    seed: int = 1,
    *,
    count: int = 1500,
    stress: Stress,
    holes: tuple[Hole, ...] = (),
    pressures: tuple[float, ...] = (),
    gravity: float = 0.0,
    bonds: Bonds | None = STRONG,
) -> StressState:
    """A loaded rock; by the static solver where it is bonded and `stress` allows."""
    pressures = pressures or (0.0,) * len(holes)
    ground = Ground(DENSITY * gravity, holes, pressures)
    rock = packed(count=count, seed=seed)
    elastic = {"stiffness_ratio": 2.5, "friction": 0.5, "bonds": bonds}
    units = None
    if bonds is not None and stress.method != "explicit":
        units = units_of(count, seed, bonds, ground)
    return load(rock, units, normal_stiffness=KN, **elastic, stress=stress, ground=ground)


@cache
def units_of(count: int, seed: int, bonds: Bonds, ground: Ground) -> UnitLoads:
    """The unit loads of a rock, which many stresses share."""
    rock = packed(count=count, seed=seed)
    return unit_loads(rock, stiffness_ratio=2.5, friction=0.5, bonds=bonds, ground=ground.over(KN))


ROUND = Hole("hole", (0.0, 0.0), Circle(0.25))
EDGES = 0.25 * np.array([1.2, 1.7, 2.3, 3.0])


@cache
def rings(greatest: float, least: float, angle: float, pressure: float) -> np.ndarray:
    """Means over rings of six packings, (6, rings, 5)."""
    stress = Stress(xx=greatest, yy=least, angle=angle)
    every = [
        state(seed, stress=stress, holes=(ROUND,), pressures=(pressure,)) for seed in range(1, 7)
    ]
    assert all(int(one.static) for one in every)
    return np.array([ring_stresses(one, EDGES, angle) for one in every])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("greatest", "least", "angle", "pressure"),
    [
        (FAR, FAR, 0.0, 0.0),
        (FAR, FAR, 0.0, FAR),
        (FAR, FAR / 2, 0.6, 0.0),
        (FAR, FAR / 2, 2.0, 0.0),
    ],
)
def test_stresses_around_a_hole_are_kirschs_in_the_mean(greatest, least, angle, pressure):
    found = rings(greatest, least, angle, pressure) / FAR
    law = kirsch_rings(
        EDGES, radius=0.25, greatest=greatest, least=least, angle=angle, pressure=pressure
    )
    off = found.mean(axis=0) - law / FAR
    error = found.std(axis=0, ddof=1) / np.sqrt(len(found))
    # six packings: 4 standard errors are 99 % of the t distribution; 0.03 for a hole of ten grains
    assert np.all(np.abs(off) < 4.0 * error + 0.03)
    assert np.sqrt(np.mean(off**2)) < 0.05


def test_kirschs_stresses_balance_and_meet_the_rim():
    hole = {"radius": 2.0, "greatest": 3.0, "least": 1.0, "angle": 0.4, "pressure": 0.5}
    theta = np.linspace(0.0, 2.0 * np.pi, 50)
    radial, hoop, shear = kirsch_stresses(2.0, theta, **hole)
    np.testing.assert_allclose(radial, 0.5, atol=1e-14)
    np.testing.assert_allclose(shear, 0.0, atol=1e-14)
    assert hoop.max() == pytest.approx(3 * 3.0 - 1.0 - 0.5, rel=1e-2)
    # ∂σ_rr/∂r + (∂σ_rθ/∂θ)/r + (σ_rr − σ_θθ)/r = 0
    r, h = 3.1, 1e-4
    outer, inner = (kirsch_stresses(r + d, theta, **hole)[0] for d in (h, -h))
    left, right = (kirsch_stresses(r, theta + d, **hole)[2] for d in (h, -h))
    radial, hoop, _ = kirsch_stresses(r, theta, **hole)
    rest = (outer - inner) / (2 * h) + (left - right) / (2 * h * r) + (radial - hoop) / r
    np.testing.assert_allclose(rest, 0.0, atol=1e-6)


SEVERAL = (
    Hole("round", (0.45, 0.4), Circle(0.22)),
    Hole("drift", (-0.4, -0.3), Rectangle(0.5, 0.4)),
)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["static", "explicit"])
def test_every_grain_around_holes_is_in_balance(method):
    found = state(
        count=600,
        stress=Stress(xx=20e6, yy=12e6, method=method),
        holes=SEVERAL,
        gravity=GRAVITY / 10,
    )
    rock = packed(count=600)
    gone = np.isnan(found.x)
    assert 20 < gone.sum() < 0.2 * len(gone)
    assert not gone[np.r_[found.contact_a, found.contact_b]].any()
    force, _ = net_forces(found, np.where(gone, 0.0, rock.radius), KN)
    force[gone] = 0.0
    weight = DENSITY * GRAVITY / 10 * np.pi * rock.radius**2
    whole = weight[~gone].sum()
    assert force[:, 1].sum() == pytest.approx(whole, rel=0.01)  # which is what the loads are
    assert abs(force[:, 0].sum()) < 0.01 * whole
    held = np.zeros(len(gone))
    held[np.r_[found.contact_a, found.contact_b]] = 1
    own = (held > 0) & (np.abs(force[:, 1] - weight) < 0.5 * weight)
    assert own.sum() > 0.7 * (~gone).sum()  # the others bear that of floaters as well


@pytest.mark.parametrize("bonds", [STRONG, None])
def test_the_vertical_stress_grows_by_the_weight_above(bonds):
    found = state(
        count=600, stress=Stress(xx=30e6, yy=30e6, tolerance=1e-4), gravity=GRAVITY, bonds=bonds
    )
    rock = packed(count=600)
    assert bool(found.static) == (bonds is not None)
    width, height = found.box[1] - found.box[0], found.box[3] - found.box[2]
    levels = found.box[2] + height * np.linspace(0.15, 0.85, 15)
    x, y, a, b = found.x, found.y, found.contact_a, found.contact_b
    branch = np.column_stack([x[b] - x[a], y[b] - y[a]])
    normal = branch / np.hypot(*branch.T)[:, None]
    force_y = found.normal_force * normal[:, 1] + found.shear_force * normal[:, 0]
    force_y = np.where(branch[:, 1] > 0.0, force_y, -force_y)
    low, high = np.minimum(y[a], y[b]), np.maximum(y[a], y[b])
    across = np.array([force_y[(low < z) & (high > z)].sum() / width for z in levels])
    slope, at_zero = np.polyfit(levels, across, 1)
    porosity = 1.0 - np.pi * np.sum(rock.radius**2) / (width * height)
    law = lithostatic_stress(1.0, density=DENSITY, porosity=porosity, gravity=GRAVITY)
    assert -slope == pytest.approx(float(law), rel=0.03)
    middle = 0.5 * (found.box[2] + found.box[3])
    assert at_zero + slope * middle == pytest.approx(30e6, rel=0.01)
    carried = (found.wall_stress[2] - found.wall_stress[3]) * width
    assert carried == pytest.approx(DENSITY * GRAVITY * np.pi * np.sum(rock.radius**2), rel=0.01)


@pytest.mark.slow
def test_a_pressure_like_the_rocks_own_hides_the_hole():
    """In an elastic rock under p all around, a hole with p in it changes nothing, in the mean."""
    whole = state(stress=Stress(xx=FAR, yy=FAR))
    held = state(stress=Stress(xx=FAR, yy=FAR), holes=(ROUND,), pressures=(FAR,))
    empty = state(stress=Stress(xx=FAR, yy=FAR), holes=(ROUND,))
    beyond = np.array([0.3, 0.45])
    one, two, three = (ring_stresses(s, beyond, 0.0)[0, :2] / FAR for s in (whole, held, empty))
    assert np.abs(two - one).max() < 0.12
    assert three[0] < one[0] - 0.3
    assert three[1] > one[1] + 0.3


@pytest.mark.slow
def test_static_and_explicit_agree_on_a_hole():
    forces = []
    for method in ("static", "explicit"):
        found = state(
            count=600,
            stress=Stress(xx=20e6, yy=20e6, method=method, tolerance=1e-4),
            holes=SEVERAL[:1],
        )
        table = np.zeros((len(found.x), len(found.x)))
        table[found.contact_a, found.contact_b] = found.normal_force
        forces.append(table)
    assert np.linalg.norm(forces[1] - forces[0]) < 0.05 * np.linalg.norm(forces[0])


@pytest.mark.slow
def test_rims_beyond_their_strength_break_around_the_hole():
    weak = Bonds(kind="parallel", tensile_strength=25e6, shear_strength=25e6)
    stress = Stress(xx=40e6, yy=15e6)
    whole = state(count=600, stress=stress, bonds=weak)
    dug = state(count=600, stress=stress, bonds=weak, holes=(ROUND,))
    assert int(dug.broken_bonds) > int(whole.broken_bonds)
    fresh = np.hypot(dug.crack_x, dug.crack_y)[int(whole.broken_bonds) :]
    assert np.median(fresh) < 0.5


def test_a_hole_smaller_than_a_grain_is_refused():
    with pytest.raises(ModelError, match="no grain lies wholly in the hole"):
        state(
            count=600, stress=Stress(xx=1e7, yy=1e7), holes=(Hole("h", (0.0, 0.0), Circle(0.01)),)
        )
