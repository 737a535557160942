"""Transients by rational Krylov projection: a few factorisations for all times at once.

The pores obey C dp/dt = −G p + f with p(0) = 0. On a space that holds C⁻¹f, the
constants and shift-and-invert images (G + s C)⁻¹ C v for a few real poles s, the
Galerkin projection is solved exactly in time through its eigenvalues. The constants make
the projection conserve volume to round-off. (Rational Krylov for evolution equations:
Güttel 2013, GAMM-Mitt. 36; poles between 1/t_last and 1/t_first.)

The error is estimated from how the recorded outputs move while the space grows. The change
over a window of vectors is the error that the space had at the window's start; the same
reduction once more gives the error that it has now.
"""

from __future__ import annotations

import functools
import itertools
import math
from typing import NamedTuple

import numpy as np

from model.flow.algebraic import Algebraic, algebraic
from model.flow.factor import Factor, analyse, factorise, solve
from model.flow.problem import Answer, Problem, empty_answer, fill_map, relative_residual
from model.flow.system import System, without_outlet
from model.outcome import ModelError

POLES_PER_DECADE = 0.6
FEWEST_POLES = 3
MOST_CYCLES = 60

# The reduction of the error is not even; the estimate is taken this much larger.
CAUTION = 2.5

# Part of the way to the tolerance, at the rate seen, that the space grows between two checks.
STRIDE = 0.2

# A check costs what this part of the vectors did; larger spaces are checked less often.
CHECK_COST = 8

# Lags at which maps are compared between cycles; the error of a map changes slowly in time.
MAP_CHECKS = 8

# Part of the largest recorded value below which an output's own size no longer counts.
FAINT = 0.1

# Rows of edge differences that are orthogonalised at once (bounds the memory).
BLOCK_ROWS = 1 << 16


class Basis(NamedTuple):
    """A C-orthonormal basis of the pores and what is needed of it."""

    vectors: np.ndarray  # (pores, m)
    decay: np.ndarray  # (k,) eigenvalues of the projection, 1/s, k ≤ m
    modes: np.ndarray  # (m, k) its eigenvectors
    load: np.ndarray  # (k,) source in the eigenvectors


def krylov(problem: Problem) -> Answer:
    """Step responses to the tolerance, source by source, the factors shared between them.

    Raises `ModelError` where `MOST_CYCLES` cycles of poles do not bring the estimated error
    below the tolerance.
    """
    system = problem.system
    wells = algebraic(system)
    answer = empty_answer(problem)
    if system.pores == 0:
        for k in problem.active_sources:
            _record(problem, k, wells, _no_basis(), answer)
        return answer
    factors = _factors(system, _poles(problem.lag))
    error = residual = 0.0
    work = len(factors)
    for k in problem.active_sources:
        basis, estimate, solves = _basis(problem, k, wells, factors)
        _record(problem, k, wells, basis, answer)
        error = max(error, estimate)
        residual = max(residual, _residual(problem, k, wells, basis))
        work += solves
    return answer._replace(time_error=error, residual=residual, work=work)


def _no_basis() -> Basis:
    """The basis where there is no pore: wells and fixed pressures meet at once."""
    return Basis(np.empty((0, 0)), np.empty(0), np.empty((0, 0)), np.empty(0))


def _poles(lag: np.ndarray) -> np.ndarray:
    """Shifts s > 0, falling, evenly spread in log s over the reciprocal lags."""
    first, last = lag[lag > 0][0], lag[-1]
    count = max(FEWEST_POLES, round(POLES_PER_DECADE * math.log10(last / first)))
    return np.geomspace(1.0 / first, 1.0 / last, count)


def _factors(system: System, poles: np.ndarray) -> list[Factor]:
    """Factors of G + s C for every pole, on one symbolic analysis.

    Pole 0 comes first, where the pressure has a steady state: its image of C⁻¹f is that state.
    """
    symbolic = analyse(system.n, system.edge_i, system.edge_j)
    if not without_outlet(system):
        poles = np.insert(poles, 0, 0.0)
    return [
        factorise(symbolic, system.edge_g, system.excess + pole * system.storage) for pole in poles
    ]


