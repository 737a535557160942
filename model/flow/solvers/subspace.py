"""A rational Krylov space of the flow equation and the projection on it.

With A = C^(−1/2) G C^(−1/2) on the pores, wells eliminated, the space holds C^(−1/2) f and
the images (A + s)⁻¹ x of its own last vector x for real poles s. The basis is orthonormal in
√C p. Every solve tells what A does to its result, A w = x − s w, so that the projection of A
follows from the coefficients of the orthogonalisation alone (Ruhe 1984, Linear Algebra Appl.
58, 391–405): let V hold the basis so far, its last vector v_m, and H = VᵀAV. The image
w' = (A + s)⁻¹ v_m of length σ, w = w' / σ, is orthogonalised, w = V c + β v with v the new vector.
From A w = v_m / σ − s w

    A v = (A w − A V c) / β = (v_m / σ − s (V c + β v) − A V c) / β,

and since V and v are orthonormal and A is symmetric, the new column and corner of H are

    h = VᵀA v = (e_m / σ − s c − H c) / β,    vᵀA v = −s − hᵀc / β,

without a product with A. The round-off is that of the largest eigenvalue; where that is too much
for the slowest modes, or once at the end, the projection is measured: the QR decomposition of
the edge differences √g (u_i − u_j) keeps small eigenvalues that a product would lose.

A fixed pressure behind a strong pipe puts into C^(−1/2) f what its own pores exchange with it, and
a slow mode's share in that lies below its last digit. The space of such a source starts from the
steady state u = G⁻¹ f instead: the response is u − e^(−tC⁻¹G) u, in which each mode has the load
λ (φ, u), and the flow from the source is that at rest plus Σ λ (φ, u)² e^(−λt), a sum of one sign.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from demflow.model.compile import Array, kernel
from demflow.model.flow.equation.algebraic import Algebraic
from demflow.model.flow.equation.outputs import Records
from demflow.model.flow.equation.system import System
from demflow.model.flow.linear.factor import Factor, solve
from demflow.model.memory import foresee

MOST_VECTORS = 300  # of the Krylov sequence
LAGS = 8192  # at once: what is computed on the way takes several times the room of the result

# Rows of edge differences that are orthogonalised at once; they stay in cache.
BLOCK_ROWS = 1024

FIRST_ROOM = 32  # vectors for which memory is taken at first
KEPT_MODES = 16  # sizes whose modes are kept: an estimate looks at several of them
EPSILON = float(np.finfo(float).eps)
NOTHING = 1e-13  # part of a vector that is round-off once the known part is taken away


class Modes(NamedTuple):
    """The eigenvectors of a projection, or of several beside one another (…)."""

    decay: np.ndarray  # (…, k) eigenvalues λ, 1/s
    vectors: np.ndarray  # (…, m, k) in the basis
    load: np.ndarray  # (…, k) source
    rest: np.ndarray  # (…, k) steady state, of a space that starts from it

    def pressure(self, lag: np.ndarray) -> np.ndarray:
        """Coefficients of the basis (…, l, m) of the pressure, (1 − e^(−λt)) / λ in each mode."""
        return self._by_blocks(lag, lambda t: t * _phi1(t * self.decay[..., None, :]))

    def integral(self, lag: np.ndarray) -> np.ndarray:
        """Coefficients of the time integral of the pressure."""
        return self._by_blocks(lag, lambda t: t * t * _phi2(t * self.decay[..., None, :]))

    def rate(self, lag: np.ndarray) -> np.ndarray:
        """Coefficients of the pressure's rate of change."""
        return self._in_basis(np.exp(-lag[:, None] * self.decay[..., None, :]))

    def _by_blocks(self, lag: np.ndarray, modal: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """Coefficients of what each mode does at times (l, 1), which are many in long schedules."""
        if len(lag) <= LAGS:
            return self._in_basis(modal(lag[:, None]))
        blocks = np.split(lag, range(LAGS, len(lag), LAGS))
        return np.concatenate([self._in_basis(modal(t[:, None])) for t in blocks], axis=-2)

    def _in_basis(self, modal: np.ndarray) -> np.ndarray:
        """Coefficients of what each mode (…, l, k) does by a unit of its load."""
        return np.asarray((modal * self.load[..., None, :]) @ self.vectors.mT)

    def own_flow(self, lag: np.ndarray) -> np.ndarray:
        """What a source that the space starts at rest with lets in beyond its steady flow, (l,)."""
        return np.asarray(np.exp(-lag[:, None] * self.decay) @ (self.load * self.rest))

    def own_volume(self, lag: np.ndarray) -> np.ndarray:
        """The time integral of `own_flow`."""
        return np.asarray(-np.expm1(-lag[:, None] * self.decay) @ self.rest**2)


def _phi1(z: np.ndarray) -> np.ndarray:
    """(1 − e^(−z)) / z for z ≥ 0."""
    return np.divide(-np.expm1(-z), z, out=np.ones_like(z), where=z >= 1e-300)


def _phi2(z: np.ndarray) -> np.ndarray:
    """(1 − φ₁) / z for z ≥ 0, by its series near zero."""
    small = z < 1e-2
    safe = np.where(small, 1.0, z)
    series = 0.5 - z / 6 * (1 - z / 4 * (1 - z / 5 * (1 - z / 6 * (1 - z / 7))))
    return np.where(small, series, (1.0 - _phi1(safe)) / safe)


class Subspace:
    """A space that grows by one vector a solve."""

    def __init__(
        self,
        system: System,
        wells: Algebraic,
        records: Records,
        source: np.ndarray,
        drained: np.ndarray,
        rest: np.ndarray | None = None,
    ) -> None:
        """Start from a source (n,); where nothing is `drained` (n,) the constants stand before it.

        Or from the steady state (n,) that the source leads to, `rest`.

        There the mean pressure never comes to rest; without the constants, which are a mode
        of their own, it would swamp the images for small poles.
        """
        self.system, self.wells, self.records = system, wells, records
        self.pores = system.pores
        self.root = np.sqrt(system.storage[: self.pores])
        self.source = wells.reduce_source(source)
        self.count = 0
        self.solves = 0
        self._space = np.empty((system.n, FIRST_ROOM), order="F")
        self._projected = np.zeros((FIRST_ROOM, FIRST_ROOM))
        self._triangle = np.zeros((0, 0))
        self._modes: dict[int, Modes] = {}
        self._load = np.zeros(FIRST_ROOM)
        self._rows = np.zeros((records.rows.shape[0], FIRST_ROOM))
        sealed = np.where(drained[: self.pores], 0.0, self.root)
        self._append(sealed)
        self.start = self.count
        start = self.source / self.root if rest is None else self.root * rest[: self.pores]
        self.rest = 0.0 if rest is None else _size(start)
        if self._append(start):
            last = self.count - 1
            first = self._space[: self.pores, last]
            self._projected[last, last] = first @ self._applied(first)

    @property
    def size(self) -> int:
        """Vectors of the Krylov sequence, the constants not counted."""
        return self.count - self.start

    @property
    def bytes(self) -> int:
        """Memory of the basis."""
        return self._space.nbytes

    @property
    def measured(self) -> bool:
        """Whether the projection is that of the edge differences."""
        return len(self._triangle) == self.count

    def first_decay(self) -> float:
        """Rate at which the source's own pores respond, 1/s; 0 where there are none."""
        if self.start == 0 and self.rest == 0.0:  # the space begins with them
            return float(self._projected[0, 0])
        load = self.source / self.root
        size = _size(load)
        return float(load / size @ self._applied(load / size)) if size > 0.0 else 0.0

    def extend(self, pole: float, factor: Factor) -> bool:
        """Add the image of the last vector for a pole; whether there was anything to add."""
        m, pores = self.count, self.pores
        load = np.zeros(self.system.n)
        load[:pores] = self.root * self._space[:pores, m - 1]
        image = self.root * solve(factor, load)[:pores]
        self.solves += 1
        size = _size(image)
        coefficients, left = self._orthogonalise(image / size)
        if left == 0.0:
            return False
        last = np.zeros(m)
        last[-1] = 1.0 / size
        projected = self._projected
        column = (last - pole * coefficients - projected[:m, :m] @ coefficients) / left
        column[: self.start] = 0.0  # constants that nothing drains
        projected[:m, m] = projected[m, :m] = column
        projected[m, m] = -pole - coefficients @ column / left
        return True

    def modes(self, size: int) -> Modes:
        """Projection on the first `size` vectors of the sequence, as known so far."""
        if size not in self._modes:
            if len(self._modes) == KEPT_MODES:
                del self._modes[next(iter(self._modes))]
            self._modes[size] = self._decomposed(size)
        return self._modes[size]

    def _decomposed(self, size: int) -> Modes:
        """Eigenvectors of the projection on the first `size` vectors of the sequence."""
        k = self.start + size
        if k <= len(self._triangle):
            _, singular, vectors = np.linalg.svd(self._triangle[:k, :k])
            decay, vectors = singular**2, vectors.T
        else:
            decay, vectors = np.linalg.eigh(self._projected[:k, :k])
            decay = np.maximum(decay, 0.0)
        rest = self.rest * vectors[self.start] if k > self.start else np.zeros(k)
        load = decay * rest if self.rest > 0.0 else vectors.T @ self._load[:k]
        return Modes(decay, vectors, load, rest)

    def noise(self) -> float:
        """Relative round-off of the slowest mode; measured, the root of it is what is squared."""
        if self.size == 0:
            return 0.0
        decay = self.modes(self.size).decay
        if self.measured:
            fastest, slowest = np.sqrt(decay[0]), np.sqrt(decay[self.size - 1])
        else:
            fastest, slowest = decay[-1], decay[self.start]
        return float(EPSILON * fastest / slowest) if slowest > 0.0 else np.inf

    def slowest(self) -> float:
        """Smallest decay rate that the space sees, the constants' left out, 1/s."""
        decay = self.modes(self.size).decay
        return float(decay[self.size - 1] if self.measured else decay[self.start])

    def outputs(self, coefficients: np.ndarray) -> np.ndarray:
        """Recorded outputs (l, o) of coefficients of the basis (l, k), without the source's own."""
        return coefficients @ self._rows[:, : coefficients.shape[1]].T

    def fields(self, coefficients: np.ndarray) -> np.ndarray:
        """Pressure of the pores (l, pores) of coefficients of the basis (l, k)."""
        k = coefficients.shape[1]
        found: np.ndarray = (coefficients @ self._space[: self.pores, :k].T) / self.root
        return found

    def lifted(self, coefficients: np.ndarray) -> np.ndarray:
        """Pressure of all unknowns (l, n) of coefficients (l, k), without the source's own."""
        return self.wells.lift(self.fields(coefficients).T).T

    def measure(self) -> None:
        """Project anew, from the edge differences of the basis."""
        self._measure(self._unscaled())
        self._scale()

    def _measure(self, pressures: np.ndarray) -> None:
        """Project anew, from the basis as pressures (n, ≥ m)."""
        m = self.count
        self._triangle = edge_triangle(self.system, pressures, m)
        # or the errors of the recurrence would grow with every further vector
        self._projected[:m, :m] = self._triangle.T @ self._triangle
        self._modes.clear()

    def close(self, noise: float) -> Basis:
        """Complete the space by the constants, so that volume is conserved.

        What A does to them no solve tells; it comes from edge differences, since a product with
        A would leave round-off of the strongest edge, however little flows there. The projection
        is measured where its round-off may exceed `noise`. The space is used up by this.
        """
        added = self._append(self.root)
        pressures, m = self._unscaled(), self.count
        if added:
            column = _last_column(self.system, pressures, m)
            column[: self.start] = 0.0
            self._projected[:m, m - 1] = self._projected[m - 1, :m] = column
        if self.noise() > noise:
            self._measure(pressures)
        vectors = pressures[:, :m]
        return Basis(
            vectors, self.modes(self.size), self._rows[:, :m], self.system.storage @ vectors
        )

    def _unscaled(self) -> np.ndarray:
        """The basis as pressures of all unknowns, in place."""
        pores, m = self.pores, self.count
        self._space[:pores, :m] /= self.root[:, None]
        if self.system.n > pores:
            self._space[pores:, :m] = self.wells.follow(self._space[:pores, :m])
        return self._space

    def _scale(self) -> None:
        """Undo `_unscaled`."""
        self._space[: self.pores, : self.count] *= self.root[:, None]

    def _append(self, vector: np.ndarray) -> bool:
        """Orthonormalise a vector (pores,) against the space and append it, if anything is left."""
        size = _size(vector)
        return size > 0.0 and self._orthogonalise(vector / size)[1] > 0.0

    def _orthogonalise(self, vector: np.ndarray) -> tuple[np.ndarray, float]:
        """Append the part of a unit vector outside the space; coefficients inside, size outside."""
        m, pores = self.count, self.pores
        known = self._space[:pores, :m]
        coefficients = np.zeros(m)
        left = 1.0
        for _ in range(3):
            inside = known.T @ vector
            vector = vector - known @ inside
            coefficients += inside
            before, left = left, _size(vector)
            if left < NOTHING or m == pores:
                return coefficients, 0.0
            if left > 0.5 * before:  # twice is enough (Kahan and Parlett)
                break
        self._make_room()
        vector = vector / left
        self._space[:pores, m] = vector
        pressure = self.wells.lift(vector / self.root)
        self._rows[:, m] = self.records.rows @ pressure
        self._load[m] = pressure[:pores] @ self.source
        self.count += 1
        return coefficients, left

    def _make_room(self) -> None:
        """Double the memory where it is full, up to what the longest sequence takes.

        Raises `OutOfMemory` where that would not fit.
        """
        full = self._space.shape[1]
        if self.count < full:
            return
        room = max(min(2 * full, MOST_VECTORS + 2), full + 1)  # constants before and after
        foresee(f"a Krylov space of {room} vectors", self._space.itemsize * self.system.n * room)
        space = np.empty((self.system.n, room), order="F")
        space[:, :full] = self._space
        self._space = space
        self._projected = np.pad(self._projected, (0, room - full))
        self._load = np.pad(self._load, (0, room - full))
        self._rows = np.pad(self._rows, ((0, 0), (0, room - full)))

    def _applied(self, vector: np.ndarray) -> np.ndarray:
        """A times a vector of √C p, (pores,)."""
        system = self.system
        u = self.wells.lift(vector / self.root)
        flow = system.edge_g * (u[system.edge_i] - u[system.edge_j])
        net = system.excess * u
        net += np.bincount(system.edge_i, weights=flow, minlength=system.n)
        net -= np.bincount(system.edge_j, weights=flow, minlength=system.n)
        return np.asarray(net[: self.pores] / self.root)


class Basis(NamedTuple):
    """A closed space: C-orthonormal pressures, their modes and what is recorded of them."""

    vectors: np.ndarray  # (n, m)
    modes: Modes
    rows: np.ndarray  # (o, m) recorded outputs of each
    stored: np.ndarray  # (m,) volume stored in each


def _size(vector: np.ndarray) -> float:
    """Length of a vector; for small ones `numpy.linalg.norm` takes longer than the sum."""
    return math.sqrt(vector @ vector)


def edge_triangle(system: System, vectors: np.ndarray, m: int) -> np.ndarray:
    """R of the QR decomposition of √g (u_i − u_j), √g_b u_i, so that VᵀGV = RᵀR, (m, m).

    Parameters
    ----------
    system : the flow equation C dp/dt = −G p + f
    vectors : basis as pressures of all unknowns, (n, ≥ m)
    m : number of vectors
    """
    triangle = np.zeros((m, m))
    edges, fixed = len(system.edge_i), len(system.fixed_node)
    root_g, root_fixed = np.sqrt(system.edge_g), np.sqrt(system.fixed_g)
    for lo in range(0, edges, BLOCK_ROWS):
        rows = np.empty((m + min(BLOCK_ROWS, edges - lo), m))
        rows[:m] = triangle
        _edge_differences(vectors, system.edge_i, system.edge_j, root_g, lo, rows[m:])
        triangle = np.asarray(np.linalg.qr(rows, mode="r"))
    for lo in range(0, fixed, BLOCK_ROWS):
        part = slice(lo, lo + BLOCK_ROWS)
        held = root_fixed[part, None] * vectors[system.fixed_node[part], :m]
        triangle = np.asarray(np.linalg.qr(np.concatenate([triangle, held]), mode="r"))
    return triangle


def _last_column(system: System, vectors: np.ndarray, m: int) -> np.ndarray:
    """The last column of VᵀGV, (m,), from differences along edges."""
    last = vectors[:, m - 1]
    flow = system.edge_g * (last[system.edge_i] - last[system.edge_j])
    column = np.zeros(m)
    _edge_products(vectors, system.edge_i, system.edge_j, flow, column)
    held = vectors[system.fixed_node, :m]
    return np.asarray(column + held.T @ (system.fixed_g * held[:, -1]))


@kernel
def _edge_differences(
    vectors: Array, edge_i: Array, edge_j: Array, root_g: Array, lo: int, rows: Array
) -> None:
    """Rows √g (u_i − u_j) of the edges from `lo` on, for the first columns of `vectors`."""
    for c in range(rows.shape[1]):
        for e in range(rows.shape[0]):
            k = lo + e
            rows[e, c] = root_g[k] * (vectors[edge_i[k], c] - vectors[edge_j[k], c])


@kernel
def _edge_products(
    vectors: Array, edge_i: Array, edge_j: Array, flow: Array, column: Array
) -> None:
    """Sums of (u_i − u_j) times a flow over the edges, for the first columns of `vectors`."""
    for c in range(column.size):
        total = 0.0
        for e in range(flow.size):
            total += (vectors[edge_i[e], c] - vectors[edge_j[e], c]) * flow[e]
        column[c] = total
