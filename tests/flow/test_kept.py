"""What is kept for the next case is what it would be made to be."""

import numpy as np
import pytest

from demflow.model.flow.equation import system
from demflow.model.flow.linear.kept import Kept
from demflow.model.region import Circle
from demflow.model.scene import Trace, Well
from tests.reservoirs import Reservoir, reservoir
from tests.rocks import random_graph

DISC = Circle(1.0)
GRAPH = random_graph(1.1, 800, 1)
WELLS = (
    Well(name="one", at=(0.1, 0.05), radius=0.01, rate=1.0),
    Well(name="two", at=(0.13, 0.06), radius=0.008, rate=1.0, skin_factor=2.0),
    Well(name="wide", at=(-0.3, -0.2), radius=0.15, pressure=0.0),
)
TRACES = (
    Trace(name="near", aperture=3e-4, start=(-0.2, 0.1), end=(0.5, 0.0)),
    Trace(name="through", aperture=1e-4, start=(-0.6, -0.2), end=(0.0, -0.2)),
)


def test_a_result_is_made_once_and_the_oldest_is_forgotten():
    made: list[int] = []

    def ask(k: int) -> int:
        return kept.get((np.arange(3), k), lambda: made.append(k) or k)

    kept: Kept[int] = Kept(most=20, size=lambda _: 8)
    assert [ask(k) for k in (0, 1, 0, 2, 0, 1)] == [0, 1, 0, 2, 0, 1]
    assert made == [0, 1, 2, 1]  # two have room; 1 was asked for before 0
    kept.clear()
    ask(1)
    assert made == [0, 1, 2, 1, 1]


def test_the_last_result_is_kept_however_large_it_is():
    kept: Kept[float] = Kept(most=0, size=lambda _: 1000)
    first = kept.get(("a",), lambda: 1.0)
    assert kept.get(("a",), lambda: 2.0) == first
    assert kept.get(("b",), lambda: 3.0) == 3.0
    assert kept.get(("a",), lambda: 2.0) == 2.0


def test_what_differs_in_a_number_a_kind_or_a_shape_is_not_the_same():
    kept: Kept[int] = Kept(most=10**6, size=lambda _: 1)
    zeros = [np.zeros(4), np.zeros(4, dtype=int), np.zeros((2, 2)), np.full(4, -0.0)]
    asked = [*((one,) for one in zeros), (np.zeros(2), np.zeros(2)), (np.zeros(4), "a"), ("a",)]
    found = [kept.get(one, lambda k=k: k) for k, one in enumerate(asked)]
    assert found == list(range(len(asked)))


def seen(rock: Reservoir) -> list[np.ndarray]:
    responses = rock.respond(WELLS, ("outer",), method="steady", times=())
    return [responses.output, responses.pressure]


@pytest.mark.parametrize("fractures", [(), TRACES])
@pytest.mark.parametrize("before", [(), TRACES])
def test_wells_that_another_case_has_placed_answer_as_those_placed_anew(before, fractures):
    """Bit for bit; traces, fluid and rates do not move what joins a well to its rock."""
    rock = reservoir(GRAPH, DISC, fractures=fractures)
    system._kept_wells.clear()
    anew = seen(rock)
    system._kept_wells.clear()
    seen(reservoir(GRAPH, DISC, fractures=before))
    for found, right in zip(seen(rock), anew, strict=True):
        np.testing.assert_array_equal(found, right)


def test_wells_of_another_rock_are_placed_anew():
    """Every pipe counts: one that is wider, and rims that keep a pressure or do not."""
    rock = reservoir(GRAPH, DISC)
    wider = rock.apertures.conductance.copy()
    wider[len(wider) // 2] *= 5.0
    other = rock._replace(apertures=rock.apertures._replace(conductance=wider))
    system._kept_wells.clear()
    right = seen(other)
    system._kept_wells.clear()
    seen(rock)
    for found, expected in zip(seen(other), right, strict=True):
        np.testing.assert_array_equal(found, expected)
