"""Regions with holes: what lies in them, where lines end, what flows into a hole."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from demflow.model import simulate
from demflow.model.outcome import ModelError
from demflow.model.region import (
    Circle,
    Hole,
    Pierced,
    Polygon,
    Rectangle,
    clip_segment,
    clip_segments,
    contains,
    distance_to_rim,
    exit_point,
    named_sides,
    sides_at,
    tightest,
)
from demflow.model.scene import (
    CircularHole,
    Coupling,
    Fluid,
    Grains,
    Matrix,
    PolygonalHole,
    RectangularHole,
    Scene,
    SceneError,
    Stress,
    Trace,
    Well,
)

pytestmark = pytest.mark.usefixtures("packed_once")

KITE = Polygon(((0.0, -0.2), (0.25, 0.1), (0.0, 0.3), (-0.1, 0.1)))
PIERCED = [
    Pierced(
        Rectangle(2.0, 1.6),
        (
            Hole("round", (-0.5, 0.2), Circle(0.25)),
            Hole("kite", (0.5, -0.1), KITE),
        ),
    ),
    Pierced(Circle(1.0), (Hole("drift", (0.1, 0.2), Rectangle(0.7, 0.3)),)),
]
coordinate = st.floats(-1.2, 1.2)
point = st.tuples(coordinate, coordinate)


@pytest.mark.parametrize("region", PIERCED)
@given(start=point, end=point)
@settings(max_examples=80, deadline=None)
def test_parts_of_a_line_are_those_whose_points_lie_in_the_rock(region, start, end):
    start, end = np.array(start), np.array(end)
    if np.hypot(*(end - start)) < 1e-3:
        return
    s = (np.arange(2000) + 0.5) / 2000
    at = start + s[:, None] * (end - start)
    inside = contains(region, at)
    parts = clip_segment(region, start, end)
    claimed = np.zeros(len(s), bool)
    for s0, s1 in parts:
        claimed |= (s > s0) & (s < s1)
    off = distance_to_rim(region, at) > 1e-9
    np.testing.assert_array_equal(claimed[off], inside[off])
    _, a, b = clip_segments(region, start, end)
    np.testing.assert_allclose(np.column_stack([a, b]), np.array(parts).reshape(-1, 2), atol=1e-12)
    if inside[0] and contains(region, start)[0] and not inside.all():
        fraction, side = exit_point(region, start, end)
        first = s[np.argmin(inside)]
        assert abs(fraction[0] - first) < 1e-3 or distance_to_rim(region, at).min() < 2e-3
        rim = (start + fraction[0] * (end - start))[None]
        if fraction[0] < 1.0:
            assert distance_to_rim(region, rim)[0] < 1e-6
            assert side[0] in sides_at(region, rim)[0]


def test_sides_names_and_room():
    region = PIERCED[0]
    assert region.sides == ("bottom", "right", "top", "left", "round", "kite")
    assert named_sides(region, "outer") == [0, 1, 2, 3]
    assert named_sides(region, "kite") == [5]
    assert region.area == pytest.approx(3.2 - np.pi * 0.25**2 - KITE.area)
    room, name, other = tightest(region)
    assert (name, other) == ("kite", "outer")
    assert room == pytest.approx(0.25)
    crossed = Pierced(Circle(1.0), (Hole("a", (0.9, 0.0), Circle(0.2)),))
    assert tightest(crossed)[0] == pytest.approx(-0.1)


def inflow(seed: int, excavate, count: int = 2500, **more) -> np.ndarray:
    scene = Scene(
        region=Circle(10.0),
        grains=Grains(count=count, porosity=0.17, seed=seed),
        matrix=Matrix(permeability=1e-15),
        fluid=Fluid(viscosity=1e-3, bulk_modulus=2e9),
        boundaries=(("outer", 1e6), ("hole[0]", 0.0)),
        excavate=excavate,
        observe=("boundary_flow",),
        **more,
    )
    return simulate(scene)["boundary_flow"]


@pytest.mark.slow
def test_inflow_into_a_round_hole_is_thiems():
    law = 2.0 * np.pi * 1e-15 * 1e6 / (1e-3 * np.log(10.0 / 2.0))
    found = np.array([inflow(seed, (CircularHole(at=(0, 0), radius=2.0),)) for seed in range(1, 6)])
    np.testing.assert_allclose(found.sum(axis=1), 0.0, atol=1e-10 * law)
    ratio = found[:, 0] / law
    assert ratio.mean() == pytest.approx(1.0, abs=0.02)
    assert np.abs(ratio - 1.0).max() < 0.05


@pytest.mark.slow
def test_the_outline_of_a_hole_is_what_counts_not_how_it_is_given():
    turn = np.arange(48) * (2.0 * np.pi / 48)
    fits = 2.0 / np.sqrt(np.sin(2.0 * np.pi / 48) / (2.0 * np.pi / 48))  # of equal area
    corners = tuple((float(fits * np.cos(t)), float(fits * np.sin(t))) for t in turn)
    round_ = inflow(1, (CircularHole(at=(0.0, 0.0), radius=2.0),))
    many = inflow(1, (PolygonalHole(vertices=corners),))
    assert many[0] == pytest.approx(round_[0], rel=0.03)  # the logarithm near a round rim
    square = inflow(1, (RectangularHole(at=(0.0, 0.0), width=3.0, height=3.0),))
    same = inflow(
        1, (PolygonalHole(vertices=((-1.5, -1.5), (-1.5, 1.5), (1.5, 1.5), (1.5, -1.5))),)
    )
    np.testing.assert_allclose(square, same, rtol=1e-12)


def test_a_trace_that_ends_in_a_hole_drains_into_it():
    trace = Trace(name="t", start=(-20.0, 0.1), end=(20.0, 0.1), aperture=1e-3)
    hole = (CircularHole(at=(0.0, 0.0), radius=2.0),)
    with_it = inflow(1, hole, count=800, fractures=(trace,))
    # two plates from the rim to the hole, each some 8 m long
    alone = 2.0 * (1e-3) ** 3 / 12e-3 * 1e6 / 8.0
    assert with_it[1] == pytest.approx(-alone, rel=0.02)


def refused(**parts) -> str:
    whole = {
        "region": Circle(10.0),
        "grains": Grains(count=300, porosity=0.17),
        "matrix": Matrix(permeability=1e-15),
        "fluid": Fluid(viscosity=1e-3, bulk_modulus=2e9),
        "boundaries": (("outer", 1e6),),
        "observe": ("boundary_flow",),
    }
    with pytest.raises(SceneError) as told:
        Scene(**{**whole, **parts})
    return str(told.value)


def test_holes_that_cannot_be_are_refused_with_the_key_to_blame():
    def hole(x: float, radius: float = 2.0, **more):
        return CircularHole(at=(x, 0.0), radius=radius, **more)

    assert "excavate.0: it reaches beyond the region" in refused(excavate=(hole(9.0),))
    assert "excavate.1: it meets hole[0]" in refused(excavate=(hole(0.0), hole(3.0)))
    assert "another side is called a" in refused(
        excavate=(hole(5.0, side="a"), hole(0.0, side="a"))
    )
    assert "another side is called outer" in refused(excavate=(hole(5.0, side="outer"),))
    assert "only hole[0], outer" in refused(excavate=(hole(0.0),), boundaries=(("drift", 0.0),))
    assert "excavate.0.pressure: a rim bears" in refused(excavate=(hole(0.0, pressure=1e6),))
    assert "gravity: grains bear their weight only under" in refused(gravity=9.81)
    rock = Grains(count=300, porosity=0.17, modulus=1e10)
    weight = refused(grains=rock, stress=Stress(xx=1e5, yy=1e5), gravity=9.81)
    assert "gravity: half of the rock's weight, 2.21e+05 Pa, is more than" in weight
    coupled = refused(
        grains=rock, stress=Stress(xx=1e7, yy=1e7), gravity=9.81, coupling=Coupling(method="linear")
    )
    assert "fluid.density: grains weigh less by the fluid that they displace" in coupled
    well = Well(name="w", at=(0.5, 0.0), radius=0.1, rate=0.0)
    assert "wells.w.at: the well lies outside" in refused(excavate=(hole(0.0),), wells=(well,))


def test_a_hole_narrower_than_two_pores_is_refused():
    with pytest.raises(ModelError, match=r"the hole hole\[0\] is 0.886 m wide"):
        inflow(1, (CircularHole(at=(0.0, 0.0), radius=0.5),), count=300)


def test_the_tightest_place_among_many_holes_is_that_of_all_pairs():
    chance = np.random.default_rng(3)
    for _ in range(5):
        places = [(x, y) for x in (-6.0, -2.0, 2.0, 6.0) for y in (-6.0, -2.0, 2.0, 6.0)]
        holes = tuple(
            Hole(
                f"hole{k}",
                (x + chance.uniform(-0.5, 0.5), y + chance.uniform(-0.5, 0.5)),
                Circle(chance.uniform(0.5, 1.2)) if k % 2 else Rectangle(*chance.uniform(1, 2, 2)),
            )
            for k, (x, y) in enumerate(places)
        )
        region = Pierced(Rectangle(18.0, 18.0), holes)
        pairs = [
            tightest(Pierced(Rectangle(1e3, 1e3), (one, two)))[0]
            for number, one in enumerate(holes)
            for two in holes[:number]
        ]
        walls = [tightest(Pierced(region.outer, (one,)))[0] for one in holes]
        assert tightest(region)[0] == min(pairs + walls)
