"""Traces as they are drawn: the graph that they alone make, tips, corners, wells, barriers."""

import itertools
import math

import numpy as np
import pytest

from demflow.model.network.apertures import transmissivity
from demflow.model.network.domains import network
from demflow.model.network.fractures.walk import walk
from demflow.model.permeability import permeability
from demflow.model.region import Circle, Rectangle
from demflow.model.scene import FlowLine, Trace, Well
from tests.reservoirs import reservoir
from tests.rocks import hexagonal_lattice, random_graph, square_lattice

R, VISCOSITY = 0.05, 1e-3
BOX = Rectangle(2.0, 1.4)
ROCK = random_graph(1.3, 700, 1)
ACROSS = (("left", 1.0), ("right", 0.0))


def random_traces(count, seed):
    """Traces of several lengths and apertures all over the box."""
    rng = np.random.default_rng(seed)
    middle = rng.uniform((-1.0, -0.7), (1.0, 0.7), (count, 2))
    angle, half = rng.uniform(0, math.pi, count), rng.uniform(0.05, 0.6, count)
    step = half[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    return tuple(
        Trace(name=f"f{k}", aperture=w, start=tuple(a), end=tuple(b))
        for k, (a, b, w) in enumerate(
            zip(middle - step, middle + step, rng.uniform(5e-5, 3e-4, count), strict=True)
        )
    )


def flow_of_the_graph(traces):
    """Inflow at the left by dense elimination on all pairwise crossings of the traces."""
    ends = [(np.array(t.start), np.array(t.end)) for t in traces]
    places, node, position = [[] for _ in traces], 2, []
    for k, (a, b) in enumerate(ends):
        for side, x in ((0, -1.0), (1, 1.0)):
            s = (x - a[0]) / (b[0] - a[0])
            if 0 < s < 1 and abs(a[1] + s * (b[1] - a[1])) < 0.7:
                places[k].append((s, side))
        for m in range(k):
            c, d = ends[m]
            s, u = np.linalg.solve(np.column_stack([b - a, c - d]), c - a)
            x, y = a + s * (b - a)
            if 0 < s < 1 and 0 < u < 1 and abs(x) < 1.0 and abs(y) < 0.7:
                places[k].append((s, node))
                places[m].append((u, node))
                node += 1
                position.append((x, y))
    matrix = np.zeros((node, node))
    for trace, (a, b), found in zip(traces, ends, places, strict=True):
        found.sort()
        for (s, i), (u, j) in itertools.pairwise(found):
            middle = a + 0.5 * (s + u) * (b - a)
            if abs(middle[0]) > 1.0 or abs(middle[1]) > 0.7:
                continue
            g = transmissivity(trace.aperture, VISCOSITY) / ((u - s) * math.dist(a, b))
            matrix[[i, j], [i, j]] += g
            matrix[[i, j], [j, i]] -= g
    inner = np.arange(2, node)
    p = np.zeros(node)
    p[0] = 1.0
    p[inner] = np.linalg.lstsq(matrix[2:, 2:], -matrix[2:, 0], rcond=1e-13)[0]
    return float(matrix[0] @ p)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_in_a_sealed_matrix_flow_is_that_of_the_traces_graph(seed):
    traces = random_traces(60, seed)
    made = reservoir(ROCK, BOX, 0.0, traces, viscosity=VISCOSITY)
    seen = made.observed((), ACROSS, method="steady")
    expected = flow_of_the_graph(traces)
    assert expected > 0.0
    assert seen["boundary_flow"][0] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("rock", [ROCK, hexagonal_lattice(1.3, R), square_lattice(1.3, R)])
def test_traces_that_do_not_meet_conduct_nothing(rock):
    """Tips a hundredth of a pore apart, in the same pore."""
    pair = (
        Trace(name="one", aperture=1e-4, start=(-1.5, 0.11), end=(0.013, 0.11)),
        Trace(name="two", aperture=1e-4, start=(0.014, 0.11), end=(1.5, 0.11)),
    )
    seen = reservoir(rock, BOX, 0.0, pair).observed((), ACROSS, method="steady")
    assert seen["boundary_flow"][0] == 0.0


@pytest.mark.parametrize("shift", [0.0, 1e-12, 1e-3])
def test_traces_drawn_twice_or_side_by_side_carry_the_sum(shift):
    """On each other, within round-off of it, and apart within one pore, in part or as a whole."""
    pair = tuple(
        Trace(
            name=f"{k}", aperture=1e-4, start=(-1.5, 0.11 + k * shift), end=(1.5, 0.11 + k * shift)
        )
        for k in (0, 1)
    )
    made = reservoir(ROCK, BOX, 0.0, pair, viscosity=VISCOSITY)
    seen = made.observed((), ACROSS, method="steady")
    expected = 2.0 * transmissivity(1e-4, VISCOSITY) / 2.0
    assert seen["boundary_flow"][0] == pytest.approx(expected, rel=1e-9)


@pytest.mark.slow
def test_ten_thousand_traces_all_have_their_place():
    """Each conducts, or is counted as idle because it is shorter than a pore and meets nothing."""
    rng = np.random.default_rng(1)
    middle, angle = rng.uniform(-0.65, 0.65, (10_000, 2)), rng.uniform(0, math.pi, 10_000)
    step = 0.01 * np.column_stack([np.cos(angle), np.sin(angle)])
    lines = tuple(
        Trace(name=f"{k}", aperture=1e-4, start=tuple(a), end=tuple(b))
        for k, (a, b) in enumerate(zip(middle - step, middle + step, strict=True))
    )
    made = reservoir(ROCK, BOX, 1e-5, lines, viscosity=VISCOSITY)
    plain = reservoir(ROCK, BOX, 1e-5, viscosity=VISCOSITY)
    flows = [m.observed((), ACROSS, method="steady") for m in (made, plain)]
    acts = made.apertures.trace_acts > 0
    assert len(acts) == 10_000
    assert 0.5 < acts.mean() < 1.0
    assert flows[0]["boundary_flow"][0] > 1.1 * flows[1]["boundary_flow"][0]
    assert flows[0]["mass_balance_error"] < 1e-12


@pytest.mark.parametrize("end", [(1.0, 0.7), (1.3, 0.91), (1.0, 0.6999)])
def test_a_trace_that_leaves_at_a_corner_meets_the_fixed_side(end):
    trace = (Trace(name="t", aperture=1e-4, start=(-1.0, -0.7), end=end),)
    made = reservoir(ROCK, BOX, 0.0, trace, viscosity=VISCOSITY)
    seen = made.observed((), ACROSS, method="steady")
    length = math.dist(*np.concatenate([made.apertures.trace_start, made.apertures.trace_end]))
    expected = transmissivity(1e-4, VISCOSITY) / length
    assert seen["boundary_flow"][0] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("height", [0.6999, -0.6995, 0.66])
def test_a_trace_beside_a_sealed_side_conducts(height):
    trace = (Trace(name="t", aperture=1e-4, start=(-1.5, height), end=(1.5, height)),)
    seen = reservoir(ROCK, BOX, 0.0, trace, viscosity=VISCOSITY).observed(
        (), ACROSS, method="steady"
    )
    expected = transmissivity(1e-4, VISCOSITY) / 2.0
    assert seen["boundary_flow"][0] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("radius", [0.003, 0.05, 0.21])
def test_a_trace_meets_a_well_at_its_wall(radius):
    """From the rim of a disc to a well of any width, off the middle of the trace."""
    trace = (Trace(name="t", aperture=1e-4, start=(-0.9, 0.0), end=(0.9, 0.0)),)
    made = reservoir(ROCK, Circle(0.8), 0.0, trace, viscosity=VISCOSITY)
    well = (Well(name="w", at=(0.1, 0.0), radius=radius, pressure=0.0),)
    seen = made.observed(well, (("outer", 1.0),), method="steady")
    carried = transmissivity(1e-4, VISCOSITY)
    expected = carried / (0.9 - radius) + carried / (0.7 - radius)
    assert seen["boundary_flow"][0] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("radius", [0.003, 0.05, 0.21])
def test_a_well_on_a_tip_takes_what_the_trace_carries(radius):
    """Its axis on the very end of a trace that comes from the rim, whatever pore it lies in."""
    carried = transmissivity(1e-4, VISCOSITY)
    for angle in (0.3, 1.7, 4.0):
        tip = 0.31 * np.array([math.cos(angle), math.sin(angle)])
        trace = (Trace(name="t", aperture=1e-4, start=tuple(3.0 * tip), end=tuple(tip)),)
        made = reservoir(ROCK, Circle(0.8), 0.0, trace, viscosity=VISCOSITY)
        well = (Well(name="w", at=tuple(tip), radius=radius, pressure=0.0),)
        seen = made.observed(well, (("outer", 1.0),), method="steady")
        expected = carried / (0.8 - 0.31 - radius)
        assert seen["boundary_flow"][0] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("gap", "joined"), [(0.0, True), (3e-10, True), (1e-7, False)])
