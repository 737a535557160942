"""Regimes, fits, tensors and comparisons, on transients and fields that are known in full."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
import xarray as xr

from demflow.model.analytic.linear import linear_pressure
from demflow.model.analytic.radial import (
    finite_radius_well,
    line_source,
    radial_dimensionless_pressure,
)
from demflow.model.analytic.wells import closed_circle_pseudo_steady
from demflow.model.region import Circle, Rectangle
from demflow.model.scene import BiWing, Fluid, Grains, Matrix, Scene, Well
from demflow.model.transient import bourdet_derivative
from demflow.sweep.accessor import Results
from demflow.sweep.analysis import cases, compare
from demflow.sweep.analysis.linear_flow import compare_linear, linear_tables
from demflow.sweep.analysis.permeability import ensemble, principal_permeability
from demflow.sweep.analysis.radial_flow import compare_radial, radial_tables
from demflow.sweep.analysis.regimes import detect_regimes, fit_permeability
from demflow.sweep.analysis.reservoirs import MODELS, unit_response
from demflow.sweep.study.reservoir import PARAMETERS, Rock, parameters_of

MD = 9.869233e-16
FLUID = Fluid(viscosity=1.0, bulk_modulus=1e9)
GRAINS = Grains(count=5000, porosity=0.17)


def named(t, change):
    return [r.name for r in detect_regimes(t, change, bourdet_derivative(t, change))]


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda t: 3 * t, ["wellbore storage"]),
        (lambda t: 3 * t**0.5, ["linear"]),
        (lambda t: 3 * t**0.25, ["bilinear"]),
        (lambda t: 3 * np.log(t) + 90, ["radial"]),
        (lambda t: 5e3 + 3 * t, ["steady", "pseudo-steady"]),
        (lambda t: 7 + 0 * t, ["steady"]),
    ],
)
def test_each_regime_is_known_by_its_slope(change, expected):
    t = np.geomspace(1e-3, 1e6, 181)
    found = named(t, change(t))
    assert found == expected or (len(expected) == 2 and found[:2] == expected)


def test_a_well_in_a_closed_circle_goes_from_radial_to_pseudo_steady():
    E = 2000.0
    t = np.geomspace(1e2, 1e9, 200)
    boundary = 0.1 * E**2
    early, late = finite_radius_well(1.0, t), closed_circle_pseudo_steady(1.0, t, E)
    found = named(t, np.where(t < boundary, early, late))
    assert found[0] == "radial"
    assert found[-1] == "pseudo-steady"


def test_a_well_with_a_constant_pressure_boundary_ends_steady():
    t = np.geomspace(1e2, 1e9, 200)
    found = named(t, radial_dimensionless_pressure(1.0, t, 2000.0))
    assert found == ["radial", "steady"]


def response(model, **values):
    """A transient of a reservoir model in units of its well, 20 points a decade."""
    rock = Rock(porosity=1.0, viscosity=1.0, compressibility=1.0, well_radius=1.0)
    known = {name: PARAMETERS[name].default for name in parameters_of(model)}
    known |= {"permeability": 1.0, "initial_pressure": 0.0, **values}
    t = np.geomspace(1e2, 1e10, 161)
    return t, unit_response(MODELS[model], rock, known, t)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "values", "expected"),
    [
        (
            "homogeneous",
            {"wellbore_storage": 1e4, "skin_factor": 2.0},
            ["wellbore storage", "radial"],
        ),
        ("fault", {"distance": 2e3}, ["radial", "one fault"]),
        ("corner", {"distance": 2e3, "ratio": 1.1}, ["radial", "corner"]),
        ("channel", {"width": 5e3}, ["radial", "channel"]),
        ("closed_circle", {"radius": 5e3}, ["radial", "pseudo-steady"]),
        ("constant_pressure_circle", {"radius": 5e3}, ["radial", "steady"]),
        ("infinite_conductivity_fracture", {"half_length": 1e3}, ["linear", "radial"]),
        (
            "finite_conductivity_fracture",
            {"half_length": 1e4, "fracture_conductivity": 3e3},
            ["bilinear", "radial"],
        ),
    ],
)
def test_regimes_of_reservoir_models_are_read_with_noise(model, values, expected):
    t, change = response(model, **values)
    noisy = change * (1.0 + 1e-3 * np.random.default_rng(0).normal(size=len(t)))
    for one in (change, noisy):
        found = detect_regimes(t, one, bourdet_derivative(t, one, smoothing=0.3))
        assert [regime.name for regime in found] == expected
        assert all(0.0 < regime.confidence <= 1.0 for regime in found)
        assert all(a.end <= b.start for a, b in itertools.pairwise(found))


def test_a_short_stretch_is_less_sure_than_a_long_one():
    t, change = response("fault", distance=2e3)
    early = t < 1e6
    long = detect_regimes(t, change, bourdet_derivative(t, change))[0]
    short = detect_regimes(t[early], change[early], bourdet_derivative(t[early], change[early]))
    (cut,) = detect_regimes(t[t < 2e3], change[t < 2e3], bourdet_derivative(t, change)[t < 2e3])
    assert short[0].name == long.name == cut.name == "radial"
    assert cut.confidence < long.confidence


def test_permeability_comes_back_from_the_radial_plateau():
    k, q, mu, phi, c = 50 * MD, 2e-6, 1e-3, 0.2, 1e-9
    t = np.geomspace(1, 1e6, 120)
    unit = q * mu / (2 * math.pi * k)
    change = unit * line_source(0.1, k * t / (phi * mu * c))
    fitted = fit_permeability(t, change, bourdet_derivative(t, change), q, mu)
    assert fitted == pytest.approx(k, rel=1e-3)
    assert math.isnan(fit_permeability(t, 3 * t, 3 * t, q, mu))
    assert detect_regimes(t[:2], change[:2], change[:2]) == []


def test_permeability_of_a_dataset_uses_the_first_flow_period():
    k, mu = np.array([20, 80]) * MD, 1e-3
    t = np.geomspace(1, 1e5, 100)
    rate = np.where(t < 1e4, 3e-6, 0.0)
    change = 3e-6 * mu / (2 * np.pi * k[:, None]) * line_source(0.1, k[:, None] * t / (2e-13))
    change[:, t >= 1e4] = 1.0
    slope = np.stack([bourdet_derivative(t, row, start=[0.0, t[t < 1e4][-1]]) for row in change])
    dims = ("aperture", "well", "elapsed_time")
    dataset = xr.Dataset(
        {
            "pressure_change": (dims, change[:, None]),
            "pressure_derivative": (dims, slope[:, None]),
            "well_rate": (dims, np.tile(rate, (2, 1, 1))),
        },
        {"elapsed_time": t, "well": ["producer"]},
    )
    fitted = Results(dataset).radial_permeability(mu)
    assert fitted.dims == ("aperture", "well")
    np.testing.assert_allclose(fitted[:, 0], k, rtol=2e-3)
    dataset["well_rate"][0, 0, 0] = 0.0  # did not flow from the start
    np.testing.assert_array_equal(
        np.isnan(Results(dataset).radial_permeability(mu)[:, 0]), [True, False]
    )


def test_principal_values_turn_with_the_tensor():
    angles = np.radians([0, 30, 65, 90, 150])
    c, s = np.cos(angles), np.sin(angles)
    turn = np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)
    tensor = turn @ np.diag([5e-13, 2e-18]) @ np.swapaxes(turn, -1, -2)
    result = principal_permeability(
        xr.DataArray(tensor, dims=("angle", "row", "column"), attrs={"units": "m2"})
    )
    np.testing.assert_allclose(result["largest"], 5e-13, rtol=1e-12)
    np.testing.assert_allclose(result["smallest"], 2e-18, rtol=1e-8)
    np.testing.assert_allclose(result["anisotropy"], 2.5e5, rtol=1e-8)
    np.testing.assert_allclose(result["direction"], [0, 30, 65, 90, -30], atol=1e-6)


def test_ensemble_leaves_failed_members_out():
    values = xr.DataArray(
        [[1.0, 2.0, np.nan, 6.0], [4.0, np.nan, np.nan, np.nan]], dims=("angle", "seed")
    )
    result = ensemble(values, "seed")
    np.testing.assert_array_equal(result["members"], [3, 1])
    np.testing.assert_allclose(result["mean"], [3, 4])
    np.testing.assert_allclose(result["spread"], [np.std([1, 2, 6], ddof=1), np.nan])
    np.testing.assert_allclose(result["greatest"] - result["least"], [5, 0])


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (5e6, "Pa", "5 MPa"),
        (2667 * MD, "m2", "2667 mD"),
        (0.458 * MD, "m2", "0.458 mD"),
        (2e-5, "m", "20 µm"),
        (65.0, "degree", "65°"),
        (2e-5, "m3 s-1", "2×10⁻⁵ m³/s"),
        (3.0, "1", "3"),
        ("square", "1", "square"),
    ],
)
def test_values_are_written_as_people_write_them(value, unit, text):
    assert cases.with_unit(value, unit) == text


def linear_case(boundaries, region, seed, error=0.0):
    """A scene of linear flow, and its maps with the exact pressure plus an error of P_D."""
    scene = Scene(
        region=region,
        grains=GRAINS,
        matrix=Matrix(permeability=2667 * MD),
        fluid=FLUID,
        observe=("pressure_map", "boundary_flow"),
        boundaries=boundaries,
        initial_pressure=5e6,
        times=(67.0, 1467.0, 15067.0),
    )
    rng = np.random.default_rng(seed)
    pressures = dict(boundaries)
    vertical = "bottom" in pressures
    length = region.height if vertical else region.width
    first, second = (pressures[n] for n in (("bottom", "top") if vertical else ("left", "right")))
    flow = rng.uniform(-0.5, 0.5, 3000) * length
    across = rng.uniform(-1, 1, 3000)
    pressure = linear_pressure(
        flow + length / 2,
        np.array(scene.times)[:, None],
        length=length,
        diffusivity=2667 * MD * 1e9 / 0.17,
        initial=5e6,
        first=first,
        second=second,
    )
    pressure = pressure + error * abs(first - second)
    x, y = (across, flow) if vertical else (flow, across)
    maps = xr.Dataset(
        {"pressure": (("elapsed_time", "domain"), pressure)},
        {"x": ("domain", x), "y": ("domain", y), "elapsed_time": list(scene.times)},
    )
    return scene, maps


def linear_dataset(count, times, flow=1.0):
    return xr.Dataset(
        {
            "status": ("seed", np.zeros(count, int)),
            "porosity": ("seed", np.full(count, 0.17)),
            "boundary_flow": (
                ("seed", "boundary", "elapsed_time"),
                np.full((count, 2, len(times)), flow),
            ),
        },
        {
            "seed": np.arange(count),
            "elapsed_time": list(times),
            "boundary": ["left", "right"],
        },
    )


@pytest.mark.parametrize(
    "boundaries",
    [
        (("left", 5e6), ("right", 0.0)),
        (("left", 0.0), ("right", 5e6)),
        (("bottom", 5e6), ("top", 1e6)),
        (("left", 8e6), ("right", 2e6)),
    ],
)
def test_an_exact_linear_field_has_no_model_error(boundaries):
    scene, maps = linear_case(boundaries, Rectangle(width=13.5, height=14.0), 1)
    dataset = linear_dataset(1, scene.times)
    if "bottom" in dict(boundaries):
        dataset = dataset.assign_coords(boundary=["bottom", "top"])
    result = compare_linear(dataset, lambda i: scene, lambda i: maps)
    np.testing.assert_allclose(result.computed, result.expected, atol=1e-12)
    assert result.computed.shape == (1, 3, 15)
    assert np.all(result.t_D > 0)


def test_linear_comparison_measures_the_error_that_is_there():
    errors = [0.0, 0.01, -0.03]
    pairs = [
        linear_case(
            (("left", 5e6), ("right", 0.0)), Rectangle(width=13.5, height=14.0), s, errors[s]
        )
        for s in range(3)
    ]
    darcy = 2667 * MD * 14 * 5e6 / 13.5
    dataset = linear_dataset(3, pairs[0][0].times, flow=1.02 * darcy)
    result = compare_linear(dataset, lambda i: pairs[i["seed"]][0], lambda i: pairs[i["seed"]][1])
    np.testing.assert_allclose(result.rms, np.abs(errors), atol=1e-12)
    np.testing.assert_allclose(result.flow / result.darcy_flow, 1.02)
    np.testing.assert_allclose(darcy, 1.365e-5, rtol=2e-3)  # the paper's steady flow
    per_time, per_case = linear_tables(result)
    assert per_time.rows[-1][2:] == pytest.approx((0.04 / 3, np.std([0, 0.01, 0.03], ddof=1), 0.03))
    assert [row[0] for row in per_case.rows] == ["seed 0", "seed 1", "seed 2"]
    dataset["status"][1] = 1  # a failed case costs only itself
    assert len(compare_linear(dataset, lambda i: pairs[0][0], lambda i: pairs[0][1]).rms) == 2


def radial_scene():
    return Scene(
        region=Circle(radius=13.8),
        grains=GRAINS,
        matrix=Matrix(permeability=2442 * MD),
        fluid=FLUID,
        observe=("well_pressure", "pressure_map"),
        wells=(Well(name="w", at=(0.0, 0.0), radius=0.964, rate=2e-5),),
        boundaries=(("outer", 7e6),),
        initial_pressure=7e6,
        times=(120.0, 1420.0, 24086.0),
    )


def test_an_exact_radial_field_has_no_model_error():
    scene = radial_scene()
    E = 13.8 / 0.964
    fall = 2e-5 * math.log(E) / (2 * math.pi * 2442 * MD)
    t = np.array(scene.times)
    t_D = 2442 * MD * 1e9 * t / (0.18 * 0.964**2)
    rng = np.random.default_rng(2)
    radius, angle = rng.uniform(0.5, 14, 5000), rng.uniform(0, 2 * np.pi, 5000)
    P_D = radial_dimensionless_pressure(np.clip(radius / 0.964, 1, E), t_D[:, None], E)
    maps = xr.Dataset(
        {"pressure": (("elapsed_time", "domain"), 7e6 - fall * P_D)},
        {
            "x": ("domain", radius * np.cos(angle)),
            "y": ("domain", radius * np.sin(angle)),
            "elapsed_time": t,
        },
    )
    well = 7e6 - fall * 1.02 * radial_dimensionless_pressure(1.0, t_D, E)
    dataset = xr.Dataset(
        {
            "status": ((), 0),
            "porosity": ((), 0.18),
            "well_pressure": (("well", "elapsed_time"), well[None]),
        },
        {"well": ["w"], "elapsed_time": t},
    )
    result = compare_radial(dataset, lambda i: scene, lambda i: maps)
    np.testing.assert_allclose(result.profile, result.expected_profile, atol=1e-12)
    np.testing.assert_allclose(result.error, 0.02, rtol=1e-9)
    np.testing.assert_allclose(result.expected_steady, 3.49e6, rtol=2e-3)
    per_time, per_case = radial_tables(result)
    assert len(per_time.rows) == 3
    assert per_case.rows[0][-1] == pytest.approx(0.02, rel=2e-3)
    without = compare_radial(dataset, lambda i: scene, None)
    assert without.profile.size == 0
    np.testing.assert_array_equal(without.well, result.well)


@pytest.mark.parametrize(
    ("change", "kind", "why"),
    [
        ({}, "linear", "rectangle"),
        ({}, "spherical", "none of"),
        ({"boundaries": (("outer", 6e6),)}, "radial", "initial pressure"),
        ({"observe": ("pressure_map",)}, "radial", "observe well_pressure"),
        (
            {"fractures": (BiWing(name="h", aperture=1e-4, at=(0, 0), angle=0, half_length=5),)},
            "radial",
            "no fractures",
        ),
        (
            {"wells": (Well(name="w", at=(1.0, 0.0), radius=0.9, rate=2e-5),)},
            "radial",
            "middle",
        ),
        (
            {"wells": (Well(name="w", at=(0.0, 0.0), radius=0.9, pressure=2e5),)},
            "radial",
            "constant rate",
        ),
    ],
)
def test_a_scene_that_is_not_the_formulas_is_refused_with_the_reason(change, kind, why):
    scene = dataclasses.replace(radial_scene(), **change)
    assert why in compare.comparison_problem(scene, kind)
    dataset = xr.Dataset({"status": ((), 0)}, {"elapsed_time": list(scene.times)})
    with pytest.raises(ValueError, match=why):
        compare.comparable_cases(dataset, lambda i: scene, kind)


def test_nothing_to_compare_is_said():
    dataset = xr.Dataset({"status": ("seed", [1, 2])})
    with pytest.raises(ValueError, match="no case is done"):
        compare.comparable_cases(dataset, lambda i: radial_scene(), "radial")


def test_tables_are_written_as_csv_in_full_precision(tmp_path):
    from demflow.sweep.analysis.table import table

    path = table("t", ("a, b", "c"), [(np.float64(0.1) + 0.2, "x"), (1, "y,z")]).write_csv(
        tmp_path / "t.csv"
    )
    assert path.read_bytes() == b'"a, b",c\r\n0.30000000000000004,x\r\n1,"y,z"\r\n'
