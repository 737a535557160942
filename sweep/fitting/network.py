"""The network of a scene fitted to a measured test, each trial through the stages that it changes.

A trial is a scene with other values; its stage runs have identities as in any study, so that
what the fitted parameters do not touch (the packing, the network) is computed once, or taken from
the store of earlier runs and left there for later ones. What they touch is kept in memory only.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from demflow.model.outcome import ModelError
from demflow.model.parameters import SceneError
from demflow.model.products import build, named
from demflow.model.scene import Scene
from demflow.sweep.analysis.fitting import Fit, Free, fit
from demflow.sweep.analysis.reservoirs import LEVEL
from demflow.sweep.analysis.thinning import thinned
from demflow.sweep.errors import ResultsError
from demflow.sweep.plan.graph import Plan, make_plan
from demflow.sweep.plan.table import stage_table
from demflow.sweep.store.lock import FolderLock
from demflow.sweep.store.origins import with_origins
from demflow.sweep.store.products import Store, canonical, pack
from demflow.sweep.store.versions import versions
from demflow.sweep.study.axes import Axis
from demflow.sweep.study.fits import FitRequest
from demflow.sweep.study.load import Study
from demflow.sweep.study.measured import MeasuredTest
from demflow.sweep.study.scenes import SceneBuilder

POINTS = 150  # times of a trial; a longer record is thinned so that its derivative stays
STEP = 2e-3  # of the Jacobian's differences: above what the solver's tolerance leaves


class Trials:
    """Well pressures of a scene at trial values, in this process."""

    def __init__(self, study: Study, request: FitRequest, test: MeasuredTest, store: Store | None):
        if study.axes:
            raise ResultsError(
                f"{study.path} varies {', '.join(a.name for a in study.axes)}; a fit is of one "
                "scene: leave vary out"
            )
        self._study, self._request, self._store = study, request, store
        self._well = _measured_well(study, test)
        keep = thinned(test.time, test.pressure, test.rate_changes, POINTS)
        keep = keep[test.time[keep] > 0.0]
        self.time, self.pressure = test.time[keep], test.pressure[keep]
        self._stages = with_origins(stage_table(), store) if store else stage_table()
        self._made: dict[str, Mapping[str, np.ndarray]] = {}
        self._shared: set[str] = set()
        self._built: dict[str, Any] = {}  # products of what all trials share
        self.runs = 0  # stage runs that were computed
        self._rates = self._scaled_rates(test)

    def _scaled_rates(self, test: MeasuredTest) -> tuple[tuple[float, float], ...] | None:
        """Measured rates as the network has them: of one metre of depth, in the reservoir."""
        if test.rate_changes is None:
            return None
        rock = self._request.rock
        scale = rock.volume_factor / rock.thickness
        return tuple((start, rate * scale) for start, rate in test.rate_changes)

    def scene(self, values: Mapping[str, float]) -> Scene:
        """The scene with other values. Raises SceneError."""
        every = {**self._request.known, **values}
        empty = ("",) * len(every)
        axis = Axis("trial", tuple(every), (tuple(every.values()),), empty, empty, empty)
        scene = SceneBuilder(self._study.values, [axis]).scene((0,))
        wells = tuple(
            dataclasses.replace(well, rate=None, schedule=self._rates)
            if well.name == self._well and self._rates is not None
            else well
            for well in scene.wells
        )
        return dataclasses.replace(
            scene, wells=wells, times=tuple(self.time.tolist()), observe=("well_pressure",)
        )

    def share(self, one: Mapping[str, float], other: Mapping[str, float]) -> None:
        """Learn which stage runs do not depend on what is fitted, by two trials."""
        plans = [make_plan([self.scene(values)], self._stages) for values in (one, other)]
        first, second = ({run.id for run in plan.runs} for plan in plans)
        self._shared = first & second

    def well_pressure(self, values: Mapping[str, float]) -> np.ndarray:
        """Pressure of the measured well at the times of the test, Pa. Raises ValueError."""
        try:
            scene = self.scene(values)
            plan = make_plan([scene], self._stages)
            self._made = {key: self._made[key] for key in self._made if key in self._shared}
            products = [self._product(plan, k, scene) for k in range(len(plan.runs))]
        except ModelError as error:
            raise ValueError(str(error)) from error
        observed = next(
            product
            for run, product in zip(plan.runs, products, strict=True)
            if plan.stages[run.stage].observed
        )
        names = [well.name for well in scene.wells]
        found: np.ndarray = named(observed)["well_pressure"][names.index(self._well)]
        return found

    def _product(self, plan: Plan, k: int, scene: Scene) -> Any:
        run = plan.runs[k]
        stage = plan.stages[run.stage]
        if run.id in self._built:
            return self._built[run.id]
        shared = run.id in self._shared
        arrays = self._made.get(run.id)
        if arrays is None and self._store is not None and self._store.has(run.id):
            arrays = self._store.get(run.id).arrays
        if arrays is None:
            parents = [None if p < 0 else self._product(plan, p, scene) for p in run.parents]
            made = stage.run(*parents, **stage.given(scene, run.leg))
            arrays = {name: canonical(array) for name, array in named(made).items()}
            self.runs += 1
            if shared and self._store is not None:
                meta = {"stage": stage.name, "version": stage.version, "versions": versions()}
                content = pack(arrays, {**meta, "id": run.id})
                self._store.keep({run.id: ("product", content)})
        self._made[run.id] = arrays
        product = build(stage.returns, arrays)
        if shared:
            self._built[run.id] = product
        return product


def fit_network(
    study: Study,
    request: FitRequest,
    test: MeasuredTest,
    results: Path,
    tell: Callable[[str], None],
) -> tuple[np.ndarray, np.ndarray, tuple[tuple[float, float], ...], Fit]:
    """Fit parameters of a scene to a measured test: times, pressures, rates and what was found.

    The search begins at the study's own values. Raises ResultsError, StoreError, LockedError.

    Parameters
    ----------
    study : the study, read and checked
    request : what is fitted
    test : the measured test
    results : folder of results
    tell : hears how far it is
    """
    root = Path(results)
    store = Store.open(root / "store", create=True)
    with FolderLock(root, f"demflow fit {study.name}"):
        trials = Trials(study, request, test, store)
        free = [Free(one.name, one.low, one.high) for one in request.free]
        start = _start(study, request)
        moved = {one.name: one.value(0.9 * one.place(start[one.name]) + 0.05) for one in free}
        try:
            trials.share(start, moved)
            first = trials.well_pressure(start)
        except SceneError as error:
            raise ResultsError(f"the scene cannot be fitted: {error}") from None
        except ValueError as error:
            raise ResultsError(f"the scene has no result at its own values: {error}") from None
        misfit = float(np.sqrt(np.mean((first - trials.pressure) ** 2)))
        tell(f"{len(trials.time)} points; the scene as it is misses them by {misfit:.4g} Pa")
        found = fit(
            trials.well_pressure,
            trials.pressure,
            free,
            start=start,
            level=LEVEL,
            profile=bool(request.profile),
            step=STEP,
        )
    tell(f"{found.evaluations} trials, {trials.runs} stage runs computed")
    rates = test.rate_changes or _own_rates(trials, start)
    return trials.time, trials.pressure, rates, found


def _own_rates(trials: Trials, start: Mapping[str, float]) -> tuple[tuple[float, float], ...]:
    scene = trials.scene(start)
    return next(well.rate_changes for well in scene.wells if well.name == trials._well)


def _start(study: Study, request: FitRequest) -> dict[str, float]:
    """The study's own values, moved between the bounds where they lie outside."""
    start = {}
    for one in request.free:
        value: Any = study.values
        for part in one.name.split("."):
            value = value.get(part) if isinstance(value, Mapping) else None
        middle = Free(one.name, one.low, one.high).value(0.5)
        inside = isinstance(value, float | int) and one.low <= value <= one.high
        start[one.name] = float(value) if inside else middle
    return start


def _measured_well(study: Study, test: MeasuredTest) -> str:
    wells = tuple(study.values.get("wells") or {})
    if test.well is not None:
        return test.well
    if len(wells) != 1:
        few = "no well" if not wells else f"wells {', '.join(wells)}"
        raise ResultsError(f"the scene has {few}; say which was measured: data.{test.name}.well")
    found: str = wells[0]
    return found
