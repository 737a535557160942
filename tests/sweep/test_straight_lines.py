"""Straight lines of MDH, Horner and superposition plots on made tests whose answer is known."""

import numpy as np
import pytest
import xarray as xr

import demflow.sweep.accessor  # noqa: F401 (gives datasets their door)
from demflow.sweep.analysis.reservoirs import MODELS, Superposed
from demflow.sweep.analysis.straight_lines import straight_line
from demflow.sweep.errors import ResultsError
from demflow.sweep.study.reservoir import Rock

ROCK = Rock(
    porosity=0.2, viscosity=1e-3, compressibility=1e-9, well_radius=0.1, thickness=10.0,
    volume_factor=1.25,
)  # fmt: skip
K, START, SKIN = 5e-14, 3e7, 3.7
HOUR = 3600.0
RATES = ((0.0, 1e-3), (5 * HOUR, 4e-4), (12 * HOUR, 2e-3), (40 * HOUR, 0.0))


def record(rates, skin=SKIN, last=300 * HOUR, model="homogeneous", **more):
    begin = rates[-1][0]
    times = np.append(begin, begin + np.geomspace(1.0, last, 120))
    values = {
        "permeability": K, "skin_factor": skin, "wellbore_storage": 0.0, "initial_pressure": START,
        "drift": 0.0,
    } | more  # fmt: skip
    if begin == 0.0:
        late = Superposed(times[1:], rates).pressure(MODELS[model], ROCK, values)
        return times, np.append(START, late)
    return times, Superposed(times, rates).pressure(MODELS[model], ROCK, values)


@pytest.mark.parametrize("skin", [0.0, SKIN])
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("rates", [RATES[:1], RATES[:2], RATES[:3], RATES])
def test_any_rates_give_permeability_skin_and_the_first_pressure(rates, sign, skin):
    """Producing and injecting, flowing and shut in, by the plot that knows all rates."""
    turned = tuple((t, sign * q) for t, q in rates)
    made = record(turned, skin)
    found = straight_line(*made, turned, ROCK, between=(600.0, 300 * HOUR))
    assert found.permeability == pytest.approx(K, rel=1e-3)
    assert found.skin_factor == pytest.approx(skin, abs=0.02)
    if turned[-1][1] == 0.0:
        assert found.extrapolated == pytest.approx(START, abs=3e-4 * np.ptp(made[1]))
    else:
        assert np.isnan(found.extrapolated)
    if len(rates) == 2:
        return  # the sum of logarithms comes to fall, which no derivative bears
    # where the line lies is seen by itself, too, if from a little too early on
    seen = straight_line(*made, turned, ROCK)
    assert seen.permeability == pytest.approx(K, rel=1e-2)
    assert seen.skin_factor == pytest.approx(skin, abs=0.15)


def test_a_horner_plot_after_one_rate_is_the_superposition_plot():
    rates = ((0.0, 1e-3), (40 * HOUR, 0.0))
    times, pressure = record(rates)
    horner, whole = (straight_line(times, pressure, rates, ROCK, plot=plot)
                     for plot in ("horner", "superposition"))  # fmt: skip
    assert horner[1:] == pytest.approx(whole[1:], rel=1e-9)
    assert horner.extrapolated == pytest.approx(START, abs=1e-3 * np.ptp(pressure))


def test_mdh_serves_while_the_shut_in_is_short():
    rates = ((0.0, 1e-3), (400 * HOUR, 0.0))
    times, pressure = record(rates)
    early = straight_line(times, pressure, rates, ROCK, plot="mdh", between=(60.0, 2 * HOUR))
    late = straight_line(times, pressure, rates, ROCK, plot="mdh", between=(50 * HOUR, 300 * HOUR))
    assert early.permeability == pytest.approx(K, rel=3e-3)
    assert early.skin_factor == pytest.approx(SKIN, abs=0.05)
    assert late.permeability > 1.2 * K  # what it is known for
    assert np.isnan(early.extrapolated)


def test_stated_errors_cover_the_scatter():
    """Of 200 noisy records the 95 % intervals miss k and S some 10 times."""
    rates = RATES
    times, pressure = record(rates)
    rng = np.random.default_rng(1)
    window = (600.0, 200 * HOUR)
    exact = straight_line(times, pressure, rates, ROCK, between=window)
    missed_k = missed_skin = 0
    for _ in range(200):
        noisy = pressure + np.append(0.0, rng.normal(0.0, 2e4, len(times) - 1))
        found = straight_line(times, noisy, rates, ROCK, between=window)
        missed_k += abs(found.permeability - exact.permeability) > found.permeability_error
        missed_skin += abs(found.skin_factor - exact.skin_factor) > found.skin_error
    assert 3 <= missed_k <= 20
    assert 3 <= missed_skin <= 20


