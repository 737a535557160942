"""Wells and sides: where pressure is imposed, against closed forms of the flow around them."""

import math

import numpy as np
import pytest

from demflow.model.controls import sites
from demflow.model.flow.equation.wells import WELL_FLOOR
from demflow.model.flow.solvers.registry import SOLVERS
from demflow.model.outcome import ModelError
from demflow.model.permeability import permeability
from demflow.model.region import Circle, Polygon, Rectangle
from demflow.model.scene import BiWing, Probe, Trace, Well
from tests.reservoirs import dense_matrices, reservoir
from tests.rocks import hexagonal_lattice, random_graph, square_lattice

SQUARE = square_lattice(1.7, 1 / 50, (0.011, 0.004))
RANDOM = random_graph(1.7, 5000, 3)

every = pytest.mark.parametrize("method", SOLVERS)


def conductivity(rock, viscosity=1e-3):
    """Isotropic k/μ of an open network."""
    return (
        0.5
        * np.trace(permeability(rock.network, rock.apertures, viscosity=viscosity))
        / (viscosity)
    )


@pytest.mark.parametrize(
    ("packing", "within"),
    [
        (hexagonal_lattice(1.1, 1 / 60), 0.01),
        (square_lattice(1.1, 1 / 60, shift=(0.004, 0.007)), 0.02),
        (random_graph(1.1, 4000, 1), 0.05),
        (random_graph(1.1, 4000, 2), 0.05),
    ],
    ids=["hexagonal", "square", "random", "another"],
)
def test_radial_flow_follows_thiem(packing, within):
    """p_e − p_w = q ln(r_e/r_w) / (2π k/μ), by rate and by pressure alike."""
    rock = reservoir(packing, Circle(1.0))
    radius = 0.12
    expected = math.log(1 / radius) / (2 * math.pi * conductivity(rock))
    well = Well(name="w", at=(0.0, 0.0), radius=radius, rate=1.0)
    seen = rock.observed((well,), (("outer", 0.0),), method="steady")
    assert -seen["well_pressure"][0] == pytest.approx(expected, rel=within)
    held = Well(name="w", at=(0.0, 0.0), radius=radius, pressure=-expected)
    by_pressure = rock.observed((held,), (("outer", 0.0),), method="steady")
    assert by_pressure["well_rate"][0] == pytest.approx(
        expected / -seen["well_pressure"][0], rel=1e-9
    )


def test_the_well_s_radius_counts_not_the_pores_it_covers():
    """Radii between which no pore lies give pressures apart by their logarithms."""
    rock = reservoir(hexagonal_lattice(1.1, 1 / 60), Circle(1.0))
    drawdown = []
    for radius in (0.1, 0.13, 0.16, 0.2):
        well = Well(name="w", at=(0.0, 0.0), radius=radius, rate=1.0)
        seen = rock.observed((well,), (("outer", 0.0),), method="steady")
        drawdown.append(-seen["well_pressure"][0] * 2 * math.pi * conductivity(rock))
    np.testing.assert_allclose(drawdown, np.log(1 / np.array([0.1, 0.13, 0.16, 0.2])), rtol=0.01)


def test_a_well_narrower_than_a_pore_has_peaceman_s_radius():
    """The pore's pressure is that at 0.2 of the spacing; the well's goes on as the logarithm."""
    spacing = 1 / 30
    rock = reservoir(square_lattice(1.1, spacing / 2, (spacing / 2, spacing / 2)), Circle(1.0))
    for radius in (1e-4, 1e-3):
        well = Well(name="w", at=(0.0, 0.0), radius=radius, rate=1.0)
        seen = rock.observed((well,), (("outer", 0.0),), method="steady")
        drawdown = -seen["well_pressure"][0] * 2 * math.pi * conductivity(rock)
        assert drawdown == pytest.approx(math.log(1 / radius), rel=0.015)


