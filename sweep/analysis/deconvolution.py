"""Deconvolution: from pressure under changing rates to what one constant rate would have shown.

von Schroeter, Hollaender & Gringarten (2004), SPE J. 9, 375–390: z(σ) = ln(dp_u / d ln t) is
linear between nodes in σ = ln t, so that the derivative is positive; z, the rates and the initial
pressure are sought together by total least squares,

    |p − p₀ + Σ Δy g|² / σ_p² + Σ ((y − q) / σ_q)² + Σ (change of slope of z)² / κ²,

with g(t) = ∫ e^z dσ. The paper weighs rates and curvature by ν and λ; here they stand in units of
the errors: ν = σ_p² / σ_q², λ = σ_p² / κ², so that what is assumed can be told.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import optimize

from demflow.model.threads import one_blas_thread

PER_DECADE = 8  # nodes
CURVATURES = (0.02, 0.04, 0.08, 0.16, 0.32)  # κ that are tried, changes of slope from node to node
ENOUGH = 1.05  # times the best misfit that a stronger regularisation may leave


class Deconvolved(NamedTuple):
    """The response at unit rate, and what was assumed to find it."""

    time: np.ndarray  # (k,) s, the nodes
    derivative: np.ndarray  # (k,) Pa s/m³, dp_u / d ln t
    spread: np.ndarray  # (k,) standard deviation of its logarithm, the regularisation included
    change: np.ndarray  # (k,) Pa s/m³, p_u
    rates: np.ndarray  # (m,) m³/s, as corrected
    initial_pressure: float  # Pa
    curvature: float  # κ: what the slope may change from node to node (regularisation)
    misfit: float  # Pa, root mean square of the pressures' residuals
    fitted: np.ndarray  # (n,) Pa


def deconvolve(
    time: ArrayLike,
    pressure: ArrayLike,
    rates: Sequence[tuple[float, float]],
    *,
    pressure_error: float,
    rate_error: float = 0.01,
    initial_pressure: float | None = None,
    initial_error: float | None = None,
    curvature: float | None = None,
) -> Deconvolved:
    """Unit-rate response behind a record under several rates.

    Parameters
    ----------
    time, pressure : (n,) s, increasing, and Pa.
    rates : (s, m³/s) in order, nothing before the first.
    pressure_error : standard deviation of the pressures, Pa.
    rate_error : of each rate, over its size; a rate of zero is exact.
    initial_pressure, initial_error : Pa, where it is known, and how well; else it is sought.
    curvature : κ; by default the smallest of `CURVATURES` whose misfit is not above the pressures'
        error, or hardly above what the largest leaves.

    Raises
    ------
    ValueError : errors that are not above zero, or no point after the first change of rate.
    """
    if not (pressure_error > 0 and rate_error > 0):
        raise ValueError("the errors of pressures and rates must be above zero")
    problem = _Problem(
        np.asarray(time, dtype=float),
        np.asarray(pressure, dtype=float),
        np.asarray(rates, dtype=float).reshape(-1, 2),
        pressure_error,
        rate_error,
        initial_pressure,
        initial_error,
    )
    if curvature is not None:
        return problem.solve(curvature, problem.start())[0]
    found: list[Deconvolved] = []
    u = problem.start()
    for kappa in CURVATURES[::-1]:  # from the loosest, each from the one before
        one, u = problem.solve(kappa, u)
        if found and one.misfit > max(pressure_error, ENOUGH * found[0].misfit):
            break
        found.append(one)
    return found[-1]


class _Problem:
    """Residuals and Jacobian in z, ln g at the first node, rates over those given, p₀."""

    def __init__(
        self,
        time: np.ndarray,
        pressure: np.ndarray,
        rates: np.ndarray,
        pressure_error: float,
        rate_error: float,
        initial: float | None,
        initial_error: float | None,
    ):
        self.time, self.pressure = time, pressure
        self.start_times, self.given = rates.T
        self.flows = self.given != 0.0
        self.pressure_error, self.rate_error = pressure_error, rate_error
        self.initial, self.initial_error = initial, initial_error
        age = time[:, None] - self.start_times
        self.row, self.change = np.nonzero(age > 0.0)
        if not len(self.row):
            raise ValueError("no point lies after the first change of rate")
        lags = age[self.row, self.change]
        low, high = math.log(lags.min()), math.log(lags.max() * (1.0 + 1e-12))
        count = max(4, math.ceil((high - low) / math.log(10.0) * PER_DECADE) + 1)
        self.nodes, self.width = np.linspace(low, high, count, retstep=True)
        self.piece = np.minimum(((np.log(lags) - low) / self.width).astype(int), count - 2)
        self.part = np.clip(np.log(lags) - self.nodes[self.piece], 0.0, self.width)
        self.scale = float(np.ptp(pressure)) or 1.0

    def start(self) -> np.ndarray:
        """A flat derivative that gives the record's range."""
        k = len(self.nodes)
        size = float(np.max(np.abs(self.given)))
        level = math.log(self.scale / size / (self.nodes[-1] - self.nodes[0] + 1.0))
        top = float(np.max(self.pressure)) if self.initial is None else self.initial
        return np.concatenate([np.full(k + 1, level), np.ones(len(self.given)), [top / self.scale]])

    def response(self, z: np.ndarray, first: float) -> tuple[np.ndarray, np.ndarray]:
        """G at each lag, and its derivatives by z and by `first`, (l, k + 1)."""
        h, k = self.width, len(z)
        rise = np.diff(z) / h
        whole, moment = _integrals(z[:-1], rise, np.full(k - 1, h))
        to_node = np.concatenate([[0.0], np.cumsum(whole)])
        g = math.exp(first) + to_node[self.piece]
        own, own_moment = _integrals(z[self.piece], rise[self.piece], self.part)
        g = g + own
        # by z: whole pieces before the lag, then the part of its own
        by_left, by_right = whole - moment / h, moment / h
        each = np.zeros((k, k))  # row: pieces up to a node, column: z
        for j in range(k - 1):
            each[j + 1 :, j] += by_left[j]
            each[j + 1 :, j + 1] += by_right[j]
        slope = np.zeros((len(self.piece), k + 1))
        slope[:, :k] = each[self.piece]
        rows = np.arange(len(self.piece))
        slope[rows, self.piece] += own - own_moment / h
        slope[rows, self.piece + 1] += own_moment / h
        slope[:, k] = math.exp(first)
        return g, slope

    def parts(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Pressures and their Jacobian; corrected rates and nodes."""
        k, m, n = len(self.nodes), len(self.given), len(self.time)
        z, first, factor, level = u[:k], u[k], u[k + 1 : -1], u[-1] * self.scale
        rates = self.given * factor
        step = np.diff(rates, prepend=0.0)
        g, slope = self.response(z, first)
        fall = np.bincount(self.row, step[self.change] * g, minlength=n)
        jacobian = np.zeros((n, len(u)))
        weighted = slope * step[self.change][:, None]
        order = np.searchsorted(self.row, np.arange(n))
        present = np.unique(self.row)
        jacobian[present, : k + 1] = -np.add.reduceat(weighted, order[present], axis=0)
        by_step = np.zeros((n, m))
        by_step[self.row, self.change] = -g
        by_rate = by_step.copy()
        by_rate[:, :-1] -= by_step[:, 1:]
        jacobian[:, k + 1 : -1] = by_rate * self.given
        jacobian[:, -1] = self.scale
        return level - fall, jacobian, rates, z

    def residual(self, u: np.ndarray, kappa: float) -> tuple[np.ndarray, np.ndarray]:
        """Weighted residuals and their Jacobian."""
        found, jacobian, _, z = self.parts(u)
        k, m = len(self.nodes), len(self.given)
        rows = [(found - self.pressure) / self.pressure_error]
        slopes = [jacobian / self.pressure_error]
        rate_rows = np.zeros((m, len(u)))
        rate_rows[np.arange(m), k + 1 + np.arange(m)] = 1.0 / self.rate_error
        # a well that is shut in has no rate to correct; its factor stays
        rows.append((u[k + 1 : -1] - 1.0) / self.rate_error)
        slopes.append(rate_rows)
        bend = np.zeros((k - 2, len(u)))
        at = np.arange(k - 2)
        for shift, weight in ((0, 1.0), (1, -2.0), (2, 1.0)):
            bend[at, at + shift] = weight / (self.width * kappa)
        rows.append(bend[:, :k] @ z)
        slopes.append(bend)
        if self.initial is not None:
            error = self.initial_error or self.pressure_error
            last = np.zeros((1, len(u)))
            last[0, -1] = self.scale / error
            rows.append(np.array([(u[-1] * self.scale - self.initial) / error]))
            slopes.append(last)
        return np.concatenate(rows), np.vstack(slopes)

    def solve(self, kappa: float, start: np.ndarray) -> tuple[Deconvolved, np.ndarray]:
        """The least squares at one regularisation, from a start."""
        with one_blas_thread():
            found = optimize.least_squares(
                lambda u: self.residual(u, kappa)[0],
                start,
                jac=lambda u: self.residual(u, kappa)[1],
                x_scale="jac",
                ftol=1e-6,
                xtol=1e-6,
                max_nfev=60,
            )
        u = found.x
        pressure, _, rates, z = self.parts(u)
        k = len(self.nodes)
        off = pressure - self.pressure
        covariance = np.linalg.pinv(found.jac.T @ found.jac, rcond=1e-15)
        whole, _ = _integrals(z[:-1], np.diff(z) / self.width, np.full(k - 1, self.width))
        change = math.exp(u[k]) + np.concatenate([[0.0], np.cumsum(whole)])
        return (
            Deconvolved(
                time=np.exp(self.nodes),
                derivative=np.exp(z),
                spread=np.sqrt(np.diag(covariance)[:k]),
                change=change,
                rates=rates,
                initial_pressure=float(u[-1] * self.scale),
                curvature=kappa,
                misfit=float(np.sqrt(np.mean(off**2))),
                fitted=pressure,
            ),
            u,
        )


def _integrals(z: np.ndarray, rise: np.ndarray, to: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """∫ e^(z + rise x) dx and ∫ x e^(z + rise x) dx from 0 to `to`."""
    y = rise * to
    small = np.abs(y) < 1e-3
    safe = np.where(small, 1.0, y)
    first = np.where(small, 1.0 + y / 2.0 + y * y / 6.0, np.expm1(safe) / safe)
    second = np.where(
        small,
        0.5 + y / 3.0 + y * y / 8.0,
        (safe * np.exp(safe) - np.expm1(safe)) / safe**2,
    )
    size = np.exp(z) * to
    return size * first, size * to * second
