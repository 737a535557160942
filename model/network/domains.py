"""From grains and contacts to domains and pipes (the *network* stage)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from demflow.model.mechanics.loading.ground import dug_out
from demflow.model.network.connectivity import component_labels
from demflow.model.network.enclosure import enclosed, hollowed
from demflow.model.network.evening import evened
from demflow.model.network.faces import (
    crossing_pairs,
    locate,
    measure_faces,
    next_half_edges,
    prune,
    walk_faces,
)
from demflow.model.outcome import ModelError
from demflow.model.products import Network, Packing
from demflow.model.region import (
    Circle,
    Pierced,
    Polygon,
    Region,
    contains,
    exit_point,
    narrowest,
    parts_of,
    tightest,
)

# A domain keeps at least this part of the mean pore volume: overlapping grains can leave
# none, and the explicit step shrinks with the smallest.
VOLUME_FLOOR = 1e-6

# A centroid may lie on the rim itself; its distance to the rim is kept above this part of
# the distance between the centroids.
CUT_FLOOR = 0.02

# Pores across the narrowest part of a region.
NARROWEST = 2.0


def network(
    packing: Packing, *, region: Region, walled: bool | None = None, even: bool | None = None
) -> Network:
    """Build the pores and pipes of a packing, and cut them along the rim of the region.

    A domain is a bounded face of the graph of contacts; its pore volume is the area of
    the polygon less the sectors of its grains and less the floaters inside it. A pipe
    stands at each contact between two domains. The domains inside the region are those
    whose centroid is; a pipe from one inside to one outside is cut where it meets the
    rim. Grains with fewer than two contacts, and clusters apart from the largest, bound
    no face: they count as floaters.

    A `walled` network is that of all pores between the walls of the packing, those at the walls
    too (`enclosure`); no rim cuts it. A pipe at a wall is half of one between a grain and its
    mirror image. Without the grains that a hole of the region takes, the hole is one large domain
    outside, to which no pipe leads: those that would are cut in their middle, as in rock that goes
    on, and so end on the rim.

    Raises `ModelError` where no domain lies inside the region.

    Parameters
    ----------
    packing : grains at rest under the packing pressure
    region : where the case lies, m
    walled : whether pores at the walls of the packing count, and no rim cuts
    even : whether the rock is to be one everywhere, as graded grains are (`evening`)
    """
    gone: list[np.ndarray] = []
    of_hole: list[int] = []
    if walled:
        packing = enclosed(packing)
        if isinstance(region, Pierced):
            gone = dug_out(packing, region.holes)
            packing = hollowed(packing, np.any(gone, axis=0))
    x, y, radius = packing.x, packing.y, packing.radius
    a, b, dropped = _without_crossings(packing.contact_a, packing.contact_b, x, y, radius)
    a, b = _load_bearing(len(x), a, b)
    if len(a) == 0:
        raise ModelError(
            "the grains enclose no pore: too few of them touch; raise grains.count or lower "
            "grains.porosity"
        )
    first, corner_grain, corner_half_edge, face = _faces(a, b, x, y)
    area, cx, cy, void = measure_faces(first, corner_grain, x, y, radius)
    bounded = area > 0.0
    domain_of_face = np.where(bounded, np.cumsum(bounded) - 1, -1)

    corners = np.diff(first)
    corner_kept = np.repeat(bounded, corners)
    corner_grain = corner_grain[corner_kept]
    corner_half_edge = corner_half_edge[corner_kept]
    corner_start = np.concatenate([[0], np.cumsum(corners[bounded])])
    area, cx, cy, volume = area[bounded], cx[bounded], cy[bounded], void[bounded]

    left, right = domain_of_face[face[0::2]], domain_of_face[face[1::2]]
    is_pipe = (left >= 0) & (right >= 0) & (left != right)
    pipe_of_contact = np.where(is_pipe, np.cumsum(is_pipe) - 1, -1)
    a, b, left, right = a[is_pipe], b[is_pipe], left[is_pipe], right[is_pipe]

    carried = np.zeros(len(x), dtype=bool)
    carried[corner_grain] = True
    floaters = np.flatnonzero(~carried)
    host = locate(x[floaters], y[floaters], corner_start, corner_grain, x, y)
    inside_void = host >= 0
    np.subtract.at(volume, host[inside_void], np.pi * radius[floaters[inside_void]] ** 2)

    inside = contains(region, np.column_stack([cx, cy]))
    if walled:
        inside[:] = True
        of_hole = faces_of_holes(gone, corner_start, corner_grain, x, y)
        inside[of_hole] = False
    if not inside.any():
        raise ModelError(
            "no pore lies inside the region: the grains are larger than it; raise grains.count"
        )
    floor = VOLUME_FLOOR * volume[inside].mean()
    slivers = volume < floor
    volume = np.maximum(volume, floor)
    sliver_count = np.count_nonzero(slivers & inside)

    corner_pipe = pipe_of_contact[corner_half_edge >> 1]
    length = radius[a] + radius[b]
    if walled:
        length[np.minimum(radius[a], radius[b]) == 0.0] *= 4.0
    if len(packing.scale):
        # pipes among finer grains conduct as coarse ones do: one aperture is one permeability
        length /= 0.5 * (packing.scale[a] + packing.scale[b])
    _check_width(region, float(np.sqrt(area[inside].mean())))
    parted = _over_slots(region, cx, cy, inside & (not walled), left, right)
    if len(parted.pipe):
        # either end of such a pipe leads to a domain of its own outside, and to nothing else
        pipe, count = parted.pipe, len(parted.pipe)
        turned = np.full(len(left), -1)
        turned[pipe] = len(left) + np.arange(count)
        second = (corner_half_edge % 2 == 1) & (corner_pipe >= 0)
        second[second] = turned[corner_pipe[second]] >= 0
        corner_pipe[second] = turned[corner_pipe[second]]
        beyond = len(cx) + np.arange(2 * count)
        a, b = np.append(a, a[pipe]), np.append(b, b[pipe])
        length = np.append(length, length[pipe] * (1.0 - parted.part))
        length[pipe] *= parted.part
        left, right = np.append(left, beyond[count:]), np.append(right, right[pipe])
        right[pipe] = beyond[:count]
        cx, cy = np.append(cx, np.tile(parted.x, 2)), np.append(cy, np.tile(parted.y, 2))
        volume, area = (
            np.append(volume, np.full(2 * count, floor)),
            np.append(area, np.zeros(2 * count)),
        )
        inside = np.append(inside, np.zeros(2 * count, dtype=bool))
        corner_start = np.append(corner_start, np.full(2 * count, corner_start[-1]))
    at_hole = np.full(len(cx), -1)
    at_hole[of_hole] = np.arange(len(of_hole))
    cut, cut_inside, cut_outside = cut_pipes(inside, left, right)
    if of_hole:
        # each ends in a domain of its own, which lies where the rock's would, were there no hole
        nth = len(region.sides) - len(of_hole)
        side, fraction = nth + at_hole[cut_outside], np.full(len(cut), 0.5)
        beyond = len(cx) + np.arange(len(cut))
        left[cut] = np.where(left[cut] == cut_outside, beyond, left[cut])
        right[cut] = np.where(right[cut] == cut_outside, beyond, right[cut])
        cut_outside = beyond
        one, other, inner = a[cut], b[cut], cut_inside
        cx = np.append(cx, x[one] + x[other] - cx[inner])
        cy = np.append(cy, y[one] + y[other] - cy[inner])
        volume = np.append(volume, np.full(len(cut), floor))
        area, inside = np.append(area, np.zeros(len(cut))), np.append(inside, [False] * len(cut))
        corner_start = np.append(corner_start, np.full(len(cut), corner_start[-1]))
    else:
        side, fraction = cut_places(region, cx, cy, cut_inside, cut_outside)
    found = Network(
        x=cx,
        y=cy,
        volume=volume,
        area=area,
        inside=inside,
        corner_start=corner_start,
        corner_grain=corner_grain,
        corner_pipe=corner_pipe,
        pipe_from=left,
        pipe_to=right,
        pipe_grain_a=a,
        pipe_grain_b=b,
        pipe_length=length,
        cut=cut,
        cut_inside=cut_inside,
        cut_outside=cut_outside,
        cut_side=side,
        cut_fraction=fraction,
        grain_x=x,
        grain_y=y,
        grain_radius=radius,
        porosity=np.asarray(volume[inside].sum() / area[inside].sum()),
        floaters=np.asarray(np.count_nonzero(inside[host[inside_void]])),
        slivers=np.asarray(sliver_count),
        crossing_edges=np.asarray(dropped),
    )
    return evened(found) if even else found


def faces_of_holes(
    gone: list[np.ndarray], start: np.ndarray, corner: np.ndarray, x: np.ndarray, y: np.ndarray
) -> list[int]:
    """The domain that each hole is of a network without the grains that it took.

    Raises `ModelError` where the rock around leaves it in parts, or two are one.

    Parameters
    ----------
    gone : grains that each hole took, (n,) bool
    start, corner : corners of the domains, as in `Network`
    x, y : centres of the grains, m
    """
    found: list[int] = []
    for taken in gone:
        (those,) = np.nonzero(taken)
        faces = np.unique(locate(x[those], y[those], start, corner, x, y))
        if len(faces) != 1 or faces[0] < 0 or int(faces[0]) in found:
            raise ModelError(
                "grains around a hole do not close its rim; raise grains.count, move it away from "
                "the walls, or add bonds with an installation_gap"
            )
        found.append(int(faces[0]))
    return found


class Parted(NamedTuple):
    """Pipes between two domains of the region that leave it on their way."""

    pipe: np.ndarray  # (q,)
    part: np.ndarray  # (q,) of the pipe before the middle of what lies outside
    x: np.ndarray  # (q,) m: that middle
    y: np.ndarray  # (q,)


def _over_slots(
    region: Region,
    x: np.ndarray,
    y: np.ndarray,
    inside: np.ndarray,
    left: np.ndarray,
    right: np.ndarray,
) -> Parted:
    """The pipes that cross a slot, a re-entrant corner or the edge of a hole of the region."""
    both = np.flatnonzero(inside[left] & inside[right])
    if not isinstance(region, Polygon | Pierced):
        both = both[:0]
    start = np.column_stack([x[left[both]], y[left[both]]])
    end = np.column_stack([x[right[both]], y[right[both]]])
    leaves = exit_point(region, start, end)[0]
    out = leaves < 1.0
    comes_back = 1.0 - exit_point(region, end[out], start[out])[0]
    middle = 0.5 * (leaves[out] + comes_back)
    place = start[out] + middle[:, None] * (end[out] - start[out])
    return Parted(both[out], middle, *place.T)


def _check_width(region: Region, spacing: float) -> None:
    """Raise where a part of the region is narrower than two pores (of a spacing in m)."""
    if isinstance(region, Pierced):
        _check_holes(region, spacing)
        region = region.outer
    if not isinstance(region, Polygon):
        return
    width, one, other = narrowest(region)
    if width < NARROWEST * spacing:
        names = region.sides
        raise ModelError(
            f"the region is {width:.3g} m wide between {names[one]} and {names[other]}, less than "
            f"{NARROWEST:g} pores of {spacing:.3g} m; raise grains.count "
            f"{(NARROWEST * spacing / width) ** 2:.1f}-fold, or leave the narrow part out"
        )


def _check_holes(region: Pierced, spacing: float) -> None:
    """Raise where a hole, or the rock beside it, is narrower than two pores."""
    room, name, other = tightest(region)
    narrow = [(float(np.sqrt(h.shape.area)), f"the hole {h.name} is") for h in region.holes]
    narrow.append((room, f"the rock between {name} and {other} is"))
    width, what = min(narrow)
    if width < NARROWEST * spacing:
        raise ModelError(
            f"{what} {width:.3g} m wide, less than {NARROWEST:g} pores of {spacing:.3g} m; raise "
            f"grains.count {(NARROWEST * spacing / width) ** 2:.1f}-fold, or refine grains there"
        )


def domains_at(network: Network, points: np.ndarray) -> np.ndarray:
    """The domain in which each point (n, 2) lies, else the nearest inside the region."""
    points = np.asarray(points, dtype=float).reshape(-1, 2)
    found = locate(
        points[:, 0].copy(),
        points[:, 1].copy(),
        network.corner_start,
        network.corner_grain,
        network.grain_x,
        network.grain_y,
    )
    lost = (found < 0) | ~network.inside[found]
    if lost.any():
        candidates = np.flatnonzero(network.inside)
        tree = cKDTree(np.column_stack([network.x[candidates], network.y[candidates]]))
        found[lost] = candidates[tree.query(points[lost])[1]]
    return found


def _faces(
    a: np.ndarray, b: np.ndarray, x: np.ndarray, y: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Trace all faces: from half-edge to half-edge around each."""
    origin = np.empty(2 * len(a), dtype=np.int64)
    origin[0::2], origin[1::2] = a, b
    angle = np.empty(2 * len(a))
    angle[0::2] = np.arctan2(y[b] - y[a], x[b] - x[a])
    angle[1::2] = np.arctan2(y[a] - y[b], x[a] - x[b])
    return walk_faces(next_half_edges(len(x), origin, angle), origin)