@pytest.mark.slow
@pytest.mark.parametrize(
    "packing",
    [square_lattice(1.2, 0.05, (0.05, 0.05)), hexagonal_lattice(1.2, 0.05)],
    ids=["square", "hexagonal"],
)
@every
def test_wells_that_mirror_each_other_have_one_pressure(packing, method):
    rock = reservoir(packing, Circle(0.93))
    pair = tuple(Well(name=f"{x}", at=(x, 0.0), radius=0.12, rate=1e-6) for x in (-0.4, 0.4))
    times = (1.0, 100.0) if SOLVERS[method].transient else ()
    seen = rock.observed(pair, (("outer", 0.0),), times=times, method=method)
    np.testing.assert_allclose(*seen["well_pressure"], rtol=1e-6)


def test_an_injector_and_a_producer_leave_the_midline_alone():
    rock = reservoir(square_lattice(1.2, 0.05, (0.05, 0.05)), Rectangle(1.86, 1.46))
    pair = (
        Well(name="in", at=(-0.4, 0.0), radius=0.12, rate=-1e-6),
        Well(name="out", at=(0.4, 0.0), radius=0.12, rate=1e-6),
    )
    middle = tuple(Probe(f"{y}", (0.0, y)) for y in (-0.3, 0.0, 0.4))
    seen = rock.observed(pair, (("outer", 5.0),), method="steady", probes=middle)
    scale = abs(seen["well_pressure"][0] - 5.0)
    np.testing.assert_allclose(seen["probe_pressure"], 5.0, atol=1e-9 * scale)
    assert seen["well_pressure"].sum() == pytest.approx(10.0, abs=1e-9 * scale)