@pytest.mark.parametrize("noise", [1e-3, 1e-4])
@pytest.mark.parametrize("rates", [RATES[:1], ((0.0, 1e-3), (40 * HOUR, 0.0)), RATES])
def test_errors_of_a_line_that_is_found_hold_what_storage_leaves(rates, noise):
    """The derivative is flat within its tolerance before storage has died away."""
    rng = np.random.default_rng(3)
    storages = np.geomspace(1e-9, 3e-8, 40)
    held_k, held_skin, off, width, told = 0, 0, [], [], []
    for storage, skin in zip(storages, rng.permutation(np.linspace(0.0, 8.0, 40)), strict=True):
        times, pressure = record(rates, skin, wellbore_storage=storage)
        noisy = pressure + rng.normal(0.0, noise * np.ptp(pressure), len(times))
        try:
            found = straight_line(times, noisy, rates, ROCK)
        except ValueError as error:
            told.append(str(error))
            continue
        off.append(abs(found.permeability / K - 1.0))
        width.append(found.permeability_error / K)
        held_k += off[-1] <= width[-1]
        held_skin += abs(found.skin_factor - skin) <= found.skin_error
    assert len(told) <= (10 if noise == 1e-3 else 0)
    assert all("hide the slope" in one or "no radial flow" in one for one in told)
    assert held_k >= 0.9 * len(off)
    assert held_skin >= 0.9 * len(off)
    if noise < 1e-3:  # what storage leaves moves a line without it by 1 %
        assert max(off) < 5e-3
        assert np.median(width) < 2e-3


@pytest.mark.parametrize(
    ("model", "parameter", "nearest"),
    [("fault", "distance", 150.0), ("closed_circle", "radius", 200.0)],
)
def test_errors_of_a_build_up_hold_what_the_drawdown_felt_of_a_boundary(model, parameter, nearest):
    """It is some 2 % of k, ten times what the scatter of the points tells."""
    rng = np.random.default_rng(4)
    rates = ((0.0, 1e-3), (40 * HOUR, 0.0))
    held, off = 0, []
    for place in np.geomspace(nearest, 3.0 * nearest, 20):
        values = {parameter: place, "wellbore_storage": 3e-9}
        times, pressure = record(rates, model=model, **values)
        noisy = pressure + rng.normal(0.0, 1e-4 * np.ptp(pressure), len(times))
        found = straight_line(times, noisy, rates, ROCK)
        off.append(abs(found.permeability / K - 1.0))
        held += off[-1] <= found.permeability_error / K
    assert np.median(off) > 5e-3
    assert held >= 16


def test_a_line_that_noise_hides_is_refused():
    rates = RATES[:1]
    times, pressure = record(rates, wellbore_storage=1e-8)
    rng = np.random.default_rng(5)
    told = []
    for _ in range(20):
        noisy = pressure + rng.normal(0.0, 5e-3 * np.ptp(pressure), len(times))
        try:
            found = straight_line(times, noisy, rates, ROCK)
        except ValueError as error:
            told.append(str(error))
        else:
            assert found.permeability_error < found.permeability
    assert any("noise and storage hide the slope" in one for one in told)


@pytest.mark.parametrize(
    ("rates", "options", "told"),
    [
        (RATES, {"plot": "bourdet"}, "none of mdh"),
        (((0.0, 0.0),), {}, "no flow period"),
        (RATES[:3], {"plot": "horner"}, "take superposition"),
        (((0.0, 1e-3), (HOUR, -1e-3), (2 * HOUR, 0.0)), {"plot": "horner"}, "cancels"),
        (RATES, {"between": (1.0, 1.1)}, "points lie on the line"),
        (((0.0, 1e-3), (500 * HOUR, 0.0)), {}, "at or before"),
    ],
)
def test_what_has_no_line_is_told(rates, options, told):
    times, pressure = record(RATES)
    if told == "at or before":
        times = times + 500 * HOUR
    with pytest.raises(ValueError, match=told):
        straight_line(times, pressure, rates, ROCK, **options)