def test_traces_that_touch_are_one_and_those_that_do_not_are_two(gap, joined):
    """Touching is within 1e-9 of their length, end to end and end to middle."""
    middle = (Trace(name="c", aperture=1e-4, start=(0.1, -0.3), end=(0.1, 0.4)),)
    ends = (
        Trace(name="a", aperture=1e-4, start=(-1.5, 0.05), end=(0.1 - gap, 0.05)),
        Trace(name="b", aperture=1e-4, start=(0.1 + gap, 0.05), end=(1.5, 0.05)),
    )
    for lines in (ends, (*ends, *middle)):
        made = reservoir(ROCK, BOX, 0.0, lines, viscosity=VISCOSITY)
        seen = made.observed((), ACROSS, method="steady")
        expected = transmissivity(1e-4, VISCOSITY) / 2.0 if joined else 0.0
        assert seen["boundary_flow"][0] == pytest.approx(expected, rel=1e-6, abs=1e-30)


@pytest.mark.slow
@pytest.mark.parametrize("part", ["trace", "barrier"])
def test_along_a_pipe_a_tip_is_as_far_from_a_line_as_in_the_plane(part):
    """Tips reach beyond their ends, but by a third of the way to another line at most.

    Of 300 places of a tip that ends before a line, or beside the end of one.
    """
    rng, pores, both = np.random.default_rng(4), network(ROCK, region=BOX), 0
    x, y = pores.x, pores.y
    spacing = math.sqrt(BOX.area / pores.inside.sum())
    for _ in range(300):
        turn, angle = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(0.0, math.pi)
        along, out = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
        middle = rng.uniform((-0.6, -0.3), (0.6, 0.3))
        tip = middle + rng.uniform(-0.35, 0.35) * along + rng.uniform(0.02, 0.5) * spacing * out
        away = tip + 0.3 * (math.cos(angle) * along + math.sin(angle) * out)
        line = middle - 0.3 * along, middle + 0.3 * along
        apart = min(far_from(tip, *line), *(far_from(end, tip, away) for end in line))
        found = walk(
            pores,
            region=BOX,
            lines=(
                FlowLine("trace", tuple(tip), tuple(away), False, False),
                FlowLine(part, tuple(line[0]), tuple(line[1]), False, False),
            ),
        )
        first = found.cross_line == 0
        other = found.wall_pipe if part == "barrier" else found.cross_pipe[~first]
        at = found.wall_fraction if part == "barrier" else found.cross_fraction[~first]
        for pipe, t in zip(found.cross_pipe[first], found.cross_fraction[first], strict=True):
            i, j = pores.pipe_from[pipe], pores.pipe_to[pipe]
            way = math.hypot(x[j] - x[i], y[j] - y[i])
            for u in at[other == pipe]:
                assert abs(t - u) * way >= apart / 3.0 * (1.0 - 1e-9)
                both += 1
    assert both > 30


