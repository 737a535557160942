"""Plots of analyses on axes of the caller's: each shows the numbers of a closed form."""

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure
from scipy.special import exp1

from demflow.model.outcome import Status
from demflow.model.transient import log_time
from demflow.sweep.accessor import Results
from demflow.sweep.errors import ResultsError

VISCOSITY, POROSITY, RADIUS, START = 1e-3, 0.2, 0.1, 2e7
RATES = ((0.0, 2e-5), (3600.0, 0.0))
K = np.array([1e-14, 3e-14])
COMPRESSIBILITY = 1e-9


def theis(time, k):
    """Pressure that falls for a unit rate at the well's radius, Pa s/m³."""
    diffusivity = k / (POROSITY * VISCOSITY * COMPRESSIBILITY)
    return VISCOSITY / (4.0 * np.pi * k) * exp1(RADIUS**2 / (4.0 * diffusivity * time))


def build_up():
    """Theis' drawdown and build-up in two rocks; a third case failed."""
    times = np.concatenate([np.geomspace(1.0, 3600.0, 60), 3600.0 + np.geomspace(1.0, 3e4, 60)])
    shut = times > 3600.0
    fall = RATES[0][1] * np.array([theis(times, k) for k in K])
    fall[:, shut] -= RATES[0][1] * np.array([theis(times[shut] - 3600.0, k) for k in K])
    last = RATES[0][1] * np.array([theis(3600.0, k) for k in K])
    change = np.where(shut, last[:, None] - fall, fall)
    none = np.full((1, len(times)), np.nan)
    rate = np.where(shut, 0.0, RATES[0][1])
    over = ("k", "well", "elapsed_time")
    every = {
        "well_pressure": START - fall, "pressure_change": change,
        "well_rate": np.broadcast_to(rate, change.shape),
    }  # fmt: skip
    return xr.Dataset(
        {name: (over, np.concatenate([v, none])[:, None]) for name, v in every.items()}
        | {
            "status": ("k", np.array([Status.DONE, Status.DONE, Status.FAILED], dtype=np.int8)),
            "porosity": ("k", np.full(3, POROSITY)),
        },
        {"k": ("k", [*K, 1.0]), "well": ["p"], "elapsed_time": times},
    )


FLUID = {"viscosity": VISCOSITY, "compressibility": COMPRESSIBILITY, "well_radius": RADIUS}


@pytest.mark.parametrize("plot", ["horner", "superposition", "mdh"])
def test_a_line_runs_through_the_pressures_that_it_is_of(plot):
    dataset, panel = build_up(), Figure().subplots()
    assert isinstance(dataset.demflow, Results)
    options = {**FLUID, "plot": plot, "rates": RATES, "between": (100.0, 600.0)}
    assert dataset.demflow.plot_straight_line("p", panel, **options, pressure="MPa") is panel
    line, points = panel.lines[:2]  # of the first case that is done
    assert len(panel.lines) == 4  # a case that failed is not drawn
    x, y = points.get_data()
    times = dataset["elapsed_time"].values
    np.testing.assert_allclose(y, dataset["well_pressure"][0, 0, times > 3600.0] / 1e6)
    since = times[times > 3600.0] - 3600.0
    on_it = (since > 100.0) & (since < 600.0)
    if plot == "superposition":
        expected, straight = log_time(times, RATES, "superposition")[times > 3600.0], x
    else:
        expected = since / 3600.0 if plot == "mdh" else (3600.0 + since) / since
        straight = np.log(x)
        assert panel.xaxis_inverted() == (plot == "horner")
    np.testing.assert_allclose(x, expected, rtol=1e-9)
    ends = np.array(line.get_data())
    along = ends[0] if plot == "superposition" else np.log(ends[0])
    slope, height = np.polyfit(along, ends[1], 1)
    drop = 1e-2 if plot == "mdh" else 1e-4  # MDH neglects what flowed before
    np.testing.assert_allclose(slope * straight[on_it] + height, y[on_it], atol=drop * np.ptp(y))
    if plot == "horner":  # it reaches the initial pressure where the time is endless
        assert ends[0].min() == pytest.approx(1.0)
        assert ends[1].max() == pytest.approx(START / 1e6, rel=1e-4)
    told = dataset.demflow.straight_line("p", **options)
    assert f"S {float(told['skin_factor'][0]):.2f}" in points.get_label()


