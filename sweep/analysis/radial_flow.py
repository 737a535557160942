"""Radial flow against Eq. 29: dimensionless pressure of the well and of the pores around it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from demflow.model.analytic.radial import radial_dimensionless_pressure
from demflow.model.analytic.wells import thiem_pressure_fall
from demflow.model.scene import Circle
from demflow.sweep.analysis.cases import case_title
from demflow.sweep.analysis.compare import (
    ComparisonError,
    MapsOf,
    SceneOf,
    bin_means,
    comparable_cases,
    compared_permeability,
    fluid_of,
    initial_pressure_of,
    spread,
    stacked,
)
from demflow.sweep.analysis.table import Table, table

BINS = 15


class RadialComparison(NamedTuple):
    """Dimensionless pressure of the well and around it; c cases, t times, b bins of radius."""

    R_De: float
    R_D: (
        np.ndarray
    )  # (b,) mean place (in log) of the pores in each bin; empty where no map was observed
    times: np.ndarray  # (c, t) s
    t_D: np.ndarray  # (c, t)
    well: np.ndarray  # (c, t) P_D of the well
    expected: np.ndarray  # (c, t) Eq. 29 at R_D = 1
    profile: np.ndarray  # (c, t, b) mean P_D of the pores in each bin
    expected_profile: np.ndarray  # (c, t, b) mean of Eq. 29 at the same pores
    porosity: np.ndarray  # (c,)
    initial: np.ndarray  # (c,) Pa
    steady_pressure: np.ndarray  # (c,) Pa, well pressure at the last time
    expected_steady: np.ndarray  # (c,) Pa, Thiem
    titles: tuple[str, ...]  # (c,)

    @property
    def error(self) -> np.ndarray:
        """Relative error of the well's P_D, (c, t)."""
        found: np.ndarray = self.well / self.expected - 1.0
        return found

    @property
    def steady_error(self) -> np.ndarray:
        """Relative error of the fall of pressure at the last time against Thiem's, (c,)."""
        fall = self.initial - self.expected_steady
        found: np.ndarray = (self.initial - self.steady_pressure) / fall - 1.0
        return found


def compare_radial(
    dataset: xr.Dataset, scene_of: SceneOf, maps_of: MapsOf | None
) -> RadialComparison:
    """P_D of the well and of the pores around it against Eq. 29, for every case that is done.

    P_D = (P_i − P) / (q μ ln(R_De) / 2πk): the unit is the steady state's by formula, not the
    computed one, so that an error of the steady state shows.

    Parameters
    ----------
    dataset : the study's dataset (`well_pressure`, `porosity`, `status`, `elapsed_time`).
    scene_of, maps_of : the scene and the maps of the case at an index; without maps the
        profiles are empty.

    Raises
    ------
    ComparisonError : no case is done, a scene that is not the formula's (says which and why),
        or cases with different R_De.
    """
    cases = comparable_cases(dataset, scene_of, "radial")
    ratios = {
        scene.region.radius / scene.wells[0].radius
        for _, scene in cases
        if isinstance(scene.region, Circle)
    }
    if len(ratios) > 1:
        raise ComparisonError(
            f"figures.compare radial: the cases have several R_De: {sorted(ratios)}"
        )
    (R_De,) = ratios
    edges = np.geomspace(1.0, R_De, BINS + 1) if maps_of else np.ones(1)
    rows: list[dict[str, Any]] = []
    titles, places = [], [np.empty(0)]
    for index, scene in cases:
        case, well, fluid = dataset.isel(index), scene.wells[0], fluid_of(scene)
        times = np.array(scene.times)
        phi, k = float(case["porosity"]), compared_permeability(scene, case)
        initial, rate = initial_pressure_of(scene), well.rate or 0.0
        fall = float(thiem_pressure_fall(rate, fluid.viscosity, k, 1.0, R_De))
        t_D = k * times / (scene.stores(phi) * fluid.viscosity * well.radius**2)
        pressure = case["well_pressure"].sel(well=well.name, elapsed_time=times).values
        profile = expected_profile = np.empty((len(times), 0))
        if maps_of:
            maps = maps_of(index)
            radius = np.hypot(maps["x"].values, maps["y"].values) / well.radius
            around = (radius >= 1.0) & (radius < R_De)
            at_times = maps["pressure"].sel(elapsed_time=times)
            P = at_times.transpose("elapsed_time", "domain").values[:, around]
            formula = radial_dimensionless_pressure(radius[around], t_D[:, None], R_De)
            places.append(radius[around])
            profile = bin_means(radius[around], (initial - P) / fall, edges)
            expected_profile = bin_means(radius[around], formula, edges)
        rows.append(
            {
                "times": times,
                "t_D": t_D,
                "well": (initial - pressure) / fall,
                "expected": radial_dimensionless_pressure(1.0, t_D, R_De),
                "profile": profile,
                "expected_profile": expected_profile,
                "porosity": phi,
                "initial": initial,
                "steady_pressure": pressure[-1],
                "expected_steady": initial - fall,
            }
        )
        titles.append(case_title(dataset, index))
    every = np.concatenate(places)
    return RadialComparison(
        R_De=R_De,
        R_D=np.exp(bin_means(every, np.log(every), edges)),
        titles=tuple(titles),
        **stacked(rows),
    )


def radial_tables(result: RadialComparison) -> list[Table]:
    """The comparison in numbers: per time, and the steady state per case."""
    error = result.error
    per_time = [
        (
            result.times[:, i].mean(),
            result.t_D[:, i].mean(),
            result.well[:, i].mean(),
            result.expected[:, i].mean(),
            error[:, i].mean(),
            spread(error[:, i]),
            error[np.argmax(np.abs(error[:, i])), i],
        )
        for i in range(result.times.shape[1])
    ]
    steady = (result.porosity, result.steady_pressure, result.expected_steady, result.steady_error)
    per_case = [
        (title or "only case", *numbers)
        for title, *numbers in zip(result.titles, *steady, strict=True)
    ]
    if len(per_case) > 1:
        per_case.append(("mean", *(column.mean() for column in steady)))
    return [
        table(
            f"P_D of the well against Eq. 29, {len(error)} cases, R_De = {result.R_De:.4g}",
            (
                "time (s), mean",
                "t_D, mean",
                "P_D, mean",
                "Eq. 29, mean",
                "relative error, mean",
                "relative error, spread",
                "relative error, worst case",
            ),
            per_time,
        ),
        table(
            "Well pressure at the last time against the formula's steady state",
            (
                "case",
                "porosity",
                "computed (Pa)",
                "formula (Pa)",
                "difference over the formula's fall",
            ),
            per_case,
        ),
    ]
