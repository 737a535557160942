"""Studies that run on the table of `toy_stages`, and the command line on that table."""

from __future__ import annotations

import functools
import os
import sys
from pathlib import Path
from typing import Any

from demflow.sweep import engine
from demflow.sweep import prepared as preparing
from demflow.sweep.command import cli, upkeep

TABLE = "tests.sweep.toy_stages:STAGES"
OTHER_TABLE = "DEMFLOW_TOY_TABLE"  # of the environment: the table of a run in a process of its own

TEXT = """
study: {name}
title: Toy
scene:
  region: {{shape: rectangle, width: 14 m, height: 14 m}}
  grains: {{count: 50, porosity: 0.17, seed: 1, modulus: 20 GPa}}
  stress: {{xx: 20 MPa, yy: 10 MPa}}
  matrix: {{permeability: 1 mD}}
  fluid: {{viscosity: {seconds} Pa s, bulk_modulus: 1 GPa}}
  wells: {{producer: {{at: [0 m, 0 m], radius: 1 m, rate: 1 m3/s}}}}
  boundaries: {{left: 7 MPa}}
  initial_pressure: 7 MPa
  times: [1 s, 10 s, 100 s]
{vary}
observe: [well_pressure]
{limits}
"""


def write_study(
    folder: Path,
    *,
    name: str = "toy",
    seeds: tuple[int, ...] = (1, 2),
    stresses: tuple[float, ...] = (5e6, 10e6),
    rates: tuple[float, ...] = (1.0, 2.0, 3.0),
    seconds: float = 1e-6,
    limits: str = "",
) -> Path:
    """Write a study over seeds, stresses and rates; `seconds` is what each flow takes."""
    axes = {"seed": ("grains.seed", seeds), "stress_yy": ("stress.yy", stresses)}
    axes["rate"] = ("wells.producer.rate", rates)
    lines = [
        f"  {axis}: {{parameter: {path}, values: {list(values)}}}"
        for axis, (path, values) in axes.items()
        if values
    ]
    vary = "\n".join(["vary:", *lines]) if lines else ""
    path = folder / f"{name}.yaml"
    path.write_text(
        TEXT.format(name=name, seconds=seconds, vary=vary, limits=limits and f"limits: {limits}")
    )
    return path


def run(path: Path, results: Path, *, workers: int = 1, **options: Any) -> engine.Finished:
    """Run a study on the toy stages, without figures; one worker is the soonest to start."""
    options |= {"figures": False, "table": TABLE}
    return engine.run_study(path, results=results, workers=workers, **options)


def prepared(path: Path, results: Path) -> preparing.Project:
    """A study on the toy stages, its plan and its store."""
    return _prepare(path, results, table=TABLE)


def demflow(*arguments: str, table: str = TABLE) -> int:
    """The command line, on the toy stages and without figures."""
    engine.run_study = functools.partial(_run_study, table=table, figures=False)
    engine.collect_study = functools.partial(_collect_study, table=table)
    preparing.prepare = functools.partial(_prepare, table=table)
    upkeep.unwanted = functools.partial(_unwanted, table=table)
    try:
        return cli.main(arguments)
    finally:
        engine.run_study, preparing.prepare = _run_study, _prepare
        engine.collect_study = _collect_study
        upkeep.unwanted = _unwanted


_run_study, _prepare = engine.run_study, preparing.prepare
_unwanted, _collect_study = upkeep.unwanted, engine.collect_study

if __name__ == "__main__":
    sys.exit(demflow(*sys.argv[1:], table=os.environ.get(OTHER_TABLE, TABLE)))