def _without_crossings(
    a: np.ndarray, b: np.ndarray, x: np.ndarray, y: np.ndarray, radius: np.ndarray
) -> tuple[np.ndarray, np.ndarray, int]:
    """Drop contacts that cross another, the one with the wider gap first."""
    if len(a) < 2:
        return a, b, 0
    length = np.hypot(x[b] - x[a], y[b] - y[a])
    if not length.any():
        return a, b, 0
    pairs = crossing_pairs(a, b, x, y, _cell_size(length, x, y))
    if len(pairs) == 0:
        return a, b, 0
    gap = length - radius[a] - radius[b]
    keep = np.ones(len(a), dtype=bool)
    crossed: dict[int, set[int]] = {e: set() for e in np.unique(pairs).tolist()}
    for e, f in pairs.tolist():
        crossed[e].add(f)
        crossed[f].add(e)
    for e in sorted(crossed, key=lambda e: (-gap[e], e)):
        if any(keep[f] for f in crossed[e]):
            keep[e] = False
    return a[keep], b[keep], int(np.count_nonzero(~keep))


def _cell_size(length: np.ndarray, x: np.ndarray, y: np.ndarray) -> float:
    """Size of cells that hold few contacts each, and are not many more than contacts, m."""
    wide, high = float(np.ptp(x)), float(np.ptp(y))
    contacts = len(length)
    return max(
        float(length.mean()), math.sqrt(wide * high / contacts), wide / contacts, high / contacts
    )


