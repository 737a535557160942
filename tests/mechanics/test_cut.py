"""Parts of a loaded specimen: balanced cuts, boreholes, pressure on a rim, gravity."""

import numpy as np
import pytest

from model.mechanics.cut import cut, excavate, gravity, press_on
from model.mechanics.equilibrium import AT_REST, Specimen, Stop
from model.mechanics.measures import listed, overlaps
from model.mechanics.rock import specimen_of
from model.mechanics.servo import STANDING
from model.mechanics.stress import straight_path
from model.region import Circle, Polygon
from model.scene import Bonds
from tests.mechanics.rocks import packed

BONDS = Bonds(kind="parallel", tensile_strength=1e9, shear_strength=1e9)
REGIONS = (Circle(8.0), Polygon(((-9.0, -6.0), (8.0, -7.0), (6.0, 9.0), (-5.0, 5.0))))


def pressed(bonds: Bonds | None) -> Specimen:
    specimen = specimen_of(packed(), 40e9, 2.5, 0.5, bonds)
    path = straight_path(2e-4, 3.5e-4, 2.5e-4)
    reason = specimen.relax(path, Stop(ratio=1e-4, stress=1e-3), damping=0.5, steps=100_000)
    assert reason == AT_REST
    return specimen


def contact_state(specimen: Specimen) -> np.ndarray:
    grains = specimen.grains
    a, b = listed(specimen.pairs)
    overlap = np.maximum(overlaps(grains.x, grains.y, grains.radius, a, b), 0.0)
    return np.column_stack([overlap, specimen.pairs.shear])[overlap > 0.0]


@pytest.mark.parametrize("region", REGIONS)
@pytest.mark.parametrize("bonds", [None, BONDS])
def test_a_cut_is_as_balanced_as_the_whole(region, bonds) -> None:
    whole = pressed(bonds)
    part = cut(whole, region)
    grains = whole.grains
    inside = np.isin(grains.x, part.grains.x)
    assert 20 < len(part.grains.x) == inside.sum() < len(grains.x)
    np.testing.assert_allclose(part.grains.fx, grains.fx[inside], rtol=0, atol=1e-17)
    np.testing.assert_allclose(part.grains.fy, grains.fy[inside], rtol=0, atol=1e-17)
    np.testing.assert_allclose(part.grains.torque, grains.torque[inside], rtol=0, atol=1e-17)
    before = contact_state(part)
    stop = Stop(ratio=1e-4, stress=np.inf)
    assert part.relax(STANDING, stop, damping=0.5, steps=2000) == AT_REST
    after = contact_state(part)
    assert len(before) == len(after)
    assert np.linalg.norm(after - before) < 1e-3 * np.linalg.norm(before)


def test_a_borehole_is_found_anew_in_equilibrium_and_can_be_held_open() -> None:
    whole = pressed(BONDS)
    hole = Circle(4.0)
    opened = excavate(whole, hole)
    assert len(opened.grains.x) < len(whole.grains.x)
    held = straight_path(2e-4, 3.5e-4, 2.5e-4)._replace(start_xx=3.5e-4, start_yy=2.5e-4)
    stop = Stop(ratio=1e-3, stress=5e-3)
    assert opened.relax(held, stop, damping=0.5, steps=60_000) == AT_REST
    ring = np.hypot(opened.grains.x, opened.grains.y)
    near = ring < 8.0
    closed = ring[near].mean()
    assert press_on(opened, Circle(5.0), 3e-4) >= 6
    assert abs(opened.grains.load_x.sum()) < 1e-12  # a closed rim
    assert opened.relax(held, stop, damping=0.5, steps=60_000) == AT_REST
    assert np.hypot(opened.grains.x, opened.grains.y)[near].mean() > closed
    with pytest.raises(ValueError, match="no grain"):
        excavate(whole, Circle(0.01))


def test_weight_rests_on_the_floor() -> None:
    whole = pressed(BONDS)
    weight = 1e-6 * whole.grains.radius**2
    bottom, top = whole.sums.bottom, whole.sums.top
    gravity(whole, weight)
    # a grain's weight is but 2e-3 of the mean contact force: rest must be far below that
    stop = Stop(ratio=1e-5, stress=np.inf)
    assert whole.relax(STANDING, stop, damping=0.5, steps=20_000) == AT_REST
    added = (whole.sums.bottom - bottom) - (whole.sums.top - top)
    assert added == pytest.approx(weight.sum(), rel=0.02)
