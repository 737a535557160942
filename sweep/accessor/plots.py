"""Pictures of a study's dataset on axes of yours: the `plot_…` of `dataset.demflow`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from demflow.sweep.accessor.chosen import Chosen, last_period
from demflow.sweep.analysis.cases import case_title, done, events
from demflow.sweep.analysis.sensitivity import sensitivity
from demflow.sweep.errors import ResultsError
from demflow.sweep.study.reservoir import Rock
from demflow.sweep.study.units import UnitError, parse_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class Plots(Chosen):
    """Draws on matplotlib Axes, which it returns; on pyplot's current ones where none are given."""

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
                record, known = last_period(times, p, fall, rate, rates)
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

        return plot_sensitivity(sensitivity(self._dataset, of, **options), _axes(ax))

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