def test_storage_alone_shows_no_radial_flow():
    rates = RATES[:1]
    times, pressure = record(rates, last=60.0, wellbore_storage=1e-4)
    with pytest.raises(ValueError, match="no radial flow"):
        straight_line(times, pressure, rates, ROCK)


def of_a_study(rates, count=2):
    """A dataset as a study makes it: cases of which the last failed."""
    times, pressure = record(rates)
    last = rates[-1][1]
    before = rates[-2][1] if len(rates) > 1 else 0.0
    elapsed = times[1:]
    change = np.sign(last - before) * (pressure[0] - pressure[1:])
    shape = (count, 1, len(elapsed))
    return xr.Dataset(
        {
            "status": ("k", np.array([0, 1][:count], dtype=np.int8)),
            "porosity": ("k", np.full(count, 0.2)),
            "well_pressure": (("k", "well", "elapsed_time"), np.broadcast_to(pressure[1:], shape)),
            "pressure_change": (("k", "well", "elapsed_time"), np.broadcast_to(change, shape)),
            "well_rate": (("k", "well", "elapsed_time"), np.full(shape, last)),
        },
        {"well": ["p"], "elapsed_time": elapsed},
    )


@pytest.mark.parametrize("rates", [RATES[:1], RATES])
def test_a_dataset_tells_them_for_each_case(rates):
    known = {"viscosity": 1e-3 / 8.0, "compressibility": 1e-9, "well_radius": 0.1}  # B / h = 1 / 8
    dataset = of_a_study(rates)
    found = dataset.demflow.straight_line("p", rates=rates, between=(600.0, 1e6), **known)
    assert found["permeability"].attrs["units"] == "m2"
    assert float(found["permeability"][0]) == pytest.approx(K, rel=2e-3)
    assert np.isnan(found["permeability"][1])
    assert found["message"].values.tolist() == ["", "not done"]
    if rates[-1][1] == 0.0:
        assert float(found["extrapolated"][0]) == pytest.approx(START, rel=1e-4)
    else:
        same = dataset.demflow.straight_line("p", between=(600.0, 1e6), **known)
        xr.testing.assert_identical(same, found)
    with pytest.raises(ResultsError, match="there is no well q"):
        dataset.demflow.straight_line("q", **known)
    with pytest.raises(ResultsError, match="no plot hornr"):
        dataset.demflow.straight_line("p", plot="hornr", **known)


@pytest.mark.parametrize(
    ("rates", "told"),
    [
        (((0.0, 2.0 * RATES[0][1]),), "rates say 0.002 m3/s after .* where the rate of p is 0.001"),
        (((0.0, 1e-3), (1e9, 0.0)), None),  # a change to come is none yet
        (((0.0, 1e-3), (HOUR, 0.0)), "rates say 0 m3/s after"),
        ((), "times increasing"),
        (((HOUR, 1e-3), (0.0, 0.0)), "times increasing"),
    ],
)
def test_rates_are_those_that_the_well_has(rates, told):
    dataset = of_a_study(RATES[:1])
    if told is None:
        found = dataset.demflow.straight_line("p", viscosity=1e-3, rates=rates)
        assert np.isnan(found["slope"][0])
        assert found["message"].values[0] == "no pressure after the last change of the rate"
        return
    with pytest.raises(ResultsError, match=told):
        dataset.demflow.straight_line("p", viscosity=1e-3, rates=rates)


def test_without_a_line_it_is_told_why_and_without_a_radius_no_skin_is_said():
    dataset = of_a_study(RATES[:1])
    short = dataset.demflow.straight_line("p", viscosity=1e-3, between=(600.0, 601.0))
    assert "points lie on the line" in short["message"].values[0]
    found = dataset.demflow.straight_line("p", viscosity=1e-3, between=(600.0, 1e6))
    assert np.isfinite(found["permeability"][0])
    assert np.isnan(found["skin_factor"][0])
    assert np.isnan(found["skin_error"][0])


def test_a_rate_that_changes_has_to_be_given():
    dataset = of_a_study(RATES[:1])
    late = dataset["elapsed_time"] > HOUR
    changing = dataset.assign(well_rate=dataset["well_rate"].where(~late, 0.0))
    with pytest.raises(ResultsError, match="give its `rates`"):
        changing.demflow.straight_line("p", viscosity=1e-3)
