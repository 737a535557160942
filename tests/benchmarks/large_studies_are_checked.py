"""Studies of 10,000 wells and of 20,000 corners are checked in less than 2 s of processor time.

Ten times fewer take a tenth, or about that: neither check grows with the square of the number.
"""

from __future__ import annotations

import contextlib
import io
import tempfile
import time
from pathlib import Path

import numpy as np

from demflow.sweep.command import cli
from tests.benchmarks.result import Result

SECONDS = 2.0
TEXT = """
study: large
scene:
  region: {region}
  grains: {{count: 4000, porosity: 0.17}}
  matrix: {{permeability: 1 mD}}
  fluid: {{viscosity: 1 cP, bulk_modulus: 2 GPa}}
  wells: {{{wells}}}
  boundaries: {{outer: 7 MPa}}
observe: [well_pressure]
"""


def wells(count: int) -> str:
    """A study of so many wells in rows."""
    side = int(np.ceil(np.sqrt(count)))
    names = (
        f"w{k}: {{at: [{k % side - 0.5 * side + 0.5:.3f} m, {k // side - 0.5 * side + 0.5:.3f} m], "
        "radius: 0.1 m, rate: 1e-5 m3/s}"
        for k in range(count)
    )
    region = f"{{shape: rectangle, width: {side + 1} m, height: {side + 1} m}}"
    return TEXT.format(region=region, wells=", ".join(names))


def corners(count: int) -> str:
    """A study in a star of so many corners."""
    angle = 2.0 * np.pi * np.arange(count) / count
    radius = 40.0 + 5.0 * np.cos(9.0 * angle)
    at = (
        f"[{r * np.cos(a):.5f} m, {r * np.sin(a):.5f} m]"
        for r, a in zip(radius, angle, strict=True)
    )
    region = f"{{shape: polygon, vertices: [{', '.join(at)}]}}"
    return TEXT.format(region=region, wells="w: {at: [0 m, 0 m], radius: 0.1 m, rate: 1e-5 m3/s}")


def seconds(text: str) -> float:
    """Processor time of a check that finds nothing wrong."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "study.yaml"
        path.write_text(text)
        begin, said = time.process_time(), io.StringIO()
        with contextlib.redirect_stdout(said):
            assert cli.main(["check", str(path)]) == 0, said.getvalue()
        return time.process_time() - begin


def run() -> Result:
    """Check the large ones, and a tenth of each."""
    seconds(wells(10))
    lines, largest = [], 0.0
    for name, study, count in (("wells", wells, 10_000), ("corners", corners, 20_000)):
        few, many = seconds(study(count // 10)), seconds(study(count))
        lines.append(f"{count:,} {name}: {many:.2f} s; a tenth of them: {few:.2f} s")
        largest = max(largest, many)
    return Result(
        f"at most {largest:.2f} s", f"< {SECONDS:g} s", largest < SECONDS, "\n".join(lines)
    )
