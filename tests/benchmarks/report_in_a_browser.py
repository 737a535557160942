"""Report pages of 24, 100 and 1,000 cases in Chromium: size, speed, every control, no violation."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import xarray as xr

import demflow
from tests.benchmarks.result import Result
from tests.peers.yade import PeerMissingError

PACKAGES = ("@sparticuz/chromium@147.0.0", "puppeteer-core@24.40.0", "axe-core@4.14.1")
SCREENS = [[1600, "light"], [360, "dark"], [900, "dark"]]
BOUNDS = {24: (1.5, 1000), 100: (2.0, 1000), 1000: (15.0, 3000)}  # cases -> MB, ms until it answers

SCENE = """
  region: {shape: circle, radius: 10 m}
  grains: {count: COUNT, porosity: 0.17, seed: 1}
  matrix: {permeability: 5 mD}
  fluid: {viscosity: 1 cP, bulk_modulus: 2.2 GPa}
  fractures: {natural: {kind: set, angle: 0 deg, length: 5 m, spacing: 4 m, aperture: 100 um}}
  wells: {producer: {at: [0.2 m, 0.1 m], radius: 0.1 m, rate: 1e-6 m3/s}}
  boundaries: {outer: 20 MPa}
  initial_pressure: 20 MPa
  times: {first: 1 s, last: 1e5 s, per_decade: 12}
"""
VARY = """
vary:
  angle: {parameter: fractures.natural.angle, from: 0 deg, to: 90 deg, count: ANGLES}
  aperture: {parameter: fractures.natural.aperture, from: 50 um, to: 200 um, count: APERTURES}
  rate: {parameter: wells.producer.rate, from: 1e-6 m3/s, to: 1e-5 m3/s, count: RATES}
observe: [well_pressure, permeability, pressure_map]
"""
HOSTILE = '<img src=x onerror=alert(1)></script><script>alert(2)</script> $x$ & "quotes"'

NOTES = f"# {HOSTILE}\n\n[x](javascript:alert(3)) ![x](https://example.com/x.png)\n"


def study_text(name: str, count: int, sizes: tuple[int, int, int], title: str = "Cases") -> str:
    vary = VARY
    for word, size in zip(("ANGLES", "APERTURES", "RATES"), sizes, strict=True):
        vary = vary.replace(word, str(size))
    scene = SCENE.replace("COUNT", str(count))
    return f"study: {name}\ntitle: {json.dumps(title)}\nscene:{scene}{vary}"


STUDIES = {  # name -> study; its cases
    "cases-24": study_text("cases-24", 2500, (3, 2, 4)),
    "cases-100": study_text("cases-100", 600, (5, 4, 5)),
    "cases-1000": study_text("cases-1000", 300, (10, 5, 20)),
    "one-case": f"study: one-case\nscene:{SCENE.replace('COUNT', '300')}observe: [well_pressure]\n",
    "half-failed": study_text("half-failed", 300, (2, 2, 2)).replace(
        "parameter: wells.producer.rate, from: 1e-6 m3/s, to: 1e-5 m3/s, count: 2",
        "parameters: [solver.method, solver.safety_factor], "
        "values: [[krylov, 0.9], [explicit, 2.4]]",
    ),
    "all-failed": study_text("all-failed", 300, (2, 2, 2))
    + "solver: {method: explicit, safety_factor: 2.4}\n",
    "hostile": study_text("hostile", 300, (2, 1, 1), HOSTILE) + "report: {notes: notes.md}\n",
}


def _browser(folder: Path) -> Path:
    """A folder with Chromium, what drives it, and the script."""
    npm = shutil.which("npm")
    if npm is None:
        raise PeerMissingError("npm is not installed; it brings Chromium and what drives it")
    subprocess.run([npm, "init", "-y"], cwd=folder, check=True, capture_output=True)
    subprocess.run([npm, "install", *PACKAGES], cwd=folder, check=True, capture_output=True)
    script = folder / "drive_report.mjs"
    script.write_text(Path(__file__).with_name("drive_report.mjs").read_text())
    return script


def _reads(dataset: xr.Dataset) -> dict[str, list[str]]:
    """What the page must read out at the last time of the last case: change and derivative."""
    if int(dataset["status"].values.flat[-1]):
        return {}
    last = dataset.isel(dict.fromkeys(dataset["status"].dims, -1) | {"well": 0, "elapsed_time": -1})
    change, derivative = float(last["pressure_change"]), float(last["pressure_derivative"])
    scale = 1e-6 if np.nanmedian(np.abs(dataset["pressure_change"].values)) >= 1e6 else 1e-3
    shown = [_as_shown(change * scale)]
    if derivative > 0:
        shown.append(_as_shown(derivative * scale))
    return {"#read": shown}


def _as_shown(value: float) -> str:
    """Six digits, as the page writes them."""
    if 1e-3 <= abs(value) < 1e7:
        return f"{float(f'{value:.6g}'):g}"
    mantissa, exponent = f"{value:.5e}".split("e")
    return f"{mantissa}e{int(exponent):+d}"


def run() -> Result:
    """Make the pages, drive them, and hold each to its bounds."""
    lines, wrong = [], 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        script = _browser(folder)
        (folder / "notes.md").write_text(NOTES)
        jobs, counts = [], {}
        for study, text in STUDIES.items():
            path = folder / f"{study}.yaml"
            path.write_text(text)
            dataset = demflow.run(path, results=folder / "results")
            page = folder / "results" / study / "report.html"
            counts[str(page)] = dataset["status"].size
            good = bool(np.any(dataset["status"].values == 0))
            jobs.append({"name": study, "page": str(page), "screens": SCREENS, "cases": good,
                         "reads": _reads(dataset) if good else {}})  # fmt: skip
        (folder / "jobs.json").write_text(json.dumps(jobs))
        pictures = os.environ.get("PICTURES", "")
        told = subprocess.run(
            ["node", script, "jobs.json", pictures], cwd=folder, capture_output=True, text=True
        )
        if told.returncode:
            return Result("the browser stopped", "to run", False, told.stderr)
        for one in json.loads(told.stdout):
            page = Path(one["page"])
            megabytes = page.stat().st_size / 1e6
            most, longest = BOUNDS.get(counts[str(page)], (1.5, 1000))
            faults = [*one["errors"], *one["requests"], *one["axe"], *one["wrong"]]
            faults += [f"{one['overflow']} px wider than the screen"] if one["overflow"] > 0 else []
            faults += [f"{megabytes:.2f} MB > {most}"] if megabytes > most else []
            late = one["milliseconds"] > longest
            faults += [f"{one['milliseconds']} ms > {longest}"] if late else []
            wrong += bool(faults)
            lines.append(
                f"{page.parent.name}, {one['width']} px, {one['scheme']}: {megabytes:.2f} MB, "
                f"{one['milliseconds']} ms" + "".join(f"\n    {fault}" for fault in faults)
            )
    total = len(lines)
    return Result(f"{total - wrong} of {total} screens", f"{total}", not wrong, "\n".join(lines))
