"""The permeability tensor: closed forms of lattices, duality, symmetry, bounds."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from demflow.model.analytic import lattice as closed_form
from demflow.model.network.apertures import pipe_conductance, uniform
from demflow.model.network.domains import network
from demflow.model.outcome import ModelError
from demflow.model.permeability import (
    bar_permeability,
    periodic_permeability,
    permeability,
    unit_permeability,
)
from demflow.model.region import Circle, Polygon, Rectangle
from demflow.model.scene import Trace
from tests.reservoirs import reservoir
from tests.rocks import hexagonal_lattice, packing_of, random_graph, square_lattice

R = 0.05
REGIONS = {
    "rectangle": Rectangle(1.7, 1.1),
    "circle": Circle(0.8),
    "polygon": Polygon(((-0.8, -0.7), (0.9, -0.5), (0.6, 0.9), (0.0, 0.1))),
}
LATTICES = {
    "square": (square_lattice, 1 / (24 * R), 1 - math.pi / 4),
    "hexagonal": (
        hexagonal_lattice,
        1 / (24 * math.sqrt(3) * R),
        1 - math.pi / (2 * math.sqrt(3)),
    ),
}


@pytest.mark.parametrize("region", REGIONS)
@pytest.mark.parametrize("kind", LATTICES)
@given(dx=st.floats(-R, R), dy=st.floats(-R, R))
@settings(max_examples=8)
def test_lattices_have_their_closed_forms_however_they_are_cut(kind, region, dx, dy):
    make, k, porosity = LATTICES[kind]
    net = network(make(1.2, R, (dx, dy)), region=REGIONS[region])
    np.testing.assert_allclose(unit_permeability(net) / k, np.eye(2), atol=1e-10)
    assert net.porosity == pytest.approx(porosity, rel=1e-10)


def test_the_closed_forms_are_those_of_the_analytic_room():
    w = 2e-5
    assert closed_form.square_permeability(w, R) == pytest.approx(w**3 / (24 * R))
    assert closed_form.hexagonal_permeability(w, R) == pytest.approx(w**3 / (24 * R * 3**0.5))
    assert pytest.approx(LATTICES["square"][2]) == closed_form.SQUARE_POROSITY
    assert pytest.approx(LATTICES["hexagonal"][2]) == closed_form.HEXAGONAL_POROSITY


def scaled(net, factor):
    """The network at unit aperture with every conductance times a factor (pipes,)."""
    opened = uniform(net, 1.0, 1.0)
    conductance = opened.conductance * factor
    return opened._replace(
        conductance=conductance, cut_conductance=conductance[net.cut] / net.cut_fraction
    )


def test_duality_makes_the_geometric_mean_of_a_square_lattice():
    """Keller (1964), Dykhne (1971): ln g symmetric about 0 gives k = k(g = 1) in 2-D.

    The arithmetic mean of these conductances is 3.8, the harmonic one 0.27.
    """
    net = network(square_lattice(1.0, 1 / 60), region=Rectangle(1.8, 1.8))
    rng = np.random.default_rng(1)
    logs = []
    for _ in range(10):
        factor = np.exp(rng.choice([-2.0, 2.0], len(net.pipe_from)))
        tensor = permeability(net, scaled(net, factor), viscosity=1.0) * 24 / 60
        logs += np.log(np.linalg.eigvalsh(tensor)).tolist()
    assert abs(np.mean(logs)) < 4 * np.std(logs) / math.sqrt(len(logs))
    assert abs(np.mean(logs)) < 0.05


def test_layers_in_series_and_in_parallel():
    """Rows of pores alternate between 1 and 9: means harmonic across, arithmetic along."""
    net = network(square_lattice(1.0, R, (R, R)), region=Rectangle(1.6 * (1 - 1e-9), 1.6 - 1e-9))
    along_x = np.abs(net.y[net.pipe_from] - net.y[net.pipe_to]) < 1e-9
    column = np.round((net.x[net.pipe_from] + net.x[net.pipe_to]) / (2 * R)).astype(int) // 2
    strong = np.where(column % 2 == 0, 9.0, 1.0)
    tensor = permeability(net, scaled(net, np.where(along_x, strong, 1.0)), viscosity=1.0)
    assert tensor[0, 0] * 24 * R == pytest.approx(2 / (1 + 1 / 9), rel=0.03)
    assert tensor[1, 1] * 24 * R == pytest.approx(1.0, rel=1e-9)
    assert tensor[0, 1] == pytest.approx(0, abs=1e-9 * tensor[0, 0])


@pytest.mark.parametrize("seed", range(4))
def test_tensors_are_symmetric_and_positive(seed):
    net = network(random_graph(1.0, 200, seed), region=Circle(0.8))
    factor = np.exp(np.random.default_rng(seed).normal(0, 2, len(net.pipe_from)))
    tensor = permeability(net, scaled(net, factor), viscosity=1.0)
    np.testing.assert_array_equal(tensor, tensor.T)
    assert np.all(np.linalg.eigvalsh(tensor) > 0)


@pytest.mark.parametrize("angle", [0.4, math.pi / 2, 2.0])
def test_the_tensor_turns_with_the_rock(angle):
    packing = random_graph(1.0, 250, 3)
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    x, y = turn @ np.array([packing.x, packing.y])
    here, there = (
        unit_permeability(network(p, region=Circle(0.8)))
        for p in (packing, packing._replace(x=x, y=y))
    )
    np.testing.assert_allclose(there, turn @ here @ turn.T, rtol=1e-9, atol=1e-9 * here[0, 0])


def test_it_turns_with_fractures_too():
    packing = random_graph(1.0, 250, 3)
    angle = 0.7
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    x, y = turn @ np.array([packing.x, packing.y])
    ends = np.array([(-0.5, -0.2), (1.2, 0.3)])
    tensors = []
    for rock, (start, end) in ((packing, ends), (packing._replace(x=x, y=y), ends @ turn.T)):
        trace = Trace(name="t", aperture=3e-5, start=tuple(start), end=tuple(end))
        made = reservoir(rock, Circle(0.8), 1e-5, (trace,))
        tensors.append(permeability(made.network, made.apertures, viscosity=1e-3))
    here, there = tensors
    assert here[0, 0] > 1.2 * here[1, 1]
    np.testing.assert_allclose(there, turn @ here @ turn.T, rtol=1e-7, atol=1e-7 * here[0, 0])


def test_opening_any_pipe_never_lowers_it():
    """Rayleigh's law: the dissipation at given rim pressures grows with every conductance.

    The outer halves of cut pipes are left out of it, so that it holds but for a small part.
    """
    net = network(random_graph(1.0, 200, 5), region=Circle(0.8))
    rng = np.random.default_rng(5)
    factor = np.exp(rng.normal(0, 1, len(net.pipe_from)))
    inner = np.flatnonzero(net.inside[net.pipe_from] & net.inside[net.pipe_to])
    before = permeability(net, scaled(net, factor), viscosity=1.0)
    grew = 0
    for pipe in rng.choice(inner, 20, replace=False):
        more = factor.copy()
        more[pipe] *= 10
        after = permeability(net, scaled(net, more), viscosity=1.0)
        least, most = np.linalg.eigvalsh(after - before)
        assert least >= -0.1 * most
        grew += most > 0
    assert grew > 15  # a pipe into a dead end changes nothing


def test_it_does_not_depend_on_the_fluid_and_goes_with_the_cube_of_the_aperture():
    net = network(random_graph(1.0, 200, 2), region=Rectangle(1.5, 1.2))
    unit = unit_permeability(net)
    for w, viscosity in ((1e-5, 1e-3), (3e-4, 0.7)):
        found = permeability(net, uniform(net, w, viscosity), viscosity=viscosity)
        np.testing.assert_allclose(found, w**3 * unit, rtol=1e-11)


def test_a_fracture_across_the_region_adds_its_own_share():
    """A trace along x between rims: k_xx grows by T μ / height in a nearly sealed matrix."""
    region = Rectangle(1.6, 1.0)
    trace = Trace(name="t", aperture=1e-4, start=(-1.5, 0.02), end=(1.5, 0.02))
    made = reservoir(random_graph(1.2, 500, 4), region, 1e-8, (trace,))
    tensor = permeability(made.network, made.apertures, viscosity=1e-3)
    expected = 1e-12 / 12 * 1.6 / made.network.area[made.network.inside].sum()
    assert tensor[0, 0] == pytest.approx(expected, rel=1e-6)


def test_a_sealed_rock_has_no_permeability_to_measure():
    made = reservoir(square_lattice(1.0, R), Circle(0.7), 0.0)
    with pytest.raises(ModelError, match="no conducting pipe"):
        permeability(made.network, made.apertures, viscosity=1e-3)


def test_a_single_pore_has_none_either():
    three = packing_of([0, 1, 0.5], [0, 0, math.sqrt(3) / 2], [0.5] * 3, [(0, 1), (1, 2), (0, 2)])
    with pytest.raises(ModelError, match="no conducting pipe"):
        unit_permeability(network(three, region=Circle(5.0)))


def test_parts_that_no_pressure_reaches_do_no_harm():
    """A ring of sealed pipes around the middle: the rest goes on conducting."""
    net = network(square_lattice(1.0, R), region=Rectangle(1.5, 1.5))
    p, q = (
        np.maximum(np.abs(net.x[d]), np.abs(net.y[d])) < 0.2 for d in (net.pipe_from, net.pipe_to)
    )
    tensor = permeability(net, scaled(net, np.where(p != q, 0.0, 1.0)), viscosity=1.0) * 24 * R
    assert np.all(np.isfinite(tensor))
    assert 0.8 < tensor[0, 0] < 0.99
    assert tensor[0, 0] == pytest.approx(tensor[1, 1], rel=1e-9)


def test_conductances_are_those_of_plates():
    """k from a single pore column by hand: g 2R / (cells side by side · depth)."""
    net = network(square_lattice(1.0, R), region=Rectangle(1.5, 1.5))
    g = pipe_conductance(np.array([1e-4]), np.array([2 * R]), 1e-3)[0]
    tensor = permeability(net, uniform(net, 1e-4, 1e-3), viscosity=1e-3)
    assert tensor[0, 0] == pytest.approx(g * 1e-3, rel=1e-12)


TRACES = (
    Trace(name="a", aperture=2e-4, start=(-1.1, -0.3), end=(1.2, 0.5)),
    Trace(name="b", aperture=1e-4, start=(-0.2, 1.0), end=(0.4, -1.0)),
    Trace(name="wall", start=(-0.6, -0.9), end=(-0.4, 0.3), thickness=0.02, permeability=1e-19),
)


@pytest.mark.parametrize("seed", range(3))
def test_a_bar_has_the_permeability_of_its_flow(seed):
    """Two assemblies of the same rock that share nothing: from side to side the same flow."""
    box = Rectangle(1.9, 1.6)
    rock = reservoir(random_graph(1.3, 900, seed), box, 2e-5, TRACES)
    along = bar_permeability(rock.network, rock.apertures, region=box, viscosity=1e-3)
    for k, (one, other, over) in zip(
        along, (("left", "right", 1.9 / 1.6), ("bottom", "top", 1.6 / 1.9)), strict=True
    ):
        seen = rock.observed((), ((one, 3e5), (other, 1e5)), method="steady")
        flow = float(np.ravel(seen["boundary_flow"])[0])
        assert k == pytest.approx(1e-3 * flow / 2e5 * over, rel=1e-4)
    tensor = permeability(rock.network, rock.apertures, viscosity=1e-3)
    assert along[0] <= tensor[0, 0] * 1.02
    assert along[1] <= tensor[1, 1] * 1.02  # with more freedom at its rim it dissipates less


@pytest.mark.parametrize("kind", LATTICES)
def test_bars_of_lattices_are_nearly_as_permeable_as_their_closed_form(kind):
    make, k, _ = LATTICES[kind]
    box = Rectangle(1.61, 1.13)
    net = network(make(1.2, 0.02, (0.003, 0.004)), region=box)
    along = bar_permeability(net, uniform(net, 1.0, 1.0), region=box, viscosity=1.0)
    np.testing.assert_allclose(along / (k * R / 0.02), 1.0, atol=0.03)


def test_a_fracture_along_a_bar_adds_its_own_share():
    box = Rectangle(1.6, 1.0)
    trace = Trace(name="t", aperture=1e-4, start=(-1.5, 0.02), end=(1.5, 0.02))
    made = reservoir(random_graph(1.2, 500, 4), box, 1e-8, (trace,))
    along = bar_permeability(made.network, made.apertures, region=box, viscosity=1e-3)
    assert along[0] == pytest.approx(1e-12 / 12, rel=1e-6)
    assert along[1] < 1e-4 * along[0]


def test_a_sealed_bar_has_no_permeability_to_measure():
    box = Rectangle(1.6, 1.0)
    made = reservoir(square_lattice(1.0, R), box, 0.0)
    with pytest.raises(ModelError, match="no flow goes from side to side"):
        bar_permeability(made.network, made.apertures, region=box, viscosity=1e-3)
    lone = Trace(name="t", aperture=1e-4, start=(-1.5, 0.02), end=(0.5, 0.02))
    made = reservoir(square_lattice(1.0, R), box, 0.0, (lone,))
    with pytest.raises(ModelError, match="no flow goes from side to side"):
        bar_permeability(made.network, made.apertures, region=box, viscosity=1e-3)
    through = Trace(name="t", aperture=1e-4, start=(-1.5, 0.02), end=(1.5, 0.02))
    made = reservoir(square_lattice(1.0, R), box, 0.0, (through,))
    along = bar_permeability(made.network, made.apertures, region=box, viscosity=1e-3)
    assert along.tolist() == [pytest.approx(1e-12 / 12, rel=1e-12), 0.0]


@pytest.mark.parametrize(
    ("kind", "box"), [("square", (0.9, 0.7)), ("hexagonal", (0.9, 0.4 * 3**0.5))]
)
def test_lattices_that_fit_to_themselves_have_their_closed_form(kind, box):
    make, k, _ = LATTICES[kind]
    net = network(make(1.2, R, (0.013, 0.021)), region=Rectangle(*box))
    found = periodic_permeability(net, uniform(net, 1.0, 1.0), viscosity=1.0)
    np.testing.assert_allclose(found / k, np.eye(2), atol=1e-9)


def of_a_ring(factor, size):
    """Periodic permeability of a square lattice whose pipes along x and y (2, cells) repeat."""
    net = network(square_lattice(1.2, R, (0.013, 0.021)), region=Rectangle(*size))
    step = np.round(np.array(size) / (2 * R)).astype(int)
    cell = np.floor(np.column_stack([net.x, net.y]) / (2 * R) + 1e-6).astype(int)
    number = np.ravel_multi_index((cell % step).T, step)
    i, j = net.pipe_from, net.pipe_to
    along_x = cell[i, 0] != cell[j, 0]
    first = np.where((cell[i] < cell[j]).any(axis=1), number[i], number[j])
    opened = scaled(net, factor[np.where(along_x, 0, 1), first])
    return periodic_permeability(net, opened, viscosity=1.0)


def test_layers_that_repeat_are_in_series_and_in_parallel():
    """Across them the harmonic mean, along them the arithmetic one, exactly."""
    strength = np.random.default_rng(2).uniform(0.1, 10.0, 9)
    layers = np.repeat(strength, 7)[None].repeat(2, axis=0)
    found = of_a_ring(layers, (0.9, 0.7)) * 24 * R
    means = [1.0 / np.mean(1.0 / strength), np.mean(strength)]
    np.testing.assert_allclose(found, np.diag(means), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_the_dual_of_a_rock_that_repeats_has_the_dual_permeability(seed):
    """Keller (1964): 1 / g on the pipes that cross makes k into k / det k, for any conductances."""
    step = (9, 7)
    x, y = factor = 10.0 ** np.random.default_rng(seed).uniform(-2.0, 2.0, (2, *step))
    dual = np.array([np.roll(1.0 / y, -1, 0), np.roll(1.0 / x, -1, 1)])
    here, there = (of_a_ring(f.reshape(2, -1), (0.9, 0.7)) * 24 * R for f in (factor, dual))
    np.testing.assert_allclose(there, here / np.linalg.det(here), rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("seed", range(3))
def test_a_rock_that_repeats_has_the_permeability_of_its_torus(seed):
    """Against a dense solve on a lattice that is closed to a ring both ways, any conductances."""
    size = np.array([0.9, 0.7])
    step = np.round(size / (2 * R)).astype(int)
    factor = 10.0 ** np.random.default_rng(seed).uniform(-2.0, 2.0, (2, step.prod()))
    found = of_a_ring(factor, size)

    g = pipe_conductance(np.array([1.0]), np.array([2 * R]), 1.0)[0] * factor
    nodes = np.arange(step.prod()).reshape(step)
    ends = [np.roll(nodes, -1, axis).ravel() for axis in range(2)]
    matrix, load = np.zeros((step.prod(),) * 2), np.zeros((step.prod(), 2))
    for axis, other in enumerate(ends):
        for a, b, size_of in zip(nodes.ravel(), other, g[axis], strict=True):
            matrix[[a, b], [a, b]] += size_of
            matrix[[a, b], [b, a]] -= size_of
            load[[a, b], axis] += np.array([-1.0, 1.0]) * size_of * 2 * R
    p = np.linalg.lstsq(matrix, load, rcond=None)[0]
    exact = np.zeros((2, 2))
    for axis, other in enumerate(ends):
        drop = p - p[other] + 2 * R * np.eye(2)[axis]
        exact += drop.T @ (g[axis][:, None] * drop)
    np.testing.assert_allclose(found, exact / size.prod(), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_a_periodic_rim_is_never_more_permeable_than_a_linear_one(seed):
    traces = TRACES if seed % 2 else ()
    rock = reservoir(random_graph(1.3, 700, seed), Rectangle(1.9, 1.6), 2e-5, traces)
    linear = permeability(rock.network, rock.apertures, viscosity=1e-3)
    found = periodic_permeability(rock.network, rock.apertures, viscosity=1e-3)
    assert found[0, 1] == found[1, 0]
    assert np.linalg.eigvalsh(found).min() > 0.0
    assert np.linalg.eigvalsh(linear - found).min() > -1e-12 * linear.max()
    if not traces:
        np.testing.assert_allclose(found, linear, atol=0.05 * linear.max())


def test_a_fracture_that_meets_its_copy_carries_on_and_another_does_not():
    box = Rectangle(1.6, 1.0)
    along = []
    for rise in (0.0, 0.15):
        trace = Trace(name="t", aperture=1e-4, start=(-1.5, 0.02 - rise), end=(1.5, 0.02 + rise))
        made = reservoir(random_graph(1.2, 500, 4), box, 1e-8, (trace,))
        along.append(periodic_permeability(made.network, made.apertures, viscosity=1e-3)[0, 0])
    assert along[0] == pytest.approx(1e-12 / 12, rel=1e-6)
    assert along[1] < 1e-3 * along[0]
    sealed = reservoir(square_lattice(1.0, R), box, 0.0)
    with pytest.raises(ModelError, match="no conducting pipe reaches the rim"):
        periodic_permeability(sealed.network, sealed.apertures, viscosity=1e-3)
