"""One matrix is the push of the fluid and the change of the pores."""

from functools import cache

import numpy as np
import pytest

from demflow.model.coupling.duality import (
    LENGTHS,
    place_of,
    pore_volumes,
    pores_of,
    volume_gradient,
)
from demflow.model.mechanics.packing.packing import pack
from demflow.model.network.domains import network
from demflow.model.network.enclosure import feet
from demflow.model.region import Rectangle

REGION = Rectangle(2.0, 2.0)


@cache
def rock(kind: str):
    given = {
        "loose": {"packing": "random", "porosity": 0.19, "seed": 3},
        "dense": {"packing": "random", "porosity": 0.16, "seed": 5},
        "pressed": {"packing": "random", "porosity": None, "packing_friction": 0.0,
                    "packing_pressure": 3e-2, "seed": 2},
        "graded": {"packing": "random", "porosity": 0.17, "seed": 1, "radius_ratio": 4.0},
        "square": {"packing": "square", "porosity": None, "seed": 1},
        "hexagonal": {"packing": "hexagonal", "porosity": None, "seed": 1},
    }[kind]  # fmt: skip
    given = {"radius_ratio": 1.66, **given}
    packing = pack(region=REGION, count=150, mean_radius=None, **given)
    if kind == "loose":  # bonds across gaps make faces whose grains stand apart
        radius = packing.radius * np.random.default_rng(1).uniform(0.85, 1.0, len(packing.x))
        at_wall = feet(packing).grain
        radius[at_wall] = packing.radius[at_wall]
        packing = packing._replace(radius=radius)
    net = network(packing, region=REGION, walled=True)
    return packing, net, pores_of(packing, net), place_of(packing.x, packing.y, packing.box)


ROCKS = ("loose", "dense", "pressed", "graded", "square", "hexagonal")


@pytest.mark.slow
@pytest.mark.parametrize("kind", ROCKS)
def test_it_is_the_gradient_of_the_volumes(kind):
    packing, _, pores, place = rock(kind)
    gradient = volume_gradient(pores, place)
    rng = np.random.default_rng(7)
    unit = packing.radius.mean()
    for _ in range(4):
        way = rng.standard_normal(len(place))
        h = 2e-4 * unit

        def changed(step, way=way):
            return pore_volumes(pores, place + step * way) - pore_volumes(pores, place - step * way)

        found = (8.0 * changed(h) - changed(2.0 * h)) / (12.0 * h)  # of fourth order
        wanted = gradient.T @ way
        assert np.abs(found - wanted).max() < 1e-8 * np.abs(wanted).max()


@pytest.mark.parametrize("kind", ROCKS)
@pytest.mark.parametrize("lengths", ["chord", "arc"])
def test_uniform_pressure_moves_no_grain(kind, lengths):
    packing, net, pores, place = rock(kind)
    force = volume_gradient(pores, place, lengths) @ np.full(len(net.x), 3.0)
    scale = 3.0 * packing.radius.mean()
    assert np.abs(force[:-4]).max() < 1e-12 * scale
    # and pushes each wall outwards by its length
    if lengths == "chord":
        width, height = np.diff(packing.box)[[0, 2]]
        wanted = 3.0 * np.array([-height, height, -width, width])
        assert force[-4:] == pytest.approx(wanted, rel=1e-12)


@pytest.mark.parametrize("kind", ROCKS)
def test_pores_and_grains_fill_the_box(kind):
    packing, net, pores, place = rock(kind)
    found = pore_volumes(pores, place)
    assert found == pytest.approx(net.volume, rel=1e-9, abs=1e-5 * net.volume.mean())
    width, height = np.diff(packing.box)[[0, 2]]
    assert net.area.sum() == pytest.approx(width * height, rel=1e-12)
    solid = np.pi * np.sum(packing.radius**2)
    a, b = packing.contact_a, packing.contact_b
    d = np.hypot(packing.x[b] - packing.x[a], packing.y[b] - packing.y[a])
    # each overlap counts twice in the discs: its lens is of order overlap^1.5
    overlap = np.maximum(packing.radius[a] + packing.radius[b] - d, 0.0)
    lens = np.sum(overlap**1.5 * np.sqrt(packing.radius.max()))
    lens += len(feet(packing).grain) * overlap.max(initial=0.0) ** 1.5
    assert abs(found.sum() - (width * height - solid)) < 3.0 * lens + 1e-12


