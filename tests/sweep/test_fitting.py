"""Least squares and its intervals; reservoir models in SI; `demflow fit` from a file."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from demflow.model.analytic.fractures import finite_conductivity_transform
from demflow.model.analytic.laplace import invert
from demflow.model.analytic.radial import line_source
from demflow.sweep.analysis.fitting import Free, choice, fit, told_pairs
from demflow.sweep.analysis.reservoirs import MODELS, Superposed, unit_response
from demflow.sweep.command.cli import main
from demflow.sweep.fitting.fitted import fit_study
from demflow.sweep.study.reservoir import PARAMETERS, Rock, parameters_of

ROCK = Rock(porosity=0.2, viscosity=1e-3, compressibility=1e-9, well_radius=0.1, thickness=10.0)
VALUES = {
    "permeability": 5e-14,
    "initial_pressure": 3e7,
    "skin_factor": 2.0,
    "wellbore_storage": 1e-8,
    "drift": 0.0,
    "distance": 60.0,
    "ratio": 2.5,
    "width": 120.0,
    "offset": 0.3,
    "radius": 200.0,
    "area": 9e4,
    "aspect": 2.0,
    "offset_along": 0.4,
    "offset_across": 0.3,
    "half_length": 30.0,
    "fracture_conductivity": 5e-12,
    "storativity_ratio": 0.1,
    "interporosity_flow": 1e-6,
}
TIMES = np.geomspace(1.0, 1e6, 80)
RATES = ((0.0, 1e-3),)


def straight(x, noise, seed):
    return 2.0 + 0.5 * x + np.random.default_rng(seed).normal(0, noise, len(x))


@pytest.mark.parametrize("profile", [False, True])
def test_a_straight_line_has_the_intervals_of_the_textbook(profile):
    x = np.linspace(0.0, 10.0, 30)
    y = straight(x, 0.3, 1)
    free = [Free("slope", -5.0, 5.0), Free("level", -20.0, 20.0)]
    found = fit(lambda v: v["level"] + v["slope"] * x, y, free, profile=profile, level="level")
    known = stats.linregress(x, y)
    half = stats.t.ppf(0.975, 28) * known.stderr
    slope = found["slope"]
    assert slope.value == pytest.approx(known.slope, rel=1e-6)
    assert slope.low == pytest.approx(known.slope - half, rel=0.02)
    assert slope.high == pytest.approx(known.slope + half, rel=0.02)
    expected = -x.mean() / math.sqrt(np.mean(x**2))
    assert found.correlation[0, 1] == pytest.approx(expected, abs=1e-4)
    assert slope.method == ("profile" if profile else "jacobian")


@pytest.mark.parametrize("profile", [False, True, None])
def test_data_without_any_noise_are_fitted_to_round_off(profile):
    x = np.linspace(0.0, 10.0, 30)
    free = [Free("slope", -5.0, 5.0), Free("level", 1e-3, 1e3)]
    found = fit(lambda v: v["level"] + v["slope"] * x, 2.0 + 0.5 * x, free, profile=profile)
    for name, true in {"slope": 0.5, "level": 2.0}.items():
        one = found[name]
        assert one.determined
        assert one.low <= one.value <= one.high
        assert one.low == pytest.approx(true, rel=1e-6)
        assert one.high == pytest.approx(true, rel=1e-6)


def test_what_the_data_do_not_hold_is_said():
    x = np.linspace(0.0, 1.0, 40)
    y = straight(x, 0.05, 2)
    free = [Free("slope", -5.0, 5.0), Free("level", -20.0, 20.0), Free("idle", 0.1, 100.0)]
    found = fit(lambda v: v["level"] + v["slope"] * x + 0.0 * v["idle"], y, free)
    assert found["slope"].determined
    assert not found["idle"].determined
    assert (found["idle"].low, found["idle"].high) == pytest.approx((0.1, 100.0))
    together = [Free("a", -5.0, 5.0), Free("b", -5.0, 5.0)]
    found = fit(lambda v: (v["a"] + v["b"]) * x + 2.0, y, together)
    assert not found["a"].determined
    assert not found["b"].determined
    assert "a and b go together" in told_pairs(found)[0]


def test_a_bound_from_one_side_is_said_to_be_one():
    """A fault that is not felt may lie anywhere beyond."""
    well = Superposed(TIMES, RATES)
    model = MODELS["fault"]
    truth = {**VALUES, "distance": 5e3}
    data = well.pressure(model, ROCK, truth)
    data = data + np.random.default_rng(3).normal(0, 2e3, len(data))
    free = [Free("permeability", 1e-15, 1e-12), Free("distance", 5.0, 2e4)]
    known = {key: truth[key] for key in parameters_of("fault")}
    found = fit(lambda v: well.pressure(model, ROCK, {**known, **v}), data, free)
    assert found["permeability"].determined
    far = found["distance"]
    assert not far.determined
    assert "upper side open" in far.why
    assert 100.0 < far.low < 5e3
    assert far.high == pytest.approx(2e4)


def test_residuals_that_hang_together_widen_the_intervals():
    x = np.linspace(0.0, 10.0, 200)
    rng = np.random.default_rng(4)
    walk = np.zeros(200)
    for k in range(1, 200):
        walk[k] = 0.9 * walk[k - 1] + rng.normal(0, 0.1)
    free = [Free("slope", -5.0, 5.0), Free("level", -20.0, 20.0)]
    found = fit(lambda v: v["level"] + v["slope"] * x, 2.0 + 0.5 * x + walk, free, level="level")
    assert 0.7 < found.persistence < 0.95
    assert found.effective < 40
    assert found["slope"].low < 0.5 < found["slope"].high
    white = fit(lambda v: v["level"] + v["slope"] * x, straight(x, 0.3, 5), free, level="level")
    assert white.persistence == 0.0
    assert white.effective == 200


def test_what_cannot_be_fitted_is_refused():
    with pytest.raises(ValueError, match="2 data cannot determine 2 parameters"):
        fit(lambda v: np.zeros(2), np.zeros(2), [Free("a", 0, 1), Free("b", 0, 1)])
    with pytest.raises(ValueError, match="bounds of a are not in order"):
        fit(lambda v: np.zeros(9), np.zeros(9), [Free("a", 1, 0)])
    with pytest.raises(ValueError, match="nothing is left to fit"):
        fit(lambda v: np.zeros(9), np.zeros(9), [])


@pytest.mark.slow
def test_the_likeliest_model_is_named_and_no_more():
    well = Superposed(TIMES, RATES)
    truth = {**VALUES, "distance": 40.0}
    data = well.pressure(MODELS["fault"], ROCK, truth)
    data = data + np.random.default_rng(6).normal(0, 5e3, len(data))
    free = [Free("permeability", 1e-15, 1e-12), Free("skin_factor", -4.0, 20.0)]
    free += [Free("initial_pressure", 2e7, 4e7), Free("wellbore_storage", 1e-10, 1e-6)]
    more = {"homogeneous": [], "fault": [Free("distance", 5.0, 1e3)]}
    found = {
        name: fit(
            lambda v, name=name: well.pressure(
                MODELS[name], ROCK, {**{k: VALUES[k] for k in parameters_of(name)}, **v}
            ),
            data,
            free + own,
            level="initial_pressure",
        )
        for name, own in more.items()
    }
    assert choice(found).startswith("the data speak plainly for fault before homogeneous")
    assert "no model that was not tried is excluded" in choice(found)
    assert found["fault"]["distance"].low < 40.0 < found["fault"]["distance"].high


@pytest.mark.parametrize("name", MODELS)
def test_every_model_begins_with_storage_and_falls_on_and_on(name):
    """t / C while the well empties, whatever the reservoir; the fall never shrinks."""
    values = {key: VALUES[key] for key in parameters_of(name)}
    early = np.geomspace(1e-5, 1e-3, 5)
    response = unit_response(MODELS[name], ROCK, values, early)
    np.testing.assert_allclose(response, early / VALUES["wellbore_storage"], rtol=0.02)
    response = unit_response(MODELS[name], ROCK, values, np.geomspace(1e-2, 1e7, 60))
    assert np.all(np.diff(response) > -1e-6 * response[1:])
    assert np.all(response > 0)


def test_homogeneous_is_theis_with_skin_in_si():
    values = {**VALUES, "wellbore_storage": 0.0}
    t = np.geomspace(2e3, 1e6, 6)
    scale = ROCK.viscosity / (2 * math.pi * VALUES["permeability"] * ROCK.thickness)
    t_D = VALUES["permeability"] * t / (0.2 * 1e-3 * 1e-9 * 0.01)
    for skin, radius in ((2.0, 1.0), (-2.0, math.exp(2.0))):
        expected = scale * (line_source(radius, t_D) + max(skin, 0.0))
        found = unit_response(MODELS["homogeneous"], ROCK, {**values, "skin_factor": skin}, t)
        np.testing.assert_allclose(found, expected, rtol=1e-3)


def test_rates_superpose():
    rates = ((0.0, 1e-3), (1e4, 3e-3), (5e4, 0.0))
    times = np.concatenate([np.geomspace(1.0, 1e4, 30), 1e4 + np.geomspace(1, 9e4, 60)])
    model, values = MODELS["homogeneous"], VALUES
    found = Superposed(times, rates).pressure(model, ROCK, values)
    expected, before = np.full_like(times, 3e7), 0.0
    for start, rate in rates:
        acts = times > start
        response = unit_response(model, ROCK, values, times[acts] - start)
        expected[acts] -= (rate - before) * response
        before = rate
    np.testing.assert_allclose(found, expected, atol=5e-6 * np.ptp(expected))
    surface = Rock(**{**ROCK.__dict__, "volume_factor": 1.3})
    reservoir = tuple((start, 1.3 * rate) for start, rate in rates)
    np.testing.assert_allclose(
        Superposed(times, rates).pressure(model, surface, values),
        Superposed(times, reservoir).pressure(model, ROCK, values),
    )


def test_no_flow_is_nothing_to_fit():
    with pytest.raises(ValueError, match="nothing flows"):
        Superposed(TIMES, ((0.0, 0.0),))
    assert {known.unit for known in PARAMETERS.values()} >= {"m2", "Pa", "m3/Pa", "m"}


STUDY = """study: fitted
title: A made test
data:
  test: {file: gauge.csv, rates: [[0 s, 1e-3 m3/s], [2e5 s, 0 m3/s]]}
