"""Two well tests measured and fitted by others, each from its files by one command."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import NamedTuple

from demflow.sweep.command.cli import main
from demflow.sweep.study.units import parse_quantity
from tests.benchmarks.outside_data import outside
from tests.benchmarks.result import Result


class Published(NamedTuple):
    """A value, the half width of its interval (0: none is given), and their unit."""

    value: float
    half: float
    unit: str
    si: str


class Test(NamedTuple):
    """A test: the study that fits it, and what others found."""

    files: tuple[str, ...]
    study: str
    published: dict[str, Published]


TESTS = {
    "Bourdet et al. 1983, no. 1": Test(
        ("bourdet_1983_1_pressure.csv", "bourdet_1983_1_rate.csv"),
        """
study: build_up_1983
data:
  test: {file: bourdet_1983_1_pressure.csv, rates: bourdet_1983_1_rate.csv}
fit:
  to: data.test
  model: homogeneous
  reservoir:
    {porosity: 0.25, viscosity: 2.5 cP, compressibility: 5.974e-5 cm2/kgf, thickness: 32.6136 m,
     well_radius: 0.088392 m, volume_factor: 1.06}
  parameters:
    permeability: [0.1 mD, 1000 mD]
    skin_factor: [-5, 50]
    wellbore_storage: [1e-5 m3 cm2/kgf, 1 m3 cm2/kgf]
    initial_pressure: [200 kgf/cm2, 350 kgf/cm2]
""",
        {
            "permeability": Published(11.70, 0.14, "mD", "m2"),
            "skin_factor": Published(8.78, 0.16, "", "1"),
            "wellbore_storage": Published(0.02058, 0.0, "m3 cm2/kgf", "m3/Pa"),
            "initial_pressure": Published(272.578, 0.0, "kgf/cm2", "Pa"),
        },
    ),
    "Samad 1994, no. 7": Test(
        ("samad_1994_7_pressure.csv", "samad_1994_7_rate.csv"),
        """
study: drawdown_1994
data:
  test: {file: samad_1994_7_pressure.csv, rates: samad_1994_7_rate.csv}
fit:
  to: data.test
  model: infinite_conductivity_fracture
  reservoir:
    {porosity: 0.11, viscosity: 0.92 cP, compressibility: 7.70e-6 1/psi, thickness: 103 ft,
     well_radius: 0.3 ft, volume_factor: 1.00}
  parameters:
    initial_pressure: 3119.41 psi
    permeability: [0.1 mD, 1000 mD]
    half_length: [30 ft, 3000 ft]
    wellbore_storage: [1e-4 bbl/psi, 10 bbl/psi]
""",
        {
            "permeability": Published(12.90, 0.04, "mD", "m2"),
            "half_length": Published(355.1, 1.4, "ft", "m"),
        },
    ),
}


def run() -> Result:
    """Every published value against the command's."""
    lines, good, worst = [], True, 0.0
    for name, test in TESTS.items():
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place)
            for file in test.files:
                (folder / file).write_bytes(outside(f"welltests/{file}").read_bytes())
            study = folder / "study.yaml"
            study.write_text(test.study)
            status = main(["fit", str(study), "--results", str(folder / "results")])
            made = next((folder / "results").glob("*/fit/fit.json"))
            (found,) = json.loads(made.read_text())["models"].values()
        good &= status == 0
        for key, known in test.published.items():
            unit = parse_quantity(f"1 {known.unit}".strip(), known.si)
            value = found["parameters"][key]["value"] / unit
            off = value / known.value - 1.0
            inside = abs(value - known.value) <= known.half
            good &= inside or abs(off) <= 0.02
            worst = max(worst, abs(off))
            told = f"± {known.half:g} " if known.half else ""
            lines.append(
                f"{name}: {key} {value:.5g} {known.unit}, published {known.value:g} {told}"
                f"({off:+.2%}{', inside' if inside else ''})"
            )
    return Result(
        f"off by {worst:.2%} at most from what was published",
        "inside the published interval or ≤ 2 %",
        good,
        "\n".join(lines),
    )