@pytest.mark.parametrize("lean", [-0.3, 0.0, 0.2])
def test_what_tips_before_a_barrier_bring_to_it_passes_it_as_it_lets(lean):
    """All that flows crosses a barrier from rim to rim: at most its length over its resistance."""
    rng, worth = np.random.default_rng(3), 1e13
    low, high = np.array([lean, -0.9]), np.array([-lean, 0.9])
    fault = Trace(name="fault", resistance=worth, start=tuple(low), end=tuple(high))
    traces = []
    for k, part in enumerate(np.linspace(0.15, 0.85, 25)):
        foot = low + part * (high - low)
        tip = foot + (-1) ** k * np.array([rng.uniform(1e-3, 0.02), 0.0])
        away = tip + (-1) ** k * np.array([0.4, rng.uniform(-0.1, 0.1)])
        traces.append(Trace(name=f"t{k}", aperture=1e-3, start=tuple(tip), end=tuple(away)))
    made = reservoir(ROCK, BOX, 1e-5, (fault, *traces), viscosity=VISCOSITY)
    flow = made.observed((), ACROSS, method="steady")["boundary_flow"][0]
    within = 1.4 * math.hypot(1.0, lean / 0.9)
    assert 0.5 < flow / (within / worth) <= 1.0


def far_from(place, start, end):
    """Distance of a place from a line."""
    part = np.clip((place - start) @ (end - start) / ((end - start) @ (end - start)), 0.0, 1.0)
    return float(np.hypot(*(start + part * (end - start) - place)))


