"""A steady study, from the command line to its figures: no time anywhere."""

import numpy as np
import pytest

from demflow import sweep
from demflow.sweep.command.cli import main

STUDY = """
study: steady
title: A well between a fracture too short to matter and a barrier
scene:
  region: {shape: circle, radius: 14 m}
  grains: {packing: hexagonal, count: 300}
  matrix: {permeability: 5 mD}
  fluid: {viscosity: 1 cP, bulk_modulus: 2 GPa}
  fractures:
    tiny: {kind: trace, from: [3 m, 3 m], to: [3.05 m, 3 m], aperture: 100 um}
    barrier: {kind: trace, from: [-20 m, 5 m], to: [20 m, 5 m], transmissibility_multiplier: 0}
  wells: {producer: {at: [0 m, 0 m], radius: 2 m, rate: 1e-6 m3/s}}
  boundaries: {outer: 7 MPa}
  probes: {near: {at: [4 m, 0 m]}}
observe: [well_pressure, pressure_map, probe_pressure, boundary_flow]
vary: {rate: {parameter: wells.producer.rate, values: [1e-6 m3/s, 1e-4 m3/s]}}
"""


@pytest.mark.slow
@pytest.mark.usefixtures("one_worker")
def test_a_steady_study_has_values_figures_and_a_report(tmp_path, capsys):
    path = tmp_path / "steady.yaml"
    path.write_text(STUDY)
    results = tmp_path / "results"
    assert main(["run", str(path), "--workers", "1", "--results", str(results)]) == 0
    dataset = sweep.open_results(results / "steady")
    assert "elapsed_time" not in dataset.dims
    assert "pressure_change" not in dataset
    assert dataset["well_pressure"].dims == ("rate", "well")
    fall = 7e6 - dataset["well_pressure"].values[:, 0]
    np.testing.assert_allclose(fall[1] / fall[0], 100.0, rtol=1e-9)
    np.testing.assert_allclose(dataset["boundary_flow"].values[:, 0], [1e-6, 1e-4], rtol=1e-9)
    assert np.all(dataset["idle_traces"] == 1)
    maps = sweep.open_case(results / "steady", rate=1e-6)
    assert maps["pressure"].dims == ("domain",)
    assert list((results / "steady" / "figures").glob("pressure_map*.png"))
    page = (results / "steady" / "report.html").read_text(encoding="utf-8")
    # 1e-4 m³/s is more than this rock yields at 7 MPa, and the report says so
    assert ("falls below zero" in page) == bool(np.any(fall > 7e6))
