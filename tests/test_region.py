"""Regions: inside and outside, where segments leave, what is left of a line."""

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from demflow.model.parameters import SceneError
from demflow.model.region import (
    Circle,
    Polygon,
    Rectangle,
    bounding_box,
    clip_segment,
    contains,
    exit_point,
    narrowest,
)
from demflow.model.region import distance_to_rim as rim_distance

STAR = Polygon(((-0.9, -0.8), (0.1, -0.3), (1.0, -0.9), (0.4, 0.1), (0.8, 1.0), (-0.2, 0.3)))
REGIONS = [Rectangle(1.4, 2.0), Circle(0.8), STAR]
coordinate = st.floats(-1.5, 1.5)
point = st.tuples(coordinate, coordinate)
near = st.tuples(st.floats(-0.55, 0.55), st.floats(-0.55, 0.55))  # mostly inside every region


def winds_around(corners, x, y):
    """Whether the angle under which a polygon is seen from a point is a full turn."""
    turn = 0.0
    for (x1, y1), (x2, y2) in zip(corners, [*corners[1:], corners[0]], strict=True):
        a, b = complex(x1 - x, y1 - y), complex(x2 - x, y2 - y)
        turn += math.atan2((a.conjugate() * b).imag, (a.conjugate() * b).real)
    return abs(turn) > math.pi


def is_inside(region, x, y):
    if isinstance(region, Circle):
        return x * x + y * y < region.radius**2
    return winds_around([tuple(c) for c in np.asarray(region.vertices)], x, y)


def distance_to_rim(region, x, y):
    if isinstance(region, Circle):
        return abs(math.hypot(x, y) - region.radius)
    corners = np.asarray(region.vertices)
    return min(
        distance_to_segment(p, q, x, y)
        for p, q in zip(corners, np.roll(corners, -1, axis=0), strict=True)
    )


def distance_to_segment(p, q, x, y):
    edge, offset = q - p, np.array([x, y]) - p
    s = np.clip(offset @ edge / (edge @ edge), 0, 1)
    return float(np.hypot(*(offset - s * edge)))


@pytest.mark.parametrize("region", REGIONS)
def test_contains_agrees_with_the_winding_number(region):
    points = np.random.default_rng(1).uniform(-1.2, 1.2, (500, 2))
    expected = [is_inside(region, x, y) for x, y in points]
    np.testing.assert_array_equal(contains(region, points), expected)
    assert 50 < sum(expected) < 450


@pytest.mark.parametrize("region", REGIONS)
def test_share_of_the_box_inside_is_the_area(region):
    xmin, xmax, ymin, ymax = bounding_box(region)
    n = 400
    x = xmin + (np.arange(n) + 0.5) / n * (xmax - xmin)
    y = ymin + (np.arange(n) + 0.5) / n * (ymax - ymin)
    points = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    share = contains(region, points).mean()
    assert share * (xmax - xmin) * (ymax - ymin) == pytest.approx(region.area, rel=5e-3)


@pytest.mark.parametrize("region", REGIONS)
@given(inner=near, outer=point)
@settings(max_examples=60, suppress_health_check=[HealthCheck.filter_too_much])
def test_segments_leave_where_the_rim_is(region, inner, outer):
    assume(is_inside(region, *inner) and not is_inside(region, *outer))
    assume(distance_to_rim(region, *inner) > 1e-6 and distance_to_rim(region, *outer) > 1e-6)
    (fraction,), (side,) = exit_point(region, np.array([inner]), np.array([outer]))
    x, y = np.array(inner) + fraction * (np.array(outer) - inner)
    assert distance_to_rim(region, x, y) < 1e-9
    for part in np.linspace(0, fraction, 12)[:-1]:
        assert is_inside(region, *(np.array(inner) + part * (np.array(outer) - inner)))
    if not isinstance(region, Circle):
        corners = np.asarray(region.vertices)
        p, q = corners[side], np.roll(corners, -1, axis=0)[side]
        assert distance_to_segment(p, q, x, y) < 1e-8


def test_sides_of_a_rectangle_are_where_their_names_say():
    region = Rectangle(2.0, 1.0)
    ends = {"left": (-3, 0.1), "right": (3, 0.1), "bottom": (0.1, -3), "top": (0.1, 3)}
    _, side = exit_point(region, np.zeros((4, 2)), np.array(list(ends.values()), dtype=float))
    assert [region.sides[k] for k in side] == list(ends)


def test_the_centre_of_a_circle_is_a_whole_radius_from_its_rim():
    fraction, _ = exit_point(Circle(2.0), np.zeros((1, 2)), np.array([[5.0, 0.0]]))
    assert fraction[0] == pytest.approx(0.4, rel=1e-14)


