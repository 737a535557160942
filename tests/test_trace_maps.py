"""Maps laid into a scene: judged, joined, thinned, cut; against another library's geometry."""

import math

import numpy as np
import pytest
import shapely

from demflow.model.parameters import SceneError
from demflow.model.region import Circle, Rectangle
from demflow.model.scene import LengthPower, LogNormal, MapFile, TraceMap, lines_of
from demflow.model.scene.topology import topology
from demflow.model.scene.trace_maps import ring_area_and_centroid


def map_file(polylines, unit=1.0):
    arrays = [np.array(one, dtype=float).reshape(-1, 2) for one in polylines]
    first = np.concatenate([[0], np.cumsum([len(one) for one in arrays])])
    return MapFile(np.concatenate(arrays), first, np.arange(1, len(arrays) + 1), "0", unit)


def traces(*polylines, **given):
    file = polylines[0] if isinstance(polylines[0], MapFile) else map_file(polylines)
    return TraceMap(**{"name": "m", "aperture": 1e-4, "file": file} | given)


def polylines_of(laid):
    return [laid.vertices[a:b] for a, b in zip(laid.first, laid.first[1:], strict=False)]


def wiggly(seed, count=60, far=(466000.0, 6691582.0)):
    """Polylines with bends as maps have them, at coordinates as maps have them."""
    rng = np.random.default_rng(seed)
    found = []
    while len(found) < count:
        steps = rng.integers(2, 30)
        turn = rng.uniform(0, np.pi) + np.cumsum(rng.normal(0, 0.1, steps))
        step = rng.uniform(0.1, 0.5) * np.column_stack([np.cos(turn), np.sin(turn)])
        found.append(np.array(far) + rng.uniform(0, 12, 2) + np.cumsum(step, axis=0))
    return found


def links(polylines):
    lines = [shapely.linestrings(one) for one in polylines]
    i, j = shapely.STRtree(lines).query(lines, predicate="dwithin", distance=1e-7)
    return {(a, b) for a, b in zip(i.tolist(), j.tolist(), strict=True) if a < b}


def test_the_origin_moves_and_the_length_stays():
    given = wiggly(1)
    laid = traces(*given, origin="centroid").laid
    length = [shapely.linestrings(one).length for one in given]
    assert laid.length == pytest.approx(sum(length), rel=1e-12)
    lines = shapely.multilinestrings([shapely.linestrings(one) for one in given])
    np.testing.assert_allclose(laid.origin, [lines.centroid.x, lines.centroid.y], atol=1e-6)
    np.testing.assert_allclose(laid.vertices, np.concatenate(given) - laid.origin, atol=1e-8)
    at = (466003.0, 6691585.0)
    np.testing.assert_allclose(traces(*given, origin=at).laid.vertices[0], given[0][0] - at)
    assert np.array_equal(traces(*given).laid.vertices, np.concatenate(given))
    np.testing.assert_allclose(traces(*given, unit=0.5).laid.length, 0.5 * sum(length))


def test_area_and_centroid_of_an_outline_with_a_hole():
    outer = [(0, 0), (8, 0), (8, 6), (0, 6), (0, 0)]
    hole = [(1, 1), (1, 3), (4, 3), (4, 1), (1, 1)]
    for rings in ([outer, hole], [hole[::-1], outer[::-1]]):
        area, centre = ring_area_and_centroid(map_file(rings), 0.5)
        assert area == pytest.approx(0.25 * 42.0)
        wanted = shapely.Polygon(outer, [hole]).centroid
        np.testing.assert_allclose(centre, [0.5 * wanted.x, 0.5 * wanted.y])


@pytest.mark.parametrize("seed", range(4))
def test_simplifying_keeps_every_link_and_stays_near(seed):
    given = wiggly(seed)
    plain = polylines_of(traces(*given, origin="centroid").laid)
    thin = polylines_of(traces(*given, origin="centroid", simplify=0.1).laid)
    assert links(thin) == links(plain)
    assert sum(map(len, thin)) < sum(map(len, plain))
    for a, b in zip(plain, thin, strict=True):
        assert shapely.hausdorff_distance(*map(shapely.linestrings, (a, b))) < 0.1 + 1e-9
        assert np.array_equal(a[[0, -1]], b[[0, -1]])


