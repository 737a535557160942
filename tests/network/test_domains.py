"""Domains and pipes against faces walked with dictionaries, laws of plane graphs, hard cases."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from demflow.model.network.domains import CUT_FLOOR, VOLUME_FLOOR, domains_at, network
from demflow.model.outcome import ModelError
from demflow.model.region import Circle, Polygon, Rectangle, contains
from tests.rocks import hexagonal_lattice, packing_of, random_graph, square_lattice

EVERYWHERE = Rectangle(100.0, 100.0)


def faces_by_hand(packing):
    """Grains around every face, outside included, by turning at each grain; also the edges left."""
    neighbours = {g: set() for g in range(len(packing.x))}
    for a, b in zip(packing.contact_a.tolist(), packing.contact_b.tolist(), strict=True):
        neighbours[a].add(b)
        neighbours[b].add(a)
    while weak := [g for g, around in neighbours.items() if len(around) < 2]:
        for g in weak:
            for other in neighbours.pop(g):
                if other in neighbours:
                    neighbours[other].discard(g)
    neighbours = largest_cluster(neighbours)
    turned = {
        g: sorted(
            around,
            key=lambda h, g=g: math.atan2(packing.y[h] - packing.y[g], packing.x[h] - packing.x[g]),
        )
        for g, around in neighbours.items()
    }
    unseen = {(g, h) for g, around in neighbours.items() for h in around}
    faces = []
    while unseen:
        g, h = start = min(unseen)
        face = []
        while True:
            unseen.discard((g, h))
            face.append(g)
            around = turned[h]
            g, h = h, around[around.index(g) - 1]
            if (g, h) == start:
                break
        faces.append(face)
    edges = {(g, h) for g, around in neighbours.items() for h in around if g < h}
    return faces, edges


def largest_cluster(neighbours):
    rest, clusters = set(neighbours), []
    while rest:
        cluster, front = set(), [rest.pop()]
        while front:
            g = front.pop()
            cluster.add(g)
            front += [h for h in neighbours[g] if h not in cluster]
        rest -= cluster
        clusters.append(cluster)
    best = max(clusters, key=lambda c: sum(len(neighbours[g]) for g in c), default=set())
    return {g: neighbours[g] for g in best}


def shoelace(packing, face):
    p = [(packing.x[g], packing.y[g]) for g in face]
    return 0.5 * sum(
        x1 * y2 - x2 * y1 for (x1, y1), (x2, y2) in zip(p, [*p[1:], p[0]], strict=True)
    )


def canonical(face):
    k = face.index(min(face))
    return tuple(face[k:] + face[:k])


def faces_of(net):
    bounds = net.corner_start
    return [net.corner_grain[lo:hi].tolist() for lo, hi in itertools.pairwise(bounds)]


def without_contacts(packing, lost):
    keep = np.ones(len(packing.contact_a), dtype=bool)
    keep[lost] = False
    return packing._replace(contact_a=packing.contact_a[keep], contact_b=packing.contact_b[keep])


@given(seed=st.integers(0, 10**6), count=st.integers(9, 56), lost=st.lists(st.integers(0, 10**6)))
@settings(max_examples=40)
def test_faces_are_those_walked_by_hand(seed, count, lost):
    packing = random_graph(1.0, count, seed)
    packing = without_contacts(packing, [k % len(packing.contact_a) for k in lost])
    faces, edges = faces_by_hand(packing)
    areas = [shoelace(packing, face) for face in faces]
    bounded = [face for face, area in zip(faces, areas, strict=True) if area > 0]
    if not bounded:
        with pytest.raises(ModelError):
            network(packing, region=EVERYWHERE)
        return
    net = network(packing, region=EVERYWHERE)
    assert sorted(map(canonical, faces_of(net))) == sorted(map(canonical, bounded))
    np.testing.assert_allclose(
        net.area, [shoelace(packing, face) for face in faces_of(net)], rtol=1e-12
    )
    # Euler: vertices − edges + faces = 2 for a connected plane graph
    vertices = {g for edge in edges for g in edge}
    assert len(vertices) - len(edges) + len(faces) == 2
    assert len(net.x) == len(edges) - len(vertices) + 1
    # the polygons fill what the outer boundary encloses
    assert net.area.sum() == pytest.approx(-min(areas), rel=1e-12)
    # a pipe for every edge between two different bounded faces, with the right grains
    of_half_edge = {
        (face[k - 1], face[k]): d for d, face in enumerate(faces_of(net)) for k in range(len(face))
    }
    expected = {(a, b): {of_half_edge.get((a, b)), of_half_edge.get((b, a))} for a, b in edges}
    expected = {e: f for e, f in expected.items() if len(f) == 2 and None not in f}
    pipes = zip(net.pipe_grain_a, net.pipe_grain_b, net.pipe_from, net.pipe_to, strict=True)
    assert {(int(a), int(b)): {int(i), int(j)} for a, b, i, j in pipes} == expected
    np.testing.assert_array_equal(
        net.pipe_length, packing.radius[net.pipe_grain_a] + packing.radius[net.pipe_grain_b]
    )


def test_corner_pipes_lead_to_the_domain_across():
    net = network(random_graph(1.0, 60, 3), region=EVERYWHERE)
    seen = np.zeros(len(net.pipe_from), dtype=int)
    for d, face in enumerate(faces_of(net)):
        for k, grain in enumerate(face):
            pipe = net.corner_pipe[net.corner_start[d] + k]
            if pipe >= 0:
                seen[pipe] += 1
                assert d in (net.pipe_from[pipe], net.pipe_to[pipe])
                ends = {grain, face[(k + 1) % len(face)]}
                assert ends == {net.pipe_grain_a[pipe], net.pipe_grain_b[pipe]}
    assert np.all(seen == 2)


@pytest.mark.slow
def test_pore_volume_is_the_void_that_points_find():
    """Points strewn over polygons of touching grains; those in no grain make up the pore."""
    packing = hexagonal_lattice(0.3, 0.1)
    rng = np.random.default_rng(0)
    packing = without_contacts(packing, rng.random(len(packing.contact_a)) < 0.25)
    net = network(packing, region=EVERYWHERE)
    grains = np.column_stack([packing.x, packing.y])
    for d, corners in enumerate(faces_of(net)):
        polygon = grains[corners]
        low, high, reach = polygon.min(axis=0), polygon.max(axis=0), packing.radius[:, None]
        points = rng.uniform(low, high, (20_000, 2))
        points = points[winds_around(polygon, points)]
        void = np.ones(len(points), dtype=bool)
        near = np.all((grains > low - reach) & (grains < high + reach), axis=1)
        for grain, radius in zip(grains[near], packing.radius[near], strict=True):
            void &= np.hypot(*(points - grain).T) > radius
        assert void.mean() == pytest.approx(net.volume[d] / net.area[d], abs=0.02)
        away = points.mean(axis=0) - (net.x[d], net.y[d])
        assert np.hypot(*away) < 0.03 * math.sqrt(net.area[d])
    assert len(np.unique(np.diff(net.corner_start))) > 3


def winds_around(corners, points):
    """Whether a polygon is seen from each point under a full turn."""
    seen = (corners[:, 0] + 1j * corners[:, 1])[:, None] - (points[:, 0] + 1j * points[:, 1])
    return np.abs(np.angle(np.roll(seen, -1, axis=0) / seen).sum(axis=0)) > np.pi


def test_void_and_grains_fill_the_polygons():
    """Sectors of a grain that faces surround on all sides add up to the whole disc."""
    packing = hexagonal_lattice(1.0, 0.1)
    net = network(packing, region=EVERYWHERE)
    d = len(net.x)
    triangle = math.sqrt(3) * 0.01
    np.testing.assert_allclose(net.area, triangle, rtol=1e-12)
    assert net.volume.sum() == pytest.approx(d * (triangle - 0.5 * math.pi * 0.01), rel=1e-11)


@pytest.mark.parametrize("seed", range(4))
def test_names_of_grains_do_not_matter(seed):
    packing = random_graph(1.0, 150, seed)
    rng = np.random.default_rng(seed)
    place = rng.permutation(len(packing.x))  # new name of each grain
    back = np.argsort(place)
    pairs = np.column_stack([place[packing.contact_a], place[packing.contact_b]])
    renamed = packing_of(packing.x[back], packing.y[back], packing.radius[back], pairs)
    region = Circle(0.8)
    same_rocks(network(packing, region=region), network(renamed, region=region))


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("angle", [0.3, math.pi / 2, 2.5])
def test_turned_and_mirrored_rocks_are_the_same(angle, mirrored):
    packing = random_graph(1.0, 150, 7)
    x = packing.x * (-1 if mirrored else 1)
    turned = packing._replace(
        x=math.cos(angle) * x - math.sin(angle) * packing.y,
        y=math.sin(angle) * x + math.cos(angle) * packing.y,
    )
    same_rocks(network(packing, region=Circle(0.8)), network(turned, region=Circle(0.8)))


def same_rocks(one, other):
    for name in ("volume", "area", "pipe_length", "cut_fraction"):
        np.testing.assert_allclose(
            np.sort(getattr(one, name)), np.sort(getattr(other, name)), rtol=1e-9
        )
    for name in ("porosity", "floaters", "slivers", "crossing_edges"):
        assert getattr(one, name) == pytest.approx(getattr(other, name), rel=1e-12)
    assert one.inside.sum() == other.inside.sum()


def lattice_with(extra, pairs=()):
    """A square lattice of unit spacing with further grains (x, y, r) and contacts between names."""
    base = square_lattice(2.0, 0.5)
    n = len(base.x)
    xs, ys, rs = np.array(extra).reshape(-1, 3).T
    contacts = np.column_stack([base.contact_a, base.contact_b])
    if pairs:
        contacts = np.concatenate([contacts, pairs])
    return (
        packing_of(
            np.concatenate([base.x, xs]),
            np.concatenate([base.y, ys]),
            np.concatenate([base.radius, rs]),
            contacts,
        ),
        n,
    )


def named(packing, x, y):
    return int(np.argmin(np.hypot(packing.x - x, packing.y - y)))


def test_floaters_take_their_area_from_the_pore_around_them():
    packing, _ = lattice_with([(0.5, 0.5, 0.1), (0.45, 1.5, 0.05), (0.55, 1.5, 0.04)])
    net = network(packing, region=Rectangle(3.9, 3.9))
    empty = network(square_lattice(2.0, 0.5), region=Rectangle(3.9, 3.9))
    lost = empty.volume - net.volume
    here = domains_at(net, np.array([(0.5, 0.5), (0.5, 1.5)]))
    assert lost[here] == pytest.approx([math.pi * 0.01, math.pi * (0.0025 + 0.0016)])
    assert lost.sum() == pytest.approx(lost[here].sum())
    assert net.floaters == 3
    assert net.porosity == pytest.approx(net.volume[net.inside].sum() / net.area[net.inside].sum())


def test_dangling_grains_and_clusters_apart_are_floaters():
    """A grain on one contact, a chain of two, and a ring of three that touches nothing."""
    packing, n = lattice_with(
        [
            *[(0.5, 0.62, 0.1), (1.4, 0.5, 0.05), (1.5, 0.5, 0.05)],
            *[(0.45, 1.5, 0.05), (0.55, 1.5, 0.05), (0.5, 1.5866, 0.05)],
        ],
    )
    contacts = [
        (named(packing, 0.0, 1.0), n),
        (named(packing, 1.0, 0.0), n + 1),
        (n + 1, n + 2),
        (n + 3, n + 4),
        (n + 3, n + 5),
        (n + 4, n + 5),
    ]
    packing, _ = lattice_with(np.column_stack(packing[:3])[n:], contacts)
    net = network(packing, region=Rectangle(3.9, 3.9))
    empty = network(square_lattice(2.0, 0.5), region=Rectangle(3.9, 3.9))
    assert net.floaters == 6
    assert len(net.x) == len(empty.x)
    assert (empty.volume - net.volume).sum() == pytest.approx(math.pi * (0.01 + 5 * 0.0025))


def test_a_contact_that_crosses_another_is_dropped_the_wider_first():
    packing, _ = lattice_with([])
    a, b = named(packing, 0, 0), named(packing, 1, 1)
    c, d = named(packing, 1, 0), named(packing, 0, 1)
    radius = packing.radius.copy()
    radius[[a, b]] = 0.505  # the gap from a to b is the smaller one
    both, _ = lattice_with([], [(a, b), (c, d)])
    net = network(both._replace(radius=radius), region=Rectangle(3.9, 3.9))
    assert net.crossing_edges == 1
    kept = set(zip(net.pipe_grain_a.tolist(), net.pipe_grain_b.tolist(), strict=True))
    assert (min(a, b), max(a, b)) in kept
    assert (min(c, d), max(c, d)) not in kept


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 0, 2), (1, 2, 0), (0, 2, 1)])
def test_no_more_contacts_are_dropped_than_cross(order):
    """A wide contact across two narrow ones that stay apart: only the wide one goes."""
    tops = [(0.0, 0.0, 0.2), (0.0, 1.0, 0.3), (1.0, 0.0, 0.3), (1.0, 1.0, 0.3)]
    ends = [(-0.7, 0.5, 0.1), (1.7, 0.5, 0.1)]
    grains = tops + ends
    uprights = [(0, 1), (2, 3)]
    across = [(4, 5)]
    ring = [(0, 2), (1, 3), (0, 4), (1, 4), (2, 5), (3, 5)]
    contacts = [(uprights + across)[k] for k in order] + ring
    # names in another order put the crossing pairs in another order, too
    name = np.array([[0, 1, 2, 3, 4, 5], [5, 4, 3, 2, 1, 0], [4, 2, 0, 5, 1, 3]][order[0]])
    x, y, r = np.array(grains)[np.argsort(name)].T
    net = network(packing_of(x, y, r, name[np.array(contacts)]), region=EVERYWHERE)
    assert net.crossing_edges == 1
    assert len(net.x) == 3


def test_which_contacts_are_dropped_follows_gaps_not_names():
    """A bar of gap 2 crosses an upright of gap 1 and one of gap 3."""
    grains = [(0, -1, 0.5), (0, 1, 0.5), (1, -2, 0.5), (1, 2, 0.5), (-1.5, 0, 0.5), (1.5, 0, 0.5)]
    contacts = [(0, 1), (2, 3), (4, 5), (0, 2), (1, 3), (0, 4), (1, 4), (2, 5), (3, 5)]
    areas = set()
    for name in ([0, 1, 2, 3, 4, 5], [2, 3, 0, 1, 4, 5], [4, 5, 2, 3, 0, 1], [2, 3, 4, 5, 0, 1]):
        x, y, r = np.array(grains)[np.argsort(name)].T
        net = network(packing_of(x, y, r, np.array(name)[contacts]), region=EVERYWHERE)
        areas.add(tuple(np.sort(np.round(net.area, 9)).tolist()))
    assert len(areas) == 1


def test_slivers_are_raised_to_the_floor_and_counted():
    packing = square_lattice(2.0, 0.5)
    radius = packing.radius.copy()
    cell = [named(packing, x, y) for x in (0, 1) for y in (0, 1)]
    radius[cell] = 0.6  # their sectors cover the cell
    net = network(packing._replace(radius=radius), region=Rectangle(3.9, 3.9))
    (sliver,) = domains_at(net, np.array([(0.5, 0.5)]))
    assert net.slivers == 1
    assert 0 < net.volume[sliver] <= VOLUME_FLOOR * net.volume[net.inside].mean()
    assert np.all(net.volume > 0)


@pytest.mark.parametrize(
    ("points", "pairs"),
    [
        ([(0, 0)], np.empty((0, 2))),
        ([(0, 0), (1, 0)], [(0, 1)]),
        ([(0, 0), (1, 0), (2, 0)], [(0, 1), (1, 2)]),
    ],
)
def test_too_few_grains_enclose_no_pore(points, pairs):
    x, y = np.array(points, dtype=float).T
    with pytest.raises(ModelError, match="enclose no pore"):
        network(packing_of(x, y, np.full(len(x), 0.5), pairs), region=EVERYWHERE)


def test_three_touching_grains_enclose_one():
    height = math.sqrt(3) / 2
    net = network(
        packing_of([0, 1, 0.5], [0, 0, height], [0.5] * 3, [(0, 1), (1, 2), (0, 2)]),
        region=EVERYWHERE,
    )
    assert net.volume == pytest.approx([height / 2 - math.pi / 8])
    assert len(net.pipe_from) == len(net.cut) == 0


def test_a_region_between_the_pores_is_an_error():
    with pytest.raises(ModelError, match="no pore lies inside the region"):
        network(square_lattice(2.0, 0.5, shift=(0.0, 0.0)), region=Circle(0.01))


@pytest.mark.parametrize(
    "region", [Rectangle(1.5, 1.1), Circle(0.75), Polygon(((-0.8, -0.7), (0.9, -0.6), (0.1, 0.8)))]
)
def test_cut_pipes_join_an_inner_to_an_outer_domain_across_the_rim(region):
    net = network(random_graph(1.0, 300, 2), region=region)
    np.testing.assert_array_equal(net.inside, contains(region, np.column_stack([net.x, net.y])))
    ends = np.sort(np.column_stack([net.pipe_from, net.pipe_to])[net.cut], axis=1)
    np.testing.assert_array_equal(
        ends, np.sort(np.column_stack([net.cut_inside, net.cut_outside]), axis=1)
    )
    assert np.all(net.inside[net.cut_inside] & ~net.inside[net.cut_outside])
    uncut = np.setdiff1d(np.arange(len(net.pipe_from)), net.cut)
    assert np.all(net.inside[net.pipe_from[uncut]] == net.inside[net.pipe_to[uncut]])
    assert np.all((net.cut_fraction >= CUT_FLOOR) & (net.cut_fraction <= 1))
    assert len(net.cut) > 10


def test_a_straight_rim_cuts_lattice_pipes_by_distance():
    net = network(square_lattice(2.0, 0.5), region=Rectangle(2.6, 3.4))
    for side, name in enumerate(Rectangle(2.6, 3.4).sides):
        half = 1.3 if name in ("left", "right") else 1.7
        inner = max(0.5 + k for k in range(3) if 0.5 + k < half)
        np.testing.assert_allclose(net.cut_fraction[net.cut_side == side], half - inner)


def test_a_round_rim_cuts_by_the_logarithm():
    net = network(random_graph(1.0, 400, 4), region=Circle(0.8))
    r_in = np.hypot(net.x[net.cut_inside], net.y[net.cut_inside])
    r_out = np.hypot(net.x[net.cut_outside], net.y[net.cut_outside])
    expected = np.maximum(np.log(0.8 / r_in) / np.log(r_out / r_in), CUT_FLOOR)
    np.testing.assert_allclose(net.cut_fraction, expected, rtol=1e-12)


def test_points_are_found_in_their_polygons_or_the_nearest_domain():
    packing = random_graph(1.0, 120, 6)
    net = network(packing, region=Circle(0.8))
    polygons = [Polygon(tuple(zip(packing.x[f], packing.y[f], strict=True))) for f in faces_of(net)]
    points = np.random.default_rng(1).uniform(-1.1, 1.1, (60, 2))
    found = domains_at(net, points)
    outside = 0
    for point, d in zip(points, found, strict=True):
        hosts = [k for k, p in enumerate(polygons) if contains(p, point)[0] and net.inside[k]]
        if hosts:
            assert hosts == [d]
        else:
            inner = np.flatnonzero(net.inside)
            nearest = inner[np.argmin(np.hypot(net.x[inner] - point[0], net.y[inner] - point[1]))]
            assert d == nearest
            outside += 1
    assert 0 < outside < 60
