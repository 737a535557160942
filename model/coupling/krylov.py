"""Transients of a poroelastic rock by rational Krylov projection, a factor for each of a few poles.

B dp/dt = −G p + q is projected on images of (G + s B)⁻¹, orthonormal in the inner product of
B = C + AᵀK⁻¹A, and solved there exactly in time through eigenvalues, as `flow.solvers.krylov`
does for rigid rock. Every vector p brings its u = K⁻¹A p, solved for anew with K's own factor:
carried along by recursion instead, round-off makes the space indefinite from some 30 vectors on.
The uniform pressure belongs to every space, so that volumes balance to round-off.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from demflow.model.coupling.record import Record
from demflow.model.coupling.rock import Rock, Source
from demflow.model.flow.solvers.subspace import edge_triangle
from demflow.model.mechanics.static.stiffness import Quasidefinite
from demflow.model.outcome import ModelError

Array = np.ndarray

MOST_VECTORS = 150
POLES = 3  # of a window of two decades or more that begins while pores even out
ABOVE = 2.0  # the fast pole, over the fast end of a window that begins later
# Largest rate of a pore times the first time, from which on neighbouring pores have evened out.
EVEN = 150.0
LAST_SEEN = 0.3  # of the change before: what a round of few vectors may hide
FAINT = 0.1  # of the largest of a kind, below which an output's own size no longer counts
CAUTION = 2.0  # an estimate is taken this much larger
NOTHING = 1e-13  # of a vector: what is left of it is round-off


class Course(NamedTuple):
    """What a unit of a source does, at l lags; in SI."""

    output: Array  # (l, o)
    cumulative: Array  # (l, fixed + 1) volumes let in by each fixed pressure, and stored, m³
    pressure: Array  # (l, n) Pa; none where no map is asked for
    error: float  # estimated, relative
    residual: float  # of the last image, relative
    vectors: int


class Factors:
    """Factors of the shifts that were asked for; sources share them."""

    def __init__(self, rock: Rock) -> None:
        self.rock = rock
        self._made: dict[float, Quasidefinite] = {}

    @property
    def made(self) -> int:
        """Number of factors made so far."""
        return len(self._made)

    def solve(self, shift: float, load: Array) -> Array:
        """Pressures (n,) of (G + s B) p = b."""
        if shift not in self._made:
            self._made[shift] = self.rock.factor(shift)
        return self.rock.solve(self._made[shift], shift, load)


class Space:
    """A B-orthonormal space of pressures and what goes with each."""

    def __init__(self, rock: Rock, record: Record) -> None:
        self.rock, self.record = rock, record
        n, m, o = rock.system.n, len(rock.frame.free), record.pressure.shape[0]
        self.size = 0
        self._pressure = np.empty((n, MOST_VECTORS + 2), order="F")
        self._stored = np.empty((n, MOST_VECTORS + 2), order="F")  # B p of each
        self._seen = np.empty((o, MOST_VECTORS + 2))
        self._speed = np.empty((o, MOST_VECTORS + 2))
        self._moved = np.empty((m, MOST_VECTORS + 2), order="F")
        self.projected = np.empty((MOST_VECTORS + 2, MOST_VECTORS + 2))

    @property
    def pressure(self) -> Array:
        """(n, k) in units of the rock."""
        return self._pressure[:, : self.size]

    @property
    def moved(self) -> Array:
        """(m, k) displacements that go with them."""
        return self._moved[:, : self.size]

    @property
    def seen(self) -> Array:
        """(o, k) outputs of each."""
        return self._seen[:, : self.size]

    @property
    def speed(self) -> Array:
        """(o, k) outputs by how fast each moves."""
        return self._speed[:, : self.size]

    def stored(self, column: int) -> Array:
        """B p of a vector, (n,)."""
        return self._stored[:, column]

    def modes(self) -> tuple[Array, Array]:
        """Eigenvalues and eigenvectors of VᵀGV, by differences along edges.

        Products with G would lose a slow mode, or that of a sealed rock, in the round-off of the
        fastest.
        """
        triangle = edge_triangle(self.rock.system, self.pressure, self.size)
        _, root, vector = np.linalg.svd(triangle)
        return root**2 * (self.rock.modulus / self.rock.size), vector.T

    def append(self, pressure: Array) -> bool:
        """Append the part of a pressure outside the space, if anything is left of it."""
        k, size = self.size, float(np.linalg.norm(pressure))
        if size == 0.0 or k == self._pressure.shape[1]:
            return False
        vector = pressure / size
        for _ in range(2):  # twice is enough (Kahan and Parlett)
            vector = vector - self.pressure @ (self._stored[:, :k].T @ vector)
        if float(np.linalg.norm(vector)) < NOTHING:
            return False
        moved = self.rock.frame.moved(self.rock.squeeze @ vector, 0)  # the factor is exact enough
        stored = self.rock.stored(vector, moved)
        norm = math.sqrt(max(float(vector @ stored), 0.0))
        if norm == 0.0:
            return False
        self._pressure[:, k], self._moved[:, k] = vector / norm, moved / norm
        self._stored[:, k] = stored / norm
        record = self.record
        self._seen[:, k] = (record.pressure @ vector + record.place @ moved) / norm
        self._speed[:, k] = (record.speed @ moved) / norm
        self.size = k + 1
        flow = self.rock.conductance @ self._pressure[:, k]
        self.projected[: k + 1, k] = self.projected[k, : k + 1] = self.pressure.T @ flow
        return True


class Modes:
    """The projected equation, solved in time: y(0) = `start`, dy/dt = −H y + `drive`.

    `rate` (k,) and `vector` (k, k) are the eigenvalues and eigenvectors of H.
    """

    def __init__(self, rate: Array, vector: Array, start: Array, drive: Array) -> None:
        self.rate, self.vector = rate, vector
        self.start, self.drive = self.vector.T @ start, self.vector.T @ drive

    def at(self, times: Array) -> tuple[Array, Array, Array]:
        """Coefficients (t, k), how fast they change, and their integrals since the start."""
        x = np.outer(times, self.rate)
        left = np.exp(-x)
        small = x < 1e-4
        safe = np.where(small, 1.0, x)
        once = times[:, None] * np.where(small, 1.0 - 0.5 * x, -np.expm1(-x) / safe)
        twice = times[:, None] * np.where(
            small, times[:, None] * (0.5 - x / 6.0), (times[:, None] - once) / safe
        )
        now = left * self.start + once * self.drive
        speed = left * (self.drive - self.rate * self.start)
        so_far = once * self.start + twice * self.drive
        return now @ self.vector.T, speed @ self.vector.T, so_far @ self.vector.T


def _poles(slow: float, fast: float, most: int) -> list[float]:
    """Shifts for a window of rates, 1/s: its slow end, its fast end and between them.

    Rounded, so that sources find the factors of one another. More poles save vectors, but each
    costs a factor, and a factor as much as ten vectors or more.
    """
    fast = max(fast, slow)
    count = most if fast >= 100.0 * slow else 2 if fast > 1.5 * slow else 1
    return [2.0 ** round(math.log2(s)) for s in np.geomspace(slow, fast, count)]


def course(
    factors: Factors, record: Record, source: Source, direct: Array, lag: Array, tolerance: float,
    *, field: bool = False,
) -> Course:  # fmt: skip
    """What a unit of a source does.

    Parameters
    ----------
    factors : of the rock, shared between its sources.
    record : what is recorded.
    source : the source.
    direct : (o,) what it adds to the outputs by itself.
    lag : (l,) s, increasing, from 0 on, at which nothing has acted yet.
    tolerance : of each output beside the largest that it takes, or `FAINT` of the largest of its
        kind.
    field : whether pressures are wanted everywhere.

    Raises `ModelError` where `MOST_VECTORS` do not bring the estimated error below it.
    """
    rock = factors.rock
    later = lag > 0.0
    times = lag[later]
    jump, at_once = rock.jump(source), rock.frame.moved(source.force)
    fixed = direct + record.place @ at_once
    chains = [load for load in (jump, source.flow) if load.any()]
    if not chains or not len(times):
        return idle(rock, record, fixed, lag, field=field)
    space = Space(rock, record)
    error, residual = 0.0, 0.0
    seen: list[tuple[Array, float]] = []
    loads = list(chains)

    def extend(shift: float) -> None:
        for chain, load in enumerate(loads):
            if space.append(factors.solve(shift, load)):
                loads[chain] = space.stored(space.size - 1)

    first, fastest = 2.0 ** round(-math.log2(times[-1])), _fastest(rock)
    if fastest * times[0] >= EVEN:
        shifts = _poles(first, ABOVE / times[0], 2)
    else:  # what pores do by themselves counts: start from where they stand at once
        extend(math.inf)
        extend(first)
        # what is slower than the rock's slowest mode needs no pole
        slowest = float(np.linalg.eigvalsh(space.projected[: space.size, : space.size])[0])
        shifts = _poles(max(first, slowest), min(1.0 / times[0], fastest), POLES)
    around = len(shifts) * len(chains)
    error = math.inf
    while True:
        for shift in shifts:
            extend(shift)
        now = _outputs(space, jump, source.flow, fixed, times)
        change = _change(now, seen[-1][0], record.kind) if seen else math.inf
        if not math.isfinite(change) and seen:
            raise ModelError(
                f"the coupled transient lost its numbers at {space.size} vectors; look for "
                "apertures or pores that lie too far apart"
            )
        error = CAUTION * max(change, LAST_SEEN * (seen[-1][1] if seen else math.inf))
        seen.append((now, change))
        if error <= tolerance or space.size >= rock.system.n:
            break
        if space.size + around > MOST_VECTORS:
            raise ModelError(
                f"the coupled transient reached a relative error of {error:.2g} in "
                f"{space.size} vectors, not {tolerance:g}; raise solver.tolerance, or record "
                "fewer decades of time"
            )
    residual = _residual(factors, shifts[-1], chains[-1])
    space.append(np.ones(rock.system.n))
    modes = Modes(*space.modes(), space.pressure.T @ jump, space.pressure.T @ source.flow)
    found, speed, so_far = modes.at(times)
    output = np.zeros((len(lag), len(fixed)))
    output[later] = found @ space.seen.T + speed @ space.speed.T + fixed
    cumulative = np.zeros((len(lag), record.inflow.shape[0] + 1))
    by_pressure, by_place = record.volume
    into = so_far @ (record.inflow @ space.pressure).T
    held = rock.size * (rock.held.T @ np.column_stack([space.moved, at_once]))
    into += found @ held[:, :-1].T + held[:, -1]
    into += np.outer(times, direct[record.kind == 1])
    stored = found @ (by_pressure @ space.pressure + by_place @ space.moved)
    cumulative[later, :-1] = into
    cumulative[later, -1] = stored + by_place @ at_once
    pressure = np.zeros((len(lag), rock.system.n if field else 0))
    if field:
        pressure[later] = rock.modulus * (found @ space.pressure.T)
    return Course(output, cumulative, pressure, float(error), residual, space.size)


def idle(rock: Rock, record: Record, fixed: Array, lag: Array, *, field: bool) -> Course:
    """The course of what moves no fluid.

    Parameters
    ----------
    rock : grains and pores of the specimen
    record : rows of what is recorded
    fixed : which unknowns are held, (n,) bool
    lag : (l,) s
    field : whether the whole field is kept
    """
    output = np.where(lag[:, None] > 0.0, fixed, 0.0)
    cumulative = np.zeros((len(lag), record.inflow.shape[0] + 1))
    pressure = np.zeros((len(lag), rock.system.n if field else 0))
    return Course(output, cumulative, pressure, 0.0, 0.0, 0)


def _outputs(space: Space, jump: Array, flow: Array, fixed: Array, times: Array) -> Array:
    """Outputs (t, o) of a space."""
    projected = space.projected[: space.size, : space.size]
    rate, vector = np.linalg.eigh(projected)
    rate = np.maximum(rate, 0.0)
    modes = Modes(rate, vector, space.pressure.T @ jump, space.pressure.T @ flow)
    found, speed, _ = modes.at(times)
    return np.asarray(found @ space.seen.T + speed @ space.speed.T + fixed)


def _change(now: Array, before: Array, kind: Array) -> float:
    """Largest relative change of an output; see `course` for what it is relative to."""
    own = np.abs(now).max(axis=0)
    worst = 0.0
    for one in np.unique(kind):
        ours = kind == one
        size = np.maximum(own[ours], FAINT * own[ours].max())
        counts = size > 0.0
        moved = np.abs(now - before).max(axis=0)[ours][counts] / size[counts]
        worst = max(worst, float(np.max(moved, initial=0.0)))
    return worst


def _fastest(rock: Rock) -> float:
    """A bound of the rates at which pressures even out, 1/s."""
    stores = rock.storage > 0.0
    diagonal = rock.conductance.diagonal()
    return float(2.0 * np.max(diagonal[stores] / rock.storage[stores], initial=0.0)) or math.inf


def _residual(factors: Factors, shift: float, load: Array) -> float:
    """Relative residual of (G + s B) p = b as it is solved, u by K's own factor."""
    rock = factors.rock
    found = factors.solve(shift, load)
    moved = rock.frame.moved(rock.squeeze @ found)
    left = rock.conductance @ found + shift * rock.stored(found, moved) - load
    return float(np.linalg.norm(left) / np.linalg.norm(load))
