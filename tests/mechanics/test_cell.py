"""Periodic packings: contacts through the edges of the cell, momentum, tiles without seams."""

import numpy as np
import pytest

from demflow.model.mechanics.contact.grains import at_rest
from demflow.model.mechanics.contact.law import Linear
from demflow.model.mechanics.motion.equilibrium import AT_REST, FIRE, NEVER, Stop
from demflow.model.mechanics.motion.servo import STANDING
from demflow.model.mechanics.packing.cell import Cell
from demflow.model.mechanics.packing.compaction import attempt, hydrostatic
from demflow.model.mechanics.packing.packing import pack
from demflow.model.mechanics.packing.packing_targets import by_porosity
from demflow.model.mechanics.packing.sizes import sizes_of
from demflow.model.mechanics.packing.tiles import tiled
from demflow.model.mechanics.specimen.measures import porosity
from demflow.model.outcome import ModelError
from demflow.model.scene import Fluid, Grains, Matrix, Scene
from demflow.model.stages import STAGES, simulate
from tests.mechanics.rocks import REGIONS, net_forces

LAW = sizes_of("uniform", 1.66, None, None)


@pytest.fixture(scope="module")
def trial():
    size = np.array([30.0, 22.0])
    return attempt(by_porosity(0.175, 2e-4), 0.175, size, LAW, [1, 0], periodic=True)


def touching(cell: Cell) -> dict[tuple[int, int], float]:
    """Overlaps by pairs of grains: all pairs, each at its nearest image."""
    grains, sides = cell.grains, cell.box[[1, 3]] - cell.box[[0, 2]]
    dx = grains.x[:, None] - grains.x
    dy = grains.y[:, None] - grains.y
    dx -= sides[0] * np.round(dx / sides[0])
    dy -= sides[1] * np.round(dy / sides[1])
    overlap = grains.radius[:, None] + grains.radius - np.hypot(dx, dy)
    a, b = np.nonzero(np.triu(overlap > 0.0, 1))
    return dict(zip(zip(a.tolist(), b.tolist(), strict=True), overlap[a, b], strict=True))


def test_contacts_are_all_pairs_at_their_nearest_images(trial) -> None:
    a, b, _, _, overlap, _ = trial.specimen.contacts()
    pairs = zip(np.minimum(a, b).tolist(), np.maximum(a, b).tolist(), strict=True)
    found = dict(zip(pairs, overlap, strict=True))
    wanted = touching(trial.specimen)
    assert len(found) == len(a)
    assert found.keys() == wanted.keys()
    for pair, size in wanted.items():
        assert found[pair] == pytest.approx(size, abs=1e-12)


def test_a_cell_comes_to_rest_at_its_pressure(trial) -> None:
    cell = trial.specimen
    assert trial.rested
    assert cell.run.ratio <= 1e-3
    area = (cell.box[1] - cell.box[0]) * (cell.box[3] - cell.box[2])
    assert cell.sums.virial_xx / area == pytest.approx(2e-4, rel=6e-3)
    assert cell.sums.virial_yy / area == pytest.approx(2e-4, rel=6e-3)
    assert trial.porosity == pytest.approx(0.175, abs=0.02)


def moving(n: int = 110) -> Cell:
    """Grains of equal mass that fly through a cell and its edges."""
    rng = np.random.default_rng(3)
    side = 16.0
    x, y = rng.uniform(-0.5 * side, 0.5 * side, (2, n))
    grains = at_rest(x, y, rng.uniform(0.6, 1.0, n), np.full(n, 4.0))
    box = 0.5 * side * np.array([-1.0, 1.0, -1.0, 1.0])
    return Cell(grains, box, Linear(1.0, 0.4, 0.3))


def test_no_contact_is_missed_and_momentum_is_kept_while_grains_part() -> None:
    cell = moving()
    for _ in range(12):
        cell.relax(STANDING, NEVER, damping=FIRE, steps=25)
        found = {(min(a, b), max(a, b)) for a, b, *_ in zip(*cell.contacts(), strict=True)}
        assert found == touching(cell).keys()
        grains = cell.grains
        speed = np.hypot(grains.vx, grains.vy).sum()
        assert abs(grains.vx.sum()) < 1e-12 * speed
        assert abs(grains.vy.sum()) < 1e-12 * speed
        force = np.hypot(grains.fx, grains.fy).sum()
        assert abs(grains.fx.sum()) < 1e-12 * force
        assert abs(grains.fy.sum()) < 1e-12 * force


def test_a_cell_rests_by_local_damping_as_well_and_tells_what_runs_away() -> None:
    cell = moving()
    stop = Stop(ratio=0.05, stress=0.01)
    assert cell.relax(hydrostatic(1e-3), stop, damping=0.5, steps=20_000) == AT_REST
    cell.grains.vy[7] = np.nan
    with pytest.raises(ModelError, match="ran away"):
        cell.relax(hydrostatic(1e-3), stop, damping=FIRE, steps=1000)


