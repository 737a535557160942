"""What a network of traces is: plain figures by hand, brute force, and closed forms."""

import dataclasses
import itertools
import math

import numpy as np
import pytest

from demflow.model.flow.equation.sites import WellPlace
from demflow.model.fracture_network import _backbone, describe, graph_of
from demflow.model.maps import case_maps
from demflow.model.region import Circle, Rectangle
from demflow.model.scene import (
    Fluid,
    Grains,
    Joint,
    Matrix,
    RandomSet,
    Scene,
    Solver,
    Trace,
    Uniform,
    lines_of,
)
from demflow.model.stages import run_stages

BOX = Rectangle(4.0, 2.0)
W, MU = 1e-4, 1e-3
T = W**3 / (12.0 * MU)


def traces(*polylines, **given):
    given = {"aperture": W} | given
    return tuple(
        Trace(name=f"t{k}", vertices=tuple(map(tuple, line)), **given)
        for k, line in enumerate(polylines)
    )


def described(fractures, region=BOX, wells=(), sides=("left", "right")):
    return describe(region=region, fractures=fractures, viscosity=MU, wells=wells, sides=sides)


def test_a_ladder_is_counted_by_hand():
    """Two rails from side to side, a rung (Y, Y), a crossing with two free ends, and a lone one."""
    found = described(
        traces(
            [(-3, 0.5), (0.3, 0.5), (3, 0.5)],
            [(-3, -0.5), (3, -0.5)],
            [(1, 0.5), (1, -0.5)],
            [(-1, 0.8), (-1, 0.2)],
            [(0.2, 0.0), (0.5, 0.0)],
        )
    )
    counted = (found.nodes_i, found.nodes_y, found.nodes_x, found.nodes_rim)
    assert tuple(map(int, counted)) == (4, 2, 1, 4)
    assert (int(found.traces), int(found.branches), int(found.clusters)) == (5, 9, 2)
    assert found.connections == pytest.approx(4 * 3 / 6)
    length = 4 + 4 + 1 + 0.6 + 0.3
    assert found.p20 == pytest.approx(5 / 8)
    assert found.p21 == pytest.approx(length / 8)
    assert found.p22 == pytest.approx(length / 8 * length / 5)
    assert found.backbone == pytest.approx(9 / length)
    assert int(found.joined_pairs) == 1
    assert found.side_joined.tolist() == [1, 1]
    # two rails in parallel; the rung joins places of one pressure
    np.testing.assert_allclose(
        found.conductance, 2 * T / 4 * np.array([[1, -1], [-1, 1]]), rtol=1e-12
    )


@pytest.mark.parametrize(
    "kind",
    [
        {"transmissibility_multiplier": 0.1},
        {"resistance": 1e12},
        {"thickness": 0.05, "permeability": 1e-18},
        {"joint": Joint(normal_stiffness=1e10, shear_stiffness=1e10, friction=0.5)},
    ],
)
def test_a_barrier_and_a_mere_joint_are_no_network(kind):
    found = described(traces([(-3, 0), (3, 0)], aperture=None, **kind))
    assert int(found.traces) == 0
    assert found.p21 == found.backbone == found.connections == 0
    assert not found.conductance.any()


def test_wells_are_joined_where_a_trace_passes_within_their_radius():
    line = traces([(-1, 0.05), (1, 0.05)])
    wells = (WellPlace((-0.5, 0.0), 0.1), WellPlace((0.5, 0.0), 0.1), WellPlace((0.0, 0.0), 0.01))
    found = described(line, wells=wells, sides=())
    assert found.well_joined.tolist() == [1, 1, 0]
    assert int(found.joined_pairs) == 1
    assert found.backbone == pytest.approx(0.5)
    assert (int(found.nodes_i), int(found.nodes_x), int(found.nodes_y)) == (2, 0, 0)
    np.testing.assert_allclose(
        found.conductance, T * np.array([[1, -1, 0], [-1, 1, 0], [0, 0, 0]]), rtol=1e-12
    )


