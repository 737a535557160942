"""What a study is told is as near to the exact solution as the tolerance says.

Random scenes go through the stages as a study's cases do; every recorded quantity is compared with
a solution in extended precision, on the scale that the tolerance is stated for:

- the pressure change of a well, and its derivative: the largest change of its flow period so far,
  for the derivative of a shut-in times d ln Δt / d ln of the equivalent time by which it is taken,
  or the derivative itself, where its window reaches to changes far larger;
- the pressure of a well: its largest change so far;
- the rate of a well at a pressure, the flow through a side: the largest of its own, or a millionth
  of the largest flow or rate of the case, or a tenth of what would fill all pores to its pressure
  in the time of the case;
- a probe: its own largest change, or a tenth of the largest change of any well, side or probe;
- a map: the largest change of any pore.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np

from demflow.model.controls import controls_of, sites
from demflow.model.flow.equation.outputs import outputs
from demflow.model.flow.equation.probes import between_pores
from demflow.model.flow.equation.system import System, assemble
from demflow.model.history import superposed_map
from demflow.model.outcome import ModelError
from demflow.model.products import Responses
from demflow.model.scene import Scene, Solver
from demflow.model.stages import STAGES
from demflow.model.transient import bourdet_derivative, flow_periods, log_time
from tests.benchmarks.result import Result
from tests.extended import exact, superposed
from tests.scenes import START, random_scene

SCENES = 60
TOLERANCES = tuple(10.0**-k for k in range(2, 9))
METHODS = ("krylov", "implicit", "auto")
MOST, SHARE, NEVER = 1.0, 0.99, 3.0
FAINT_FLOW, FAINT_PROBE = 1e-6, 0.1

Recorded = dict[str, np.ndarray]
BY_NAME = {stage.name: stage for stage in STAGES}


def products_of(scene: Scene, known: dict[str, Any], *names: str) -> dict[str, Any]:
    """Products of some stages, in order, beside those known."""
    products = dict(known)
    for name in names:
        stage = BY_NAME[name]
        parts = {key: part(scene) for key, part in stage.reads.items()}
        products[name] = stage.run(*(products.get(p) for p in stage.parents), **parts)
    return products


def open_rock(scene: Scene) -> dict[str, Any]:
    """Products of all stages before the flow."""
    before = [stage for stage in STAGES[: [s.name for s in STAGES].index("flow")]]
    return products_of(scene, {}, *(stage.name for stage in before if stage.wanted(scene)))


def recorded(scene: Scene, rock: dict[str, Any]) -> Recorded:
    """What a study is told of one case, maps too."""
    products = products_of(scene, rock, "flow", "observe")
    return products["observe"] | {"pressure": superposed_map(products["flow"], controls_of(scene))}


def truth(scene: Scene, rock: dict[str, Any], told_by: Responses) -> tuple[Recorded, Recorded]:
    """The exact values of what is recorded, and the scale on which each is compared."""
    told, lag = controls_of(scene), told_by.lag
    net = rock["network"]
    system = assembled(scene, rock)
    points = np.array([p.at for p in scene.probes])
    probed = between_pores(net, rock["open"], scene.region, system, points)
    found = exact(system, outputs(system, probed), lag)
    times = np.array(told.times)
    output = superposed(found.output, lag, told, times)
    rates = [k for k, w in enumerate(told.wells) if w.pressure is None]
    held = [k for k, w in enumerate(told.wells) if w.pressure is not None]
    sides = len(told.side_pressures)
    wells, flows, probes = np.split(output.T, [len(rates), len(rates) + sides + len(held)])
    drift = np.full((len(told.wells), len(times)), np.nan, dtype=np.longdouble)
    derivative, so_far, stretched = drift.copy(), drift.copy(), drift.copy()
    for row, k in enumerate(rates):
        start, sign = flow_periods(told.wells[k].rate_changes)
        before = superposed(found.output, lag, told, start)[:, row]
        period = np.searchsorted(start, times, side="left") - 1
        for p in range(len(start)):
            now = period == p
            drift[k, now] = sign[p] * (before[p] - wells[row, now])
            so_far[k, now] = np.maximum.accumulate(np.abs(drift[k, now]))
        stretched[k] = so_far[k] * stretch(times, told.wells[k].rate_changes)
        derivative[k] = derivative_of(times, drift[k], told.wells[k].rate_changes)
    inside = told_by.domain
    node, fixed = system.node_of_domain[inside], system.source_of_domain[inside]
    field = np.zeros((*found.output.shape[:2], len(inside)), dtype=np.longdouble)
    field[:, :, node >= 0] = found.pressure[:, :, node[node >= 0]]
    for k in range(system.fixed_count):
        field[k, :, fixed == k] = 1.0
    mapped = superposed(field, lag, told, times)
    pressure = np.full_like(drift, 0.0)
    pressure[rates] = wells
    pressure[held] = np.array([told.wells[k].pressure - START for k in held])[:, None]
    steps = np.abs([p - START for p in told.fixed_pressures])
    largest = np.abs(np.concatenate([wells, probes])).max(initial=steps.max(initial=0.0))
    fill = steps[:, None] * float(system.storage.sum() / times[-1])
    most = max((abs(q) for w in told.wells for _, q in w.rate_changes), default=0.0)
    faint = FAINT_FLOW * np.abs(flows).max(initial=max(most, fill.max(initial=0.0)))
    faint = np.maximum(faint, FAINT_PROBE * fill)
    flow_scale = np.maximum(np.abs(flows).max(axis=1, keepdims=True), faint) + 0.0 * flows
    rate, rate_scale = np.zeros_like(drift), np.zeros_like(drift)
    rate[held], rate_scale[held] = -flows[sides:], flow_scale[sides:]
    values = {
        "pressure_change": drift,
        "pressure_derivative": derivative,
        "well_pressure": pressure,
        "well_rate": rate,
        "boundary_flow": flows[:sides],
        "probe_pressure": probes,
        "pressure": mapped,
    }
    own = np.abs(probes).max(axis=1, keepdims=True)
    scales = {
        "pressure_change": so_far,
        "pressure_derivative": np.fmax(stretched, np.abs(derivative)),
        "well_pressure": np.maximum.accumulate(np.abs(pressure), axis=1),
        "well_rate": rate_scale,
        "boundary_flow": flow_scale[:sides],
        "probe_pressure": np.maximum(own, FAINT_PROBE * largest) + 0.0 * probes,
        "pressure": np.abs(mapped).max() + 0.0 * mapped,
    }
    return values, scales


def stretch(times: np.ndarray, rates: Any) -> np.ndarray:
    """How many times more slowly the abscissa of the derivative runs than ln Δt, ≥ 1."""
    start, _ = flow_periods(rates)
    x, found = log_time(times, rates), np.ones(len(times))
    for period in np.split(np.arange(len(times)), np.searchsorted(times, start, side="right")):
        if len(period) > 1 and np.isfinite(x[period]).all():
            since = times[period] - start[start < times[period[0]]][-1]
            found[period] = np.maximum(1.0, np.gradient(np.log(since), x[period]))
    return found


def derivative_of(times: np.ndarray, change: np.ndarray, rates: Any) -> np.ndarray:
    """The Bourdet derivative as a study is told it."""
    start, _ = flow_periods(rates)
    x = log_time(times, rates)
    return bourdet_derivative(times, change.astype(float), start, x=x)


def ratios(
    found: Recorded, values: Recorded, scales: Recorded, tolerance: float
) -> dict[str, float]:
    """Largest true over asked error of each quantity; the last digit of a pressure is free."""
    worst = {}
    for name, value in values.items():
        if name not in found:
            continue
        given = np.asarray(found[name], dtype=np.longdouble)
        round_off = 0.0
        if name in ("well_pressure", "probe_pressure", "pressure"):
            given = given - START
        if name.startswith(("pressure", "well_pressure", "probe")):
            round_off = 64 * np.spacing(START)
        if name == "pressure_derivative":  # the digit over the abscissa's smaller step
            round_off = round_off * np.fmax(1.0, scales[name] / scales["pressure_change"])
        counts = np.isfinite(value) & (scales[name] > 0.0)
        off = np.maximum(np.abs(given - value) - round_off, 0.0)[counts]
        ratio = off / (tolerance * scales[name][counts])
        worst[name] = float(np.max(np.where(np.isfinite(ratio), ratio, np.inf), initial=0.0))
    return worst


def solvable(count: int, first: int) -> Iterator[tuple[int, Scene, dict[str, Any]]]:
    """Seeds, scenes and open networks, those left out in which a well has no rock around it."""
    seed = first
    while count:
        scene = random_scene(seed)
        rock = open_rock(scene)
        try:
            assembled(scene, rock)
        except ModelError:
            pass
        else:
            count -= 1
            yield seed, scene, rock
        seed += 1


def assembled(scene: Scene, rock: dict[str, Any]) -> System:
    """The flow equation of a scene."""
    return assemble(
        rock["network"],
        rock["open"],
        region=scene.region,
        bulk_modulus=scene.fluid.bulk_modulus,
        wells=sites(scene.wells),
        sides=tuple(name for name, _ in scene.boundaries),
    )


def run(scenes: int = SCENES, methods: tuple[str, ...] = METHODS, first: int = 1) -> Result:
    """True over asked error of each scene, solver and tolerance; what was claimed beside it."""
    rows: list[tuple[float, str]] = []
    false_claims, refused = 0, 0
    for seed, scene, rock in solvable(scenes, first):
        answer: tuple[Recorded, Recorded] | None = None
        for method in methods:
            for tolerance in TOLERANCES:
                asked = dataclasses.replace(
                    scene, solver=Solver(method=method, tolerance=tolerance)
                )
                label = f"scene {seed}, {method}, {tolerance:.0e}"
                try:
                    found = recorded(asked, rock)
                except ModelError as told:
                    refused += 1
                    rows.append((0.0, f"{label}: refused: {told}"))
                    continue
                if answer is None:
                    answer = truth(scene, rock, products_of(asked, rock, "flow")["flow"])
                each = ratios(found, *answer, tolerance)
                name = max(each, key=lambda key: each[key])
                rows.append((each[name], f"{label}: {each[name]:.3g} ({name})"))
                if each[name] > NEVER and found["tolerance_met"] == 1.0:
                    false_claims += 1
    ratio = np.array([r for r, _ in rows])
    share, most = float(np.mean(ratio <= MOST)), float(ratio.max())
    lines = [text for r, text in sorted(rows, reverse=True)[:30] if r > MOST]
    lines += [text for _, text in rows if "refused" in text][:10]
    for method in methods:
        own = np.array([r for r, text in rows if f", {method}," in text])
        within = f"{np.mean(own <= MOST):.1%} within"
        lines.append(f"{method}: {within}, median {np.median(own):.2g}, largest {own.max():.3g}")
    return Result(
        f"{share:.1%} of {len(rows)} within the tolerance, largest {most:.3g} times it, "
        f"{false_claims} claims false, {refused} refused",
        f"{SHARE:.0%} within, never above {NEVER:g}, no claim false",
        bool(share >= SHARE and most <= NEVER and false_claims == 0),
        "\n".join(lines),
    )
