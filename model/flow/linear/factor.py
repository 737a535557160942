"""Subtraction-free factorisation of the flow equation's matrices.

K = G + s C is a diagonally dominant M-matrix: it is given by conductances of edges and
by each row's excess (conductance to fixed pressures plus s times storage), and its
diagonal is their sum. Eliminating a node turns its edges into edges between its
neighbours; written with edges and excesses, every step adds positive numbers, so that
no digit cancels however far the conductances lie apart (Grassmann, Taksar & Heyman
1985; O'Cinneide 1993). An ordinary LDLᵀ stores the diagonal and loses, at a contrast of
1e12, whatever the excess held.

The elimination is multifrontal (Duff & Reid 1983, ACM Trans. Math. Softw. 9, 302–325): a
front gathers its edges and what the fronts below hand on, eliminates its own nodes, and
hands the edges between the others on.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from demflow.model.compile import Array, kernel
from demflow.model.flow.linear.elimination import Symbolic, analyse
from demflow.model.memory import foresee
from demflow.model.outcome import ModelError

__all__ = ["Factor", "Symbolic", "analyse", "factorise", "solve"]

# Columns of a front that are eliminated before the rest of it is brought up to date, and rows
# that are then worked on at once: so that both stay in the cache.
COLUMNS = 8
ROWS = 256


class Factor(NamedTuple):
    """K = L D Lᵀ of one matrix, in elimination order; L is −`lower` below a unit diagonal."""

    symbolic: Symbolic
    lower: np.ndarray  # the fronts' columns, see `Symbolic`; above the diagonal unused
    pivot: np.ndarray  # (n,)

    @property
    def parts(self) -> tuple[Array, Array, Array, Array, Array, Array]:
        """What kernels are given of it: one by one, since named tuples take long to pass."""
        of = self.symbolic
        return of.first, of.row_start, of.row, of.place, self.lower, self.pivot


def factorise(symbolic: Symbolic, conductance: np.ndarray, excess: np.ndarray) -> Factor:
    """Factor the matrix with the given edge conductances (e,) ≥ 0 and row excesses (n,) ≥ 0.

    Raises `OutOfMemory` where the factor would not fit, before it is made, and `ModelError`
    where the matrix is singular: nodes without excess that no edge joins to one that has some.

    Parameters
    ----------
    symbolic : order and pattern
    conductance : of the edges, (e,) ≥ 0
    excess : what each row has beyond its edges, (n,) ≥ 0
    """
    foresee("the factor of the flow equation", symbolic.factor_bytes + symbolic.work_bytes)
    lower, pivot = _numeric(
        symbolic.first,
        symbolic.row_start,
        symbolic.row,
        symbolic.place,
        symbolic.children,
        symbolic.stacked,
        symbolic.widest,
        symbolic.edge_slot,
        conductance,
        np.ascontiguousarray(excess[symbolic.order]),
    )
    if not np.all(pivot > 0.0):
        raise ModelError(
            "the flow equation is singular: some pores store nothing and reach no fixed pressure, "
            "or their conductances lie below the smallest number; check apertures and fluid"
        )
    return Factor(symbolic, lower, pivot)


def solve(factor: Factor, rhs: np.ndarray) -> np.ndarray:
    """Solve K x = rhs for one (n,) or several (n, k) right-hand sides."""
    symbolic = factor.symbolic
    x = np.ascontiguousarray(rhs[symbolic.order], dtype=float)
    if x.ndim == 1:
        substitute(*factor.parts, x)
    else:
        _substitute_several(*factor.parts, x)
    found: np.ndarray = x[symbolic.rank]
    return found


@kernel
def _numeric(
    first: Array,
    row_start: Array,
    row: Array,
    place: Array,
    children: Array,
    stacked: int,
    widest: int,
    edge_slot: Array,
    conductance: Array,
    excess: Array,
) -> tuple[Array, Array]:
    fronts = children.size
    lower = np.zeros(place[fronts])
    for e in range(edge_slot.size):
        lower[edge_slot[e]] += conductance[e]
    pivot = np.empty(excess.size)
    rest = np.empty(widest * widest)  # edges between the rows below a front
    stack = np.empty(stacked)  # the rests that wait
    waiting = np.empty(fronts + 1, np.int32)  # whose they are
    count, top = 0, 0
    at = np.empty(excess.size, np.int32)  # place of a row in the present front
    weight = np.empty(_largest(first, row_start))
    for s in range(fronts):
        begin, end = first[s], first[s + 1]
        width, m = end - begin, row_start[s + 1] - row_start[s]
        rows = row[row_start[s] : row_start[s + 1]]
        panel = lower[place[s] : place[s + 1]]
        for k in range(width):
            at[begin + k] = k
        for k in range(m):
            at[rows[k]] = width + k
            rest[k * m + k + 1 : (k + 1) * m] = 0.0
        for _ in range(children[s]):
            count -= 1
            c = waiting[count]
            theirs = row[row_start[c] : row_start[c + 1]]
            top -= theirs.size * (theirs.size - 1) // 2
            _hand_on(stack, top, theirs, at, panel, width, rest, m)
        _eliminate_front(panel, width, m, begin, rows, excess, pivot, weight)
        if m > 0:
            for k in range(width):
                d = pivot[begin + k]
                column = k * (width + m) + width
                for q in range(m):
                    weight[q * width + k] = panel[column + q] * d
            _add_products(rest, 0, m, 0, m - 1, m, panel, width, width + m, width, weight)
            for q in range(m - 1):
                for r in range(q + 1, m):
                    stack[top] = rest[q * m + r]
                    top += 1
            waiting[count] = s
            count += 1
    return lower, pivot


@kernel
def _largest(first: Array, row_start: Array) -> int:
    most = 0
    for s in range(first.size - 1):
        width = first[s + 1] - first[s]
        most = max(most, width * (width + row_start[s + 1] - row_start[s]))
    return most


@kernel
def _hand_on(
    stack: Array, top: int, theirs: Array, at: Array, panel: Array, width: int, rest: Array, m: int
) -> None:
    """Add the edges between `theirs` rows to a front and its rest."""
    height = width + m
    for q in range(theirs.size):
        column = at[theirs[q]]
        if column < width:
            target = column * height
            for r in range(q + 1, theirs.size):
                panel[target + at[theirs[r]]] += stack[top]
                top += 1
        else:
            target = (column - width) * m - width
            for r in range(q + 1, theirs.size):
                rest[target + at[theirs[r]]] += stack[top]
                top += 1


@kernel
def _eliminate_front(
    panel: Array,
    width: int,
    m: int,
    begin: int,
    rows: Array,
    excess: Array,
    pivot: Array,
    weight: Array,
) -> None:
    """Eliminate a front's own nodes: columns of edge conductances become columns of L.

    pivot = excess + Σ edges; an eliminated node's excess goes to its neighbours, each by its
    part of the pivot.
    """
    height = width + m
    for c0 in range(0, width, COLUMNS):
        c1 = min(c0 + COLUMNS, width)
        for c in range(c0, c1):
            t = c * height
            for k in range(c0, c):
                u = k * height
                w = panel[u + c] * pivot[begin + k]
                for r in range(c + 1, height):
                    panel[t + r] += w * panel[u + r]
            s = excess[begin + c]
            d = s
            for r in range(c + 1, height):
                d += panel[t + r]
            pivot[begin + c] = d
            for r in range(c + 1, height):
                panel[t + r] /= d
            for r in range(c + 1, width):
                excess[begin + r] += panel[t + r] * s
            for r in range(m):
                excess[rows[r]] += panel[t + width + r] * s
        if c1 < width:
            block = c1 - c0
            for q in range(c1, width):
                for k in range(block):
                    u = (c0 + k) * height
                    weight[(q - c1) * block + k] = panel[u + q] * pivot[begin + c0 + k]
            _add_products(
                panel, 0, height, c1, width, height, panel, c0 * height, height, block, weight
            )


@kernel
def _add_products(
    target: Array,
    t0: int,
    step: int,
    q0: int,
    q1: int,
    end: int,
    source: Array,
    s0: int,
    height: int,
    width: int,
    weight: Array,
) -> None:
    """target[t0 + q step + r] += Σ_k weight[q − q0, k] source[s0 + k height + r], q < r < end.

    For columns q0 ≤ q < q1; two of them and four products at a time.
    """
    for lo in range(q0 + 1, end, ROWS):
        hi = min(lo + ROWS, end)
        last = min(q1, hi - 1)
        for q in range(q0, last, 2):
            ta = t0 + q * step
            ka = (q - q0) * width
            begin = max(lo, q + 1)
            if q + 1 == last:
                for k in range(width):
                    a = weight[ka + k]
                    s = s0 + k * height
                    for r in range(begin, hi):
                        target[ta + r] += a * source[s + r]
                continue
            tb, kb = ta + step, ka + width
            both = max(lo, q + 2)
            if begin < both:
                for k in range(width):
                    target[ta + begin] += weight[ka + k] * source[s0 + k * height + begin]
            for k in range(0, width - 3, 4):
                a0, a1, a2, a3 = (
                    weight[ka + k],
                    weight[ka + k + 1],
                    weight[ka + k + 2],
                    weight[ka + k + 3],
                )
                b0, b1, b2, b3 = (
                    weight[kb + k],
                    weight[kb + k + 1],
                    weight[kb + k + 2],
                    weight[kb + k + 3],
                )
                s = s0 + k * height
                u, v, w = s + height, s + 2 * height, s + 3 * height
                for r in range(both, hi):
                    x0, x1, x2, x3 = source[s + r], source[u + r], source[v + r], source[w + r]
                    target[ta + r] += (a0 * x0 + a1 * x1) + (a2 * x2 + a3 * x3)
                    target[tb + r] += (b0 * x0 + b1 * x1) + (b2 * x2 + b3 * x3)
            for k in range(width - width % 4, width):
                a, b = weight[ka + k], weight[kb + k]
                s = s0 + k * height
                for r in range(both, hi):
                    target[ta + r] += a * source[s + r]
                    target[tb + r] += b * source[s + r]


@kernel
def substitute(
    first: Array, row_start: Array, row: Array, place: Array, lower: Array, pivot: Array, x: Array
) -> None:
    """Solve L D Lᵀ x = x in place, (n,) in the order of elimination; see `Factor.parts`."""
    _forward(first, row_start, row, place, lower, x)
    _backward(first, row_start, row, place, lower, pivot, x)


@kernel
def _forward(
    first: Array, row_start: Array, row: Array, place: Array, lower: Array, x: Array
) -> None:
    """Solve L y = x in place, (n,); two columns of a front at a time, which share its rows."""
    for s in range(first.size - 1):
        begin, end = first[s], first[s + 1]
        rows, m = row_start[s], row_start[s + 1] - row_start[s]
        height = end - begin + m
        t = place[s]
        for k in range(begin, end - 1, 2):
            u = t + height + 1  # the second column's diagonal
            a = x[k]
            b = x[k + 1] + lower[t + 1] * a
            x[k + 1] = b
            for r in range(1, end - k - 1):
                x[k + 1 + r] += lower[t + 1 + r] * a + lower[u + r] * b
            t += end - k
            u += end - k - 1
            for r in range(m):
                x[row[rows + r]] += lower[t + r] * a + lower[u + r] * b
            t = u + m + (k + 2 - begin)
        if (end - begin) % 2 == 1:
            a = x[end - 1]
            for r in range(m):
                x[row[rows + r]] += lower[t + 1 + r] * a


@kernel
def _backward(
    first: Array, row_start: Array, row: Array, place: Array, lower: Array, pivot: Array, x: Array
) -> None:
    """Solve D Lᵀ x = y in place, (n,), likewise."""
    for s in range(first.size - 2, -1, -1):
        begin, end = first[s], first[s + 1]
        rows, m = row_start[s], row_start[s + 1] - row_start[s]
        height = end - begin + m
        k = end - 1
        t = place[s + 1] - m  # the last column's rows below the front
        if (end - begin) % 2 == 1:
            a = x[k] / pivot[k]
            for r in range(m):
                a += lower[t + r] * x[row[rows + r]]
            x[k] = a
            k -= 1
            t -= height
        while k > begin:
            a, b = x[k - 1] / pivot[k - 1], x[k] / pivot[k]
            for r in range(m):
                known = x[row[rows + r]]
                a += lower[t - height + r] * known
                b += lower[t + r] * known
            for r in range(1, end - k):
                a += lower[t - height - r] * x[end - r]
                b += lower[t - r] * x[end - r]
            x[k] = b
            x[k - 1] = a + lower[t - height - (end - k)] * b
            k -= 2
            t -= 2 * height


@kernel
def _substitute_several(
    first: Array, row_start: Array, row: Array, place: Array, lower: Array, pivot: Array, x: Array
) -> None:
    """Solve L D Lᵀ x = x in place for several right-hand sides at once, (n, k)."""
    sides = x.shape[1]
    for s in range(first.size - 1):
        begin, width = first[s], first[s + 1] - first[s]
        rows = row[row_start[s] : row_start[s + 1]]
        for k in range(width):
            t = place[s] + k * (width + rows.size)
            for r in range(k + 1, width + rows.size):
                i = begin + r if r < width else rows[r - width]
                for c in range(sides):
                    x[i, c] += lower[t + r] * x[begin + k, c]
    for s in range(first.size - 2, -1, -1):
        begin, width = first[s], first[s + 1] - first[s]
        rows = row[row_start[s] : row_start[s + 1]]
        for k in range(width - 1, -1, -1):
            t = place[s] + k * (width + rows.size)
            for c in range(sides):
                x[begin + k, c] /= pivot[begin + k]
            for r in range(k + 1, width + rows.size):
                i = begin + r if r < width else rows[r - width]
                for c in range(sides):
                    x[begin + k, c] += lower[t + r] * x[i, c]
