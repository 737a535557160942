"""Wells with limits of pressure, followed exactly: event after event, by dense eigenvectors."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from demflow.model.flow.equation.system import System
from tests.reservoirs import dense_matrices

GIVEN, HELD, SHUT = 0, 1, 2


class Limited(NamedTuple):
    """What a well is told."""

    schedule: tuple[tuple[float, float], ...]
    least: float = -np.inf
    largest: float = np.inf

    def rate(self, time: float) -> float:
        return next((q for t, q in reversed(self.schedule) if t <= time), 0.0)

    def limit(self, time: float) -> float:
        return self.least if self.rate(time) > 0.0 else self.largest


class Exact:
    """Pressures of one network whose wells all are at rates, some of them limited."""

    def __init__(self, system: System, sides: np.ndarray, start: float, wells: list[Limited]):
        self.matrix, self.storage = dense_matrices(system)
        self.m, self.start, self.wells = system.pores, start, wells
        self.load = sum((p - start) * system.source(k) for k, p in enumerate(sides)) + np.zeros(
            system.n
        )
        self.well_node = np.asarray(system.well_node)

    def run(self, times):
        """Pressure and rate of each well at times (w, t), and the times of switching."""
        end, now = times[-1], 0.0
        x = np.zeros(self.m)
        holds = [GIVEN] * len(self.wells)
        found = {t: None for t in times}
        switches = []
        changes = sorted({t for w in self.wells for t, _ in w.schedule} | {end})
        while now < end:
            then = next(t for t in changes if t > now)
            bounded = [w.rate(now) != 0.0 and np.isfinite(w.limit(now)) for w in self.wells]
            kept = [h if b else GIVEN for h, b in zip(holds, bounded, strict=True)]
            wanted = self.better(x, now, 1e-9 * then, kept)
            if wanted != holds:
                if now > 0.0 or HELD in wanted:
                    switches.append(now)
                holds = wanted
            march = self.march(x, now, holds)
            grid = now + np.geomspace(1e-6 * (then - now), then - now, 400)
            beyond = [
                k for k, t in enumerate(grid) if self.condition(*march(t)[1:], now, holds) != holds
            ]
            stop = then
            if beyond:
                k = beyond[0]
                low = grid[k - 1] if k else now
                stop = self.locate(march, now, holds, low, grid[k])
            for t in times:
                if now < t <= stop:
                    found[t] = march(t)[1:]
            x = march(stop)[0]
            if stop < then:
                holds = self.condition(*march(grid[beyond[0]])[1:], now, holds)
                switches.append(stop)
            now = stop
        pressure, rate = (np.array([found[t][k] for t in times]).T for k in (0, 1))
        return self.start + pressure, rate, switches

    def better(self, x, now, span, holds):
        for _ in range(10):
            _, pressure, rate = self.march(x, now, holds)(now + span)
            new = self.condition(pressure, rate, now, holds)
            if new == holds:
                return holds
            holds = new
        raise AssertionError("no condition holds")

    def condition(self, pressure, rate, now, holds):
        new: list[int] = []
        for k, (well, hold) in enumerate(zip(self.wells, holds, strict=True)):
            target = well.rate(now)
            if target == 0.0 or not np.isfinite(well.limit(now)):
                new.append(GIVEN)
                continue
            sign = np.sign(target)
            room = sign * (self.start + pressure[k] - well.limit(now))
            if hold == GIVEN:
                new.append(HELD if room < -1e-6 else GIVEN)
            elif hold == SHUT:
                new.append(HELD if room > 1e-6 else SHUT)
            elif sign * rate[k] > abs(target) * (1 + 1e-12):
                new.append(GIVEN)
            else:
                new.append(SHUT if sign * rate[k] < 0.0 else HELD)
        return new

    def locate(self, march, now, holds, low, high):
        def margin(t):
            _, pressure, rate = march(t)
            worst = np.inf
            for k, (well, hold) in enumerate(zip(self.wells, holds, strict=True)):
                target = well.rate(now)
                sign, limit = np.sign(target), well.limit(now)
                if target == 0.0 or not np.isfinite(limit):
                    continue
                room = sign * (self.start + pressure[k] - limit)
                if hold == GIVEN:
                    worst = min(worst, room / abs(limit))
                elif hold == SHUT:
                    worst = min(worst, -room / abs(limit))
                else:
                    left = abs(target) - sign * rate[k]
                    worst = min(worst, left / abs(target), sign * rate[k] / abs(target))
            return worst

        return brentq(margin, low, high, xtol=1e-14 * high, rtol=1e-14)

    def march(self, x, now, holds):
        """State, well pressures and rates at later times while these conditions hold."""
        m, node = self.m, self.well_node
        held = [k for k, hold in enumerate(holds) if hold == HELD]
        free = [k for k in range(len(holds)) if k not in held]
        fixed = np.array([w.limit(now) - self.start for w in self.wells])
        target = np.array(
            [w.rate(now) if h == GIVEN else 0.0 for w, h in zip(self.wells, holds, strict=True)]
        )
        wells = np.array([n for n in range(m, len(self.matrix))], dtype=int)
        load = self.load.copy()
        load[node] -= target
        f, h = node[free], node[held]
        assert set(node) == set(wells)
        shut = np.linalg.inv(self.matrix[np.ix_(f, f)]) if free else np.zeros((0, 0))
        at_f = load[f] - self.matrix[np.ix_(f, h)] @ fixed[held]
        across = self.matrix[:m, f] @ shut
        reduced = self.matrix[:m, :m] - across @ self.matrix[f, :m]
        push = load[:m] - self.matrix[:m, h] @ fixed[held] - across @ at_f
        root = np.sqrt(self.storage)
        decay, modes = np.linalg.eigh(reduced / np.outer(root, root))
        decay = np.maximum(decay, 0.0)
        weight, state = modes.T @ (push / root), modes.T @ (root * x)

        def at(time):
            span = time - now
            z = decay * span
            grown = np.where(z < 1e-9, span, -np.expm1(-z) / np.where(decay > 0, decay, 1))
            pores = modes @ (state * np.exp(-z) + weight * grown) / root
            pressure, rate = np.empty(len(holds)), target.copy()
            pressure[held] = fixed[held]
            pressure[free] = shut @ (at_f - self.matrix[f, :m] @ pores)
            rows = self.matrix[h, :m] @ pores + self.matrix[np.ix_(h, h)] @ fixed[held]
            rate[held] = self.load[h] - rows - self.matrix[np.ix_(h, f)] @ pressure[free]
            return pores, pressure, rate

        return at
