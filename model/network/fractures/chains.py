"""Fractures as chains of the matrix's own pipes: those that run along a line.

A line gives every grain one sign, the side on which its centre lies (zero counts as
minus). The contacts whose two grains differ in sign cross the line; walking from face
to face across them gives a chain of pipes that cannot break, however the grains lie.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from demflow.model.compile import Array, kernel
from demflow.model.products import Network
from demflow.model.scene import Line

# Places along a trace are kept apart by this part of their mean distance: two contacts of
# one grain can meet the line at the same point.
LEAST_SPACING = 1e-3


class Chain(NamedTuple):
    """The pores and pipes along a trace, in order."""

    domain: np.ndarray  # (k,) inside the region
    place: np.ndarray  # (k,) m along the trace
    storage_length: np.ndarray  # (k,) m of the trace that each pore stands for
    pipe: np.ndarray  # (k - 1,) pipe between neighbours
    rim_pipe: tuple[int, int]  # pipe from the first / last pore to the rim, −1 where none
    length: float  # m


def chain_along(network: Network, line: Line) -> Chain:
    """The chain of pores along a trace, placed on it.

    A pore stands at the middle of the stretch of trace on which the chain passes it; at a
    tip the trace ends in the pore, so its place is the tip itself. The places increase
    strictly from 0 to the length of the trace. A trace that crosses no contact inside the
    region gives an empty chain.
    """
    domain, pipe, crossing = _walk(network, line)
    run = _inside_run(network, domain)
    if run is None:
        none = np.empty(0, dtype=np.int64)
        return Chain(none, np.empty(0), np.empty(0), none, (-1, -1), line.length)
    lo, hi = run
    rim_start = int(pipe[lo - 1]) if lo > 0 and line.start_at_rim else -1
    rim_end = int(pipe[hi]) if hi < len(pipe) and line.end_at_rim else -1
    entry = np.concatenate([[-np.inf], crossing])[lo : hi + 1]
    leave = np.concatenate([crossing, [np.inf]])[lo : hi + 1]
    entry = np.clip(entry, 0.0, line.length)
    leave = np.clip(leave, 0.0, line.length)
    place = _spread(0.5 * (entry + leave), line.length, rim_start >= 0, rim_end >= 0)
    return Chain(
        domain[lo : hi + 1],
        place,
        np.maximum(leave - entry, 0.0),
        pipe[lo:hi],
        (rim_start, rim_end),
        line.length,
    )


def reach(network: Network) -> float:
    """A distance that spans a few of the largest pores, m."""
    return 4.0 * float(np.sqrt(network.area.max()))


def _walk(network: Network, line: Line) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Domains, pipes between them and where the trace crosses those, loops erased.

    Beyond an end at the rim the walk goes on for a few pores, so that it leaves the region.
    """
    start, end = np.asarray(line.start), np.asarray(line.end)
    along = (end - start) / line.length
    grains = np.column_stack([network.grain_x, network.grain_y])
    offset = grains - start
    height = offset[:, 1] * along[0] - offset[:, 0] * along[1]
    s = offset @ along
    plus = height > 0.0

    g, h = network.pipe_grain_a, network.pipe_grain_b
    crossed = np.flatnonzero(plus[g] != plus[h])
    t = height[g[crossed]] / (height[g[crossed]] - height[h[crossed]])
    where = np.full(len(g), np.nan)
    where[crossed] = s[g[crossed]] + t * (s[h[crossed]] - s[g[crossed]])

    beyond = reach(network)
    low = -beyond if line.start_at_rim else 0.0
    high = line.length + (beyond if line.end_at_rim else 0.0)
    candidates = crossed[(where[crossed] >= low) & (where[crossed] <= high)]
    if len(candidates) == 0:
        nothing = np.empty(0, dtype=np.int64)
        return nothing, nothing, np.empty(0)
    first_pipe = candidates[np.argmin(where[candidates])]
    domain, pipe = _follow(
        int(first_pipe),
        high,
        where,
        plus,
        network.corner_start,
        network.corner_grain,
        network.corner_pipe,
        network.pipe_from,
        network.pipe_to,
        len(crossed),
    )
    return domain, pipe, where[pipe]


