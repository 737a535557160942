"""Random sets: densities wherever one looks, the laws' closed forms, and what a seed fixes."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import special

from demflow.model.parameters import SceneError
from demflow.model.region import Circle, Polygon, Rectangle, clip_segments, contains
from demflow.model.scene import (
    Exponential,
    LengthPower,
    LogNormal,
    PowerLaw,
    RandomSet,
    Uniform,
    VonMises,
    lines,
    lines_of,
)
from demflow.model.scene.random_sets import expected, segments

REGION = Rectangle(4.0, 2.0)
LENGTHS = [PowerLaw(2.2, 0.2, 6.0), PowerLaw(1.0, 0.3, 3.0), LogNormal(0.8, 0.7), Exponential(1.0)]
LONG = PowerLaw(1.5, 0.5, 20.0)


def drawn(**changed):
    given = {"name": "s", "aperture": 1e-4, "length": 1.0, "angle": 0.4, "intensity": 2.0}
    return RandomSet(**{key: v for key, v in {**given, **changed}.items() if v is not None})


def ends(fracture, region):
    return segments(fracture.drawing, region)


def inside(start, end, region):
    """Length of segments in a region."""
    piece, s0, s1 = clip_segments(region, start, end)
    return float(((s1 - s0) * np.hypot(*(end - start)[piece].T)).sum())


def standing(values, wanted, errors=3.5):
    """Whether a mean is what is wanted within so many of its standard errors."""
    error = np.std(values, ddof=1) / math.sqrt(len(values))
    assert abs(np.mean(values) - wanted) < errors * error, (np.mean(values), wanted, error)


@pytest.mark.slow
@pytest.mark.parametrize("length", [1.0, *LENGTHS, LONG], ids=str)
def test_intensity_is_the_same_in_the_middle_and_in_a_corner(length):
    """Fractures from outside reach in: nothing thins out at the rim, also where most are longer."""
    middle = Rectangle(1.0, 1.0)
    corner = Polygon(((1.0, 0.0), (2.0, 0.0), (2.0, 1.0), (1.0, 1.0)))
    sets = [drawn(length=length, angle=Uniform((0.0, math.pi)), seed=s) for s in range(150)]
    for place in (middle, corner):
        standing([inside(*ends(one, REGION), place) for one in sets], 2.0)


def test_density_counts_centres_and_a_count_is_exact():
    law = LogNormal(0.5, 0.8)
    found = []
    for seed in range(150):
        start, end = ends(drawn(density=3.0, intensity=None, length=law, seed=seed), REGION)
        found.append(np.count_nonzero(contains(REGION, 0.5 * (start + end))))
    standing(found, 3.0 * REGION.area)
    standing((np.array(found) - 24.0) ** 2, 24.0)  # Poisson: the variance is the mean
    triangle = Polygon(((0.0, 0.0), (2.0, 0.0), (0.0, 2.0)))
    start, end = ends(drawn(count=57, intensity=None, length=law), triangle)
    assert np.count_nonzero(contains(triangle, 0.5 * (start + end))) == len(start) == 57


@pytest.mark.parametrize("law", LENGTHS, ids=str)
def test_lengths_and_their_biased_law_have_the_moments_of_the_density(law):
    """E[ℓ] as stated, and E[ln ℓ] and E[1/ℓ] of the biased law from those of the plain one."""
    rng = np.random.default_rng(7)
    plain, biased = law.draw(rng, 40_000), law.biased(rng, 40_000)
    standing(plain, law.mean)
    standing(1.0 / biased, 1.0 / law.mean)  # ∫ ℓ f / E[ℓ] · 1/ℓ
    weights = plain / law.mean
    standing(weights * np.log(plain), np.log(biased).mean(), errors=5.0)


def test_power_law_has_its_quantiles_and_its_limits():
    law = PowerLaw(2.2, 0.5, 20.0)
    found = np.sort(law.draw(np.random.default_rng(2), 20_000))
    assert 0.5 <= found[0] < found[-1] <= 20.0
    cumulative = (0.5**-1.2 - found**-1.2) / (0.5**-1.2 - 20.0**-1.2)
    steps = (np.arange(len(found)) + 0.5) / len(found)
    assert np.abs(cumulative - steps).max() < 1.63 / math.sqrt(len(found))  # 1 % of the time more


def test_angles_follow_von_mises():
    found = VonMises(4.0, 0.9).draw(np.random.default_rng(3), 20_000)
    standing(np.cos(found - 0.9), special.i1(4.0) / special.i0(4.0))
    standing(np.sin(found - 0.9), 0.0)


def test_apertures_follow_their_law_and_the_whole_length():
    region = Circle(0.5)  # cuts nearly every fracture
    power = LengthPower(0.5, 1e-4, 2.0)
    lines = lines_of((drawn(length=LONG, aperture=power, seed=4),), region)
    start, end = ends(drawn(length=LONG, aperture=power, seed=4), region)
    whole = np.hypot(*(end - start).T)
    for line in lines:
        assert line.aperture == pytest.approx(1e-4 * math.sqrt(whole[line.trace] / 2.0), rel=1e-12)
    law = LogNormal(0.5, 8e-5)
    apertures = [line.aperture for line in lines_of((drawn(intensity=300, aperture=law),), REGION)]
    standing(np.log(apertures), math.log(8e-5))
    standing((np.log(apertures) - math.log(8e-5)) ** 2, 0.25)


def test_lines_are_those_of_the_scene_whatever_was_asked_for_before():
    """In any order, also of sets that differ in width, place or region alone, and of many."""
    wide = [2e-4, LogNormal(0.5, 1e-4), LengthPower(0.5, 1e-4, 2.0)]
    asked = [
        ((drawn(length=LONG, seed=seed, aperture=w), drawn(seed=seed, aperture=w)), region)
        for seed in range(4)
        for w in (1e-4, *wide)
        for region in (REGION, Circle(0.7))
    ]

    def afresh(fractures, region):
        lines._lines_of.cache_clear()
        lines._kept.clear()
        return lines_of(fractures, region)

    alone = [afresh(*one) for one in asked]
    for k in np.random.default_rng(7).integers(len(asked), size=100):
        assert lines_of(*asked[k]) == alone[k]
        assert len(lines._kept) <= lines.MOST_CLIPPED


def test_least_spacing_keeps_centres_apart_or_says_that_it_cannot():
    start, end = ends(drawn(least_spacing=0.25, length=0.5, intensity=3.0), REGION)
    middle = 0.5 * (start + end)
    apart = np.hypot(*(middle[:, None] - middle[None]).T)
    assert len(middle) > 50
    assert apart[~np.eye(len(middle), dtype=bool)].min() >= 0.25
    with pytest.raises(SceneError, match="no room"):
        ends(drawn(least_spacing=0.5, length=0.5, intensity=12.0), REGION)


def test_a_seed_fixes_the_set_and_each_property_has_its_own_numbers():
    one = drawn(length=LONG, seed=5)
    assert all(map(np.array_equal, ends(one, REGION), ends(replace(one), REGION)))
    other = ends(replace(one, seed=6), REGION)[0]
    assert not np.array_equal(ends(one, REGION)[0], other)
    turned = ends(replace(one, angle=1.1), REGION)
    np.testing.assert_allclose(
        np.hypot(*(turned[1] - turned[0]).T),
        np.hypot(*np.subtract(*ends(one, REGION)[::-1]).T),
        rtol=1e-12,
    )
    wide = replace(one, aperture=LogNormal(0.5, 1e-4))
    again = replace(one, aperture=LogNormal(0.5, 2e-4))
    a, b = (np.array([x.aperture for x in lines_of((s,), REGION)]) for s in (wide, again))
    np.testing.assert_allclose(b, 2.0 * a, rtol=1e-12)


def test_regions_of_several_sizes_cut_the_same_set_within():
    one = drawn(length=LONG, within=3.0, seed=8)
    large, small = (
        {(line.trace, line.aperture) for line in lines_of((one,), region)}
        for region in (Rectangle(3.0, 3.0), Rectangle(1.0, 1.0))
    )
    assert small < large
    start, end = ends(one, Rectangle(1.0, 1.0))
    assert all(map(np.array_equal, (start, end), ends(one, Circle(2.0))))


def test_as_many_are_drawn_as_are_expected():
    one = drawn(length=LENGTHS[0])
    counts = [len(ends(replace(one, seed=s), REGION)[0]) for s in range(200)]
    standing(counts, expected(one.drawing, REGION))


@pytest.mark.parametrize(
    ("changed", "path"),
    [
        ({"intensity": None}, ""),
        ({"count": 3}, "intensity"),
        ({"count": 3, "intensity": None, "within": 9.0}, "within"),
        ({"length": -1.0}, "length"),
        ({"aperture": None}, ""),
    ],
)
def test_sets_that_contradict_themselves(changed, path):
    with pytest.raises(SceneError) as caught:
        drawn(**changed)
    assert path in [where for where, _ in caught.value.problems]