@pytest.mark.parametrize("shift", [0.0, 0.3, 0.5, 0.77])
@pytest.mark.parametrize(
    ("held", "size"), [(("left", "right"), (2.0, 1.4)), (("bottom", "top"), (1.4, 2.0))]
)
def test_straight_flow_has_the_length_between_the_sides(shift, held, size):
    """Q = (k/μ) Δp · rows · 2R / L at any offset of the lattice: the lines count, not the pores."""
    r = 0.05
    region = Rectangle(*size)
    offset = 2 * r * shift
    packing = square_lattice(1.3, r, (offset + r, r) if held[0] == "left" else (r, offset + r))
    rock = reservoir(packing, region)
    seen = rock.observed((), ((held[0], 2.0), (held[1], 0.0)), method="steady")
    k = 1e-15 / (24 * r) / 1e-3
    across = rock.network.y if held[0] == "left" else rock.network.x
    rows = len(np.unique(np.round(across[rock.network.inside], 9)))
    expected = 2.0 * k * rows * 2 * r / 2.0
    np.testing.assert_allclose(seen["boundary_flow"], [expected, -expected], rtol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_a_sealed_bar_conducts_as_its_permeability_says(seed):
    """Between two sides, the others sealed: k/μ · width / length within a few per cent."""
    region = Rectangle(2.0, 1.0)
    rock = reservoir(random_graph(1.1, 3000, seed), region)
    seen = rock.observed((), (("left", 1.0), ("right", 0.0)), method="steady")
    tensor = permeability(rock.network, rock.apertures, viscosity=1e-3) / 1e-3
    assert seen["boundary_flow"][0] == pytest.approx(tensor[0, 0] * 1.0 / 2.0, rel=0.03)


def test_a_pressure_gradient_on_every_side_is_met_exactly():
    """With one pressure all around nothing moves; each side feeds what leaves by the others."""
    rock = reservoir(random_graph(1.1, 800, 1), Rectangle(1.6, 1.2))
    names = ("left", "right", "bottom", "top")
    still = rock.observed((), tuple((n, 3.0) for n in names), method="steady")
    moved = rock.observed((), tuple(zip(names, (1.0, 0.0, 0.0, 0.0), strict=True)), method="steady")
    scale = moved["boundary_flow"][0]
    assert scale > 0
    assert np.all(moved["boundary_flow"][1:] < 0)
    assert np.all(np.abs(still["boundary_flow"]) < 1e-12 * scale)
    assert abs(moved["boundary_flow"].sum()) < 1e-12 * scale


def test_outer_is_all_sides_at_once():
    rock = reservoir(random_graph(1.1, 800, 1), Polygon(((-0.8, -0.8), (0.9, -0.6), (0.0, 0.9))))
    well = (Well(name="w", at=(0.0, -0.2), radius=0.1, rate=1e-6),)
    whole = rock.observed(well, (("outer", 1.0),), method="steady")
    parts = rock.observed(well, tuple((f"side[{k}]", 1.0) for k in range(3)), method="steady")
    np.testing.assert_allclose(whole["well_pressure"], parts["well_pressure"], rtol=1e-10)
    assert parts["boundary_flow"].sum() == pytest.approx(whole["boundary_flow"][0], rel=1e-10)
    assert np.all(parts["boundary_flow"] > 0)


@pytest.mark.parametrize("reverse", [False, True], ids=["one way round", "the other"])
@pytest.mark.parametrize("packing", [SQUARE, RANDOM])
def test_a_slot_thinner_than_a_pore_does_not_leak(packing, reverse):
    """Half of a strip of height H closed by a thin slot adds (4 H/π) ln √2 to its length.

    The flow through a slit in a wall across a strip, by conformal mapping.
    """
    slot = ((-0.002, -0.5), (-0.002, 0.0), (0.002, 0.0), (0.002, -0.5))
    corners = ((-1.5, 0.5), (-1.5, -0.5), *slot, (1.5, -0.5), (1.5, 0.5))
    # sides in the order of the corners: the left one is 0, or where reversed 6
    left, right = ("side[6]", "side[0]") if reverse else ("side[0]", "side[6]")
    rock = reservoir(packing, Polygon(corners[::-1] if reverse else corners))
    seen = rock.observed((), ((left, 1.0), (right, 0.0)), method="steady")
    whole = reservoir(packing, Rectangle(3.0, 1.0))
    plain = whole.observed((), (("left", 1.0), ("right", 0.0)), method="steady")
    longer = 4 / math.pi * math.log(math.sqrt(2))
    ratio = seen["boundary_flow"][0] / plain["boundary_flow"][0]
    assert ratio == pytest.approx(3 / (3 + longer), rel=0.03)


def test_a_slot_at_a_pressure_takes_from_both_of_its_sides():
    """Either half between its own side and its face of the slot, as if it were alone."""
    slot = ((-0.002, -0.5), (-0.002, 0.36), (0.002, 0.36), (0.002, -0.5))
    rock = reservoir(SQUARE, Polygon(((-1.5, 0.5), (-1.5, -0.5), *slot, (1.5, -0.5), (1.5, 0.5))))
    held = (("side[0]", 1.0), ("side[2]", 0.0), ("side[4]", 0.0), ("side[6]", 1.0))
    flow = rock.observed((), held, method="steady")["boundary_flow"]
    np.testing.assert_allclose(-flow[[1, 2]], flow[[0, 3]], rtol=0.03)
    whole = reservoir(SQUARE, Rectangle(3.0, 1.0))
    plain = whole.observed((), (("left", 1.0), ("right", 0.0)), method="steady")
    np.testing.assert_allclose(flow[[0, 3]], 2 * plain["boundary_flow"][0], rtol=0.05)


def test_a_part_narrower_than_two_pores_is_refused_with_its_sides():
    bar = ((-0.5, -0.02), (-0.5, -0.5), (-1.5, -0.5), (-1.5, 0.5), (-0.5, 0.5), (-0.5, 0.02))
    region = Polygon(
        (*bar, (0.5, 0.02), (0.5, 0.5), (1.5, 0.5), (1.5, -0.5), (0.5, -0.5), (0.5, -0.02))
    )
    with pytest.raises(ModelError, match=r"0\.04 m wide between side\[5\] and side\[11\]"):
        reservoir(RANDOM, region)


def test_sealing_a_side_leaves_the_rest_of_the_system_a_graph():
    """Edges that stand for cut pores join pores inside, with conductances above zero."""
    rock = reservoir(random_graph(1.1, 800, 2), Rectangle(1.6, 1.2))
    for sides in ((), ("left",), ("left", "right"), ("outer",)):
        system = (
            rock.assembled((), sides)
            if sides
            else rock.assembled(sites((Well(name="w", at=(0, 0), radius=0.1, rate=1.0),)), ())
        )
        assert np.all(system.edge_g > 0)
        assert np.all(system.fixed_g > 0)
        assert system.edge_i.max(initial=0) < system.n
        matrix, _ = dense_matrices(system)
        np.testing.assert_allclose(matrix, matrix.T)
        np.testing.assert_allclose(matrix.sum(axis=1), system.excess, atol=1e-12 * matrix.max())


def test_a_well_stores_nothing_and_covers_the_pores_within_its_radius():
    rock = reservoir(random_graph(1.1, 800, 3), Circle(1.0))
    well = Well(name="w", at=(0.1, -0.2), radius=0.2, rate=1.0)
    system = rock.assembled(sites((well,)), ("outer",))
    net = rock.network
    covered = (np.hypot(net.x - 0.1, net.y + 0.2) < 0.2) & net.inside
    assert covered.sum() > 5
    assert set(system.node_of_domain[covered].tolist()) == {system.pores}
    assert system.storage[system.pores] == 0
    np.testing.assert_allclose(
        system.storage[: system.pores], net.volume[system.domain] / rock.bulk_modulus
    )
    assert len(system.domain) + covered.sum() + system.isolated == net.inside.sum()


def test_a_fracture_starts_at_the_wall_of_its_well():
    """A bi-wing alone: q = T Δp (1/ℓ₁ + 1/ℓ₂), ℓ from the well's wall to the rim."""
    wings = (BiWing(name="wings", aperture=1e-4, at=(0.0, 0.0), angle=0.0, half_length=2.0),)
    well = (Well(name="w", at=(0.1, 0.0), radius=0.12, pressure=1.0),)
    carried = 1e-12 / 12e-3
    for packing in (
        square_lattice(1.3, 0.02, (0.02, 0.013)),
        random_graph(1.3, 2500, 1),
    ):
        rock = reservoir(packing, Circle(1.0), 0.0, wings)
        seen = rock.observed(well, (("outer", 0.0),), method="steady")
        expected = -carried * (1 / (0.9 - 0.12) + 1 / (1.1 - 0.12))
        assert seen["well_rate"][0] == pytest.approx(expected, rel=2e-3)


def test_a_well_that_touches_the_wall_of_a_pore_keeps_finite_conductances():
    rock = reservoir(random_graph(1.1, 800, 4), Circle(1.0))
    net = rock.network
    radii = np.sort(np.hypot(net.x, net.y))[3:12]
    for radius in radii * (1 - 1e-12):
        system = rock.assembled(
            sites((Well(name="w", at=(0.0, 0.0), radius=float(radius), rate=1.0),)), ("outer",)
        )
        plain = rock.assembled((), ("outer",))
        assert system.edge_g.max() <= plain.edge_g.max() / WELL_FLOOR * (1 + 1e-9)


def test_a_crossing_trace_feeds_the_well_it_passes_through():
    """A well on a trace between two sides splits it into two resistances."""
    trace = (Trace(name="t", aperture=1e-4, start=(-1.5, 0.01), end=(1.5, 0.01)),)
    rock = reservoir(random_graph(1.3, 1500, 2), Rectangle(2.0, 1.4), 0.0, trace)
    well = (Well(name="w", at=(0.2, 0.01), radius=0.1, rate=1e-11),)
    seen = rock.observed(well, (("left", 0.0), ("right", 0.0)), method="steady")
    carried = 1e-12 / 12e-3
    conductances = carried / np.array([1.2 - 0.1, 0.8 - 0.1])
    # the wall of the well may lie anywhere in a pore
    assert seen["well_pressure"][0] == pytest.approx(-1e-11 / conductances.sum(), rel=0.05)
    np.testing.assert_allclose(
        seen["boundary_flow"], 1e-11 * conductances / conductances.sum(), rtol=0.05
    )
