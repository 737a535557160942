"""Links and nodes of mapped and random traces are those that shapely finds."""

from __future__ import annotations

import math

import numpy as np
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from demflow.model.region import Rectangle
from demflow.model.scene import PowerLaw, RandomSet, Uniform, lines_of
from demflow.model.scene.topology import meetings, topology
from demflow.sweep.study.map_files import read_map
from tests.benchmarks.outside_data import outside
from tests.benchmarks.result import Result

MAPS = {"KB11_traces.geojson": 1e-3, "networkgt.shp": 1e-3, "fracpaq_SD11A.txt": 0.0}
KB11 = (588, 826, 268)  # I, Y, X of the published count, with a snap of 1 mm
NEAR = 1e-7  # m, what counts as one place without a snap, well above the round-off of a map
SETS = 100


def ours(polylines: list[np.ndarray], snap: float) -> tuple[set, tuple[int, ...]]:
    """Pairs of traces that meet, and I, Y, X, by the routine of the model."""
    start = np.concatenate([one[:-1] for one in polylines])
    end = np.concatenate([one[1:] for one in polylines])
    owner = np.repeat(np.arange(len(polylines)), [len(one) - 1 for one in polylines])
    met = meetings(start, end, snap)
    i, j = owner[met.line_a], owner[met.line_b]
    pairs = {(min(a, b), max(a, b)) for a, b in zip(i.tolist(), j.tolist(), strict=True) if a != b}
    degree = topology(start, end, snap).degree
    counts = (degree == 1).sum(), (degree == 3).sum(), (degree > 3).sum()
    return pairs, tuple(map(int, counts))


def theirs(polylines: list[np.ndarray], snap: float) -> tuple[set, tuple[int, ...]]:
    """The same by shapely: pairs by distance, places where they meet, and branches around each."""
    near = max(snap, NEAR)
    origin = polylines[0][0]
    lines = shapely.linestrings(
        np.concatenate([one - origin for one in polylines]),
        indices=np.repeat(np.arange(len(polylines)), [len(one) for one in polylines]),
    )
    i, j = shapely.STRtree(lines).query(lines, predicate="dwithin", distance=near)
    i, j = i[i < j], j[i < j]
    ends = [shapely.get_point(lines, k) for k in (0, -1)]
    places = [shapely.get_coordinates(one) for one in ends]
    touch = np.zeros(len(i), dtype=bool)
    for line, other in ((i, j), (j, i)):
        for one in ends:
            touch |= shapely.distance(one[line], lines[other]) <= near
    crossing = shapely.intersection(lines[i], lines[j])
    places.append(shapely.get_coordinates(crossing))
    points = np.concatenate(places)
    tree = cKDTree(points)
    close = tree.query_pairs(near * 1.5, output_type="ndarray").reshape(-1, 2)
    graph = coo_array((np.ones(len(close)), close.T), shape=(len(points),) * 2)
    count, label = connected_components(graph, directed=False)
    _, first = np.unique(label, return_index=True)
    node = shapely.points(points[first])
    at, line = shapely.STRtree(lines).query(node, predicate="dwithin", distance=near * 1.5)
    tip = np.min([shapely.distance(node[at], one[line]) for one in ends], axis=0) <= near * 1.5
    degree = np.bincount(at, weights=np.where(tip, 1, 2), minlength=count)
    counts = (degree == 1).sum(), (degree == 3).sum(), (degree > 3).sum()
    return set(zip(i.tolist(), j.tolist(), strict=True)), tuple(map(int, counts))


def random_traces(seed: int) -> list[np.ndarray]:
    """About 200 straight traces with lengths by a power law, some of them ending on others."""
    rng = np.random.default_rng(seed)
    drawn = RandomSet(
        name="r",
        aperture=1e-4,
        seed=seed,
        count=200,
        length=PowerLaw(2.0, 0.3, 8.0),
        angle=Uniform((0.0, math.pi)),
    )
    lines = [np.array([a.start, a.end]) for a in lines_of((drawn,), Rectangle(10.0, 10.0))]
    for k in range(0, len(lines), 5):  # an end moved onto another trace
        host = lines[(k + 7) % len(lines)]
        lines[k][1] = host[0] + rng.uniform(0.1, 0.9) * (host[1] - host[0])
    return lines


def run() -> Result:
    """Compare every map and set."""
    told, wrong = [], 0
    for name, snap in MAPS.items():
        path = outside(f"traces/{name}")
        found = read_map({name: path.read_bytes()})
        polylines = np.split(found.vertices, found.first[1:-1])
        told.append(f"{name}: {len(polylines)} traces, {_compared(polylines, snap)}")
        wrong += _faults(polylines, snap)
    kb11 = read_map({"a.geojson": outside("traces/KB11_traces.geojson").read_bytes()})
    counted = ours(np.split(kb11.vertices, kb11.first[1:-1]), 1e-3)[1]
    told.append(f"KB11: I, Y, X {counted}, published {KB11}")
    wrong += counted != KB11
    sets = [random_traces(seed) for seed in range(SETS)]
    faults = [_faults(one, 0.0) for one in sets]
    told.append(f"{SETS} random sets of 200: {sum(faults)} faults")
    wrong += sum(faults)
    return Result(f"{wrong} links or counts differ", "0", wrong == 0, "\n".join(told))


def _faults(polylines: list[np.ndarray], snap: float) -> int:
    (a, one), (b, other) = ours(polylines, snap), theirs(polylines, snap)
    return len(a ^ b) + (one != other)


def _compared(polylines: list[np.ndarray], snap: float) -> str:
    (a, one), (b, other) = ours(polylines, snap), theirs(polylines, snap)
    return (
        f"{len(a)} links, {len(a - b)} false, {len(b - a)} missing; I, Y, X {one}, "
        f"by shapely {other}"
    )