def test_a_case_without_a_line_says_why():
    dataset, panel = build_up(), Figure().subplots()
    few = dataset.isel(elapsed_time=slice(0, 66))
    few.isel(k=[0]).demflow.plot_straight_line("p", panel, **FLUID, rates=RATES)
    assert len(panel.lines) == 1
    assert "no straight line" in panel.lines[0].get_label()
    for wrong, told in (
        ({"rates": None}, "give `rates`"),
        ({"plot": "linear"}, "no plot linear"),
        ({"time": "bar"}, "no unit of a time"),
    ):
        with pytest.raises(ResultsError, match=told):
            dataset.demflow.plot_straight_line("p", panel, **({**FLUID, "rates": RATES} | wrong))
    with pytest.raises(ResultsError, match="0 cases are done"):
        dataset.isel(k=[2]).demflow.plot_straight_line("p", panel, **FLUID, rates=RATES)


def test_a_deconvolved_record_lies_on_the_drawdown_that_made_it():
    record = build_up().isel(k=0, well=0)
    times = record["elapsed_time"].values
    drawdown = RATES[0][1] / 2.0 * theis(times, K[0])  # at another rate than the record's
    slope = RATES[0][1] / 2.0 * VISCOSITY / (4.0 * np.pi * K[0])
    one = xr.Dataset(
        {
            "status": np.int8(Status.DONE),
            "pressure_change": (("well", "elapsed_time"), drawdown[None]),
            "pressure_derivative": (("well", "elapsed_time"), np.full((1, len(times)), slope)),
            "well_rate": (("well", "elapsed_time"), np.full((1, len(times)), RATES[0][1] / 2.0)),
        },
        {"well": ["p"], "elapsed_time": times},
    )
    panel = Figure().subplots()
    pressure = record["well_pressure"].values
    told = {"pressure_error": 50.0, "initial_pressure": START}
    assert one.demflow.plot_deconvolution("p", times, pressure, RATES, panel, **told) is panel
    change, derivative, computed, level = panel.lines
    inner = (change.get_xdata() > 0.01) & (change.get_xdata() < 2.0)
    expected = np.interp(change.get_xdata()[inner], *computed.get_data())
    np.testing.assert_allclose(change.get_ydata()[inner], expected, rtol=0.02)
    np.testing.assert_allclose(derivative.get_ydata()[inner], level.get_ydata()[0], rtol=0.1)
    assert "2×10⁻⁵" in panel.get_ylabel()
    changing = build_up().assign(pressure_derivative=build_up()["pressure_change"])
    with pytest.raises(ResultsError, match="rate of p is not one"):
        changing.demflow.plot_deconvolution("p", times, pressure, RATES, panel, **told)
    with pytest.raises(ResultsError, match="above zero"):
        one.demflow.plot_deconvolution("p", times, pressure, RATES, panel, pressure_error=0.0)


def product():
    """A result a·b² on three values of each axis, and on an axis that does nothing."""
    a, b = np.array([1.0, 2.0, 3.0]), np.array([1.0, 2.0, 4.0])
    values = np.broadcast_to(a[:, None, None] * b[:, None] ** 2, (3, 3, 2))
    return xr.Dataset(
        {
            "status": (("a", "b", "c"), np.zeros((3, 3, 2), dtype=np.int8)),
            "result": (("a", "b", "c"), values, {"units": "1"}),
        },
        {"a": a, "b": b, "c": [0.0, 1.0]},
    )


