"""Traces: they carry the cubic law, seal as barriers, and never break, wherever they lie."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from demflow.model.network.apertures import transmissivity
from demflow.model.network.domains import network
from demflow.model.network.fractures.chains import chain_along
from demflow.model.network.fractures.crossings import crossings
from demflow.model.products import Permeability
from demflow.model.region import Circle, Polygon, Rectangle, clip_segment, contains
from demflow.model.scene import BiWing, FractureSet, Line, Trace, lines_of
from tests.reservoirs import reservoir
from tests.rocks import hexagonal_lattice, random_graph, square_lattice

R = 0.05
WIDE = Rectangle(2.0, 1.4)
PACKINGS = {
    "square": square_lattice(1.3, R),
    "hexagonal": hexagonal_lattice(1.3, R),
    "hexagonal, shifted": hexagonal_lattice(1.3, R, shift=(0.013, 0.021)),
    "random": random_graph(1.3, 700, 1),
    "random, coarse": random_graph(1.3, 250, 2),
}
NETWORKS = {name: network(packing, region=WIDE) for name, packing in PACKINGS.items()}
APERTURE, VISCOSITY = 1e-4, 1e-3
FROM_LEFT = (("left", 1.0), ("right", 0.0))

everywhere = pytest.mark.parametrize("rock", PACKINGS)


def steady(rock, *fractures, matrix=0.0, boundaries=FROM_LEFT, region=WIDE, **more):
    made = reservoir(PACKINGS[rock], region, matrix, fractures, viscosity=VISCOSITY)
    return made, made.observed((), boundaries, method="steady", **more)


def open_trace(start, end, name="open"):
    return Trace(name=name, aperture=APERTURE, start=start, end=end)


def barrier(start, end, multiplier=0.0):
    return Trace(name="barrier", transmissibility_multiplier=multiplier, start=start, end=end)


def cubic_law(made, trace=0):
    length = np.hypot(*(made.apertures.trace_end - made.apertures.trace_start)[trace])
    return transmissivity(APERTURE, VISCOSITY) / length


@pytest.mark.slow
@everywhere
@given(left=st.floats(-0.6, 0.6), right=st.floats(-0.6, 0.6))
@settings(max_examples=15)
def test_a_trace_in_a_sealed_matrix_carries_the_cubic_law(rock, left, right):
    """From side to side, at any place and angle: T Δp / ℓ, and p falls on a straight line."""
    across = ((-1.6, left - 0.3 * (right - left)), (1.6, right + 0.3 * (right - left)))
    fracture = open_trace(*across)
    made, seen = steady(rock, fracture)
    expected = cubic_law(made)
    np.testing.assert_allclose(seen["boundary_flow"], [expected, -expected], rtol=1e-9)
    (line,) = lines_of((fracture,), WIDE)
    responses = made.respond((), ("left", "right"), method="steady")
    nodes = responses.domain >= len(made.network.x)
    along = (made.apertures.node_x - line.start[0]) / (line.end[0] - line.start[0])
    np.testing.assert_allclose(responses.pressure[0, 0][nodes], 1 - along, atol=1e-9)


@everywhere
@pytest.mark.parametrize("height", [0.0, 2 * R, 0.05, math.sqrt(3) * R, 0.3])
def test_it_does_so_along_a_row_of_grains(rock, height):
    made, seen = steady(rock, open_trace((-1.5, height), (1.5, height)))
    assert seen["boundary_flow"][0] == pytest.approx(cubic_law(made), rel=1e-9)


@everywhere
@pytest.mark.parametrize("angle", [0.0, 0.1, 0.3, -0.4])
def test_it_does_so_through_the_centre_of_a_grain(rock, angle):
    packing = PACKINGS[rock]
    grain = int(np.argmin(np.hypot(packing.x - 0.1, packing.y)))
    step = 1.5 * np.array([math.cos(angle), math.sin(angle)])
    centre = np.array([packing.x[grain], packing.y[grain]])
    made, seen = steady(rock, open_trace(tuple(centre - step), tuple(centre + step)))
    assert seen["boundary_flow"][0] == pytest.approx(cubic_law(made), rel=1e-9)


@everywhere
def test_a_trace_drawn_from_rim_to_rim_reaches_both(rock):
    """Ends that lie on the rim, to the last digit, belong to it as those beyond it do."""
    made, seen = steady(rock, open_trace((-1.0, 0.11), (1.0, -0.2)))
    assert seen["boundary_flow"][0] == pytest.approx(cubic_law(made), rel=1e-9)
    np.testing.assert_allclose(made.apertures.trace_start, [(-1.0, 0.11)], atol=1e-12)


@everywhere
def test_a_trace_drawn_the_other_way_is_the_same(rock):
    ends = (-1.4, 0.2), (1.4, -0.35)
    flows = [
        steady(rock, open_trace(*way), matrix=2e-5)[1]["boundary_flow"]
        for way in (ends, ends[::-1])
    ]
    # crossings that are one node are so from the other end on
    np.testing.assert_allclose(*flows, rtol=1e-4)


@everywhere
def test_a_scaled_aperture_scales_the_flow_with_its_cube(rock):
    ends = (-1.4, 0.2), (1.4, -0.35)
    flows = [
        steady(rock, Trace(name="open", aperture=w, start=ends[0], end=ends[1]))[1]["boundary_flow"]
        for w in (1e-4, 3e-4)
    ]
    np.testing.assert_allclose(flows[1], 27 * flows[0], rtol=1e-9)


@everywhere
@given(data=st.data())
@settings(max_examples=15)
def test_chains_are_paths_of_pipes_with_places_in_order(rock, data):
    net = NETWORKS[rock]
    number = st.floats(-1.1, 1.1)
    start, end = (data.draw(st.tuples(number, number)) for _ in range(2))
    if math.dist(start, end) < 1e-3:
        return
    for line in lines_of((open_trace(start, end),), WIDE):
        chain = chain_along(net, line)
        assert len(chain.domain) in (0, len(chain.pipe) + 1)
        assert len(np.unique(chain.domain)) == len(chain.domain)
        assert np.all(net.inside[chain.domain])
        for k, pipe in enumerate(chain.pipe):
            assert {net.pipe_from[pipe], net.pipe_to[pipe]} == set(chain.domain[k : k + 2])
        assert np.all(np.diff(chain.place) > 0)
        assert np.all((chain.place >= 0) & (chain.place <= line.length * (1 + 1e-12)))
        assert np.all(chain.storage_length >= 0)
        assert chain.storage_length.sum() <= line.length * (1 + 1e-9)
        for pipe in chain.rim_pipe:
            assert pipe == -1 or pipe in net.cut


@everywhere
def test_domains_of_a_chain_lie_at_the_line(rock):
    net = NETWORKS[rock]
    (line,) = lines_of((open_trace((-1.4, -0.2), (1.4, 0.33)),), WIDE)
    chain = chain_along(net, line)
    along = (np.array(line.end) - line.start) / line.length
    offset = np.column_stack([net.x, net.y])[chain.domain] - line.start
    away = np.abs(offset[:, 1] * along[0] - offset[:, 0] * along[1])
    assert np.max(away) < 2 * np.sqrt(net.area.max())
    assert np.max(np.abs(offset @ along - chain.place)) < 2 * np.sqrt(net.area.max())


def test_the_pores_below_a_square_row_are_its_chain():
    """A line at half height of a row of pores passes each once, between its two contacts."""
    net = NETWORKS["square"]
    (line,) = lines_of((open_trace((-1.5, R), (1.5, R)),), WIDE)
    chain = chain_along(net, line)
    np.testing.assert_allclose(net.y[chain.domain], R)
    np.testing.assert_allclose(net.x[chain.domain], np.arange(-19, 20, 2) * R)
    np.testing.assert_allclose(chain.place, net.x[chain.domain] + 1.0)
    np.testing.assert_allclose(chain.storage_length, 2 * R)


@everywhere
@pytest.mark.parametrize("shift", [0.0, 0.013, 0.05])
@pytest.mark.parametrize("lean", [0.0, 0.31])
def test_a_sealed_barrier_passes_nothing(rock, shift, lean):
    _, open_flow = steady(rock, matrix=1e-5)
    wall = barrier((shift - lean, -1.0), (shift + lean, 1.0))
    _, sealed = steady(rock, wall, matrix=1e-5)
    assert np.all(np.abs(sealed["boundary_flow"]) <= 1e-9 * open_flow["boundary_flow"][0])


@everywhere
def test_a_barrier_drawn_from_rim_to_rim_seals(rock):
    _, open_flow = steady(rock, matrix=1e-5)
    _, sealed = steady(rock, barrier((0.02, -0.7), (0.21, 0.7)), matrix=1e-5)
    assert np.all(np.abs(sealed["boundary_flow"]) <= 1e-9 * open_flow["boundary_flow"][0])


@everywhere
def test_a_barrier_seals_a_fracture_that_crosses_it(rock):
    trace = open_trace((-1.5, 0.1), (1.5, -0.15))
    _, open_flow = steady(rock, trace, matrix=1e-5)
    _, sealed = steady(rock, trace, barrier((0.03, -1.0), (-0.1, 1.0)), matrix=1e-5)
    assert abs(sealed["boundary_flow"][0]) <= 1e-9 * open_flow["boundary_flow"][0]


def test_a_leaky_barrier_adds_its_resistance():
    """n pipes in a row, of which one keeps the part m: the flow falls by n / (n − 1 + 1/m)."""
    _, open_flow = steady("square", matrix=1e-5)
    n = 2.0 / (2 * R)  # two half pipes at the rims
    for m in (1.0, 0.5, 1e-2, 1e-4):
        _, leaky = steady("square", barrier((0.001, -1.0), (0.001, 1.0), m), matrix=1e-5)
        ratio = leaky["boundary_flow"][0] / open_flow["boundary_flow"][0]
        assert ratio == pytest.approx(n / (n - 1 + 1 / m), rel=1e-9)


@everywhere
def test_a_nearly_sealed_barrier_lets_through_in_proportion(rock):
    flows = [
        steady(rock, barrier((0.1, -1.0), (-0.1, 1.0), m), matrix=1e-5)[1]["boundary_flow"][0]
        for m in (1e-6, 1e-7)
    ]
    assert flows[0] / flows[1] == pytest.approx(10.0, rel=1e-3)


def test_a_short_barrier_leaves_the_rest_alone():
    net = NETWORKS["random"]
    line = Line(0, (-0.1, -0.2), (0.15, 0.1), False, False)
    met = crossings(net, np.array([line.start]), np.array([line.end]))
    across = np.isin(np.arange(len(net.pipe_from)), met.pipe)
    assert across.sum() == len(met.pipe)
    p = np.column_stack([net.x, net.y])
    for pipe in range(len(net.pipe_from)):
        ends = p[net.pipe_from[pipe]], p[net.pipe_to[pipe]]
        if not (net.inside[net.pipe_from[pipe]] or net.inside[net.pipe_to[pipe]]):
            continue
        assert across[pipe] == meet(line.start, line.end, *ends)
    assert 2 < across.sum() < 60


def meet(p, q, r, s):
    """Whether two segments cross, by solving for the crossing."""
    p, q, r, s = map(np.asarray, (p, q, r, s))
    t, u = np.linalg.solve(np.column_stack([q - p, r - s]), r - p)
    return 0 <= t <= 1 and 0 <= u <= 1


@everywhere
def test_crossing_traces_exchange_fluid(rock):
    """A plus sign held at 1 on the left and 0 on the other three sides: a star of resistances.

    The two share one node where they cross, in a sealed matrix to the last digits.
    """
    _made, seen = steady(
        rock,
        open_trace((-1.5, 0.013), (1.5, 0.013), "level"),
        open_trace((0.017, -1.5), (0.017, 1.5), "upright"),
        boundaries=(("left", 1.0), ("right", 0.0), ("bottom", 0.0), ("top", 0.0)),
    )
    arms = 1 / np.array([1.017, 0.983, 0.713, 0.687])  # conductances over T
    whole = transmissivity(APERTURE, VISCOSITY) * arms
    middle = whole[0] / whole.sum()
    expected = np.array([whole[0] * (1 - middle), *(-whole[1:] * middle)])
    np.testing.assert_allclose(seen["boundary_flow"], expected, rtol=1e-9)
    assert seen["boundary_flow"].sum() == pytest.approx(0, abs=1e-12 * whole[0])


@everywhere
@pytest.mark.parametrize("region", [WIDE, Circle(0.8)])
def test_traces_end_where_the_region_does(rock, region):
    start, end = (-1.5, -0.4), (0.3, 0.2)
    made, _ = steady(
        rock, open_trace(start, end), region=region, matrix=1e-6, boundaries=(("outer", 1.0),)
    )
    ((s0, s1),) = clip_segment(region, start, end)
    step = np.array(end) - start
    np.testing.assert_allclose(made.apertures.trace_start, [start + s0 * step], atol=1e-12)
    np.testing.assert_allclose(made.apertures.trace_end, [start + s1 * step], atol=1e-12)
    assert made.apertures.trace_pipes[0] > 3


@everywhere
@pytest.mark.parametrize("outside", [((3.0, 3.0), (4.0, 4.0)), ((-3.0, 0.9), (3.0, 0.9))])
def test_a_trace_outside_the_region_is_none(rock, outside):
    assert lines_of((open_trace(*outside),), WIDE) == []
    made, seen = steady(rock, open_trace(*outside), matrix=1e-5)
    plain, plainly = steady(rock, matrix=1e-5)
    np.testing.assert_array_equal(made.apertures.conductance, plain.apertures.conductance)
    np.testing.assert_array_equal(seen["boundary_flow"], plainly["boundary_flow"])


@everywhere
def test_a_trace_shorter_than_a_pore_breaks_nothing(rock):
    """It joins what it crosses, which is next to nothing; one that crosses nothing is idle."""
    net = NETWORKS[rock]
    d = int(np.argmin(np.hypot(net.x - 0.2, net.y - 0.1)))
    x, y = float(net.x[d]), float(net.y[d])
    ends = (x - 1e-4, y + 2e-5), (x + 1e-4, y)
    _, plainly = steady(rock, matrix=1e-5)
    made, seen = steady(rock, open_trace(*ends), matrix=1e-5)
    assert seen["boundary_flow"] == pytest.approx(plainly["boundary_flow"], rel=0.05)
    np.testing.assert_array_equal(made.apertures.volume, net.volume)
    # a barrier as short may still cut the pipes that meet beside it
    _, walled = steady(rock, barrier(*ends), matrix=1e-5)
    assert 0.9 < walled["boundary_flow"][0] / plainly["boundary_flow"][0] <= 1 + 1e-12


@pytest.mark.parametrize("gap", [None, 0.7])
@pytest.mark.parametrize("angle", [0.0, 0.4, math.pi / 2, -1.1, 2.0])
def test_a_set_is_parallel_spaced_and_staggered(angle, gap):
    length, spacing = 0.5, 0.3
    region = Circle(2.0)
    pieces = FractureSet(
        name="set", aperture=1e-4, angle=angle, length=length, spacing=spacing, gap=gap
    )
    lines = lines_of((pieces,), region)
    along = np.array([math.cos(angle), math.sin(angle)])
    across = np.array([-along[1], along[0]])
    period = length + (spacing if gap is None else gap)
    rows = {}
    for line in lines:
        a, b = np.array(line.start), np.array(line.end)
        row = (a @ across) / spacing
        assert row == pytest.approx(round(row), abs=1e-9)
        assert (b - a) @ across == pytest.approx(0, abs=1e-9)
        assert (b - a) @ along > 0
        if not (line.start_at_rim or line.end_at_rim):
            assert line.length == pytest.approx(length)
            phase = (0.5 * (a + b) @ along) / period - 0.5 * (round(row) % 2)
            assert phase == pytest.approx(round(phase), abs=1e-9)
        rows.setdefault(round(row), []).append((a @ along, b @ along))
    # one row through the origin, rows wherever the region is, no fracture left out in any
    assert sorted(rows) == list(range(min(rows), max(rows) + 1))
    assert max(rows) == -min(rows) == math.floor(2.0 / spacing)
    for row, stretches in rows.items():
        half = math.sqrt(4.0 - (row * spacing) ** 2)
        ends = [(-half, -half), *sorted(stretches), (half, half)]
        for (_, before), (after, _) in itertools.pairwise(ends):
            assert after - before <= period - length + 1e-9
            assert after - before >= -1e-9


def test_a_set_fills_its_share_of_the_region():
    """Length of fractures per area is length / (period · spacing)."""
    pieces = FractureSet(name="set", aperture=1e-4, angle=0.7, length=0.3, spacing=0.1, gap=0.2)
    region = Polygon(((-2.0, -2.0), (2.0, -1.0), (1.0, 2.5), (-1.5, 2.0)))
    total = sum(line.length for line in lines_of((pieces,), region))
    assert total / region.area == pytest.approx(0.3 / (0.5 * 0.1), rel=0.02)


def test_a_bi_wing_stands_symmetrically_about_its_centre():
    wings = BiWing(name="wings", aperture=1e-4, at=(0.1, -0.2), angle=0.6, half_length=0.35)
    (line,) = lines_of((wings,), Circle(1.0))
    np.testing.assert_allclose(0.5 * (np.array(line.start) + line.end), (0.1, -0.2), atol=1e-15)
    assert line.length == pytest.approx(0.7)
    slope = math.atan2(line.end[1] - line.start[1], line.end[0] - line.start[0])
    assert slope == pytest.approx(0.6)
    assert not line.start_at_rim
    assert not line.end_at_rim


@everywhere
def test_storage_handed_over_is_kept(rock):
    """Pores along a chain keep the fracture's own volume, the matrix beside has the rest."""
    fracture = Trace(
        name="wide", permeability=1e-13, start=(-0.8, 0.1), end=(0.7, -0.3), pore_storage="matrix"
    )
    unit = Permeability(1e-3 * np.eye(2))
    made = reservoir(PACKINGS[rock], WIDE, 1e-5, (fracture,), unit_permeability=unit)
    net, volume = made.network, made.apertures.volume
    (line,) = lines_of((fracture,), WIDE)
    chain = chain_along(net, line)
    width = made.apertures.aperture[chain.pipe].mean()
    floor = 1e-6 * net.volume.mean()
    assert volume.sum() == pytest.approx(net.volume.sum(), abs=len(chain.domain) * floor)
    off = np.setdiff1d(np.arange(len(volume)), chain.domain)
    assert np.all(volume[off] >= net.volume[off])
    assert np.any(volume[off] > 1.01 * net.volume[off])
    for d, stretch in zip(chain.domain, chain.storage_length, strict=True):
        around = np.concatenate([net.pipe_to[net.pipe_from == d], net.pipe_from[net.pipe_to == d]])
        if not np.isin(around, chain.domain).all():
            assert volume[d] == pytest.approx(max(width * stretch, floor), rel=1e-6)


@everywhere
def test_traces_store_in_their_own_volume_alone(rock):
    """Aperture times length, whatever crosses; the matrix keeps what it has."""
    pieces = FractureSet(name="set", aperture=APERTURE, angle=0.5, length=0.5, spacing=0.2)
    wings = BiWing(name="wings", aperture=2 * APERTURE, at=(0, 0), angle=-0.7, half_length=0.5)
    made, _ = steady(rock, pieces, wings, matrix=1e-5)
    lengths = [sum(line.length for line in lines_of((f,), WIDE)) for f in (pieces, wings)]
    expected = APERTURE * (lengths[0] + 2 * lengths[1])
    assert made.apertures.node_volume.sum() == pytest.approx(expected, rel=1e-9)
    np.testing.assert_array_equal(made.apertures.volume, made.network.volume)


def test_networks_hold_traces_within_the_region_only():
    net = NETWORKS["random"]
    (line,) = lines_of((open_trace((-1.5, 0.0), (1.5, 0.1)),), WIDE)
    chain = chain_along(net, line)
    assert np.all(contains(WIDE, np.column_stack([net.x, net.y])[chain.domain]))
