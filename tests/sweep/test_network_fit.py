"""The network of a scene fitted to a made test; long records thinned."""

import numpy as np
import pytest

from demflow.model.stages import simulate
from demflow.model.transient import bourdet_derivative
from demflow.sweep.analysis.thinning import thinned
from demflow.sweep.errors import ResultsError
from demflow.sweep.fitting.fitted import fit_study
from demflow.sweep.fitting.network import Trials
from demflow.sweep.study.load import load_study

STUDY = """study: network
scene:
  region: {shape: circle, radius: 20 m}
  grains: {count: 300, porosity: 0.16, seed: 1, modulus: 20 GPa, density: 2650 kg/m3}
  matrix: {permeability: 3 mD}
  fluid: {viscosity: 1 cP, bulk_modulus: 1 GPa}
  wells: {p: {at: [0 m, 0 m], radius: 0.1 m, rate: 1e-6 m3/s, wellbore_storage: 1e-9 m3/Pa}}
  boundaries: {outer: 7 MPa}
  initial_pressure: 7 MPa
  times: {first: 1 s, last: 1e5 s, per_decade: 8}
observe: [well_pressure]
data:
  test: {file: gauge.csv, rates: [[0 s, 4e-6 m3/s], [1e5 s, 0 m3/s]]}
fit:
  to: data.test
  reservoir: {thickness: 4 m, volume_factor: 1.0}
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


@pytest.fixture
def study(tmp_path):
    """A study whose gauge measured the network itself at other values, with noise."""
    path = tmp_path / "study.yaml"
    path.write_text(STUDY)
    times = np.concatenate([np.geomspace(1.0, 1e5, 40), 1e5 + np.geomspace(1.0, 1e5, 40)])

    def write(pressure):
        rows = (f"{t!r},{p!r}" for t, p in zip(times.tolist(), pressure.tolist(), strict=True))
        (tmp_path / "gauge.csv").write_text("\n".join(["t [s],p [Pa]", *rows]))

    write(np.full(len(times), 7e6))
    read = load_study(path)
    scene = Trials(read, read.fit, read.data["test"], None).scene(TRUTH)
    pressure = simulate(scene)["well_pressure"][0]
    write(pressure + np.random.default_rng(1).normal(0.0, 200.0, len(times)))
    return path


def test_trials_are_scenes_with_the_measured_rates_of_one_metre(study):
    read = load_study(study)
    trials = Trials(read, read.fit, read.data["test"], None)
    scene = trials.scene(TRUTH)
    assert scene.wells[0].schedule == ((0.0, 1e-6), (1e5, 0.0))
    assert scene.wells[0].skin_factor == 2.5
    assert scene.matrix.permeability == 7e-15
    assert scene.times == tuple(trials.time)
    trials.share(TRUTH, {**TRUTH, "matrix.permeability": 2e-15})
    first = trials.well_pressure(TRUTH)
    before = trials.runs
    again = trials.well_pressure({**TRUTH, "matrix.permeability": 2e-15})
    assert 0 < trials.runs - before < before  # the packing and the network are not made anew
    assert np.ptp(again) > np.ptp(first)
    np.testing.assert_array_equal(trials.well_pressure(TRUTH), first)
    np.testing.assert_array_equal(simulate(scene)["well_pressure"][0], first)


@pytest.mark.slow
def test_the_values_of_a_made_test_are_found_again(study, tmp_path):
    said = []
    fitted = fit_study(study, tmp_path / "results", tell=said.append)
    for name, truth in TRUTH.items():
        one = fitted.best[name]
        half = 0.5 * (one.high - one.low)
        assert abs(one.value - truth) < 2.0 * half < 0.4 * truth
        assert one.determined
    assert "misses them by" in said[0]
    computed = int(said[1].split()[2])
    stored = fit_study(study, tmp_path / "results", figure=False, tell=said.append)
    assert stored.best.values == fitted.best.values
    assert int(said[3].split()[2]) < computed  # the packing lies in the store


def test_a_study_that_varies_is_refused(study):
    study.write_text(
        study.read_text().replace(
            "observe:", "vary: {k: {parameter: grains.seed, values: [1, 2]}}\nobserve:"
        )
    )
    read = load_study(study)
    with pytest.raises(ResultsError, match="varies k; a fit is of one scene"):
        Trials(read, read.fit, read.data["test"], None)


def test_thinning_keeps_pressure_derivative_and_the_ends_of_periods():
    rng = np.random.default_rng(0)
    t = np.concatenate([np.linspace(1.0, 1e4, 5000), 1e4 + np.linspace(1.0, 3e4, 15000)])
    rates = ((0.0, 1.0), (1e4, 0.0))
    fall = np.log1p(t) - np.where(t > 1e4, np.log1p(np.maximum(t - 1e4, 0.0)), 0.0)
    noisy = -fall + rng.normal(0.0, 1e-3, len(t))
    keep = thinned(t, noisy, rates, 120)
    assert len(keep) <= 120
    assert np.all(np.diff(keep) > 0)
    assert {0, 4999, 5000, len(t) - 1} <= set(keep.tolist())
    late = keep[t[keep] > 1e4 + 30.0]
    since = t[late] - 1e4
    slope = bourdet_derivative(since, noisy[late], smoothing=0.3)
    exact = since / (1.0 + since) - since / (1.0 + t[late])
    np.testing.assert_allclose(slope[2:-2], exact[2:-2], rtol=0.05, atol=0.01)
    few = thinned(t[:50], noisy[:50], rates, 120)
    np.testing.assert_array_equal(few, np.arange(50))
    assert len(thinned(t, noisy, None, 8)) <= 8