def test_outer_names_every_side():
    found = described(traces([(-3, 0), (3, 0)], [(0, -2), (0, 2)]), sides=("outer",), wells=())
    assert found.side_joined.tolist() == [0]
    well = (WellPlace((0.0, 0.0), 0.1),)
    found = described(traces([(-3, 0), (3, 0)]), sides=("outer",), wells=well)
    assert found.side_joined.tolist() == [1]
    np.testing.assert_allclose(found.conductance[0, 0], T, rtol=1e-12)


def random_set(seed, intensity=6.0):
    return RandomSet(
        name="r",
        aperture=W,
        seed=seed,
        intensity=intensity,
        length=0.9,
        angle=Uniform((0.0, math.pi)),
    )


def simple_ways(graph):
    """Branches on ways between two different ports that repeat no node, by walking all of them."""
    around = {}
    for k, (a, b) in enumerate(zip(graph.branch_a.tolist(), graph.branch_b.tolist(), strict=True)):
        around.setdefault(a, []).append((b, k))
        around.setdefault(b, []).append((a, k))
    ports = {}
    for node, port in zip(graph.port_node.tolist(), graph.port.tolist(), strict=True):
        ports.setdefault(node, set()).add(port)
    found = 0  # sets of nodes and of branches are the bits of a number

    def walk(node, seen, way, ends):
        nonlocal found
        if node in ends:
            found |= way
        for other, branch in around.get(node, ()):
            if not seen >> other & 1:
                walk(other, seen | 1 << other, way | 1 << branch, ends)

    for node, own in ports.items():
        for port in own:
            walk(node, 1 << node, 0, {n for n, there in ports.items() if there - {port}})
    return {branch for branch in range(len(graph.branch_a)) if found >> branch & 1}


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_the_backbone_is_all_ways_between_different_ports(seed):
    """Not through a port: a way ends where it meets one other than its own."""
    region = Rectangle(1.6, 0.9)
    graph = graph_of(lines_of((random_set(seed, 5.0),), region), region, ())
    assert set(np.flatnonzero(_backbone(graph)).tolist()) == simple_ways(graph)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_flow_alone_is_that_of_the_whole_laplacian(seed):
    """Against a dense pseudo-inverse over all nodes, ports eliminated by hand."""
    fractures = (random_set(seed, 9.0),)
    wells = (WellPlace((0.3, 0.1), 0.15),)
    found = described(fractures, wells=wells)
    graph = graph_of(lines_of(fractures, BOX), BOX, wells)
    n = len(graph.nodes.node_x)
    laplacian = np.zeros((n, n))
    for a, b, s in zip(graph.branch_a, graph.branch_b, graph.branch_length, strict=True):
        laplacian[[a, b], [a, b]] += T / s
        laplacian[[a, b], [b, a]] -= T / s
    column = {BOX.sides.index("left"): 0, BOX.sides.index("right"): 1, len(BOX.sides): 2}
    port = np.full(n, -1)
    for node, k in zip(graph.port_node, graph.port, strict=True):
        if k in column:
            port[node] = column[k]
    held, inner = np.flatnonzero(port >= 0), np.flatnonzero(port < 0)
    merge = np.eye(3)[port[held]]
    ii = laplacian[np.ix_(inner, inner)]
    hi = laplacian[np.ix_(held, inner)]
    schur = laplacian[np.ix_(held, held)] - hi @ np.linalg.pinv(ii, rcond=1e-12) @ hi.T
    wanted = merge.T @ schur @ merge
    np.testing.assert_allclose(found.conductance, wanted, rtol=1e-7, atol=1e-9 * T)
    np.testing.assert_allclose(found.conductance, found.conductance.T, rtol=1e-9, atol=1e-15 * T)
    assert np.abs(found.conductance).max() > 0


@pytest.mark.parametrize("angle", [0.0, 0.4, 2.0])
def test_tensors_of_plates_are_the_closed_form(angle):
    """Plates that cross the whole region: w³/(12 s) along them, by Oda and by Snow alike."""
    spacing = 0.05
    along = np.array([math.cos(angle), math.sin(angle)])
    across = np.array([-along[1], along[0]])
    middles = [(k + 0.5) * spacing * across for k in range(-60, 60)]
    rows = traces(*[(at - 4 * along, at + 4 * along) for at in middles])
    found = described(rows, region=Circle(3.0), sides=("outer",))
    wanted = W**3 / (12 * spacing) * np.outer(along, along)
    np.testing.assert_allclose(found.oda, wanted, rtol=2e-3, atol=1e-6 * wanted.max())
    np.testing.assert_allclose(found.snow, wanted, rtol=2e-3, atol=1e-6 * wanted.max())


