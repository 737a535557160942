"""`dataset.demflow`: what is made of a study's dataset, where its users look for it.

dataset = sweep.open_results("results/quickstart")
dataset.demflow.to_csv("wells.csv", "well_pressure")
dataset.demflow.derivative(smoothing=0.3).sel(well="producer").plot()
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from demflow.model.outcome import Status
from demflow.model.transient import SMOOTHING, bourdet_derivative
from demflow.sweep.analysis.cases import Index, case_title, done, events
from demflow.sweep.analysis.permeability import ensemble, principal_permeability
from demflow.sweep.analysis.sensitivity import sensitivity
from demflow.sweep.dataset.open import open_results, same_value
from demflow.sweep.dataset.ragged import count_name
from demflow.sweep.errors import ResultsError
from demflow.sweep.study.reservoir import Rock
from demflow.sweep.study.units import UnitError, parse_unit

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from demflow.sweep.analysis.fitting import Fit


# of what a straight line says, where it is no pressure
_UNITS = {
    **dict.fromkeys(("permeability", "permeability_error"), "m2"),
    **dict.fromkeys(("skin_factor", "skin_error", "points"), "1"),
    **dict.fromkeys(("start", "end"), "s"),
}


@xr.register_dataset_accessor("demflow")  # type: ignore[no-untyped-call]
class Results:
    """What a study's dataset can tell. Nothing is changed in it."""

    def __init__(self, dataset: xr.Dataset):
        self._dataset = dataset

    def good(self) -> xr.Dataset:
        """Return the dataset with only the results of cases that are done; NaN for the others.

        Variables that do not lie along all axes, as means of ensembles, stay as they are.
        """
        status = self._variable("status")
        done = status == Status.DONE
        kept = {
            name: variable.where(done)
            for name, variable in self._dataset.data_vars.items()
            if set(status.dims) <= set(variable.dims) and variable.dtype.kind == "f"
        }
        return self._dataset.assign(kept)

    def ensemble(self, name: str, axis: str) -> xr.Dataset:
        """Return the mean of a result over packings, its standard error, and their spread.

        Parameters
        ----------
        name : of the result, such as `well_pressure`.
        axis : along which cases differ in chance alone, such as seeds of packings.

        Of the cases that are done; see `sweep.analysis.permeability.ensemble`. Raises ResultsError
        where there is no such result, or where it does not lie along the axis.
        """
        values = self._variable(name)
        if axis not in values.dims:
            along = ", ".join(map(str, values.dims)) or "nothing"
            raise ResultsError(f"{name} lies along {along}, not along {axis!r}")
        done = self._variable("status") == Status.DONE
        return ensemble(values.where(done), axis)

    def derivative(self, smoothing: float = SMOOTHING) -> xr.DataArray:
        """Return Bourdet's derivative of `pressure_change` by the logarithm of elapsed time, Pa.

        Parameters
        ----------
        smoothing : window L in natural logarithms of time.

        Of wells with one rate from the start. Raises ResultsError where a rate changes: the
        dataset's own `pressure_derivative` takes each flow period by itself.
        """
        change = self._variable("pressure_change")
        self._check_rates(change)
        times = np.asarray(self._dataset["elapsed_time"].values, dtype=float)

        def of(values: np.ndarray) -> np.ndarray:
            return bourdet_derivative(times, values, np.zeros(1), smoothing=smoothing)

        found = xr.apply_ufunc(
            of,
            change,
            input_core_dims=[["elapsed_time"]],
            output_core_dims=[["elapsed_time"]],
            vectorize=True,
        )
        return found.rename("pressure_derivative").assign_attrs(
            units="Pa", long_name="Bourdet derivative", smoothing_window=smoothing
        )

    def regimes(self, well: str, *, since: float = 0.0, until: float = np.inf) -> pd.DataFrame:
        """Return the flow regimes of a well, a row for each stretch of each case that is done.

        Beside the values of the axes: `regime`, `start` and `end` (s after `since`), `level`
        (median derivative, Pa), and `confidence` from 0 to 1; see `sweep.analysis.regimes`.

        Parameters
        ----------
        well : name of the well.
        since, until : begin and end of the flow period, s.

        Raises ResultsError where there is no such well.
        """
        import pandas as pd

        from demflow.sweep.analysis.regimes import Regime, detect_regimes

        change, slope = (self._variable(n) for n in ("pressure_change", "pressure_derivative"))
        self._check_well(well)
        times = np.asarray(self._dataset["elapsed_time"].values, dtype=float)
        now = (times > since) & (times <= until)
        rows = []
        for index in done(self._dataset):
            told = {axis: self._dataset[axis].values[at] for axis, at in index.items()}
            case = [one.isel(index).sel(well=well).values[now] for one in (change, slope)]
            rows += [told | one._asdict() for one in detect_regimes(times[now] - since, *case)]
        columns = [*map(str, self._variable("status").dims), *Regime._fields]
        return pd.DataFrame(rows, columns=columns).rename(columns={"name": "regime"})

    def fit(
        self,
        well: str,
        model: str,
        free: Mapping[str, tuple[float, float]],
        *,
        viscosity: float,
        compressibility: float,
        well_radius: float,
        known: Mapping[str, float] | None = None,
        rates: Sequence[tuple[float, float]] | None = None,
        **at: Any,
    ) -> Fit:
        """Fit a reservoir model to the computed pressure of a well of one case, as to a gauge's.

        What an interpreter would read from the test: `found["permeability"].value`, its interval
        from `.low` to `.high`, and whether the pressures determine it; all in SI.

        Parameters
        ----------
        well : name of the well.
        model : name of a reservoir model, as under `fit: {model: …}` of a study.
        free : bounds of each parameter that is fitted.
        viscosity : of the fluid, Pa s.
        compressibility : total, 1/Pa.
        well_radius : m.
        known : values of other parameters of the model.
        rates : (time in s, new rate in m³/s) of the well; without it the rate is one.
        at : values of the study's axes that choose one case.

        Raises ResultsError where that is not one case that is done, where the well or the model is
        none or lacks a parameter, or the rate changes untold.
        """
        from demflow.sweep.analysis.reservoirs import fit_model

        self._check_well(well)
        case = self._dataset.isel(self._places(at))
        if case["status"].size != 1 or case["status"].item() != Status.DONE:
            raise ResultsError(
                f"{case['status'].size} cases are chosen; a fit is of one that is done"
            )
        case = case.squeeze(list(case["status"].dims))
        if rates is None:
            self._check_rates(
                self._variable("pressure_change").sel(well=[well]), "give its `rates`"
            )
        else:
            self._check_told(well, rates)
        of_well = case.sel(well=well)
        p, fall, rate = (
            np.asarray(of_well[name].values, dtype=float)
            for name in ("well_pressure", "pressure_change", "well_rate")
        )
        seen = np.isfinite(p) & np.isfinite(fall)
        changes = [(0.0, float(rate[-1]))] if rates is None else list(rates)
        start = {"initial_pressure": float((p + np.sign(changes[0][1]) * fall)[seen][0])}
        rock = Rock(float(of_well["porosity"]), viscosity, compressibility, well_radius)
        times = np.asarray(case["elapsed_time"].values, dtype=float)[seen]
        try:
            bounds = {name: (float(low), float(high)) for name, (low, high) in free.items()}
            return fit_model(
                model, rock, (times, p[seen]), changes, bounds, start | dict(known or {})
            )
        except ValueError as error:
            raise ResultsError(f"fit of {model}: {error}") from None

    def plot_well(
        self,
        well: str,
        ax: Axes | None = None,
        *,
        since: float = 0.0,
        until: float = np.inf,
        time: str = "h",
        pressure: str = "kPa",
        **at: Any,
    ) -> Axes:
        """Draw pressure change and Bourdet derivative of a well on log-log axes; return these.

        Blue is the change, red the derivative; every line has a label, so that `ax.legend()`
        names them. Of cases that failed nothing is drawn. Values of axes of the study choose
        cases, as `rate=1e-5`; those along the other axes are drawn each.

        Parameters
        ----------
        well : name of the well.
        ax : matplotlib Axes to draw on, those of another study too; by default pyplot's current.
        since, until : begin and end of the flow period, s.
        time, pressure : units of the axes, as in a study file.

        Raises ResultsError where there is no such well, axis, value or unit, where more cases are
        left than can be told apart, or where the rate changes between `since` and `until`.
        """
        from demflow.sweep.figures.wells import plot_period

        for name in ("pressure_change", "pressure_derivative", "well_rate"):
            self._variable(name)
        self._check_well(well)
        for unit, like in ((time, "s"), (pressure, "Pa")):
            _check_unit(unit, like)
        chosen = self._dataset.isel(self._places(at))
        return plot_period(chosen, well, ax, since=since, until=until, time=time, pressure=pressure)

    def plot_measured(
        self, well: str, time: np.ndarray, pressure: np.ndarray, ax: Axes | None = None
    ) -> Axes:
        """Draw a gauge's record beside the computed pressure of its well; return the axes.

        Parameters
        ----------
        well : name of the well.
        time, pressure : (n,) s since the beginning of the study's times, increasing, and Pa.
        ax : matplotlib Axes to draw on; by default pyplot's current.

        Raises ResultsError where there is no such well, or no record or case to draw.
        """
        from demflow.sweep.figures.measured import plot_measured

        self._variable("well_pressure")
        self._check_well(well)
        return plot_measured(self._dataset, well, time, pressure, _axes(ax))

    def straight_line(
        self,
        well: str,
        *,
        viscosity: float,
        compressibility: float = np.nan,
        well_radius: float = np.nan,
        plot: str = "superposition",
        rates: Sequence[tuple[float, float]] | None = None,
        between: tuple[float, float] | None = None,
    ) -> xr.Dataset:
        """Return what a straight line through a well's last flow period says, for each case.

        `permeability` with its error, `skin_factor`, `extrapolated` (p* of a well that is shut in),
        `slope`, and between which times the line lies; NaN of cases that are not done, or have no
        such line: `message` says why. See `sweep.analysis.straight_lines`. The errors are those
        of the line alone: another packing of the same rock has another permeability.

        Parameters
        ----------
        well : name of the well.
        viscosity : of the fluid, Pa s.
        compressibility : total, 1/Pa; the skin needs it, and the well's radius.
        well_radius : m.
        plot : mdh, horner or superposition.
        rates : (time in s, new rate in m³/s) of the well; without it the rate is one.
        between : s since the period began; by default the radial stretch of the derivative.

        Raises ResultsError where there is no such well or plot, the rate changes untold, or `rates`
        are others than the well's own.
        """
        from demflow.sweep.analysis.straight_lines import PLOTS, StraightLine, straight_line

        if plot not in PLOTS:
            raise ResultsError(f"there is no plot {plot}, only {', '.join(PLOTS)}")
        pressure, change = (self._variable(n) for n in ("well_pressure", "pressure_change"))
        self._check_well(well)
        if rates is None:
            self._check_rates(change.sel(well=[well]), "give its `rates`")
        else:
            self._check_told(well, rates)
        times = np.asarray(self._dataset["elapsed_time"].values, dtype=float)
        told = StraightLine._fields[1:]

        def of(
            p: np.ndarray, fall: np.ndarray, rate: np.ndarray, porosity: float, done: bool
        ) -> tuple[np.ndarray, np.ndarray]:
            none = np.full(len(told), np.nan)
            if not done:
                return none, np.array("not done", dtype=object)
            try:
                record, known = _last_period(times, p, fall, rate, rates)
                found = straight_line(
                    *record,
                    known,
                    Rock(porosity, viscosity, compressibility, well_radius),
                    plot=plot,
                    between=between,
                )
            except ValueError as error:
                return none, np.array(str(error), dtype=object)
            numbers = [getattr(found, name) for name in told]
            return np.array(numbers, dtype=float), np.array("", dtype=object)

        done = self._variable("status") == Status.DONE
        along = [["elapsed_time"]] * 3
        numbers, message = xr.apply_ufunc(
            of,
            *(one.sel(well=well) for one in (pressure, change, self._variable("well_rate"))),
            self._variable("porosity"),
            done,
            input_core_dims=[*along, [], []],
            output_core_dims=[["told"], []],
            vectorize=True,
        )
        lines = {
            name: numbers.isel(told=k).assign_attrs(units=_UNITS.get(name, "Pa"))
            for k, name in enumerate(told)
        }
        return xr.Dataset({**lines, "message": message.astype(str)})

    def plot_straight_line(
        self,
        well: str,
        ax: Axes | None = None,
        *,
        viscosity: float,
        compressibility: float = np.nan,
        well_radius: float = np.nan,
        plot: str = "superposition",
        rates: Sequence[tuple[float, float]] | None = None,
        between: tuple[float, float] | None = None,
        time: str = "h",
        pressure: str = "kPa",
    ) -> Axes:
        """Draw a well's last flow period on its MDH, Horner or superposition plot; return the axes.

        Dots are pressures, the dashed line is what `straight_line` finds with the same arguments;
        the labels tell permeability, skin factor and p* of each case, or why it has no line.

        Parameters
        ----------
        well : name of the well.
        ax : matplotlib Axes to draw on; by default pyplot's current.
        viscosity, compressibility, well_radius, plot, rates, between : as for `straight_line`.
        time, pressure : units of the axes.

        Raises ResultsError as `straight_line`, and where more cases are done than can be told
        apart, or none.
        """
        from demflow.sweep.analysis.straight_lines import PLOTS
        from demflow.sweep.figures.horner import plot_straight_line
        from demflow.sweep.figures.style import sequence
        from demflow.sweep.figures.wells import MOST_LINES

        if plot not in PLOTS:
            raise ResultsError(f"there is no plot {plot}, only {', '.join(PLOTS)}")
        for unit, like in ((time, "s"), (pressure, "Pa")):
            _check_unit(unit, like)
        self._check_well(well)
        shown = list(done(self._dataset))
        if not 0 < len(shown) <= MOST_LINES:
            raise ResultsError(
                f"{len(shown)} cases are done, and 1 to {MOST_LINES} can be told apart; choose "
                "some by isel or sel"
            )
        if rates is None:
            self._check_rates(self._variable("pressure_change").sel(well=[well]), "give `rates`")
        else:
            self._check_told(well, rates)
        panel, times = _axes(ax), np.asarray(self._dataset["elapsed_time"].values, dtype=float)
        for index, colour in zip(shown, sequence(len(shown)), strict=True):
            case = self._dataset.isel(index).sel(well=well)
            names = ("well_pressure", "pressure_change", "well_rate")
            p, fall, rate = (np.asarray(case[name].values, dtype=float) for name in names)
            try:
                record, known = _last_period(times, p, fall, rate, rates)
                plot_straight_line(
                    record,
                    known,
                    Rock(float(case["porosity"]), viscosity, compressibility, well_radius),
                    panel,
                    plot=plot,
                    between=between,
                    name=case_title(self._dataset, index),
                    units=(time, pressure),
                    colour=colour,
                )
            except ValueError as error:
                raise ResultsError(str(error)) from None
        return panel

    def plot_deconvolution(
        self,
        well: str,
        time: np.ndarray,
        pressure: np.ndarray,
        rates: Sequence[tuple[float, float]],
        ax: Axes | None = None,
        *,
        pressure_error: float,
        **options: Any,
    ) -> Axes:
        """Draw what one rate would have shown behind a gauge's record, and what cases compute.

        Parameters
        ----------
        well : of the dataset, whose cases flow at one rate from the start.
        time, pressure : (n,) s, increasing, and Pa, measured.
        rates : (time in s, new rate in m³/s) of the record, in order.
        ax : matplotlib Axes to draw on; by default pyplot's current.
        pressure_error : standard deviation of the measured pressures, Pa.
        options : more of `sweep.analysis.deconvolution.deconvolve`, as `rate_error`.

        Raises ResultsError where there is no such well, its rate changes, too many cases are done,
        or the record allows no deconvolution.
        """
        from demflow.sweep.analysis.deconvolution import deconvolve
        from demflow.sweep.figures.deconvolution import plot_deconvolution

        for name in ("pressure_change", "pressure_derivative", "well_rate"):
            self._variable(name)
        self._check_well(well)
        try:
            found = deconvolve(time, pressure, rates, pressure_error=pressure_error, **options)
        except ValueError as error:
            raise ResultsError(str(error)) from None
        return plot_deconvolution(self._dataset, well, found, _axes(ax))

    def plot_sensitivity(
        self, of: str | xr.DataArray, ax: Axes | None = None, **options: Any
    ) -> Axes:
        """Draw how much each sampled parameter decides a result: Sobol' or Morris bars.

        Parameters
        ----------
        of : a variable with one number a case, or such an array made of some.
        ax : matplotlib Axes to draw on; by default pyplot's current.
        options : of `sensitivity`.
        """
        from demflow.sweep.figures.sensitivity import plot_sensitivity

        return plot_sensitivity(self.sensitivity(of, **options), _axes(ax))

    def plot_tornado(self, of: str | xr.DataArray, ax: Axes | None = None, **at: Any) -> Axes:
        """Draw how far each axis of the study moves a number alone; return the axes.

        Bars go from the number's least to its greatest along an axis, at whose values it has them,
        while the others stay.

        Parameters
        ----------
        of : a variable with one number a case, or such an array made of some.
        ax : matplotlib Axes to draw on; by default pyplot's current.
        at : where an axis stays while others move, as `rate=1e-5`; by default in its middle.
        """
        from demflow.sweep.figures.sensitivity import plot_tornado

        held = {str(axis): n // 2 for axis, n in self._variable("status").sizes.items()}
        held |= self._places(at)
        return plot_tornado(self._dataset, self._numbers(of), held, _axes(ax))

    def plot_work_precision(self, ax: Axes | None = None) -> Axes:
        """Draw the error of each solver against its processor time; return the axes.

        Of a study that varies `solver.method` and observes `time_error`; medians over its other
        axes, so choose one scene and size first.
        """
        from demflow.sweep.analysis.speed import ladders_of
        from demflow.sweep.figures.speed import plot_work_precision

        return plot_work_precision(ladders_of(self._dataset), _axes(ax))

    def plot_settlement(self, wall: str, ax: Axes | None = None) -> Axes:
        """Draw the way of a wall inwards against time, a few cases; return the axes."""
        from demflow.sweep.figures.movement import plot_settlement

        return plot_settlement(self._dataset, wall, _axes(ax))

    def plot_slip(self, ax: Axes | None = None, of: str = "joint_slip") -> Axes:
        """Draw slip of joints against the first well's pressure, a few cases; return the axes.

        Parameters
        ----------
        ax : matplotlib Axes to draw on; by default pyplot's current.
        of : joint_slip, or permeability_in_time.
        """
        from demflow.sweep.figures.movement import plot_slip

        return plot_slip(self._dataset, _axes(ax), of)

    def plot_breaks(self, ax: Axes | None = None, *, places: bool = False, **at: Any) -> Axes:
        """Draw how much of one case broke until each time, by mode, or where; return the axes.

        Parameters
        ----------
        ax : matplotlib Axes to draw on; by default pyplot's current.
        places : draw where it broke instead.
        at : the case, by its value on every axis of the study that varies.
        """
        from demflow.sweep.figures.events import plot_break_places, plot_breaks

        self._variable("event_time")
        chosen = self._places(at)
        sizes = self._variable("status").sizes
        left = [str(axis) for axis, n in sizes.items() if n > 1 and axis not in chosen]
        if left:
            raise ResultsError(f"choose the case: give a value of {', '.join(left)}")
        own = events(self._dataset, {str(axis): 0 for axis in sizes} | chosen)
        return (plot_break_places if places else plot_breaks)(own, _axes(ax))

    def plot_along(self, of: str | xr.DataArray, axis: str, ax: Axes | None = None) -> Axes:
        """Draw a number against an axis of the study; return the axes.

        The line is the mean over the other axes (geometric where all is above zero), the band from
        the least to the greatest, such as over packings.

        Parameters
        ----------
        of : a variable with one number a case, or such an array made of some.
        axis : of the study.
        ax : matplotlib Axes to draw on; by default pyplot's current.
        """
        from demflow.sweep.figures.permeability import place_axis, plot_along, tick_names

        values = self._numbers(of)
        if axis not in values.dims:
            there = ", ".join(map(str, values.dims)) or "none"
            raise ResultsError(f"{axis} is no axis of it; they are {there}")
        panel = plot_along(self._dataset, values, axis, _axes(ax))
        place_axis(panel, self._dataset, axis, tick_names(self._dataset, axis))
        return panel

    def plot_over(
        self, of: str | xr.DataArray, x: str, y: str, ax: Axes | None = None, *, bar: bool = True
    ) -> Axes:
        """Draw a number over two axes of the study as colours, means over the others.

        Parameters
        ----------
        of : a variable with one number a case, or such an array made of some.
        x, y : axes of the study.
        ax : matplotlib Axes to draw on; by default pyplot's current.
        bar : with a colour bar.
        """
        from demflow.sweep.figures.two_axes import plot_over

        panel = plot_over(self._dataset, self._numbers(of), x, y, _axes(ax))
        return _with_bar(panel, panel.images[0]) if bar else panel

    def plot_ellipses(self, x: str, y: str, ax: Axes | None = None) -> Axes:
        """Draw permeability tensors over two axes of the study as ellipses; return the axes."""
        from demflow.sweep.figures.two_axes import plot_ellipses

        return plot_ellipses(self._dataset, x, y, _axes(ax))

    def plot_permeability_rose(self, ax: Axes | None = None) -> Axes:
        """Draw how permeable each case is in every direction; return the axes."""
        from demflow.sweep.figures.permeability import plot_permeability_rose

        return plot_permeability_rose(self._dataset, _axes(ax))

    def plot_topology(self, ax: Axes | None = None) -> Axes:
        """Draw the parts of I, Y and X nodes of the fractures of each case; return the axes."""
        from demflow.sweep.figures.traces import plot_topology

        return plot_topology(self._dataset, _axes(ax))

    def plot_rose(self, ax: Axes | None = None) -> Axes:
        """Draw where traces point, of maps that `open_case` gives; return the axes."""
        from demflow.sweep.figures.traces import plot_rose

        return plot_rose(self._dataset, _axes(ax))

    def plot_lengths(self, ax: Axes | None = None) -> Axes:
        """Draw how many traces are at least so long, of maps of `open_case`; return the axes."""
        from demflow.sweep.figures.traces import plot_lengths

        return plot_lengths(self._dataset, _axes(ax))

    def plot_map(
        self, ax: Axes | None = None, time: float | None = None, *, bar: bool = True
    ) -> Axes:
        """Draw pressure over the pores, of maps that `open_case` gives; return the axes.

        Parameters
        ----------
        ax : matplotlib Axes to draw on; by default pyplot's current.
        time : s, the nearest recorded one; by default the last.
        bar : with a colour bar.
        """
        from demflow.sweep.figures.maps import plot_map

        panel = plot_map(self._dataset, _axes(ax), time)
        return _with_bar(panel, panel.collections[0]) if bar else panel

    def animate(self, path: str | Path, breaks: xr.Dataset | None = None) -> Path:
        """Write pressure in time, of maps that `open_case` gives, as GIF or MP4; return the path.

        Parameters
        ----------
        path : its suffix, .gif or .mp4 (which needs ffmpeg), tells which.
        breaks : `event_time` (s), `event_x` and `event_y` (m) of what broke, drawn over the maps.

        At most 40 recorded times are drawn. Raises ResultsError where there are no two.
        """
        from demflow.sweep.figures.animation import draw_animation
        from demflow.sweep.figures.style import house_style

        with house_style():
            return draw_animation(self._dataset, Path(path), breaks=breaks)

    def plot_forces(self, ax: Axes | None = None) -> Axes:
        """Draw chains of normal forces, of maps that `open_case` gives; return the axes."""
        from demflow.sweep.figures.holes import plot_forces

        return plot_forces(self._dataset, _axes(ax))

    def permeability(self) -> xr.Dataset:
        """Return principal permeabilities, direction and anisotropy of each case."""
        return principal_permeability(self._variable("permeability"))

    def radial_permeability(self, viscosity: xr.DataArray | float) -> xr.DataArray:
        """Permeability that each well's first flow period shows in radial flow, m²; NaN where none.

        Parameters
        ----------
        viscosity : of the fluid, Pa s; one number or an array over the axes that vary it.
        """
        from demflow.sweep.analysis.regimes import fitted_permeability

        for name in ("pressure_change", "pressure_derivative", "well_rate"):
            self._variable(name)  # or it is told which is missing
        return fitted_permeability(self._dataset, viscosity)

    def sensitivity(self, of: str | xr.DataArray, **options: Any) -> xr.Dataset:
        """Return how much each sampled parameter decides a result, see `sweep.sensitivity`."""
        return sensitivity(self._dataset, of, **options)

    def to_dataframe(self, names: str | Sequence[str] | None = None) -> pd.DataFrame:
        """Return variables as a table with a row for each case and place; names carry units.

        Rows of what cases have many of, as events, bear the values of their case on the axes.

        Parameters
        ----------
        names : variables that lie along the same dimensions; by default all that lie along the
            axes of the study alone.

        Raises ResultsError where they do not, or where events are those of other cases than the
        dataset holds.
        """
        if names is None:
            axes = self._variable("status").dims
            chosen = [n for n, v in self._dataset.data_vars.items() if v.dims == axes]
        else:
            chosen = [names] if isinstance(names, str) else list(names)
        if not chosen:
            raise ResultsError("no variable is named to make a table of")
        variables = {name: self._variable(str(name)) for name in chosen}
        shapes = {variable.dims for variable in variables.values()}
        if len(shapes) > 1:
            raise ResultsError(
                "variables of one table lie along the same dimensions; these lie along "
                + " and ".join(sorted(", ".join(map(str, one)) or "none" for one in shapes))
            )
        if shapes == {()}:  # one case without axes is one row
            row = {n: [v.item()] for n, v in variables.items()}
            import pandas as pd

            table = pd.DataFrame(row)
        else:
            along = {str(name) for dimensions in shapes for name in dimensions}
            table = xr.Dataset(variables).to_dataframe().reset_index()
            for dimension in along:
                for place, (axis, values) in enumerate(self._cases_along(dimension).items()):
                    table.insert(place, axis, values)
        return table.rename(columns=self._named)

    def to_csv(self, path: str | Path, names: str | Sequence[str] | None = None) -> Path:
        """Write what `to_dataframe` gives as CSV, numbers in all their digits."""
        self.to_dataframe(names).to_csv(path, index=False)
        return Path(path)

    def to_parquet(self, path: str | Path, names: str | Sequence[str] | None = None) -> Path:
        """Write what `to_dataframe` gives as Parquet. Raises ResultsError without pyarrow."""
        try:
            self.to_dataframe(names).to_parquet(path, index=False)
        except ImportError:
            raise ResultsError("Parquet needs pyarrow: pip install pyarrow") from None
        return Path(path)

    def _places(self, at: Mapping[str, Any]) -> Index:
        """Positions of values on axes of the study. Raises ResultsError where one is not there."""
        found: Index = {}
        for axis, value in at.items():
            if axis not in self._variable("status").dims:
                there = ", ".join(map(str, self._variable("status").dims)) or "none"
                raise ResultsError(f"{axis} is no axis of the study; they are {there}")
            values = self._dataset[axis].values
            places = [k for k, one in enumerate(values) if same_value(one, value)]
            if not places:  # the nearest one is not taken in silence
                told = ", ".join(str(one) for one in values)
                raise ResultsError(f"{axis} = {value} is not there; give one of {told}")
            found[axis] = places[0]
        return found

    def _numbers(self, of: str | xr.DataArray) -> xr.DataArray:
        """One number a case. Raises ResultsError for what has more."""
        values = self._variable(of) if isinstance(of, str) else of
        more = [str(d) for d in values.dims if d not in self._variable("status").dims]
        if more:
            raise ResultsError(
                f"{values.name} has more than one number a case, along {', '.join(more)}; choose, "
                f"as dataset.{values.name}.isel({more[0]}=-1)"
            )
        return values

    def _variable(self, name: str) -> xr.DataArray:
        if name not in self._dataset:
            there = ", ".join(map(str, self._dataset.data_vars))
            raise ResultsError(f"the dataset has no {name}; it has {there}")
        return self._dataset[name]

    def _check_well(self, well: str) -> None:
        """Raise ResultsError where there is no such well."""
        there = [str(name) for name in self._dataset["well"].values]
        if well not in there:
            raise ResultsError(f"there is no well {well}; there are {', '.join(there)}")

    def _cases_along(self, dimension: str) -> dict[str, np.ndarray]:
        """Values of the axes along a dimension on which cases stand one after the other; else {}.

        Raises ResultsError where the counts of the cases do not add up to what is there.
        """
        counts = self._dataset.get(count_name(dimension))
        if counts is None or counts.attrs.get("sample_dimension") != dimension:
            return {}
        cases = np.repeat(np.arange(counts.size), counts.values.ravel())
        if len(cases) != self._dataset.sizes[dimension]:
            raise ResultsError(
                f"each {dimension} belongs to a case by the {counts.name} of all of them, and the "
                "dataset holds some of them only; make the table of the whole dataset"
            )
        places = np.unravel_index(cases, counts.shape) if counts.dims else ()
        return {
            str(axis): self._dataset[axis].values[at]
            for axis, at in zip(counts.dims, places, strict=True)
        }

    def _check_told(self, well: str, rates: Sequence[tuple[float, float]]) -> None:
        """Raise ResultsError where rates told of a well are not those that it has."""
        when, new = np.array(rates, dtype=float).reshape(-1, 2).T
        if not len(when) or np.any(np.diff(when) <= 0.0):
            raise ResultsError("rates are pairs (time in s, rate in m³/s), times increasing")
        times = np.asarray(self._dataset["elapsed_time"].values, dtype=float)
        steps = np.append(0.0, new)[np.searchsorted(when, times)]
        at_change = np.isclose(times[:, None], when, rtol=1e-9, atol=0.0).any(axis=1)
        rate = self._variable("well_rate").sel(well=well)
        said = xr.DataArray(np.where(at_change, np.nan, steps), dims="elapsed_time")
        off = abs(rate.drop_vars("elapsed_time") - said) > 1e-6 * np.abs(new).max()
        at = off.any([name for name in off.dims if name != "elapsed_time"]).values
        if at.any():
            first = int(np.flatnonzero(at)[0])
            other = rate.isel(elapsed_time=first).where(off.isel(elapsed_time=first))
            raise ResultsError(
                f"rates say {float(said[first]):.6g} m3/s after {times[first]:.6g} s, where the "
                f"rate of {well} is {float(other.max()):.6g} m3/s; give its own, and choose cases "
                "that have them"
            )

    def _check_rates(
        self,
        change: xr.DataArray,
        instead: str = "take the dataset's own pressure_derivative, or plot_well with since= and "
        "until=",
    ) -> None:
        """Raise ResultsError where the rate of a well with a pressure change is not one."""
        if "well_rate" not in self._dataset:
            return
        rate = self._dataset["well_rate"].where(change.notnull())
        spread = rate.max("elapsed_time") - rate.min("elapsed_time")
        changes = spread > 1e-9 * abs(rate).max("elapsed_time")
        changing = changes.any([name for name in changes.dims if name != "well"])
        if bool(changing.any()):
            names = ", ".join(str(one) for one in self._dataset["well"].values[changing.values])
            raise ResultsError(
                f"the rate of {names} changes, and a derivative is of one flow period; {instead}"
            )

    def _named(self, name: str) -> str:
        """A column's name with its unit."""
        if name not in self._dataset.variables:
            return name
        unit = str(self._dataset[name].attrs.get("units", "1"))
        return name if unit == "1" or not unit else f"{name} [{unit}]"


def _last_period(
    times: np.ndarray,
    pressure: np.ndarray,
    change: np.ndarray,
    rate: np.ndarray,
    rates: Sequence[tuple[float, float]] | None,
) -> tuple[tuple[np.ndarray, np.ndarray], list[tuple[float, float]]]:
    """Times and pressures of a case's last flow period, from just before it, and all its rates.

    Raises ValueError where it has no pressure in that period.
    """
    known = [(0.0, float(rate[-1]))] if rates is None else list(rates)
    before = known[-2][1] if len(known) > 1 else 0.0
    begin, sign = known[-1][0], np.sign(known[-1][1] - before)
    now = (times > begin) & np.isfinite(pressure) & np.isfinite(change)
    if not now.any():
        raise ValueError("no pressure after the last change of the rate")
    first = float((pressure + sign * change)[now][0])
    return (np.append(begin, times[now]), np.append(first, pressure[now])), known


def _axes(ax: Axes | None) -> Axes:
    if ax is not None:
        return ax
    from matplotlib import pyplot

    return pyplot.gca()


def _with_bar(panel: Axes, colours: Any) -> Axes:
    figure = panel.get_figure(root=True)
    assert figure is not None
    figure.colorbar(colours, ax=panel, label=colours.get_label())
    return panel


def _check_unit(unit: str, like: str) -> None:
    """Raise ResultsError for a unit that measures something else."""
    try:
        given = parse_unit(unit)
    except UnitError as error:
        raise ResultsError(str(error)) from None
    if given.dimension != parse_unit(like).dimension:
        raise ResultsError(f"{unit} is no unit of a {'time' if like == 's' else 'pressure'}")


def compare(*folders: str | Path, lazy: bool = False) -> xr.DataTree:
    """Return the datasets of several studies side by side, a node for each under its name.

    Parameters
    ----------
    folders : `results/<study>` of each.
    lazy : leave the numbers on disk until they are asked for.

    `tree.map_over_datasets(f)` does the same with all of them. Raises ResultsError where one has no
    dataset, or two have one name.
    """
    found: Mapping[str, xr.Dataset] = {}
    for folder in folders:
        dataset = open_results(folder, lazy=lazy)
        name = str(dataset.attrs["study"])
        if name in found:
            raise ResultsError(f"two of the studies are named {name}")
        found = {**found, name: dataset}
    return xr.DataTree.from_dict({f"/{name}": dataset for name, dataset in found.items()})