@pytest.mark.slow
@pytest.mark.parametrize("region", REGIONS)
@given(start=point, end=point)
@settings(max_examples=60)
def test_clipping_keeps_what_lies_inside(region, start, end):
    assume(math.dist(start, end) > 1e-3)
    parts = clip_segment(region, start, end)
    flat = [s for part in parts for s in part]
    assert flat == sorted(flat)
    assert all(0 <= s <= 1 for s in flat)
    step = np.array(end) - start
    for s in np.linspace(0.003, 0.997, 41):
        x, y = np.array(start) + s * step
        if distance_to_rim(region, x, y) > 1e-6:
            assert any(a <= s <= b for a, b in parts) == is_inside(region, x, y)
    for s in flat:
        x, y = np.array(start) + s * step
        assert 0 < s < 1 or is_inside(region, x, y) or distance_to_rim(region, x, y) < 1e-9
        if 0 < s < 1:
            assert distance_to_rim(region, x, y) < 1e-9


def test_a_chord_of_a_circle():
    ((s0, s1),) = clip_segment(Circle(1.0), (-2.0, 0.6), (2.0, 0.6))
    assert (s0, s1) == pytest.approx((0.3, 0.7), abs=1e-14)
    assert clip_segment(Circle(1.0), (-2.0, 1.1), (2.0, 1.1)) == []


def test_a_segment_along_a_side_or_through_corners_stays_whole():
    square = Rectangle(2.0, 2.0)
    assert clip_segment(square, (-2.0, -2.0), (2.0, 2.0)) == [(0.25, 0.75)]
    assert clip_segment(square, (-1.0, 0.0), (1.0, 0.0)) == [(0.0, 1.0)]


def test_a_line_that_leaves_and_comes_back_is_two():
    u_shape = Polygon(((0, 0), (3, 0), (3, 2), (2, 2.1), (2, 1), (1, 1), (1, 2), (0, 2)))
    parts = clip_segment(u_shape, (-1.0, 1.5), (4.0, 1.5))
    assert np.ravel(parts) == pytest.approx([0.2, 0.4, 0.6, 0.8])


@given(reverse=st.booleans(), first=st.integers(0, 5), angle=st.floats(0, 2 * math.pi))
def test_sides_have_the_order_of_the_vertices_whichever_way_round(reverse, first, angle):
    """The side that a ray leaves by is that of the two vertices given, k and k + 1."""
    corners = np.roll(np.array(STAR.vertices), first, axis=0)[:: -1 if reverse else 1]
    region = Polygon(tuple(map(tuple, corners.tolist())))
    assert region.area == pytest.approx(STAR.area)
    start, far = np.array([[0.3, 0.0]]), 3.0 * np.array([[math.cos(angle), math.sin(angle)]])
    fraction, (side,) = exit_point(region, start, far)
    place = (start + fraction[:, None] * (far - start))[0]
    p, q = corners[side], corners[(side + 1) % len(corners)]
    assert distance_to_segment(p, q, *place) < 1e-9
    assert region.sides[side] == f"side[{side}]"


def test_the_narrowest_part_lies_between_two_sides_that_face_each_other():
    """A dumb-bell whose bar is 0.2 m wide; a thin slot from outside is not a narrow part."""
    bell = ((0, 0), (1, 0), (1, 0.4), (2, 0.4), (2, 0), (3, 0), (3, 1), (2, 1), (2, 0.6), (1, 0.6))
    bell += ((1, 1), (0, 1))
    for corners in (bell, bell[::-1]):
        width, one, other = narrowest(Polygon(tuple((float(x), float(y)) for x, y in corners)))
        assert width == pytest.approx(0.2)
        assert {corners[one][1], corners[other][1]} == {0.4, 0.6}
    slotted = ((0, 0), (1, 0), (1, 0.5), (1.01, 0.5), (1.01, 0), (2, 0), (2, 1), (0, 1))
    width = narrowest(Polygon(tuple((float(x), float(y)) for x, y in slotted)))[0]
    assert width == pytest.approx(0.5)


def test_a_polygon_with_two_sides_on_one_line_is_simple():
    tops_in_line = ((0, 0), (3, 0), (3, 2), (2, 2), (2, 1), (1, 1), (1, 2), (0, 2))
    assert Polygon(tops_in_line).area == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("corners", "what"),
    [
        (((0, 0), (1, 0)), "three corners"),
        (((0, 0), (1, 0), (2, 0)), "no area"),
        (((0, 0), (2, 2), (2, 0), (0, 1)), "cross"),
        (((0, 0), (3, 0), (3, 1), (1, 0), (0, 1)), "cross"),
    ],
)
def test_polygons_that_are_none(corners, what):
    with pytest.raises(SceneError, match=what):
        Polygon(corners)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_polygons_need_finite_corners(bad):
    with pytest.raises(SceneError):
        Polygon(((0.0, 0.0), (1.0, 0.0), (1.0, bad)))


@pytest.mark.parametrize("bad", [0.0, -1.0, math.nan, math.inf])
def test_extents_are_positive_and_finite(bad):
    with pytest.raises(SceneError):
        Circle(bad)
    with pytest.raises(SceneError):
        Rectangle(1.0, bad)


@pytest.mark.parametrize("region", REGIONS)
def test_distance_to_the_rim(region):
    points = np.random.default_rng(2).uniform(-1.2, 1.2, (200, 2))
    expected = [distance_to_rim(region, x, y) for x, y in points]
    np.testing.assert_allclose(rim_distance(region, points), expected, atol=1e-12)