def _basis(
    problem: Problem, source: int, wells: Algebraic, factors: list[Factor]
) -> tuple[Basis, float, int]:
    """Grow the space until the recorded outputs have converged; basis, error estimate, solves."""
    system = problem.system
    pores = system.pores
    root = np.sqrt(system.storage[:pores])
    rhs = wells.reduce_source(system.source(source))
    most = MOST_CYCLES * len(factors)
    space = np.empty((pores, min(pores, 1 + most) + 1), order="F")  # touched only where used
    count = _append(space, 0, rhs / root)
    cycle = len(factors)
    estimate, solves, wanted = math.inf, 0, 3
    invariant = False
    while True:
        for factor in itertools.islice(itertools.cycle(factors), solves, wanted):
            if count == pores or invariant:
                break
            load = np.zeros(system.n)
            load[:pores] = root * space[:, count - 1]
            added = _append(space, count, root * solve(factor, load)[:pores])
            invariant = added == 0  # the space holds all that the source can reach
            count += added
            solves += 1
        # the constants stay out of the sequence, which must remain a Krylov space of C⁻¹f
        complete = count + _append(space, count, root)
        nest = _nest(system, wells, space[:, :complete], rhs, root)
        if complete == pores or invariant:
            return nest.basis(count), 0.0, solves
        estimate, rate = _estimate(problem, source, wells, nest, count, cycle)
        if estimate <= problem.tolerance:
            return nest.basis(count), estimate, solves
        if wanted >= most:
            break
        further = math.log(problem.tolerance / estimate) / math.log(rate) if estimate < 1.0 else 0.0
        stride = min(cycle, int(STRIDE * further)) + 1 + solves // CHECK_COST
        wanted = min(most, solves + stride)
    raise ModelError(
        f"krylov reached a relative error of {estimate:.2g} in {MOST_CYCLES} cycles, not "
        f"{problem.tolerance:g}; raise solver.tolerance, or record fewer decades of time"
    )


def _estimate(
    problem: Problem, source: int, wells: Algebraic, nest: Nest, count: int, cycle: int
) -> tuple[float, float]:
    """Error of the space's `count` vectors and the factor by which each further one reduces it.

    With d the largest change of an output over the last w vectors and b that over the w
    before, the error is d · d / b; where there were none before, b is 1, the error of no
    vectors. The largest estimate counts of w = 2, which sees the rate, and of a cycle of
    poles and one less, which see every range of times.
    """

    @functools.cache
    def seen(size: int) -> list[tuple[np.ndarray, np.ndarray]]:
        return _checked_outputs(problem, source, wells, nest.basis(size))

    widths = [w for w in {2, cycle - 1, cycle} if count >= w + 2]
    worst, slowest = 0.0 if widths else math.inf, 0.0
    for width in widths:
        change, before = _change(seen(count), seen(count - width)), 1.0
        if count >= 2 * width + 2:
            before = _change(seen(count - width), seen(count - 2 * width))
        reduction = min(1.0, change / before) if before > 0.0 else 1.0
        worst = max(worst, CAUTION * change * reduction)
        slowest = max(slowest, reduction ** (1.0 / width))
    return worst, min(max(slowest, 0.1), 0.9)


def _append(space: np.ndarray, count: int, vector: np.ndarray) -> int:
    """Orthonormalise a vector against the space and append it; 0 where it adds nothing."""
    size = np.linalg.norm(vector)
    if size == 0.0 or count == len(space):
        return 0
    vector = vector / size
    known = space[:, :count]
    left = 1.0
    for _ in range(3):
        vector = vector - known @ (known.T @ vector)
        before, left = left, float(np.linalg.norm(vector))
        if left < 1e-13:
            return 0
        if left > 0.5 * before:  # twice is enough (Kahan and Parlett)
            break
    space[:, count] = vector / left
    return 1


