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
from demflow.sweep.accessor.chosen import last_period
from demflow.sweep.accessor.plots import Plots
from demflow.sweep.analysis.cases import done
from demflow.sweep.analysis.permeability import ensemble, principal_permeability
from demflow.sweep.analysis.sensitivity import sensitivity
from demflow.sweep.dataset.open import open_results
from demflow.sweep.dataset.ragged import count_name
from demflow.sweep.errors import ResultsError
from demflow.sweep.study.reservoir import Rock

if TYPE_CHECKING:
    import pandas as pd

    from demflow.sweep.analysis.fitting import Fit


# of what a straight line says, where it is no pressure
_UNITS = {
    **dict.fromkeys(("permeability", "permeability_error"), "m2"),
    **dict.fromkeys(("skin_factor", "skin_error", "points"), "1"),
    **dict.fromkeys(("start", "end"), "s"),
}


@xr.register_dataset_accessor("demflow")  # type: ignore[no-untyped-call]
class Results(Plots):
    """What a study's dataset can tell, and show. Nothing is changed in it."""

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
                record, known = last_period(times, p, fall, rate, rates)
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

    def permeability(self, of: str = "permeability") -> xr.Dataset:
        """Return principal permeabilities, direction and anisotropy of each case.

        `of` names another tensor of the results, as periodic_permeability.
        """
        return principal_permeability(self._variable(of))

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

    def _named(self, name: str) -> str:
        """A column's name with its unit."""
        if name not in self._dataset.variables:
            return name
        unit = str(self._dataset[name].attrs.get("units", "1"))
        return name if unit == "1" or not unit else f"{name} [{unit}]"


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