@kernel
def _follow(  # noqa: C901 (a kernel)
    first_pipe: int,
    high: float,
    where: Array,
    plus: Array,
    corner_start: Array,
    corner_grain: Array,
    corner_pipe: Array,
    left: Array,
    right: Array,
    bound: int,
) -> tuple[Array, Array]:
    """Walk along the line from the pore behind `first_pipe`, keeping plus grains to the left."""
    domain = np.empty(bound + 2, np.int64)
    pipe = np.empty(bound + 1, np.int64)
    # the pore ahead is the one in which the shared edge runs from plus to minus
    count = 0
    ahead, corner = left[first_pipe], -1
    for attempt in range(2):
        ahead = left[first_pipe] if attempt == 0 else right[first_pipe]
        lo, hi = corner_start[ahead], corner_start[ahead + 1]
        for k in range(lo, hi):
            after = corner_grain[k + 1] if k + 1 < hi else corner_grain[lo]
            if corner_pipe[k] == first_pipe and plus[corner_grain[k]] and not plus[after]:
                corner = k
        if corner >= 0:
            break
    domain[0] = right[first_pipe] if ahead == left[first_pipe] else left[first_pipe]
    domain[1] = ahead
    pipe[0] = first_pipe
    count = 1
    for _ in range(bound):
        lo, hi = corner_start[ahead], corner_start[ahead + 1]
        k = corner
        leaving = -1
        for _turn in range(hi - lo):
            k = k + 1 if k + 1 < hi else lo
            after = corner_grain[k + 1] if k + 1 < hi else corner_grain[lo]
            if not plus[corner_grain[k]] and plus[after]:
                leaving = k
                break
        if leaving < 0 or corner_pipe[leaving] < 0:
            break
        p = corner_pipe[leaving]
        if where[p] > high or p == first_pipe:
            break
        ahead = right[p] if left[p] == ahead else left[p]
        lo, hi = corner_start[ahead], corner_start[ahead + 1]
        for k in range(lo, hi):
            if corner_pipe[k] == p:
                corner = k
        seen = -1
        for i in range(count + 1):
            if domain[i] == ahead:
                seen = i
        if seen >= 0:
            count = seen  # a loop: forget the way since the pore was first entered
        else:
            pipe[count] = p
            count += 1
            domain[count] = ahead
    return domain[: count + 1].copy(), pipe[:count].copy()


def _inside_run(network: Network, domain: np.ndarray) -> tuple[int, int] | None:
    """First and last position of the longest unbroken stretch of pores inside the region."""
    if len(domain) == 0:
        return None
    inside = np.concatenate([[False], network.inside[domain], [False]])
    starts = np.flatnonzero(~inside[:-1] & inside[1:])
    ends = np.flatnonzero(inside[:-1] & ~inside[1:]) - 1
    if len(starts) == 0:
        return None
    k = int(np.argmax(ends - starts))
    return int(starts[k]), int(ends[k])


def _spread(place: np.ndarray, length: float, rim_start: bool, rim_end: bool) -> np.ndarray:
    """Places that increase strictly, with tips at the ends and rims just beyond them."""
    place = place.copy()
    if not rim_start:
        place[0] = 0.0
    if not rim_end and (len(place) > 1 or rim_start):
        place[-1] = length
    nodes = np.concatenate([[0.0] if rim_start else [], place, [length] if rim_end else []])
    if len(nodes) < 2:
        return place
    even = np.linspace(0.0, length, len(nodes))
    if np.min(np.diff(nodes)) < LEAST_SPACING * even[1]:
        nodes = (1.0 - LEAST_SPACING) * np.maximum.accumulate(nodes) + LEAST_SPACING * even
    return nodes[int(rim_start) : len(nodes) - int(rim_end)]