def test_a_tornado_s_bars_are_what_each_axis_does_alone():
    panel = Figure().subplots()
    dataset = product()
    assert dataset.demflow.plot_tornado("result", panel) is panel
    # in the middle 2·2² = 8; b alone gives 2 to 32, a alone 4 to 12, c nothing
    names = [text.get_text() for text in panel.get_yticklabels()]
    assert names == ["b", "a", "c"]
    ends = [(bar.get_x(), bar.get_x() + bar.get_width()) for bar in panel.patches]
    np.testing.assert_allclose([one[0] for one in ends], 8.0)
    np.testing.assert_allclose([one[1] for one in ends], [2.0, 32.0, 4.0, 12.0, 8.0, 8.0])
    other = Figure().subplots()
    dataset.demflow.plot_tornado("result", other, a=1.0)
    assert other.patches[0].get_x() == pytest.approx(4.0)
    with pytest.raises(ResultsError, match=r"a = 7\.0 is not there"):
        dataset.demflow.plot_tornado("result", other, a=7.0)
    dataset["result"] = dataset["result"].where(dataset["a"] != 2.0)
    with pytest.raises(ResultsError, match="the case in the middle"):
        dataset.demflow.plot_tornado("result", other)


def test_work_against_precision_is_the_median_of_the_packings():
    rng = np.random.default_rng(3)
    error, seconds = rng.uniform(1e-6, 1e-2, (3, 4)), rng.uniform(0.1, 9.0, (3, 4))
    over = ("packing", "solver")
    dataset = xr.Dataset(
        {
            "status": (over, np.zeros((3, 4), dtype=np.int8)),
            "message": (over, np.full((3, 4), "", dtype=object)),
            "time_error": (over, error),
            "solver_time": (over, seconds),
        },
        {
            "packing": [1, 2, 3],
            "solver": ["a", "b", "c", "d"],
            "solver_method": ("solver", ["krylov", "krylov", "explicit", "explicit"]),
            "solver_tolerance": ("solver", [1e-3, 1e-4, np.nan, np.nan]),
            "solver_safety_factor": ("solver", [np.nan, np.nan, 0.5, 0.9]),
        },
    )
    panel = Figure().subplots()
    assert dataset.demflow.plot_work_precision(panel) is panel
    assert [line.get_label() for line in panel.lines] == ["krylov", "explicit"]
    for k, line in enumerate(panel.lines):
        middle = [np.median(one, axis=0)[2 * k : 2 * k + 2] for one in (seconds, error)]
        assert set(zip(*line.get_data(), strict=True)) == set(zip(*middle, strict=True))
    with pytest.raises(ResultsError, match="no axis of the study sets"):
        dataset.drop_vars("solver_method").demflow.plot_work_precision(panel)
    with pytest.raises(ResultsError, match="observe time_error"):
        dataset.drop_vars("time_error").demflow.plot_work_precision(panel)


def test_breaks_are_counted_by_mode():
    counts = np.array([2, 5])
    rng = np.random.default_rng(4)
    dataset = xr.Dataset(
        {
            "status": ("rate", np.zeros(2, dtype=np.int8)),
            "event_count": ("rate", counts, {"sample_dimension": "event"}),
            "event_time": ("event", rng.uniform(1.0, 50.0, 7)),
            "event_mode": ("event", np.array([1, 1, 1, 2, 1, 2, 1])),
            "event_x": ("event", rng.normal(size=7)),
            "event_y": ("event", rng.normal(size=7)),
        },
        {"rate": [1.0, 2.0]},
    )
    panel, places = Figure().subplots(1, 2)
    assert dataset.demflow.plot_breaks(panel, rate=2.0) is panel
    tension, shear = panel.lines
    own = dataset["event_time"].values[2:]
    at = np.sort(own[dataset["event_mode"].values[2:] == 1])
    for t in rng.uniform(0.0, 50.0, 20):
        seen = tension.get_ydata()[np.searchsorted(tension.get_xdata(), t, side="right") - 1]
        assert seen == np.count_nonzero(at <= t)
    assert shear.get_ydata().max() == 2
    dataset.demflow.plot_breaks(places, places=True, rate=2.0)
    drawn = np.concatenate([one.get_offsets() for one in places.collections])
    expected = 1e3 * np.stack([dataset["event_x"], dataset["event_y"]], axis=1)[2:]
    assert places.get_xlabel() == "x (mm)"
    order = [np.lexsort(one.T) for one in (np.asarray(drawn), expected)]
    np.testing.assert_allclose(np.asarray(drawn)[order[0]], expected[order[1]])
    with pytest.raises(ResultsError, match="give a value of rate"):
        dataset.demflow.plot_breaks(panel)
