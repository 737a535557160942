"""Wells with limits of pressure switch when the event-exact solution of the same network does.

Twenty random rocks, each with one or two wells whose rates, schedules and limits are drawn: the
times at which a limit takes over, and pressures and rates at all times, against dense
eigenvectors followed from event to event, at the default tolerance. A rate that comes back
slowly to what was asked for gives its time badly: a time counts by what the rate or the pressure is
off at it.
"""

from __future__ import annotations

import numpy as np

from demflow.model.controls import Controls, sites, step_sizes
from demflow.model.history import superposed
from demflow.model.limited import settled
from demflow.model.region import Rectangle
from demflow.model.scene import Well
from tests.benchmarks.result import Result
from tests.controlled import Exact, Limited
from tests.reservoirs import reservoir
from tests.rocks import random_graph

ROCKS, TOLERANCE, START = 20, 1e-4, 1e7
TIMES = tuple(np.geomspace(1e-2, 1e3, 41))


def drawn(rng: np.random.Generator) -> tuple[Well, ...]:
    """One or two wells with limits."""
    wells = []
    for k in range(int(rng.integers(1, 3))):
        sign = 1.0 if k == 0 else float(rng.choice([-1.0, 1.0]))
        changes = np.sort(rng.choice(np.geomspace(0.5, 300.0, 30), int(rng.integers(0, 4)), False))
        rates = sign * 10.0 ** rng.uniform(-7.0, -5.3, len(changes) + 1)
        rates[1:][rng.random(len(changes)) < 0.2] = 0.0
        limit = START - sign * 10.0 ** rng.uniform(4.5, 5.8)
        wells.append(
            Well(
                name="ab"[k],
                at=((0.4, 0.3), (-0.5, -0.35))[k],
                radius=0.1,
                schedule=tuple(zip([0.0, *changes.tolist()], rates.tolist(), strict=True)),
                **{"least_pressure" if sign > 0.0 else "largest_pressure": limit},
            )
        )
    return tuple(wells)


def compared(seed: int) -> tuple[float, float, float, int]:
    """Errors of times, pressures and rates, and how many switches there were."""
    rng = np.random.default_rng(seed)
    rock = reservoir(random_graph(1.2, 400, seed), Rectangle(2.0, 2.0))
    wells = drawn(rng)
    responses = rock.respond(wells, ("left",), TIMES, method="krylov", tolerance=TOLERANCE)
    controls = Controls(START, START, (START,), wells, TIMES, True)
    history = superposed(responses, controls)
    found = settled(responses, controls, step_sizes(controls))
    assert found is not None
    told = [
        Limited(w.rate_changes, w.least_pressure or -np.inf, w.largest_pressure or np.inf)
        for w in wells
    ]
    exact = Exact(rock.assembled(sites(wells), ("left",)), np.array([START]), START, told)
    pressure, rate, switches = exact.run(TIMES)
    change, most = np.abs(pressure - START).max(), np.abs(rate).max()
    worst = 0.0 if len(switches) == len(found.switches) else np.inf
    if worst == 0.0 and switches:
        # what is off at a time by which it is off
        both = sorted({*TIMES, *switches, *found.switches} - {0.0})
        own_p, own_q, _ = exact.run(tuple(both))
        for mine, known in zip(found.switches, switches, strict=True):
            if mine == known:
                continue
            i, j = both.index(mine), both.index(known)
            off = np.abs(own_p[:, i] - own_p[:, j]).max() / change
            worst = max(worst, off, np.abs(own_q[:, i] - own_q[:, j]).max() / most)
    return (
        worst,
        float(np.abs(history.well_pressure - pressure).max() / change),
        float(np.abs(history.well_rate - rate).max() / most),
        len(switches),
    )


def run() -> Result:
    """All rocks."""
    found = np.array([compared(seed) for seed in range(ROCKS)])
    times, pressures, rates = found[:, :3].max(axis=0)
    switches = int(found[:, 3].sum())
    lines = [f"rock {k}: " + ", ".join(f"{x:.1e}" for x in row) for k, row in enumerate(found)]
    return Result(
        f"{switches} switches: times off by {times:.1e} of the largest change, "
        f"pressures by {pressures:.1e}, rates by {rates:.1e}",
        f"≤ {TOLERANCE:g}",
        bool(max(times, pressures, rates) <= TOLERANCE and switches >= ROCKS),
        "\n".join(lines),
    )