def test_the_place_of_the_cell_does_not_matter() -> None:
    """Grains moved through an edge of the cell, with all others, feel the same forces."""
    plain, moved = moving(), moving()
    for values, way in ((moved.grains.x, 5.0), (moved.grains.y, -3.0)):
        values[:] = -8.0 + np.mod(values + way + 8.0, 16.0)
    moved = Cell(moved.grains, moved.box, moved.law)
    for cell in (plain, moved):
        cell.relax(STANDING, NEVER, damping=FIRE, steps=100)
    np.testing.assert_allclose(plain.grains.fx, moved.grains.fx, atol=1e-9)
    np.testing.assert_allclose(plain.grains.torque, moved.grains.torque, atol=1e-9)


def test_tiles_have_no_seams(trial) -> None:
    """Forces balance on every grain, at the edges of a tile as within it."""
    cell = trial.specimen
    part = tiled(cell, np.array([80.0, 70.0]))
    np.testing.assert_array_equal(np.lexsort((part.b, part.a)), np.arange(len(part.a)))
    assert np.all(part.a < part.b)
    gap = np.hypot(part.x[part.a] - part.x[part.b], part.y[part.a] - part.y[part.b])
    overlap = part.radius[part.a] + part.radius[part.b] - gap
    np.testing.assert_allclose(overlap, part.overlap, atol=1e-12)

    class State:
        x, y, contact_a, contact_b = part.x, part.y, part.a, part.b
        normal_force, shear_force = part.overlap, part.shear
        box = 1e9 * np.array([-1.0, 1.0, -1.0, 1.0])

    force, torque = net_forces(State, part.radius, 1.0)
    inner = (np.abs(part.x) < 37.0) & (np.abs(part.y) < 32.0)
    mean = np.hypot(part.overlap, part.shear).mean()
    size = np.hypot(*force.T)
    grains = cell.grains
    np.testing.assert_allclose(
        size[inner], np.hypot(grains.fx, grains.fy)[part.twin][inner], atol=1e-9 * mean
    )
    assert np.abs(torque[inner]).mean() < 2e-3 * mean
    width, height = cell.box[1] - cell.box[0], cell.box[3] - cell.box[2]
    near = np.minimum(
        np.abs(np.mod(part.x, width) - 0.5 * width), np.abs(np.mod(part.y, height) - 0.5 * height)
    )
    edge = inner & (near < 1.5)
    assert edge.sum() > 100
    assert size[edge].mean() < 2e-3 * mean


@pytest.mark.parametrize("floaters", ["leave", "fit"])
def test_a_periodic_packing_covers_a_region(floaters: str) -> None:
    rock = pack(
        region=REGIONS["slab"], count=900, mean_radius=None, packing="periodic", radius_ratio=1.66,
        porosity=0.17, seed=1, tile=300, floaters=floaters,
    )  # fmt: skip
    assert float(rock.porosity) == pytest.approx(0.17, abs=0.003)
    n = len(rock.x)
    gap = np.hypot(rock.x[:, None] - rock.x, rock.y[:, None] - rock.y)
    gap -= rock.radius[:, None] + rock.radius
    a, b = np.nonzero(np.triu(gap < 0.0, 1))
    listed = rock.contact_a * n + rock.contact_b
    assert set((a * n + b).tolist()) <= set(listed.tolist())
    assert np.all(np.diff(listed) > 0)
    inner = rock.box + 6.0 * rock.radius.mean() * np.array([1.0, -1.0, 1.0, -1.0])
    measured = porosity(rock.x, rock.y, rock.radius, inner)
    assert measured == pytest.approx(float(rock.porosity), abs=0.003)
    if floaters == "leave":
        assert len(a) == len(listed)
    else:
        assert int(rock.floaters) < 0.01 * n
    by_name = {stage.name: stage.run for stage in STAGES}
    pores = by_name["network"](rock, region=REGIONS["slab"])
    assert float(pores.porosity) == pytest.approx(0.17, abs=0.02)


def test_a_cell_must_be_wide_enough() -> None:
    grains = at_rest(np.zeros(1), np.zeros(1), np.ones(1), np.ones(1))
    with pytest.raises(ModelError, match=r"raise grains\.tile"):
        Cell(grains, 2.0 * np.array([-1.0, 1.0, -1.0, 1.0]), Linear(1.0, 0.4, 0.3))


def test_a_periodic_packing_conducts_as_a_large_one() -> None:
    """Nothing at the edges of its tiles lets more or less through."""
    found = {}
    for packing in ("periodic", "random"):
        grains = Grains(count=1500, packing=packing, porosity=0.17, tile=400, seed=2)
        scene = Scene(
            region=REGIONS["disc"],
            grains=grains,
            matrix=Matrix(aperture=1e-5),
            fluid=Fluid(1e-3, 1e9),
            observe=("permeability",),
        )
        found[packing] = simulate(scene)
    tensor = found["periodic"]["permeability"]
    mean = 0.5 * np.trace(found["random"]["permeability"])
    assert abs(tensor[0, 1]) < 0.05 * mean
    np.testing.assert_allclose(np.diag(tensor), mean, rtol=0.08)
    assert float(found["periodic"]["floater_fraction"]) < 0.1
