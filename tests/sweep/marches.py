"""Tables of stages that march: one of a few lines, and one through the rates of a well."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from demflow.model.controls import controls_of, sites
from demflow.model.flow.equation.sites import WellSite, change_times
from demflow.model.products import Apertures, Network
from demflow.model.quantities import STOPPED, checked
from demflow.model.scene import Scene
from demflow.model.stages import STAGES as MODEL
from demflow.model.stages import Stage
from tests.sweep.toy_stages import DIARY, Packed
from tests.sweep.toy_stages import pack as toy_pack

TOY, RATES = f"{__name__}:TOY_STAGES", f"{__name__}:RATE_STAGES"
DECAY = 0.1  # 1/s
DIES_ONCE, RAISES, STOPS = 99.0, 98.0, 97.0  # rates


TEXT = """
study: marched
title: Marched
scene:
  region: {{shape: rectangle, width: 14 m, height: 14 m}}
  grains: {{count: 50, porosity: 0.17, seed: 1}}
  matrix: {{permeability: 1 mD}}
  fluid: {{viscosity: {seconds} Pa s, bulk_modulus: 1 GPa}}
  wells: {{producer: {{at: [0 m, 0 m], radius: 1 m, schedule: [[0 s, 1 m3/s]]}}}}
  boundaries: {{left: 7 MPa}}
  initial_pressure: 7 MPa
  times: [1 s, 5 s, 15 s, 25 s, {last} s]
