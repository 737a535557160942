"""Verlet lists against the search over all pairs."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from demflow.model.mechanics.contact.grains import along_strips, at_rest
from demflow.model.mechanics.contact.neighbours import find_pairs, no_pairs


def all_pairs(x, y, radius, skin) -> set[tuple[int, int]]:
    distance = np.hypot(x[:, None] - x, y[:, None] - y)
    near = np.triu(distance < radius[:, None] + radius + skin, 1)
    return set(zip(*(k.tolist() for k in np.nonzero(near)), strict=True))


def listed(pairs) -> list[tuple[int, int]]:
    return [
        (i, int(pairs.other[k]))
        for i in range(len(pairs.start) - 1)
        for k in range(pairs.start[i], pairs.start[i + 1])
    ]


@settings(max_examples=60)
@given(
    n=st.integers(1, 60),
    seed=st.integers(0, 10_000),
    width=st.floats(1e-3, 100.0),
    height=st.floats(1e-3, 100.0),
    ratio=st.floats(1.0, 10.0),
    skin=st.floats(0.0, 1.0),
)
def test_no_pair_is_missed(n, seed, width, height, ratio, skin) -> None:
    rng = np.random.Generator(np.random.PCG64(seed))
    x, y, radius = rng.uniform(0, width, n), rng.uniform(0, height, n), rng.uniform(1, ratio, n)
    pairs = find_pairs(at_rest(x, y, radius, np.ones(n)), skin, no_pairs(n))
    found = listed(pairs)
    assert found == sorted(set(found))
    assert set(found) == all_pairs(x, y, radius, skin)


@given(seed=st.integers(0, 10_000))
def test_memory_survives_a_rebuild(seed) -> None:
    rng = np.random.Generator(np.random.PCG64(seed))
    x, y, radius = *rng.uniform(0, 12, (2, 40)), np.ones(40)
    old = find_pairs(at_rest(x, y, radius, np.ones(40)), 0.5, no_pairs(40))
    old.shear[:] = rng.normal(size=len(old.shear))
    old.bond[:] = np.arange(len(old.bond))
    before = dict(zip(listed(old), zip(old.shear, old.bond, strict=True), strict=True))
    moved = at_rest(x + rng.uniform(-1, 1, 40), y, radius, np.ones(40))
    new = find_pairs(moved, 0.5, old)
    assert set(listed(new)) != set(before)
    for pair, shear, bond in zip(listed(new), new.shear, new.bond, strict=True):
        assert (shear, bond) == before.get(pair, (0.0, -1))


def test_grains_along_strips_are_near_their_neighbours_in_memory() -> None:
    """On a grid, strips of h rows keep all within 1 of each other within h columns and a strip."""
    n, h = 32, 4
    x, y = (v.ravel().astype(float) for v in np.meshgrid(np.arange(n), np.arange(n)))
    shuffled = np.random.default_rng(0).permutation(n * n)
    order = shuffled[along_strips(x[shuffled], y[shuffled], h)]
    assert sorted(order) == list(range(n * n))
    place = np.empty(n * n, int)
    place[order] = np.arange(n * n)
    place = place.reshape(n, n)
    along, across = np.abs(np.diff(place, axis=1)), np.abs(np.diff(place, axis=0))
    assert along.max() < 2 * h
    assert across.max() < n * h + h
    assert np.mean(across < h) > 1.0 - 1.0 / h
