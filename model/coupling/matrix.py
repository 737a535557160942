"""The matrix of one implicit step of rock and fluid, and equations with it.

With s the sum of what flows in the step, the symmetric matrix

    [ K   −A      ]
    [ −Aᵀ −(C + s G) ]

is quasi-definite, so that it has a factor L D Lᵀ in any order (Vanderbei 1995, SIAM J. Optim. 5,
100–113). Its pattern is that of all contacts and pipes, whatever they do, so that it is analysed
once; its entries are linear in their stiffnesses and conductances. A factor serves as long as
GMRES with it converges in a few solves: a bond that breaks changes few directions.
"""

from __future__ import annotations

import numpy as np
import qdldl
from scipy.sparse import coo_array, csc_array, csr_array
from scipy.sparse.linalg import LinearOperator, gmres

from demflow.model.mechanics.contact.grains import Array

MOST_SOLVES = 12  # of one equation with a factor of before: half as long as a new one takes
MANY_SOLVES = 10  # after which the next equation gets a factor of its own
WITH_NEW = 100  # with one of its own
ENOUGH = 1e-2  # relative residual with which such a solve still serves Newton's method


class StepMatrix:
    """K, A, C and G of one case, of m displacements and d pressures."""

    def __init__(
        self,
        strains: tuple[csr_array, ...],
        anchor: Array,
        push: csr_array,
        storage: Array,
        pipe_i: Array,
        pipe_j: Array,
        link: Array,
    ):
        """`strains` are operators (c, m), `anchor` (m,) is added to the diagonal, `push` A (m, d).

        Pipes join pressures i and j (p,); links (q,) join one with what keeps its own.
        """
        m, d = push.shape
        self.m, self.d, self.n = m, d, m + d
        rows, columns, parameter, values = [], [], [], []
        first = 0
        for strain in strains:
            of, (low, high), product = _pairs(strain)
            rows.append(low)
            columns.append(high)
            parameter.append(first + of)
            values.append(product)
            first += strain.shape[0]
        p, q = len(pipe_i), len(link)
        for i, j, sign in ((pipe_i, pipe_i, -1.0), (pipe_j, pipe_j, -1.0), (pipe_i, pipe_j, 1.0)):
            rows.append(m + np.minimum(i, j))
            columns.append(m + np.maximum(i, j))
            parameter.append(first + np.arange(p))
            values.append(np.full(p, sign))
        rows.append(m + link)
        columns.append(m + link)
        parameter.append(first + p + np.arange(q))
        values.append(np.full(q, -1.0))
        first += p + q
        constant = push.tocoo()
        every = np.arange(self.n)
        fixed_rows = np.concatenate([every, constant.row])
        fixed_columns = np.concatenate([every, m + constant.col])
        fixed = np.concatenate([anchor, -storage, -constant.data])
        key = np.concatenate(columns) * self.n + np.concatenate(rows)
        fixed_key = fixed_columns * self.n + fixed_rows
        pattern, place = np.unique(np.append(fixed_key, key), return_inverse=True)
        self.row, self.column = pattern % self.n, pattern // self.n
        self.start = np.searchsorted(self.column, np.arange(self.n + 1))
        (off,) = np.nonzero(self.row != self.column)  # those that also stand below the diagonal
        row, column = np.append(self.row, self.column[off]), np.append(self.column, self.row[off])
        order = np.lexsort((column, row))
        self._both = np.append(np.arange(len(pattern)), off)[order], column[order]
        self._starts = np.searchsorted(row[order], np.arange(self.n + 1))
        self.fixed = np.bincount(place[: len(fixed)], weights=fixed, minlength=len(pattern))
        self.by = coo_array(
            (np.concatenate(values), (place[len(fixed) :], np.concatenate(parameter))),
            shape=(len(pattern), first),
        ).tocsr()
        self.solver: qdldl.Solver | None = None
        self.factored = self.solved = 0  # how often
        self.stale = True

    def entries(self, stiffnesses: Array, conductances: Array, held: Array) -> csc_array:
        """Its upper triangle; pressures that are `held` (d,) bool keep what they are.

        Parameters
        ----------
        stiffnesses : of the contacts
        conductances : of the pipes, m³/(s Pa)
        held : which unknowns are held, bool
        """
        data = self.fixed + self.by @ np.concatenate([stiffnesses, conductances])
        if held.any():
            out = np.concatenate([np.zeros(self.m, bool), held])
            data[out[self.row] | out[self.column]] = 0.0
            data[(self.row == self.column) & out[self.row]] = -1.0
        return csc_array((data, self.row, self.start), shape=(self.n, self.n))

    def solve(self, upper: csc_array, besides: csr_array, right: Array, tolerance: float) -> Array:
        """Solve (M + besides) x = right, to a tolerance relative to the right side.

        Where GMRES thinks that it is done earlier, ENOUGH may do: the next step of Newton's method
        finds what is left.

        Parameters
        ----------
        upper : coupling above the diagonal
        besides : what stands beside
        right : right-hand side
        tolerance : relative residual that is left
        """
        whole = self._whole(upper)
        acts = LinearOperator(
            (self.n, self.n), matvec=lambda x: whole @ x + besides @ x, dtype=float
        )
        for fresh in (self.stale, True):
            if fresh:
                self._factorise(upper)
            before = self.solved
            inverse = LinearOperator((self.n, self.n), matvec=self._divided, dtype=float)
            found, _ = gmres(
                acts, right, rtol=tolerance, restart=WITH_NEW if fresh else MOST_SOLVES,
                maxiter=1, M=inverse,
            )  # fmt: skip
            off = np.linalg.norm(acts.matvec(found) - right)
            if off <= ENOUGH * np.linalg.norm(right):
                break
        self.stale = self.solved - before > MANY_SOLVES
        return np.asarray(found)

    def _whole(self, upper: csc_array) -> csr_array:
        """The matrix of an upper triangle, without sorting it anew each time."""
        place, column = self._both
        return csr_array((upper.data[place], column, self._starts), shape=(self.n, self.n))

    def _factorise(self, upper: csc_array) -> None:
        if self.solver is None:
            self.solver = qdldl.Solver(upper, upper=True)
        else:
            self.solver.update(upper, upper=True)
        self.factored += 1

    def _divided(self, right: Array) -> Array:
        assert self.solver is not None
        self.solved += 1
        return np.asarray(self.solver.solve(right))


def _pairs(strain: csr_array) -> tuple[Array, tuple[Array, Array], Array]:
    """Of an operator (c, m): the products b_i b_j, i ≤ j, of each row; its row, (i, j), product."""
    counts = np.diff(strain.indptr)
    widest = int(counts.max(initial=0))
    first = strain.indptr[:-1]
    rows, lows, highs, values = [], [], [], []
    for one in range(widest):
        for other in range(one, widest):
            (has,) = np.nonzero(counts > other)
            i, j = strain.indices[first[has] + one], strain.indices[first[has] + other]
            rows.append(has)
            lows.append(np.minimum(i, j).astype(np.int64))
            highs.append(np.maximum(i, j).astype(np.int64))
            values.append(strain.data[first[has] + one] * strain.data[first[has] + other])
    if not rows:
        none = np.empty(0, np.int64)
        return none, (none, none), np.empty(0)
    return (
        np.concatenate(rows),
        (np.concatenate(lows), np.concatenate(highs)),
        np.concatenate(values),
    )
