"""Transients of a poroelastic rock step by step: TR-BDF2 of (C p + Aᵀu)' = −G p + q, K u = A p + f.

The trapezoidal rule to t + γ Δt, then the backward differentiation formula to t + Δt, with
γ = 2 − √2 both by the same matrix B + ½ γ Δt G (Bank et al. 1985, IEEE Trans. CAD 4, 436; Hosea &
Shampine 1996, Appl. Numer. Math. 20, 21): second order, L-stable. Steps go by a ladder, so that a
factor serves many of them. `krylov` is several times faster; this one shares nothing with it but
the factors, and judges it.
"""

from __future__ import annotations

import math

import numpy as np

from demflow.model.coupling.krylov import Course, Factors, idle
from demflow.model.coupling.record import Record
from demflow.model.coupling.rock import Rock, Source
from demflow.model.mechanics.static.stiffness import Quasidefinite
from demflow.model.outcome import ModelError

Array = np.ndarray

GAMMA = 2.0 - math.sqrt(2.0)
ERROR = (-3.0 * GAMMA**2 + 4.0 * GAMMA - 2.0) / (12.0 * (2.0 - GAMMA))  # of the local error
LADDER = 2.0  # between lengths of steps
BEFORE_FIRST = 1e-2  # first step, of the first time
SAFETY = 0.8
MOST_STEPS = 20_000


class Stepper:
    """One matrix B + ½ γ Δt G at a time, factored on the order of the first."""

    def __init__(self, rock: Rock) -> None:
        self.rock = rock
        self.made, self._shift = 0, math.nan
        self._factor: Quasidefinite | None = None

    def take(self, rock: Rock) -> None:
        """Go on with other conductances."""
        self.rock, self._shift = rock, math.nan

    def solve(self, step: float, stored: Array) -> tuple[Array, Array]:
        """Pressures and displacements of (B + ½ γ Δt G) p = `stored`."""
        shift = 2.0 / (GAMMA * step)
        if shift != self._shift:
            self._shift, self.made = shift, self.made + 1
            if self._factor is None:
                self._factor = self.rock.factor(shift)
            else:
                self.rock.update(self._factor, shift)
        assert self._factor is not None
        return self.rock.solve_both(self._factor, shift, shift * stored)


def march(
    factors: Factors, record: Record, source: Source, direct: Array, lag: Array, tolerance: float,
    *, field: bool = False,
) -> Course:  # fmt: skip
    """What a unit of a source does; see `krylov.course`.

    The tolerance holds for the local error of a step, over the largest pressure so far.

    Raises `ModelError` where a step cannot be found.

    Parameters
    ----------
    factors : of the matrices, by step
    record : rows of what is recorded
    source : what acts
    direct : what acts at once, (o,)
    lag : (l,) s
    tolerance : relative error in time
    field : whether the whole field is kept
    """
    rock = factors.rock
    later = lag > 0.0
    times = lag[later]
    n, m = rock.system.n, len(rock.frame.free)
    jump, at_once = rock.jump(source), rock.frame.moved(source.force)
    fixed = direct + record.place @ at_once
    output = np.zeros((len(lag), len(fixed)))
    cumulative = np.zeros((len(lag), record.inflow.shape[0] + 1))
    pressures = np.zeros((len(lag), n if field else 0))
    if not len(times) or not (jump.any() or source.flow.any()):
        return idle(rock, record, fixed, lag, field=field)
    p, u = np.zeros(n), np.zeros(m)
    if jump.any():
        p, u = rock.solve_both(rock.factor(math.inf), math.inf, jump)
    stepper = Stepper(rock)
    stored = rock.stored(p, u)
    into = np.zeros(record.inflow.shape[0])  # ∫ of what pipes let in by pressures
    step = BEFORE_FIRST * times[0]
    now, at, worst = 0.0, int(np.argmax(later)), 0.0
    largest = np.abs(p).max()
    held = rock.size * rock.held
    by_pressure, by_place = record.volume
    for taken in range(1, MOST_STEPS + 1):
        flow = source.flow - rock.conductance @ p
        half = 0.5 * GAMMA * step
        middle, middle_u = stepper.solve(step, stored + half * (flow + source.flow))
        middle_stored = rock.stored(middle, middle_u)
        middle_flow = source.flow - rock.conductance @ middle
        mixed = (middle_stored - (1.0 - GAMMA) ** 2 * stored) / (GAMMA * (2.0 - GAMMA))
        after, after_u = stepper.solve(step, mixed + half * source.flow)
        after_flow = source.flow - rock.conductance @ after
        lost = 2.0 * ERROR * step * (
            flow / GAMMA - middle_flow / (GAMMA * (1.0 - GAMMA)) + after_flow / (1.0 - GAMMA)
        )  # fmt: skip
        error = float(np.abs(stepper.solve(step, lost)[0]).max())
        largest = max(largest, float(np.abs(after).max()))
        relative = error / largest if largest > 0.0 else 0.0
        if not math.isfinite(relative):
            raise ModelError("the coupled march lost its numbers; look at apertures and pores")
        if relative > tolerance:
            step /= LADDER
            continue
        worst = max(worst, relative)
        # volumes by the rule of the step itself, so that they balance with what is stored
        let = (record.inflow @ np.stack([p, middle, after], axis=1)).T
        then = [into, into + half * (let[0] + let[1])]
        then.append(into + step * (let[0] + let[1]) / (2.0 * (2.0 - GAMMA)) + half * let[2])
        while at < len(lag) and lag[at] <= now + step * (1.0 + 1e-12):
            z = (lag[at] - now) / step
            part, slope = between(z)
            here = part[0] * p + part[1] * middle + part[2] * after
            place = part[0] * u + part[1] * middle_u + part[2] * after_u
            speed = (slope[0] * u + slope[1] * middle_u + slope[2] * after_u) / step
            output[at] = record.pressure @ here + record.place @ place + record.speed @ speed
            output[at] += fixed
            cumulative[at, :-1] = part @ np.array(then)
            cumulative[at, :-1] += held.T @ (place + at_once)
            cumulative[at, -1] = by_pressure @ here + by_place @ (place + at_once)
            if field:
                pressures[at] = rock.modulus * here
            at += 1
        into = then[2]
        p, u, now = after, after_u, now + step
        stored = rock.stored(p, u)
        if at == len(lag):
            cumulative[:, :-1] += np.outer(lag, direct[record.kind == 1])
            return Course(output, cumulative, pressures, worst, 0.0, taken)
        wish = SAFETY * (tolerance / max(relative, 1e-300)) ** (1.0 / 3.0)
        if wish >= LADDER:
            step *= LADDER
    raise ModelError(
        f"the coupled march took {MOST_STEPS} steps to {now:.3g} s; raise solver.tolerance, or "
        "take solver.method krylov"
    )


def between(z: float) -> tuple[Array, Array]:
    """Parts of the start, the middle (at γ) and the end of a step at its part z, by a parabola.

    Then their derivatives by z.
    """
    g = GAMMA
    bottom = np.array([g, g * (g - 1.0), 1.0 - g])
    # (z − γ)(z − 1), z (z − 1), z (z − γ): a z² + b z + c
    b, c = np.array([-(1.0 + g), -1.0, -g]), np.array([g, 0.0, 0.0])
    return (z * z + b * z + c) / bottom, (2.0 * z + b) / bottom