@pytest.mark.parametrize("kind", ["loose", "pressed"])
def test_finite_moves_at_the_middle_are_of_third_order(kind):
    packing, _, pores, place = rock(kind)
    rng = np.random.default_rng(11)
    way = rng.standard_normal(len(place)) * packing.radius.mean()
    errors = []
    for step in (4e-3, 2e-3):
        middle = volume_gradient(pores, place + 0.5 * step * way)
        moved = pore_volumes(pores, place + step * way) - pore_volumes(pores, place)
        errors.append(np.abs(moved - step * (middle.T @ way)).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(3.0, abs=0.1)


def test_forms_of_the_push_agree_where_discs_just_touch_and_nowhere_else():
    _, net, pores, place = rock("square")
    chord, arc, paper = (volume_gradient(pores, place, form).toarray() for form in LENGTHS)
    scale = np.abs(chord).max()
    assert np.abs(arc - chord).max() < 1e-12 * scale
    # Eq. 6 has the angle in place of its chord: (π/4) / sin(π/4) more at a right angle
    grains = slice(0, len(place) - 4)
    factor = 0.25 * np.pi / np.sin(0.25 * np.pi)
    assert np.abs(paper[grains] - factor * chord[grains]).max() < 1e-12 * scale
    for kind, least in (("pressed", 1e-2), ("loose", 2e-2)):
        _, net, pores, place = rock(kind)
        chord, arc, paper = (volume_gradient(pores, place, form) for form in LENGTHS)
        assert abs(arc - chord).max() > least * abs(chord).max()
        push = paper @ np.ones(len(net.x))
        assert np.abs(push[:-4]).max() > 0.1 * pores.radius.max()


def test_an_arc_beyond_a_half_turn_needs_no_case_of_its_own():
    """A grain that reaches into its pore by more than half: Fig. 10."""
    _, _, pores, place = rock("loose")
    x, y = place[pores.row_x], place[pores.row_y]
    found = 0
    for pore in range(len(pores.start) - 1):
        corners = pores.corner[pores.start[pore] : pores.start[pore + 1]]
        for k, i in enumerate(corners):
            before, after = corners[k - 1], corners[(k + 1) % len(corners)]
            turn = [np.arctan2(y[j] - y[i], x[j] - x[i]) for j in (after, before)]
            angle = np.mod(turn[1] - turn[0], 2.0 * np.pi)
            once = np.count_nonzero(corners == i) == 1
            if angle > np.pi and i < (len(place) - 4) // 3 and once:
                found += 1
                push = volume_gradient(pores, place, "arc").tocsc()[[3 * i, 3 * i + 1], [pore] * 2]
                wanted = 2.0 * pores.radius[i] * np.sin(0.5 * angle)
                assert np.hypot(*push) == pytest.approx(wanted, rel=1e-12)
                middle = turn[0] + 0.5 * angle
                away = -np.array([np.cos(middle), np.sin(middle)])
                assert push @ away == pytest.approx(wanted, rel=1e-12)
        if found > 3:
            break
    assert found > 0


def test_floaters_feel_nothing():
    packing, net, pores, place = rock("dense")
    assert int(net.floaters) > 0
    assert pores.floating.sum() > 0.0
    carried = np.unique(pores.corner)
    floats = np.setdiff1d(np.arange(len(packing.x)), carried)
    gradient = volume_gradient(pores, place)
    assert abs(gradient[np.concatenate([3 * floats, 3 * floats + 1])]).sum() == 0.0


def test_what_is_no_form_or_no_such_network_is_refused():
    packing, _, pores, place = rock("square")
    with pytest.raises(ValueError, match="chord, arc, paper, not 'sine'"):
        volume_gradient(pores, place, "sine")
    with pytest.raises(ValueError, match="between its walls"):
        pores_of(packing, network(packing, region=REGION))
