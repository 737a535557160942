"""Three parameters of a network of 5,000 grains fitted to a made test, with and without sharing.

The fit without stored stages makes every stage anew in each trial; as many trials of it as the fit
needed are reckoned from some, or with WHOLE=1 that fit is really made (some 100 times 8 s).
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from demflow.model.stages import simulate
from demflow.sweep.analysis.fitting import Free, fit
from demflow.sweep.fitting.fitted import Fitted, fit_study
from demflow.sweep.fitting.network import LEVEL, STEP, Trials, _start
from demflow.sweep.study.load import load_study
from tests.benchmarks.result import Result

STUDY = """study: network
scene:
  region: {shape: circle, radius: 50 m}
  grains: {count: 5000, radius_ratio: 1.66, porosity: 0.16, seed: 1, modulus: 20 GPa,
           density: 2650 kg/m3}
  matrix: {permeability: 3 mD}
  fluid: {viscosity: 1 cP, bulk_modulus: 1 GPa}
  wells: {p: {at: [0 m, 0 m], radius: 0.1 m, rate: 1e-6 m3/s, wellbore_storage: 1e-9 m3/Pa}}
  boundaries: {outer: 7 MPa}
  initial_pressure: 7 MPa
  times: {first: 1 s, last: 1e6 s, per_decade: 10}
observe: [well_pressure]
data:
  test: {file: gauge.csv, rates: [[0 s, 1e-6 m3/s]]}
fit:
  to: data.test
  parameters:
    matrix.permeability: [0.5 mD, 50 mD]
    wells.p.skin_factor: [-2, 20]
    wells.p.wellbore_storage: [1e-11 m3/Pa, 1e-7 m3/Pa]
"""
TRUTH = {
    "matrix.permeability": 7e-15,
    "wells.p.skin_factor": 2.5,
    "wells.p.wellbore_storage": 2e-10,
}
ALONE = 5  # trials without sharing, of which the mean is taken
WHOLE = os.environ.get("WHOLE") == "1"  # whether the fit without sharing is really made
TIMES = np.geomspace(1.0, 1e6, 61)


def made(folder: Path) -> Path:
    """A study and what a gauge would have measured in its network at other values."""
    path = folder / "study.yaml"
    path.write_text(STUDY)

    def write(pressure: np.ndarray) -> None:
        rows = (f"{t!r},{p!r}" for t, p in zip(TIMES.tolist(), pressure.tolist(), strict=True))
        (folder / "gauge.csv").write_text("\n".join(["t [s],p [Pa]", *rows]))

    write(np.full(len(TIMES), 7e6))
    study = load_study(path)
    assert study.fit is not None
    trials = Trials(study, study.fit, study.data["test"], None)
    pressure = simulate(trials.scene(TRUTH))["well_pressure"][0]  # compiles, too
    noise = 0.002 * np.ptp(pressure)
    write(pressure + np.random.default_rng(0).normal(0.0, noise, len(TIMES)))
    return path


def timed(act: Callable[[], Fitted]) -> tuple[Fitted, float, float]:
    """What a fit gives, its time and its processor time, s."""
    wall, cpu = time.perf_counter(), time.process_time()
    found = act()
    return found, time.perf_counter() - wall, time.process_time() - cpu


def run() -> Result:
    """Time of a fit from nothing stored, and of as many trials that make every stage anew."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        path = made(folder)
        found, wall, cpu = timed(lambda: fit_study(path, folder / "shared"))
        study = load_study(path)
        assert study.fit is not None
        alone = Trials(study, study.fit, study.data["test"], None)  # shares nothing
        cpu_each = time.process_time()
        if WHOLE:
            own = study.fit.free
            bounds = [Free(one.name, one.low, one.high) for one in own]
            start = _start(study, study.fit)
            trial, data = alone.well_pressure, alone.pressure
            again = fit(trial, data, bounds, start=start, level=LEVEL, profile=False, step=STEP)
            trials = again.evaluations
        else:
            for k in range(ALONE):
                alone.well_pressure({**TRUTH, "matrix.permeability": (3.0 + k) * 1e-15})
            trials = ALONE
        cpu_each = (time.process_time() - cpu_each) / trials
    cpu_alone = cpu_each * (trials if WHOLE else found.best.evaluations)
    off = max(
        abs(found.best[name].value - truth) / (found.best[name].high - found.best[name].low)
        for name, truth in TRUTH.items()
    )
    ratio = cpu / cpu_alone
    lines = [
        f"{found.best.evaluations} trials; {wall:.1f} s, of the processor {cpu:.1f} s (loaded)",
        f"every stage anew: {cpu_each:.2f} s of the processor a trial (mean of {trials}), "
        f"{cpu_alone:.0f} s for {'the fit' if WHOLE else 'as many'}",
        f"true values at most {off:.2f} widths of the interval off",
    ]
    return Result(
        f"{wall:.0f} s, {ratio:.3f} of the same fit without stored stages",
        "< 60 s, ≤ 0.1, true values inside",
        bool(wall < 60.0 and ratio <= 0.1 and off < 1.0),
        "\n".join(lines),
    )
