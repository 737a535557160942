"""Nodes of lines in the plane against exact fractions, all pairs, and another library."""

from fractions import Fraction
from itertools import combinations, pairwise

import numpy as np
import pytest
import shapely

from demflow.model.region import Circle, Polygon, Rectangle, clip_segment, clip_segments
from demflow.model.scene import Trace, lines_of
from demflow.model.scene.topology import TOUCH, meetings, polyline_problems, topology


def exact_places(a, b, c, d):
    """Points that the closed segments ab and cd share: none, one, or both ends of a stretch."""
    (ax, ay), (bx, by), (cx, cy), (dx, dy) = (tuple(map(Fraction, p)) for p in (a, b, c, d))
    rx, ry, sx, sy = bx - ax, by - ay, dx - cx, dy - cy
    turn = rx * sy - ry * sx
    if turn:
        t = ((cx - ax) * sy - (cy - ay) * sx) / turn
        u = ((cx - ax) * ry - (cy - ay) * rx) / turn
        return {(ax + t * rx, ay + t * ry)} if 0 <= t <= 1 and 0 <= u <= 1 else set()
    if (cx - ax) * ry != (cy - ay) * rx:
        return set()
    square = rx * rx + ry * ry
    low, high = sorted(
        ((px - ax) * rx + (py - ay) * ry) / square for px, py in ((cx, cy), (dx, dy))
    )
    low, high = max(low, Fraction(0)), min(high, Fraction(1))
    return {(ax + t * rx, ay + t * ry) for t in (low, high)} if low <= high else set()


@pytest.mark.parametrize("seed", range(12))
def test_every_meeting_on_a_coarse_grid_is_found_exactly(seed):
    """Whole coordinates make ends on lines, joined ends, threefold points and overlaps common."""
    rng = np.random.default_rng(seed)
    ends = rng.integers(0, 9, (40, 2, 2))
    ends = ends[(ends[:, 0] != ends[:, 1]).any(axis=1)]
    shared = {}  # exact point -> lines that meet there
    for i, j in combinations(range(len(ends)), 2):
        for point in exact_places(*ends[i].tolist(), *ends[j].tolist()):
            shared.setdefault(point, set()).update((i, j))
    found = topology(ends[:, 0], ends[:, 1])

    def at(x, y):
        return round(float(x), 9), round(float(y), 9)

    nodes = {}
    for line, node in zip(found.line.tolist(), found.node.tolist(), strict=True):
        nodes.setdefault(node, set()).add(line)
    met = sorted(
        (*at(found.node_x[node], found.node_y[node]), tuple(sorted(lines)))
        for node, lines in nodes.items()
        if len(lines) > 1
    )
    wanted = sorted((*at(x, y), tuple(sorted(lines))) for (x, y), lines in shared.items())
    assert met == wanted
    pairs = meetings(ends[:, 0], ends[:, 1])
    stretches = {
        (i, j)
        for i, j in combinations(range(len(ends)), 2)
        if len(exact_places(*ends[i].tolist(), *ends[j].tolist())) == 2
    }
    lying = pairs.overlap
    assert set(zip(pairs.line_a[lying], pairs.line_b[lying], strict=True)) == stretches