def test_oda_counts_the_length_and_snow_the_chord():
    short = traces([(-0.5, 0.2), (0.5, 0.2)])
    found = described(short)
    assert found.oda[0, 0] == pytest.approx(W**3 * 1.0 / (12 * 8))
    assert found.snow[0, 0] == pytest.approx(W**3 * 4.0 / (12 * 8))
    bent = described(traces([(-1, 0), (0, 0), (0, 1)]), region=Circle(2.0), sides=())
    np.testing.assert_allclose(bent.oda, np.eye(2) * W**3 / (12 * math.pi * 4))


def test_isotropic_sets_have_isotropic_tensors():
    """Mean over seeds within three standard errors of w³ P21 / 24 either way, shear none."""
    found = np.array([described((random_set(seed),)).oda for seed in range(60)])
    wanted = W**3 * 6.0 / 24 * np.eye(2)
    error = found.std(axis=0, ddof=1) / math.sqrt(len(found))
    assert (np.abs(found.mean(axis=0) - wanted) < 3.5 * error).all()


def test_pairs_that_are_joined_are_symmetric_and_by_clusters():
    for seed in range(6):
        found = described((random_set(seed, 4.0),), sides=BOX.sides)
        lines = lines_of((random_set(seed, 4.0),), BOX)
        graph = graph_of(lines, BOX, ())
        around = {}
        for a, b in zip(graph.branch_a.tolist(), graph.branch_b.tolist(), strict=True):
            around.setdefault(a, set()).add(b)
            around.setdefault(b, set()).add(a)
        pairs, seen, clusters = set(), set(), 0
        for first in range(len(graph.nodes.node_x)):
            if first in seen:
                continue
            clusters += 1
            todo, here = [first], set()
            while todo:
                node = todo.pop()
                if node not in here:
                    here.add(node)
                    todo += around.get(node, ())
            seen |= here
            met = {p for n, p in zip(graph.port_node, graph.port, strict=True) if n in here}
            pairs |= set(itertools.combinations(sorted(met), 2))
        assert (int(found.joined_pairs), int(found.clusters)) == (len(pairs), clusters)


def test_flow_along_traces_of_a_sealed_rock_is_that_of_the_graph():
    """A bent trace from side to side, a wider one that shares a part of its way, and a dead end."""
    fractures = (
        *traces([(-3, -0.4), (-1, -0.4), (1, 0.4), (3, 0.4)]),
        *traces([(-1.0, -0.4), (-1.0, 0.4), (1.0, 0.4)], aperture=2 * W),
        *traces([(0.0, 0.0), (0.4, -0.7)]),
    )
    fractures = tuple(dataclasses.replace(f, name=f"f{k}") for k, f in enumerate(fractures))
    scene = Scene(
        region=BOX,
        grains=Grains(count=300, porosity=0.17),
        matrix=Matrix(aperture=1e-12),
        fluid=Fluid(MU, 1e9),
        fractures=fractures,
        boundaries=(("left", 1e6), ("right", 0.0)),
        observe=("pressure_map", "boundary_flow"),
        solver=Solver(method="steady"),
    )
    products = run_stages(scene)
    flow = case_maps(scene, products)["trace_flow"]
    total = products["observe"]["boundary_flow"][0]
    narrow, wide = T / math.hypot(2.0, 0.8), 8 * T / 2.8
    wanted = 1e6 / (2.0 / T + 1.0 / (narrow + wide))
    assert total == pytest.approx(wanted, rel=1e-9)
    part = wide / (narrow + wide)
    along = wanted * np.array([1.0, 1.0 - part, 1.0, part, part, 0.0])
    np.testing.assert_allclose(flow, along, rtol=1e-7, atol=1e-9 * wanted)
