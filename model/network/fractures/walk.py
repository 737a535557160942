"""Where the lines of a scene run on the network (the *walk* stage), before anything is opened.

A trace with a hydraulic aperture has nodes of its own: where it crosses a pipe, where it meets
other traces in the plane, and where it leaves the region. A pipe that it crosses ends at the
node from either side, in proportion to the distances: where the trace conducts nothing the pipe
is what it was, and where it conducts all the pressure on it is met in place, as at a rim. A
barrier cuts pipes and traces, and a fracture of given permeability is a chain of the matrix's
own pipes.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import cKDTree

from demflow.model.compile import Array, kernel
from demflow.model.network.connectivity import component_labels
from demflow.model.network.fractures.chains import chain_along, reach
from demflow.model.network.fractures.crossings import Crossings, crossings
from demflow.model.products import Network, Walk
from demflow.model.region import Region, sides_at
from demflow.model.scene import FlowLine, Line
from demflow.model.scene.topology import Topology, meetings, topology

# Crossings of a trace nearer to each other than this part of the pores' spacing are one node,
# unless a barrier runs between them: the tiny distance between would only stiffen the equation.
NODE_SPACING = 0.02

# Between the last pipe that a trace crosses and the next, which it does not, its pressure ends to
# act nearer to the former: mean over directions and places on lattices and random networks, in
# spacings of pores, by which an unbiased tip must reach further. For a barrier, where pressure
# and flow change places, it is as much less.
TIP_REACH = 0.25
# Beyond its tip a trace is met no nearer to another one than this part of their distance, lest the
# two be all but joined; before a barrier it reaches this part of the way to it.
APART = 1 / 3
LEAST_COVER = 0.1  # part of an edge across a barrier that counts as length of it
AROUND_TIP = 24  # pores whose mean area gives their spacing there


def walk(network: Network, *, region: Region, lines: tuple[FlowLine, ...]) -> Walk:
    """Find what each line meets on the network.

    Parameters
    ----------
    network : pores and pipes.
    region : for the sides at which traces leave.
    lines : straight pieces inside the region (m), each with its part in flow, as
        `model.scene.flow_lines` gives them.

    Returns
    -------
    `Walk`, whose lines are counted in the order given.
    """
    start = np.array([line.start for line in lines]).reshape(-1, 2)
    end = np.array([line.end for line in lines]).reshape(-1, 2)
    at_rim = np.array([(line.start_at_rim, line.end_at_rim) for line in lines]).reshape(-1, 2)
    part = np.array([line.part for line in lines], dtype=str)
    traces, barriers = (
        np.flatnonzero(np.isin(part, kinds)) for kinds in (["trace"], ["barrier", "multiplier"])
    )
    # a multiplier keeps its old meaning: the pipes between its very ends
    firm = np.array([line.part == "barrier" for line in lines], dtype=bool)[barriers]
    walls = _walls(network, start[barriers], end[barriers], at_rim[barriers], firm)
    found = _Traces(
        network,
        start[traces],
        end[traces],
        at_rim[traces].astype(bool),
        np.stack([start[barriers], end[barriers]]),
    )
    found.join(*_cuts(start, end, traces, barriers))
    chains = [
        (k, chain_along(network, Line(0, *lines[k][1:])))
        for k in np.flatnonzero(part == "chain").tolist()
    ]
    counts = [len(chain.pipe) for _, chain in chains]
    rims = [(k, pipe) for k, chain in chains for pipe in chain.rim_pipe if pipe >= 0]
    domains = [len(chain.domain) for _, chain in chains]
    numbers = np.array([k for k, _ in chains], dtype=np.int64)
    side = np.full((len(found.x), 2), -1)
    side[found.rim] = sides_at(region, np.column_stack([found.x, found.y])[found.rim])
    return Walk(
        line_start=start,
        line_end=end,
        node_x=found.x,
        node_y=found.y,
        node_side=side,
        branch_a=found.a,
        branch_b=found.b,
        branch_length=found.length,
        branch_line=traces[found.line],
        cross_pipe=found.met.pipe,
        cross_fraction=found.met.fraction,
        cross_node=found.node,
        cross_line=traces[found.met.line],
        wall_pipe=walls[0].pipe,
        wall_fraction=walls[0].fraction,
        wall_length=walls[1],
        wall_line=barriers[walls[0].line],
        cut_branch=found.cut_branch,
        cut_line=found.cut_line,
        chain_pipe=_joined([chain.pipe for _, chain in chains], [p for _, p in rims]),
        chain_line=_joined([np.repeat(numbers, counts)], [k for k, _ in rims]),
        chain_domain=_joined([chain.domain for _, chain in chains]),
        chain_domain_line=np.repeat(numbers, domains),
        chain_storage=np.concatenate([np.empty(0), *(chain.storage_length for _, chain in chains)]),
    )


def _joined(parts: list[np.ndarray], more: list[int] | None = None) -> np.ndarray:
    return np.concatenate([*parts, np.array(more or [], dtype=np.int64)]).astype(np.int64)


def _walls(
    network: Network, start: np.ndarray, end: np.ndarray, at_rim: np.ndarray, firm: np.ndarray
) -> tuple[Crossings, np.ndarray]:
    """Pipes that barriers cut, and the length of the barrier that each of them meets, m.

    A barrier that leaves the region is continued beyond the rim, where its pores end; a `firm`
    one ends as `TIP_REACH` says. The edges between the pores on either side follow the barrier,
    so that each pipe has the length that its edge covers of it.
    """
    length = np.hypot(*(end - start).T)[:, None]
    along = (end - start) / length
    beyond = reach(network) * at_rim.T
    joints = topology(start, end)
    tip = _tips(joints, at_rim.astype(bool)) & firm[:, None]
    ends = np.where(tip.T, -np.minimum(_tip_reach(network, start, end), 0.49 * length.T), beyond)
    met = crossings(network, start - ends[0][:, None] * along, end + ends[1][:, None] * along)
    a, b = network.pipe_grain_a[met.pipe], network.pipe_grain_b[met.pipe]
    i, j = network.pipe_from[met.pipe], network.pipe_to[met.pipe]
    edge = np.column_stack(
        [network.grain_x[b] - network.grain_x[a], network.grain_y[b] - network.grain_y[a]]
    )
    step = np.column_stack([network.x[j] - network.x[i], network.y[j] - network.y[i]])
    across = np.column_stack([-along[met.line, 1], along[met.line, 0]])
    # turned so that all edges lead along the barrier, but for those that fold back
    turn = np.sign(edge[:, 0] * step[:, 1] - edge[:, 1] * step[:, 0])
    turn = turn * np.sign(np.einsum("ij,ij->i", step, across))
    leads = turn * np.einsum("ij,ij->i", edge, along[met.line])
    covers = np.maximum(leads, LEAST_COVER * np.hypot(*edge.T))
    inner = np.ones(len(network.pipe_from))
    inner[network.cut] = network.cut_fraction
    covers = covers * inner[met.pipe]
    # a barrier with bends, of which all pieces together have the length that was drawn
    _, first = np.unique(joints.line, return_index=True)
    tie = np.repeat(joints.node[first], np.diff(np.append(first, len(joints.line))))
    label = component_labels(len(joints.node_x), tie, joints.node)
    group = label[joints.node[first]]
    whole = np.bincount(group[met.line], weights=covers, minlength=len(joints.node_x))
    drawn = np.bincount(group, weights=length[:, 0], minlength=len(joints.node_x))
    part = np.divide(drawn, whole, out=np.ones(len(whole)), where=whole > 0.0)
    return met, covers * part[group[met.line]]


def _tips(joints: Topology, at_rim: np.ndarray) -> np.ndarray:
    """Ends of lines that end in the rock alone, (lines, 2) bool."""
    count = np.bincount(joints.node, minlength=len(joints.node_x))
    first = np.append(True, joints.line[1:] != joints.line[:-1])[: len(joints.line)]
    last = np.append(first[1:], True)[: len(joints.line)]
    lone = count[joints.node] == 1
    found: np.ndarray = np.column_stack([lone[first], lone[last]]) & ~at_rim
    return found


def _tip_reach(network: Network, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """`TIP_REACH` of the spacing of the pores around each end of lines, (2, lines) m."""
    if not len(start):
        return np.empty((2, 0))
    inside = np.flatnonzero(network.inside)
    pores = cKDTree(np.column_stack([network.x[inside], network.y[inside]]))
    few = min(AROUND_TIP, len(inside))
    _, near = pores.query(np.concatenate([start, end]), k=np.arange(1, few + 1))
    spacing = np.sqrt(network.area[inside][near].mean(axis=1))
    found: np.ndarray = TIP_REACH * spacing.reshape(2, len(start))
    return found


def _before_barriers(
    reach: np.ndarray, start: np.ndarray, end: np.ndarray, walls: np.ndarray
) -> np.ndarray:
    """How far ends of traces reach beyond them, (2, traces) m, if at most by `reach`.

    No further than a part of the way to a barrier; `walls` (2, b, 2) m are the ends of those.
    """
    if not walls.shape[1] or not reach.any():
        return reach
    found = reach.copy()
    unit = (end - start) / np.hypot(*(end - start).T)[:, None]
    for tip, place, way in zip(found, (start, end), (-unit, unit), strict=True):
        ahead = place + tip[:, None] / APART * way
        met = meetings(np.concatenate([place, walls[0]]), np.concatenate([ahead, walls[1]]))
        ours = (met.line_a < len(start)) & (met.line_b >= len(start))
        np.minimum.at(tip, met.line_a[ours], APART * met.along_a[ours])
    return found


def _apart(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Distances of straight lines (2, n, 2) from others, (n,) m; 0 where they cross."""
    found = np.full(one.shape[1], np.inf)
    side = []
    for line, ends in ((one, other), (other, one)):
        step = line[1] - line[0]
        square = np.maximum((step * step).sum(axis=1), np.finfo(float).tiny)
        for place in ends:
            part = np.clip(((place - line[0]) * step).sum(axis=1) / square, 0.0, 1.0)
            found = np.minimum(found, np.hypot(*(line[0] + part[:, None] * step - place).T))
        turn = step[:, 0] * (ends[..., 1] - line[0, :, 1])
        turn -= step[:, 1] * (ends[..., 0] - line[0, :, 0])
        side.append((turn[0] > 0.0) != (turn[1] > 0.0))
    found[side[0] & side[1]] = 0.0
    return found