@pytest.mark.parametrize("seed", range(6))
def test_random_lines_meet_where_another_library_says(seed):
    """Of very unequal lengths, far from the origin as maps are: the pairs, and their points."""
    rng = np.random.default_rng(seed)
    length = 10 ** rng.uniform(-1.5, 1.3, 300)
    angle = rng.uniform(0, np.pi, 300)
    start = np.array([466000.0, 6691582.0]) + rng.uniform(0, 20, (300, 2))
    end = start + length[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    found = meetings(start, end)
    lines = shapely.linestrings(np.stack([start, end], axis=1))
    tree = shapely.STRtree(lines)
    i, j = tree.query(lines, predicate="intersects")
    assert set(zip(found.line_a, found.line_b, strict=True)) == set(
        zip(i[i < j], j[i < j], strict=True)
    )
    step = (end - start) / length[:, None]
    on_a = start[found.line_a] + found.along_a[:, None] * step[found.line_a]
    on_b = start[found.line_b] + found.along_b[:, None] * step[found.line_b]
    np.testing.assert_allclose(on_a, on_b, rtol=0, atol=1e-8)
    there = shapely.intersection(lines[found.line_a], lines[found.line_b])
    assert shapely.distance(there, shapely.points(on_a)).max() < 1e-8


@pytest.mark.parametrize("turn", [0.0, 0.7, 2.1])
def test_degrees_of_the_plain_figures(turn):
    """Free ends, an abutting end, a crossing, a bend and three ends at a point, turned about."""
    c, s = np.cos(turn), np.sin(turn)

    def degrees(*lines):
        ends = np.array(lines, dtype=float) @ np.array([[c, s], [-s, c]]) + 1000.0
        return np.bincount(topology(ends[:, 0], ends[:, 1]).degree, minlength=5).tolist()

    flat = [(0, 0), (2, 0)]
    assert degrees(flat) == [0, 2, 0, 0, 0]
    assert degrees(flat, [(1, 0), (1.3, 1)]) == [0, 3, 0, 1, 0]
    assert degrees(flat, [(1, -1), (1.3, 1)]) == [0, 4, 0, 0, 1]
    assert degrees(flat, [(2, 0), (3, 1)]) == [0, 2, 1, 0, 0]
    assert degrees(flat, [(2, 0), (3, 1)], [(2, 0), (3, -1)]) == [0, 3, 0, 1, 0]
    assert degrees(flat, [(0.5, 3), (1.5, 3)]) == [0, 4, 0, 0, 0]


@pytest.mark.parametrize(("gap", "joined"), [(0.5, True), (2.0, False)])
def test_lines_touch_within_the_stated_part_of_their_length(gap, joined):
    for reach in (-1, 1):  # short of the line, and beyond it
        end = [(0.3, 0.7), (0.3, -reach * gap * TOUCH * 2.0)]
        found = topology(np.array([(-1.0, 0.0), end[0]]), np.array([(1.0, 0.0), end[1]]))
        degree = np.bincount(found.degree, minlength=5).tolist()
        beyond = [0, 4, 0, 0, 1] if reach > 0 else [0, 4, 0, 0, 0]
        assert degree == ([0, 3, 0, 1, 0] if joined else beyond)


def test_a_snap_joins_ends_that_fall_short_and_takes_off_what_reaches_beyond():
    start = np.array([(0, 0), (1, 0.004), (3, 1), (5, -0.004)], dtype=float)
    end = np.array([(6, 0), (1, 1), (3, 0.02), (5, 1)], dtype=float)
    assert np.bincount(topology(start, end, snap=0.01).degree).tolist() == [0, 6, 0, 2]
    assert np.bincount(topology(start, end).degree).tolist() == [0, 8, 0, 0, 1]


def test_relabelled_and_reversed_lines_have_the_same_nodes():
    rng = np.random.default_rng(3)
    start, end = rng.uniform(0, 1, (2, 80, 2))
    one = topology(start, end)
    order = rng.permutation(80)
    other = topology(end[order], start[order])
    assert sorted(one.degree) == sorted(other.degree)
    a, b = (np.sort(t.node_x + 2 * t.node_y) for t in (one, other))
    np.testing.assert_allclose(a, b, rtol=0, atol=1e-12)
    line, before, after = one.branches
    sums = np.bincount(line, weights=one.along[after] - one.along[before])
    np.testing.assert_allclose(sums, np.hypot(*(end - start).T), rtol=1e-12)


def test_pieces_of_a_bent_trace_share_their_ends_and_stay_one_trace():
    bends = ((-3.0, 0.1), (-0.7, 0.3), (0.1, -0.2), (0.9, 0.4), (4.0, 0.2))
    straight = Trace(name="s", aperture=2e-4, start=(-0.5, -0.9), end=(-0.4, 0.9))
    lines = lines_of((straight, Trace(name="t", aperture=1e-4, vertices=bends)), Circle(2.0))
    assert [line.trace for line in lines] == [0, 1, 1, 1, 1]
    assert [line.aperture for line in lines] == [2e-4, *[1e-4] * 4]
    bent = lines[1:]
    assert all(a.end == b.start for a, b in pairwise(bent))
    assert [a.end for a in bent[:-1]] == list(bends[1:4])
    assert [(a.start_at_rim, a.end_at_rim) for a in bent] == [
        (True, False),
        (False, False),
        (False, False),
        (False, True),
    ]
    found = topology([a.start for a in lines], [a.end for a in lines])
    assert np.bincount(found.degree).tolist() == [0, 4, 3, 0, 1]


@pytest.mark.parametrize(
    "region",
    [
        Circle(0.6),
        Rectangle(1.1, 0.7),
        Polygon(((-0.6, -0.5), (0.6, -0.4), (0.1, 0.0), (0.5, 0.6), (-0.5, 0.4))),
    ],
)
def test_segments_are_clipped_as_one_by_one(region):
    start, end = np.random.default_rng(5).uniform(-1, 1, (2, 400, 2))
    end[200:] = start[200:] + 0.2 * end[200:]
    piece, s0, s1 = clip_segments(region, start, end)
    found = [[] for _ in start]
    for k, low, high in zip(piece, s0, s1, strict=True):
        found[k].append((low, high))
    assert found == [clip_segment(region, a, b) for a, b in zip(start, end, strict=True)]


@pytest.mark.parametrize(
    ("vertices", "said"),
    [
        ([(0, 0)], "two vertices"),
        ([(0, 0), (1, 0), (1, 0), (2, 1)], "2 and 3 are the same"),
        ([(0, 0), (1, 0), (1, 1), (0.5, -1)], "meets itself in its pieces 1 and 3"),
        ([(0, 0), (1, 0), (0.5, 0)], "folds back on itself in its pieces 1 and 2"),
        ([(0, 0), (1, 0), (1, 1), (0, 0)], "closed ring"),
        ([(0, 0), (1, 0), (np.nan, 1)], "vertex 3"),
    ],
)
def test_polylines_that_are_no_single_trace(vertices, said):
    (what,) = polyline_problems(vertices)
    assert said in what
    assert polyline_problems([(0, 0), (1, 0), (1, 1), (0.5, 0.5)]) == []