def _load_bearing(n: int, a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Contacts of the largest cluster in which every grain has two of them or more."""
    kept = prune(n, a, b)
    a, b = a[kept], b[kept]
    if len(a) == 0:
        return a, b
    label = component_labels(n, a, b)
    largest = np.argmax(np.bincount(label[a]))
    kept = label[a] == largest
    return a[kept], b[kept]


def cut_pipes(
    inside: np.ndarray, left: np.ndarray, right: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pipes that leave the region, with the domain at their inner and their outer end.

    Parameters
    ----------
    inside : (pores,) bool
    left : pore on the one side of each pipe
    right : pore on the other
    """
    cut = np.flatnonzero(inside[left] != inside[right])
    inner = np.where(inside[left[cut]], left[cut], right[cut])
    outer = np.where(inside[left[cut]], right[cut], left[cut])
    return cut, inner, outer


def cut_places(
    region: Region, x: np.ndarray, y: np.ndarray, inner: np.ndarray, outer: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Side on which each cut pipe meets the rim, and the part of the pipe that lies inside.

    On a circular rim pressure varies as the logarithm of the radius, so that the part is
    ln(r_e / r_i) / ln(r_j / r_i).

    Parameters
    ----------
    region : where the case lies, m
    x, y : centroids, m
    inner : pores inside, of pipes that are cut
    outer : pores outside
    """
    start = np.column_stack([x[inner], y[inner]])
    end = np.column_stack([x[outer], y[outer]])
    fraction, side = exit_point(region, start, end)
    for shape, at, numbers in parts_of(region):
        if not isinstance(shape, Circle):
            continue
        r_in, r_out = np.hypot(*(start - at).T), np.hypot(*(end - at).T)
        # a pore at the very centre has no logarithm; the straight fraction serves there
        off_centre = np.minimum(r_in, r_out) > 0.1 * shape.radius
        ours = off_centre & (side == numbers[0])
        ratio = np.log(shape.radius / r_in, where=ours, out=np.ones_like(r_in))
        whole = np.log(r_out / r_in, where=ours, out=np.ones_like(r_in))
        fraction = np.where(ours, ratio / whole, fraction)
    return side, np.clip(fraction, CUT_FLOOR, 1.0)
