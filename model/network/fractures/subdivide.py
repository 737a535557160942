"""Connections that traces and barriers cut, as chains of shorter ones."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from demflow.model.products import Apertures

# A trace may pass through a centroid; the distance of each keeps this part of the pipe's.
NEAREST = 0.02

# Traces may cross a pipe at one place; the distances between keep this part of the pipe's.
CLOSEST = 1e-6


class Cuts(NamedTuple):
    """Where traces and barriers cut connections, each from its `a` to its `b`."""

    way: np.ndarray  # (c,) the connection
    fraction: np.ndarray  # (c,) part of its resistance that lies before
    node: np.ndarray  # (c,) node of the trace, −1 at a barrier
    resistance: np.ndarray  # (c,) Pa s/m³ that a barrier adds, 0 at a trace
    spur: np.ndarray  # (c,) part of the connection's resistance from its place to the node

    def only(self, which: np.ndarray) -> Cuts:
        """Some of them, by their numbers or a mask (c,)."""
        some = np.flatnonzero(which) if which.dtype == bool else which
        return Cuts(*(column[some] for column in self))

    def shifted(self, by: int) -> Cuts:
        """The same of connections numbered from `by` on."""
        return self._replace(way=self.way + by)

    def scaled(self, share: np.ndarray, weight: np.ndarray) -> Cuts:
        """Cuts of the first `share` (n,) of longer connections, barriers weighted (n,)."""
        return self._replace(
            fraction=self.fraction * share[self.way],
            resistance=self.resistance * weight[self.way],
        )

    def back(self) -> Cuts:
        """Cuts of connections from `b` to `a`."""
        return self._replace(fraction=1.0 - self.fraction)

    def along(self, way: np.ndarray, turned: np.ndarray) -> Cuts:
        """Cuts of those connections that are parts (n,) of these ways, turned or not."""
        place = np.full(int(max(way.max(initial=-1), self.way.max(initial=-1))) + 1, -1)
        known = np.flatnonzero(way >= 0)
        place[way[known]] = known
        kept = self.only(place[self.way] >= 0)
        way = place[kept.way]
        fraction = np.where(turned[way], 1.0 - kept.fraction, kept.fraction)
        return kept._replace(way=way, fraction=fraction)


def cuts_of(apertures: Apertures, pipe: np.ndarray, backward: np.ndarray, part: np.ndarray) -> Cuts:
    """What cuts connections (n,) along pipes of the network; a pipe may have several.

    `backward` (n,) ones run from the end at `pipe_to`, and each covers a `part` (n,) of its pipe.

    Parameters
    ----------
    apertures : how far they are open, and traces with nodes of their own
    pipe : of each connection, (n,)
    backward : (n,) bool: it runs from the end at `pipe_to`
    part : of its pipe that each covers, (n,)
    """
    crossed = np.bincount(apertures.cross_pipe, minlength=len(apertures.conductance))
    count = crossed[pipe]
    first = (np.cumsum(crossed) - crossed)[pipe]
    way = np.repeat(np.arange(len(pipe)), count)
    cross = np.arange(len(way)) - np.repeat(np.cumsum(count) - count - first, count)
    fraction = apertures.cross_fraction[cross]
    fraction = np.where(backward[way], 1.0 - fraction, fraction) / part[way]
    found = Cuts(
        way,
        fraction,
        apertures.cross_node[cross],
        apertures.cross_resistance[cross],
        np.zeros(len(way)),
    )
    return found.only(fraction <= 1.0)


def joined_cuts(*parts: Cuts) -> Cuts:
    """All of some cuts."""
    return Cuts(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def subdivide(
    a: np.ndarray, b: np.ndarray, conductance: np.ndarray, cuts: Cuts, first_node: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Connections (n,) from `a` to `b`, m³/(s Pa), with every trace and barrier on their way.

    A trace crossed at the fraction t parts a conductance g in g / t and g / (1 − t), a barrier
    adds its resistance in series where it stands. Where a single trace is met by a spur of s / g,
    the star of the three is a triangle: g s / D between the terminals, g (1 − t) / D and g t / D to
    the node, D = t (1 − t) + s. Node k of the traces is terminal
    `first_node` + k. Only sums of resistances are formed, so that no contrast costs a digit.

    Parameters
    ----------
    a : first terminals, (n,)
    b : second terminals, (n,)
    conductance : (n,) m³/(s Pa)
    cuts : what cuts them
    first_node : terminal of the first node of the traces
    """
    count = len(a)
    if len(cuts.way) == 0:
        return a, b, conductance
    lone = (cuts.spur > 0.0) & (np.bincount(cuts.way, minlength=count)[cuts.way] == 1)
    if lone.any():
        way, t, s = (
            cuts.way[lone],
            np.clip(cuts.fraction[lone], NEAREST, 1.0 - NEAREST),
            cuts.spur[lone],
        )
        other = np.ones(count, dtype=bool)
        other[way] = False
        rest = cuts.only(~lone)
        rest = rest._replace(way=(np.cumsum(other) - 1)[rest.way], spur=np.zeros(len(rest.way)))
        g, node = conductance[way] / (t * (1.0 - t) + s), first_node + cuts.node[lone]
        p, q, h = subdivide(a[other], b[other], conductance[other], rest, first_node)
        return (
            np.concatenate([p, a[way], a[way], b[way]]),
            np.concatenate([q, b[way], node, node]),
            np.concatenate([h, g * s, g * (1.0 - t), g * t]),
        )
    order = np.lexsort((cuts.fraction, cuts.way))
    owner, node, resistance = (column[order] for column in (cuts.way, cuts.node, cuts.resistance))
    fraction = np.clip(cuts.fraction[order], NEAREST, 1.0 - NEAREST)
    stop = node >= 0
    # the stretch before each place: numbered through, the last one of a way after its places
    stretch = np.cumsum(stop) - stop + owner
    before = stretch[stop]
    stretches = count + len(before)
    last = np.cumsum(np.bincount(owner[stop], minlength=count) + 1) - 1
    added = np.bincount(stretch[~stop], weights=resistance[~stop], minlength=stretches)
    start, end = np.empty(stretches, dtype=np.int64), np.empty(stretches, dtype=np.int64)
    begin, finish = np.zeros(stretches), np.ones(stretches)
    end[last], end[before] = b, first_node + node[stop]
    finish[before] = fraction[stop]
    start[np.append(0, last[:-1] + 1)] = a
    start[before + 1], begin[before + 1] = end[before], finish[before]
    whole = np.repeat(conductance, np.diff(np.append(-1, last)))
    return start, end, whole / (np.maximum(finish - begin, CLOSEST) + whole * added)