class Nest(NamedTuple):
    """The nested spaces of the first k vectors and the constants."""

    vectors: np.ndarray  # (pores, m) C-orthonormal
    triangle: np.ndarray  # (…, m) R with RᵀR = VᵀGV
    load: np.ndarray  # (m,) Vᵀf
    constants: np.ndarray  # (m,) coordinates of the constants

    def basis(self, size: int) -> Basis:
        """Projection on the space of the first `size` vectors and the constants."""
        chosen = np.eye(len(self.load), size + 1)
        rest = self.constants.copy()
        rest[:size] = 0.0
        left = np.linalg.norm(rest)
        if left > 1e-13 * np.linalg.norm(self.constants):
            chosen[:, size] = rest / left
        else:
            chosen = chosen[:, :size]
        _, singular, modes = np.linalg.svd(self.triangle @ chosen)
        decay = np.zeros(chosen.shape[1])
        decay[: len(singular)] = singular**2
        modes = chosen @ modes.T
        return Basis(self.vectors, decay, modes, modes.T @ self.load)


def _nest(
    system: System, wells: Algebraic, space: np.ndarray, rhs: np.ndarray, root: np.ndarray
) -> Nest:
    """Project the conductance on an orthonormal space (pores, m) of √C p."""
    vectors = np.ascontiguousarray(space / root[:, None])
    triangle = _edge_triangle(system, wells, vectors)
    return Nest(vectors, triangle, vectors.T @ rhs, space.T @ root)


def _edge_triangle(system: System, wells: Algebraic, vectors: np.ndarray) -> np.ndarray:
    """R of the QR decomposition of the edge differences √g (u_i − u_j), √g_b u_i.

    VᵀGV = RᵀR; forming it from differences keeps the small eigenvalues that the Gram
    matrix would lose.
    """
    full = wells.lift(vectors)
    triangle = np.empty((0, vectors.shape[1]))
    for lo in range(0, len(system.edge_i), BLOCK_ROWS):
        part = slice(lo, lo + BLOCK_ROWS)
        rows = full[system.edge_i[part]] - full[system.edge_j[part]]
        rows *= np.sqrt(system.edge_g[part])[:, None]
        triangle = _triangle(triangle, rows)
    rows = np.sqrt(system.fixed_g)[:, None] * full[system.fixed_node]
    return _triangle(triangle, rows)