def _not_joined(
    met: Crossings, beyond: np.ndarray, network: Network, ends: np.ndarray
) -> Crossings:
    """Crossings without those `beyond` (c,) tips that would join lines which do not meet.

    `ends` (2, l, 2) m are those of the lines. One that is met nowhere else keeps its crossings.
    """
    order = np.lexsort((met.fraction, met.pipe))
    one, other = order[:-1], order[1:]
    asked = (met.pipe[one] == met.pipe[other]) & (beyond[one] | beyond[other])
    asked &= met.line[one] != met.line[other]
    one, other = one[asked], other[asked]
    i, j = network.pipe_from[met.pipe[one]], network.pipe_to[met.pipe[one]]
    way = np.hypot(network.x[j] - network.x[i], network.y[j] - network.y[i])
    between = way * (met.fraction[other] - met.fraction[one])
    near = between < APART * _apart(ends[:, met.line[one]], ends[:, met.line[other]])
    kept = np.ones(len(met.line), dtype=bool)
    kept[np.concatenate([one[near], other[near]])] = False
    kept |= ~beyond
    kept |= np.bincount(met.line, kept, ends.shape[1])[met.line] == 0.0
    return Crossings(*(column[kept] for column in met))


def _cuts(
    start: np.ndarray, end: np.ndarray, traces: np.ndarray, barriers: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where barriers meet traces: position among the traces, m along it, line of the barrier."""
    if not len(traces) or not len(barriers):
        none = np.empty(0, dtype=np.int64)
        return none, np.empty(0), none
    lines = np.concatenate([traces, barriers])
    met = meetings(start[lines], end[lines])
    ours = (met.line_a < len(traces)) & (met.line_b >= len(traces))
    return met.line_a[ours], met.along_a[ours], lines[met.line_b[ours]]


class _Traces:
    """Nodes and branches of the traces, found line by line."""

    def __init__(
        self,
        network: Network,
        start: np.ndarray,
        end: np.ndarray,
        at_rim: np.ndarray,
        walls: np.ndarray,
    ) -> None:
        self.start, self.end, self.at_rim = start, end, at_rim
        self.spacing = NODE_SPACING * math.sqrt(float(network.area[network.inside].mean()))
        self.joints = topology(start, end)
        length = np.hypot(*(end - start).T)
        along = (end - start) / length[:, None]
        self.tip = _tips(self.joints, at_rim)
        more = np.where(self.tip.T, _tip_reach(network, start, end), 0.0)
        more = _before_barriers(more, start, end, walls)
        met = crossings(network, start - more[0][:, None] * along, end + more[1][:, None] * along)
        at = met.along - more[0][met.line]
        met = met._replace(along=np.clip(at, 0.0, length[met.line]))
        self.met = _not_joined(met, at != met.along, network, np.stack([start, end]))

    def join(self, cut_line: np.ndarray, cut_along: np.ndarray, barrier: np.ndarray) -> None:
        """Make nodes of crossings and junctions, and branches between them."""
        joints, met = self.joints, self.met
        own = len(joints.node_x)
        line = np.concatenate([joints.line, met.line, cut_line])
        along = np.concatenate([joints.along, met.along, cut_along])
        kind = np.repeat([0, 1, 2], [len(joints.line), len(met.line), len(cut_line)])
        known = np.concatenate([joints.node, np.full(len(met.line) + len(cut_line), -1)])
        order = np.lexsort((kind, along, line))
        node, opens = _nodes(
            line[order], along[order], kind[order], known[order], own, self.spacing
        )
        # the places that stand for nodes, in order along each line
        stands = order[opens]
        node_of = np.empty(len(order), dtype=np.int64)
        node_of[order] = node
        place_line, place_along = line[stands], along[stands]
        place_node = node_of[stands]
        first = np.append(True, place_line[1:] != place_line[:-1])[: len(stands)]
        last = np.append(first[1:], True)[: len(stands)]
        # a tip that meets no pipe conducts nothing: what it stores belongs to the node before it
        meets = np.bincount(node_of[len(joints.line) :][: len(met.line)], minlength=1)
        meets = np.append(meets, np.zeros(own, dtype=np.int64))[place_node] > 0
        is_end = (along[stands] == 0.0) & self.tip[place_line, 0] & first
        is_end |= last & self.tip[place_line, 1]
        tip = is_end & ~meets
        ends = np.flatnonzero(tip & last & ~first)
        alone = ends[first[ends - 1] & tip[ends - 1]]
        inner = np.setdiff1d(ends, alone)
        begins = np.flatnonzero(tip & first & ~last)
        place_node[begins] = place_node[begins + 1]
        place_node[inner] = place_node[inner - 1]
        self.node = node_of[len(joints.line) : len(joints.line) + len(met.line)]
        branch = np.flatnonzero(~last)
        self.a, self.b = place_node[branch], place_node[branch + 1]
        self.length = place_along[branch + 1] - place_along[branch]
        self.line = place_line[branch]
        self.cut_branch = self._branch_at(branch, place_line, place_along, cut_line, cut_along)
        self.cut_line = barrier[self.cut_branch >= 0]
        self.cut_branch = self.cut_branch[self.cut_branch >= 0]
        self._number(own, stands, line, along, node_of)

    @staticmethod
    def _branch_at(
        branch: np.ndarray,
        place_line: np.ndarray,
        place_along: np.ndarray,
        line: np.ndarray,
        along: np.ndarray,
    ) -> np.ndarray:
        """Branch of a line that holds a place, −1 where it has none."""
        found = np.full(len(line), -1)
        for k in range(len(line)):
            ours = np.flatnonzero(place_line[branch] == line[k])
            if len(ours):
                at = np.searchsorted(place_along[branch[ours]], along[k], side="right") - 1
                found[k] = ours[np.clip(at, 0, len(ours) - 1)]
        return found

    def _number(
        self,
        own: int,
        stands: np.ndarray,
        line: np.ndarray,
        along: np.ndarray,
        node_of: np.ndarray,
    ) -> None:
        """Number the nodes that something meets, and place them."""
        used = np.unique(np.concatenate([self.a, self.b, self.node]))
        number = np.full(max(own, int(node_of.max(initial=-1)) + 1), -1)
        number[used] = np.arange(len(used))
        x, y = np.zeros(len(used)), np.zeros(len(used))
        step = self.end - self.start
        unit = step / np.maximum(np.hypot(*step.T), np.finfo(float).tiny)[:, None]
        at = self.start[line[stands]] + along[stands, None] * unit[line[stands]]
        places = number[node_of[stands]]
        kept = places >= 0
        x[places[kept]], y[places[kept]] = at[kept].T
        joint = number[:own]
        x[joint[joint >= 0]] = self.joints.node_x[joint >= 0]
        y[joint[joint >= 0]] = self.joints.node_y[joint >= 0]
        self.x, self.y = x, y
        self.a, self.b, self.node = number[self.a], number[self.b], number[self.node]
        begins = np.append(True, self.joints.line[1:] != self.joints.line[:-1])
        begins = np.flatnonzero(begins[: len(self.joints.line)])
        stops = np.append(begins[1:], len(self.joints.line)) - 1
        leaves = [
            self.joints.node[at[rim]]
            for at, rim in zip((begins, stops), self.at_rim.T, strict=True)
        ]
        self.rim = np.unique(number[np.concatenate(leaves)])


@kernel
def _nodes(
    line: Array, along: Array, kind: Array, known: Array, own: int, spacing: float
) -> tuple[Array, Array]:
    """Node of each place, in order along each line, and whether the place stands for a node.

    Kinds are 0 a junction or an end, whose node is known, 1 a crossing with a pipe, 2 a cut by
    a barrier. Nodes of crossings are counted from `own` on.
    """
    n = line.size
    node = np.full(n, -1, np.int64)
    stands = np.zeros(n, np.bool_)
    count = own
    anchor, loose = -1, -1  # the place that stands for the last node; where its crossings begin
    for k in range(n):
        if k > 0 and line[k] != line[k - 1]:
            anchor, loose = -1, -1
        if kind[k] == 2:
            anchor, loose = -1, -1
        elif kind[k] == 0:
            node[k], stands[k] = known[k], True
            if loose >= 0 and along[k] - along[loose] <= spacing:
                stands[loose] = False  # crossings just before belong to the junction
                for e in range(loose, k):
                    if kind[e] == 1:
                        node[e] = known[k]
            anchor, loose = k, -1
        elif anchor >= 0 and along[k] - along[anchor] <= spacing:
            node[k] = node[anchor]
        else:
            node[k], stands[k] = count, True
            count += 1
            anchor, loose = k, k
    return node, stands