def test_snapping_joins_what_falls_short_and_trims_what_reaches_over():
    base = [(0, 0), (10, 0)]
    short, over, far = [(2, 0.004), (2, 3)], [(4, 3), (4, -0.004)], [(6, 0.02), (6, 3)]
    beside = [(2.003, 3.0), (3, 5)]
    laid = traces(base, short, over, far, beside, snap=0.01).laid
    owner, a = np.repeat(np.arange(5), np.diff(laid.first)), laid.vertices
    inner = np.flatnonzero(owner[1:] == owner[:-1])
    degree = topology(a[inner], a[inner + 1]).degree
    assert np.bincount(degree).tolist() == [0, 6, 1, 2]
    joined = polylines_of(laid)
    assert joined[0].shape == (4, 2)
    for k, other in ((1, 1), (2, 2)):  # each shares its vertex with the base, bit by bit
        assert any(np.array_equal(vertex, end) for vertex in joined[0] for end in joined[other])
        assert np.abs(joined[k][:, 0] - 2 * k).max() < 0.011


def test_a_snap_longer_than_traces_are_is_refused():
    with pytest.raises(SceneError, match=r"snap: 100 m is longer than a trace is in"):
        traces([(0, 0), (9, 0)], [(3, 1), (3, 2)], snap=100.0)


@pytest.mark.parametrize("seed", range(3))
def test_a_crop_keeps_the_length_in_its_square(seed):
    given = wiggly(seed)
    whole, cut = traces(*given, origin="centroid"), traces(*given, origin="centroid", crop=5.0)
    box = shapely.box(-2.5, -2.5, 2.5, 2.5)
    wanted = [shapely.linestrings(p).intersection(box) for p in polylines_of(whole.laid)]
    found = polylines_of(cut.laid)
    parts = shapely.get_num_geometries(shapely.line_merge([w for w in wanted if w.length > 0]))
    assert len(found) == parts.sum()
    length = sum(shapely.linestrings(one).length for one in found)
    assert length == pytest.approx(sum(one.length for one in wanted), rel=1e-9)
    region = Rectangle(5.0, 5.0)
    by_region = sum(line.length for line in lines_of((whole,), region))
    assert by_region == pytest.approx(length, rel=1e-9)


def test_apertures_are_drawn_by_trace_and_go_with_its_whole_length():
    given = wiggly(2)
    law = LengthPower(0.7, 1e-4, 3.0)
    bent = traces(*given, origin="centroid", aperture=law)
    length = [shapely.linestrings(one).length for one in given]
    for line in lines_of((bent,), Circle(4.0)):
        wanted = 1e-4 * (length[line.trace] / 3.0) ** 0.7
        assert line.aperture == pytest.approx(wanted, rel=1e-9)
    one, other = (
        {line.trace: line.aperture for line in lines_of((made,), Circle(4.0))}
        for made in (
            traces(*given, origin="centroid", aperture=LogNormal(0.5, 1e-4), seed=seed)
            for seed in (1, 2)
        )
    )
    assert len(set(one.values())) == len(one) > 10
    assert one != other


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ([(3, 3), (3, 3)], "feature 2 has no length"),
        ([(3, 3), (4, 3), (4, 4), (3, 3)], "feature 2 is a ring"),
        ([(3, 3), (5, 3), (5, 4), (4, 2)], "feature 2 crosses or touches itself"),
        ([(3, 3), (5, 3), (4, 3)], "feature 2 crosses or touches itself"),
        ([(1, 0), (3, 0), (3, 1)], "features 1 and 2 lie on each other"),
        ([(0, 0), (2, 0)], "features 1 and 2 lie on each other"),
    ],
)
def test_what_is_no_trace_is_refused_with_its_number(wrong, said):
    with pytest.raises(SceneError) as caught:
        traces([(0, 0), (2, 0)], wrong, [(0, 9), (1, 9)])
    assert [path for path, _ in caught.value.problems] == ["file"]
    assert said in str(caught.value)
    assert ";" in str(caught.value)  # what to do


def test_vertices_that_stand_twice_count_once_and_are_told():
    laid = traces([(0, 0), (1, 0), (1, 0), (2, 1)]).laid
    assert (laid.repeated, len(laid.vertices)) == (1, 3)
    laid = traces([(0, 0), (9, 0)], [(3, 1), (3.001, 1)], snap=0.01).laid
    assert (laid.vanished, len(laid.first) - 1, laid.feature.tolist()) == (1, 1, [1])


def test_a_map_that_may_be_in_degrees_is_refused_until_its_unit_is_given():
    degrees = map_file([[(8.1, 50.2), (8.2, 50.3)]], unit=None)
    with pytest.raises(SceneError, match="degrees"):
        traces(degrees)
    assert traces(degrees, unit=1.0).laid.length == pytest.approx(math.hypot(0.1, 0.1))


def test_maps_are_values():
    a, b = traces(*wiggly(1)), traces(*wiggly(1))
    assert a == b
    assert hash(a) == hash(b)
    assert a != traces(*wiggly(2))
    with pytest.raises(ValueError, match="read-only"):
        a.file.vertices[0] = 0.0