fit:
  to: data.test
  models: [homogeneous, fault]
  reservoir:
    {porosity: 0.2, viscosity: 1 cP, compressibility: 1e-9 1/Pa, well_radius: 0.1 m,
     thickness: 10 m}
  parameters:
    permeability: [1 mD, 1000 mD]
    skin_factor: [-4, 20]
    wellbore_storage: [1e-10 m3/Pa, 1e-6 m3/Pa]
    initial_pressure: [20 MPa, 40 MPa]
    distance: [5 m, 1000 m]
"""


@pytest.mark.slow
def test_the_command_fits_a_file(tmp_path, capsys):
    rates = ((0.0, 1e-3), (2e5, 0.0))
    times = np.concatenate([np.geomspace(1.0, 2e5, 60), 2e5 + np.geomspace(1.0, 5e5, 60)])
    truth = {**VALUES, "distance": 80.0}
    pressure = Superposed(times, rates).pressure(MODELS["fault"], ROCK, truth)
    pressure = pressure + np.random.default_rng(7).normal(0, 3e3, len(times))
    rows = (f"{t},{p / 1e6}" for t, p in zip(times.tolist(), pressure.tolist(), strict=True))
    (tmp_path / "gauge.csv").write_text("\n".join(["t [s],p [MPa]", *rows]))
    path = tmp_path / "study.yaml"
    path.write_text(STUDY)
    assert main(["fit", str(path), "--results", str(tmp_path / "results"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    best = next(iter(told["models"].values()))["parameters"]
    assert next(iter(told["models"])) == "fault"
    for name in ("permeability", "skin_factor", "wellbore_storage", "distance"):
        half = 0.5 * (best[name]["high"] - best[name]["low"])  # one interval in twenty misses
        assert abs(best[name]["value"] - truth[name]) < 2.0 * half < 0.2 * truth[name]
        assert best[name]["determined"]
    assert "plainly for fault" in told["choice"]
    shown = {one["name"]: one for one in told["regimes"]["found"]}
    assert told["regimes"]["since"] in (0.0, 2e5)
    plateau = 1e-3 * ROCK.viscosity / (4.0 * math.pi * truth["permeability"] * ROCK.thickness)
    assert shown["radial"]["level"] == pytest.approx(plateau, rel=0.1)
    assert 0.0 < shown["radial"]["confidence"] < 1.0
    made = tmp_path / "results" / "fitted" / "fit"
    assert json.loads((made / "fit.json").read_text()) == told
    assert (made / "fit.png").read_bytes()[:4] == b"\x89PNG"
    assert main(["check", str(path)]) == 0
    assert "data.test: 120 points" in capsys.readouterr().out
    assert main(["run", str(path), "--results", str(tmp_path / "results")]) == 2


@pytest.mark.slow
def test_without_rates_the_changes_that_the_pressure_shows_are_told(tmp_path, capsys):
    rates = ((0.0, 1e-3), (2e5, 0.0))
    times = np.linspace(100.0, 4e5, 300)
    pressure = Superposed(times, rates).pressure(MODELS["homogeneous"], ROCK, VALUES)
    rows = (f"{t},{p / 1e6}" for t, p in zip(times.tolist(), pressure.tolist(), strict=True))
    (tmp_path / "gauge.csv").write_text("\n".join(["t [s],p [MPa]", *rows]))
    path = tmp_path / "study.yaml"
    path.write_text(STUDY.replace(", rates: [[0 s, 1e-3 m3/s], [2e5 s, 0 m3/s]]", ""))
    assert main(["fit", str(path), "--results", str(tmp_path / "results")]) == 2
    said = capsys.readouterr().err
    assert "changes that the pressure shows" in said
    assert "e+05 s (1.000)" in said
    assert "has no rates" in said
    alone = STUDY.replace("[homogeneous, fault]", "[homogeneous]")
    alone = alone.replace("    distance: [5 m, 1000 m]\n", "")
    path.write_text(alone.replace("[2e5 s", "[1.7e5 s"))
    assert main(["fit", str(path), "--results", str(tmp_path / "results"), "--no-figure"]) == 0
    assert "later than the rates change: two clocks?" in capsys.readouterr().err


@pytest.mark.slow
def test_intervals_hold_every_way_in_which_a_model_fits():
    """A fault at the well halves what the flow sees, as does half the permeability far from one."""
    model = MODELS["fault"]
    times = np.geomspace(10.0, 1e5, 40)
    well = Superposed(times, ((0.0, 1e-3),))
    known = {"initial_pressure": 3e7, "drift": 0.0}
    truth = {"permeability": 3e-14, "skin_factor": 3.0, "wellbore_storage": 1e-8, "distance": 400.0}
    exact = well.pressure(model, ROCK, {**known, **truth})
    scatter = 0.01 * (3e7 - exact)
    data = exact + np.random.default_rng(3).normal(0.0, scatter)
    free = [
        Free("permeability", 1e-16, 1e-11),
        Free("skin_factor", -5.0, 30.0),
        Free("wellbore_storage", 1e-11, 1e-5),
        Free("distance", 1.0, 3e3),
    ]
    found = fit(
        lambda v: well.pressure(model, ROCK, {**known, **v}), data, free, weight=1.0 / scatter
    )
    for name, value in truth.items():
        assert found[name].low <= value <= found[name].high
    assert found["permeability"].low < 1.1 * truth["permeability"]
    assert found["permeability"].high > 1.9 * truth["permeability"]
    assert not found["permeability"].determined
    assert "as well" in found["permeability"].why
    assert found["permeability"].low <= found["permeability"].another <= found["permeability"].high
    assert abs(found["permeability"].another / found["permeability"].value - 1.0) > 0.1


@pytest.mark.slow
def test_the_shipped_record_gives_back_what_it_was_made_of(tmp_path):
    fitted = fit_study(Path(__file__).parents[2] / "studies" / "fit_build_up.yaml", tmp_path)
    assert next(iter(fitted.fits)) == "homogeneous"
    best = fitted.best
    for name, made in (
        ("permeability", 50 * 9.869233e-16),
        ("skin_factor", 2.0),
        ("wellbore_storage", 1e-9),
        ("initial_pressure", 2e7),
    ):
        assert best[name].determined
        assert best[name].low <= made <= best[name].high
    assert fitted.figure is not None


@pytest.mark.parametrize("F_CD", [3e-3, 0.7, 41.0, 6e5])
def test_a_tabled_fracture_responds_as_its_solution(F_CD):
    k, x_f = VALUES["permeability"], VALUES["half_length"]
    told = {"fracture_conductivity": F_CD * k * x_f, "wellbore_storage": 0.0, "skin_factor": 0.0}
    t_Dxf = np.geomspace(3e-7, 2e4, 9)
    times = t_Dxf * x_f**2 * ROCK.porosity * ROCK.viscosity * ROCK.compressibility / k
    model = MODELS["finite_conductivity_fracture"]
    found = unit_response(model, ROCK, {**VALUES, **told}, times)
    p_D = found * 2.0 * math.pi * k * ROCK.thickness / ROCK.viscosity
    exact = invert(finite_conductivity_transform(F_CD), t_Dxf, 12)
    np.testing.assert_allclose(p_D, exact, rtol=3e-5)