def test_a_trace_that_conducts_nothing_leaves_the_matrix_as_it_was():
    """But for crossings so near to each other, or beyond a tip, that they are one node."""
    traces = tuple(
        Trace(name=t.name, aperture=1e-12, start=t.start, end=t.end) for t in random_traces(40, 3)
    )
    tensors = [
        permeability((m := reservoir(ROCK, BOX, 1e-5, fs)).network, m.apertures, viscosity=1e-3)
        for fs in ((), traces)
    ]
    np.testing.assert_allclose(*tensors, rtol=5e-3, atol=5e-3 * tensors[0][0, 0])
    alone = Trace(name="t", aperture=1e-12, start=(-1.5, 0.1), end=(1.5, -0.3))
    m = reservoir(ROCK, BOX, 1e-5, (alone,))
    one = permeability(m.network, m.apertures, viscosity=1e-3)
    np.testing.assert_allclose(one, tensors[0], rtol=1e-4, atol=1e-4 * one[0, 0])


@pytest.mark.slow
def test_a_conducting_tip_is_unbiased():
    """A trace of five pores in an infinite rock adds π L² / 4 per area to the mean permeability.

    Over 40 directions and places on a lattice, within two standard errors and 3 %.
    """
    rng = np.random.default_rng(2)
    region, added = Rectangle(2.0, 2.0), []
    for _ in range(40):
        rock = square_lattice(1.2, R, tuple(rng.uniform(-R, R, 2)))
        angle = rng.uniform(0, math.pi)
        tip = 0.25 * np.array([math.cos(angle), math.sin(angle)])
        trace = Trace(name="t", aperture=1e-2, start=tuple(-tip), end=tuple(tip))
        without, through = (
            np.trace(permeability(m.network, m.apertures, viscosity=1e-3))
            for m in (reservoir(rock, region, 1e-5, fs) for fs in ((), (trace,)))
        )
        added.append(2.0 * (through / without - 1.0))
    # two dilute traces' worth: the region is finite, which adds a hundredth
    expected = math.pi * 0.25**2 / region.area
    error = np.std(added) / math.sqrt(len(added))
    assert abs(np.mean(added) / expected - 1.0) < 0.03 + 2.0 * error / expected


@pytest.mark.parametrize("worth", [0.1, 1.0, 30.0])
def test_a_barrier_is_worth_its_thickness_over_its_permeability(worth):
    """As many metres of rock, from side to side, on lattices and a random network."""
    for rock in (square_lattice(1.3, R, (0.01, 0.02)), hexagonal_lattice(1.3, R), ROCK):
        plain = reservoir(rock, BOX, 1e-5)
        k = 0.5 * np.trace(permeability(plain.network, plain.apertures, viscosity=1e-3))
        wall = Trace(
            name="w", thickness=0.05, permeability=k * 0.05 / worth, start=(0.1, -1), end=(0.1, 1)
        )
        same = Trace(name="w", resistance=1e-3 * worth / k, start=(0.1, -1), end=(0.1, 1))
        flows = [
            reservoir(rock, BOX, 1e-5, fs).observed((), ACROSS, method="steady")["boundary_flow"][0]
            for fs in ((), (wall,), (same,))
        ]
        assert flows[1] == pytest.approx(flows[2], rel=1e-12)
        assert flows[0] / flows[1] == pytest.approx(1.0 + worth / 2.0, rel=0.03)