def _triangle(above: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """R of the QR decomposition of two blocks of rows."""
    return np.asarray(np.linalg.qr(np.concatenate([above, rows]), mode="r"))


def _amplitudes(basis: Basis, lag: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coefficients of the basis (l, m): of the pressure, its time integral and its rate.

    With z = λt: p ∝ t φ₁(z), ∫p ∝ t² φ₂(z), dp/dt ∝ e^(−z); φ₁ = (1 − e^(−z))/z and
    φ₂ = (1 − φ₁)/z, both by their series near zero.
    """
    t = lag[:, None]
    z = t * basis.decay[None, :]
    small = z < 1e-3
    safe = np.where(small, 1.0, z)
    phi1 = np.where(small, 1 - z / 2 + z * z / 6 - z**3 / 24, -np.expm1(-safe) / safe)
    phi2 = np.where(small, 0.5 - z / 6 + z * z / 24 - z**3 / 120, (1.0 - phi1) / safe)
    pressure = (t * phi1 * basis.load) @ basis.modes.T
    integral = (t * t * phi2 * basis.load) @ basis.modes.T
    rate = (np.exp(-z) * basis.load) @ basis.modes.T
    return pressure, integral, rate


def _outputs(
    problem: Problem, source: int, wells: Algebraic, basis: Basis, amplitude: np.ndarray
) -> np.ndarray:
    """Recorded outputs (l, o) for given coefficients of the basis (l, m)."""
    rows = problem.records.rows @ wells.lift(basis.vectors)
    return amplitude @ rows.T + _direct(problem, source, wells)


def _direct(problem: Problem, source: int, wells: Algebraic) -> np.ndarray:
    """What a unit of the source adds to the outputs by itself, (o,)."""
    system = problem.system
    alone = np.zeros(system.n)
    alone[system.pores :] = wells.direct(system.source(source))
    return problem.records.direct[source] + problem.records.rows @ alone


def _checked_outputs(
    problem: Problem, source: int, wells: Algebraic, basis: Basis
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Quantities that must converge, each with the size that its error is compared with.

    The well that is the source is compared at every lag with its own pressure change,
    anything else with the largest value that it takes, or where it takes next to none with
    a tenth (`FAINT`) of the largest pressure or flow, the source's own included.
    """
    lag = problem.lag[problem.lag > 0]
    amplitude, _, _ = _amplitudes(basis, lag)
    output = _outputs(problem, source, wells, basis, amplitude)
    is_flow = np.zeros(output.shape[1], dtype=bool)
    wells_end = problem.records.well_rows
    is_flow[wells_end : wells_end + problem.records.flow_rows] = True
    size = np.broadcast_to(np.abs(output).max(axis=0, initial=0.0), output.shape).copy()
    own_well = problem.own_well(source)
    own_pressure, own_flow = problem.own_size(source)
    for kind, own in ((is_flow, own_flow), (~is_flow, own_pressure)):
        largest = np.max(size[:, kind], initial=own)
        size[:, kind] = np.maximum(size[:, kind], FAINT * largest)
    if own_well is not None:
        size[:, own_well] = np.abs(output[:, own_well])
    counts = ~is_flow | problem.check_flows
    checked = [(output[:, counts], size[:, counts])]
    if len(problem.domain):
        some = np.unique(np.linspace(0, len(lag) - 1, MAP_CHECKS).astype(int))
        fields = amplitude[some] @ basis.vectors.T
        checked.append((fields, np.full_like(fields, np.abs(fields).max())))
    return checked


def _change(
    now: list[tuple[np.ndarray, np.ndarray]], before: list[tuple[np.ndarray, np.ndarray]]
) -> float:
    """Largest difference between two sets of checked outputs over the size of the first."""
    worst = 0.0
    for (new, scale), (old, _) in zip(now, before, strict=True):
        counts = scale > 0
        worst = max(worst, np.max(np.abs(new - old)[counts] / scale[counts], initial=0.0))
    return float(worst)


def _record(problem: Problem, source: int, wells: Algebraic, basis: Basis, answer: Answer) -> None:
    """Fill one source's part of the answer (in place)."""
    system = problem.system
    pressure, integral, _ = _amplitudes(basis, problem.lag)
    answer.output[source] = _outputs(problem, source, wells, basis, pressure)
    flows = slice(problem.records.well_rows, problem.records.well_rows + system.fixed_count)
    direct = _direct(problem, source, wells)[flows]
    rows = (problem.records.rows @ wells.lift(basis.vectors))[flows]
    answer.cumulative[source, :, :-1] = integral @ rows.T + problem.lag[:, None] * direct
    stored = system.storage[: system.pores] @ basis.vectors
    answer.cumulative[source, :, -1] = pressure @ stored
    if len(problem.domain):
        fields = _fields(problem, source, wells, basis, pressure)
        answer.pressure[source] = fill_map(problem, source, fields)


def _fields(
    problem: Problem, source: int, wells: Algebraic, basis: Basis, amplitude: np.ndarray
) -> np.ndarray:
    """All unknowns (l, n) for given coefficients of the basis."""
    system = problem.system
    fields = np.empty((len(amplitude), system.n))
    fields[:, : system.pores] = amplitude @ basis.vectors.T
    fields[:, system.pores :] = amplitude @ wells.lift(basis.vectors)[
        system.pores :
    ].T + wells.direct(system.source(source))
    return fields


def _residual(problem: Problem, source: int, wells: Algebraic, basis: Basis) -> float:
    """Relative residual of the flow equation at the last lag."""
    system = problem.system
    pressure, _, rate = _amplitudes(basis, problem.lag[-1:])
    p = _fields(problem, source, wells, basis, pressure)[0]
    dp = np.zeros(system.n)
    dp[: system.pores] = basis.vectors @ rate[0]
    return relative_residual(system, system.source(source), dp, p)