vary:
  schedule:
    parameter: wells.producer.schedule
    values:
{schedules}
observe: [well_pressure]
{limits}
"""


def write_study(
    folder: Path,
    steps: Iterable[Sequence[float]],
    *,
    last: float = 30.0,
    seconds: float = 1e-6,
    limits: str = "",
) -> Path:
    """Write a study over schedules; each has its rates from 0, 10, 20 s … on."""

    def schedule(rates: Sequence[float]) -> str:
        return ", ".join(f"[{10 * k} s, {rate} m3/s]" for k, rate in enumerate(rates))

    lines = "\n".join(f"      - [{schedule(rates)}]" for rates in steps)
    path = folder / "marched.yaml"
    bound = f"limits: {limits}" if limits else ""
    path.write_text(TEXT.format(schedules=lines, last=last, seconds=seconds, limits=bound))
    return path


class Leg(NamedTuple):
    """What a march is to do until the next change of a rate, or its end."""

    start: float  # s
    end: float
    rates: tuple[float, ...]  # m³/s, of the wells
    times: tuple[float, ...]  # s, of the outputs in it


def legs(scene: Scene) -> tuple[Leg, ...]:
    """From change to change of a rate; the last one ends with the last time."""
    controls = controls_of(scene)
    ends = [*change_times(sites(controls.wells))[1:], np.inf]
    found, start = [], 0.0
    for end in ends:
        rates = tuple(
            next((q for t, q in well.rate_changes[::-1] if t <= start), 0.0)
            for well in controls.wells
        )
        times = tuple(t for t in controls.times if start < t <= end)
        last = end >= controls.times[-1]
        found.append(Leg(start, times[-1] if last else float(end), rates, times))
        if last:
            break
        start = float(end)
    return tuple(found)


def _always(scene: Scene) -> bool:
    return True


# A pressure that decays, drawn down by its well: dp/dt = −DECAY p − rate, from one per grain.


class Drawn(NamedTuple):
    time: Any
    pressure: Any  # (n,)
    recorded: Any  # (t,) mean at the times so far
    stopped: Any  # why nothing came after them, or an empty word
    events: Any  # (k,) s, as many in each leg as its rate says


def toy_march(packed: Packed, before: Drawn | None, *, leg: Leg, seconds: float) -> Drawn:
    begin = before or Drawn(np.zeros(()), packed.x, np.empty(0), np.array(""), np.empty(0))
    if str(begin.stopped):
        return begin
    assert float(begin.time) == leg.start
    _note("begins", leg)
    time.sleep(seconds)
    (rate,) = leg.rates
    if rate == RAISES:
        raise ValueError("the well is dry")
    if rate == DIES_ONCE and DIARY in os.environ:
        died = Path(os.environ[DIARY]).with_suffix(".died")
        if not died.exists():
            died.touch()
            os.kill(os.getpid(), signal.SIGKILL)
    _note("ends", leg)

    def at(t: np.ndarray | float) -> np.ndarray:
        left = np.exp(-DECAY * (np.asarray(t) - leg.start))
        return left * begin.pressure[..., None] - rate * (1.0 - left) / DECAY

    end, times, stopped = leg.end, leg.times, ""
    if rate == STOPS:
        end = 0.5 * (leg.start + leg.end)
        times, stopped = tuple(t for t in times if t <= end), f"it came apart at {end:g} s"
    recorded = at(np.array(times)).mean(axis=0)
    return Drawn(
        np.asarray(end),
        at([end])[:, 0],
        np.concatenate([begin.recorded, recorded]),
        np.array(stopped),
        np.concatenate([begin.events, _events(leg, end)]),
    )


def _events(leg: Leg, end: float) -> np.ndarray:
    return np.linspace(leg.start, end, int(leg.rates[0]) % 10 + 2)[1:-1]


def _note(what: str, leg: Leg) -> None:
    if path := os.environ.get(DIARY):
        with Path(path).open("ab", buffering=0) as file:
            file.write(f"{what} {leg.start:g} {leg.rates[0]:g}\n".encode())


def toy_observe(packed: Packed, drawn: Drawn, *, times: tuple[float, ...]) -> dict[str, np.ndarray]:
    pressure = np.full((1, len(times)), np.nan)
    pressure[0, : len(drawn.recorded)] = drawn.recorded
    found = {"well_pressure": pressure, "porosity": packed.x.std(), STOPPED: drawn.stopped}
    if len(drawn.events):
        found |= {"event_time": drawn.events, "event_x": np.sqrt(drawn.events)}
    return found


def toy_result(packed: Packed, steps: list[tuple[float, float]], times: np.ndarray) -> np.ndarray:
    """What the toy records, superposed."""
    found = np.exp(-DECAY * times) * packed.x.mean()
    for (t, new), (_, old) in zip(steps, [(0.0, 0.0), *steps], strict=False):
        since = np.maximum(times - t, 0.0)
        found = found + (new - old) * np.expm1(-DECAY * since) / DECAY
    return found


TOY_STAGES = (
    Stage(
        "pack",
        f"{toy_pack.__module__}:pack",
        1,
        (),
        {"count": lambda s: s.grains.count, "seed": lambda s: s.grains.seed},
        _always,
        Packed,
    ),
    Stage(
        "march",
        f"{__name__}:toy_march",
        1,
        ("pack", "march"),
        {"seconds": lambda s: s.fluid.viscosity},
        _always,
        Drawn,
        legs,
    ),
    Stage(
        "observe",
        f"{__name__}:toy_observe",
        1,
        ("pack", "march"),
        {"times": lambda s: s.times},
        _always,
        dict,
        check=checked,
        observed=True,
    ),
)

# The flow of a whole network, from one change of a rate to the next, exactly.


class Flowed(NamedTuple):
    time: Any
    pressure: Any  # (unknowns that store,) Pa above the start
    recorded: Any  # (t, wells) Pa above the start


def rate_march(
    network: Network,
    apertures: Apertures,
    before: Flowed | None,
    *,
    leg: Leg,
    region: Any,
    bulk_modulus: float,
    wells: tuple[WellSite, ...],
    sides: tuple[str, ...],
) -> Flowed:
    from tests.reservoirs import Reservoir, dense_matrices

    system = Reservoir(region, network, apertures, bulk_modulus).assembled(wells, sides)
    matrix, storage = dense_matrices(system)
    m, root = system.pores, np.sqrt(storage)
    begin = before or Flowed(np.zeros(()), np.zeros(m), np.empty((0, len(wells))))
    shut = np.linalg.inv(matrix[m:, m:])
    put = -np.bincount(system.well_node, weights=leg.rates, minlength=system.n)
    decay, modes = np.linalg.eigh(
        (matrix[:m, :m] - matrix[:m, m:] @ shut @ matrix[m:, :m]) / np.outer(root, root)
    )
    force = modes.T @ ((put[:m] - matrix[:m, m:] @ shut @ put[m:]) / root)
    state = modes.T @ (root * begin.pressure)

    def at(t: float) -> np.ndarray:
        gone = np.exp(-decay * (t - leg.start))
        return modes @ (state * gone + force * (1.0 - gone) / decay) / root

    recorded = [shut @ (put[m:] - matrix[m:, :m] @ at(t)) for t in leg.times]
    return Flowed(
        np.asarray(leg.end),
        at(leg.end),
        np.concatenate([begin.recorded, np.reshape(recorded, (-1, len(wells)))]),
    )


def rate_observe(flowed: Flowed, *, start: float) -> dict[str, np.ndarray]:
    return {"well_pressure": start + flowed.recorded.T}


MADE = ("pack", "unit_loads", "stress", "network", "calibrate", "walk")

RATE_STAGES = (
    *(s for s in MODEL if s.name in MADE),
    next(s for s in MODEL if s.name == "open"),
    Stage(
        "march",
        f"{__name__}:rate_march",
        1,
        ("network", "open", "march"),
        {
            "region": lambda s: s.region,
            "bulk_modulus": lambda s: s.fluid.bulk_modulus,
            "wells": lambda s: tuple(w._replace(change_times=()) for w in sites(s.wells)),
            "sides": lambda s: tuple(name for name, _ in s.boundaries),
        },
        _always,
        Flowed,
        legs,
    ),
    Stage(
        "observe",
        f"{__name__}:rate_observe",
        1,
        ("march",),
        {"start": lambda s: s.initial_pressure},
        _always,
        dict,
        check=checked,
        observed=True,
    ),
)
