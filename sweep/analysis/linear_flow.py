"""Linear flow against Eq. 24: dimensionless pressure in bins along the flow."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from demflow.model.analytic.linear import linear_pressure
from demflow.model.scene import Rectangle, Scene
from demflow.sweep.analysis.cases import case_title
from demflow.sweep.analysis.compare import (
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


class LinearComparison(NamedTuple):
    """Dimensionless pressure in bins along the flow; c cases, t times, b bins."""

    x_D: np.ndarray  # (b,) mean place of the pores in each bin
    times: np.ndarray  # (c, t) s
    t_D: np.ndarray  # (c, t)
    computed: np.ndarray  # (c, t, b) mean P_D of the pores in each bin
    expected: np.ndarray  # (c, t, b) mean of Eq. 24 at the same pores and t_D
    initial: np.ndarray  # (c,) P_D of the initial pressure: 0, but where no side is at it
    porosity: np.ndarray  # (c,)
    flow: np.ndarray  # (c,) m³/s into the region at the last time, NaN where not observed
    darcy_flow: np.ndarray  # (c,) m³/s, k H (P_1 − P_2) / (μ L)
    titles: tuple[str, ...]  # (c,)

    @property
    def rms(self) -> np.ndarray:
        """RMS of computed − expected over times and bins, (c,), in units of P_1 − P_2."""
        found: np.ndarray = np.sqrt(np.nanmean((self.computed - self.expected) ** 2, axis=(1, 2)))
        return found


class _Sample(NamedTuple):
    """Where and between which pressures a scene flows; `first` is the side at P_i if one is."""

    length: float  # m
    width: float  # m
    distance: np.ndarray  # (domains,) m from the first side
    first_side: str
    first: float  # Pa
    second: float  # Pa


def _sample(scene: Scene, maps: xr.Dataset) -> _Sample:
    assert isinstance(scene.region, Rectangle)
    pressures = dict(scene.held_sides)
    length, width = scene.region.width, scene.region.height
    sides, along = ("left", "right"), "x"
    if "left" not in pressures:
        length, width, sides, along = width, length, ("bottom", "top"), "y"
    distance = maps[along].values + 0.5 * length
    first, second = sides
    if pressures[second] == scene.initial_pressure != pressures[first]:
        first, second, distance = second, first, length - distance
    return _Sample(length, width, distance, first, pressures[first], pressures[second])


def compare_linear(dataset: xr.Dataset, scene_of: SceneOf, maps_of: MapsOf) -> LinearComparison:
    """P_D in 15 bins along the flow against Eq. 24, for every case that is done.

    Where neither side is at the initial pressure, the general form (Eq. 74) takes the place
    of Eq. 24, with the same P_D = (P_1 − P) / (P_1 − P_2).

    Parameters
    ----------
    dataset : the study's dataset (`porosity`, `status`, `elapsed_time`).
    scene_of, maps_of : the scene and the maps of the case at an index.

    Raises
    ------
    ComparisonError : no case is done, or a scene that is not the formula's (says which and why).
    """
    edges = np.linspace(0.0, 1.0, BINS + 1)
    rows: list[dict[str, Any]] = []
    titles, places = [], []
    for index, scene in comparable_cases(dataset, scene_of, "linear"):
        case, maps = dataset.isel(index), maps_of(index)
        times = np.array(scene.times)
        sample = _sample(scene, maps)
        initial = initial_pressure_of(scene)
        phi, k, fluid = float(case["porosity"]), compared_permeability(scene, case), fluid_of(scene)
        diffusivity = k / (scene.stores(phi) * fluid.viscosity)
        formula = linear_pressure(
            np.clip(sample.distance, 0.0, sample.length),
            times[:, None],
            length=sample.length,
            diffusivity=diffusivity,
            initial=initial,
            first=sample.first,
            second=sample.second,
        )
        pressure = (
            maps["pressure"].sel(elapsed_time=times).transpose("elapsed_time", "domain").values
        )
        fall = sample.first - sample.second
        flow = np.nan
        if "boundary_flow" in case:
            flow = float(
                case["boundary_flow"].sel(boundary=sample.first_side, elapsed_time=times[-1])
            )
        place = sample.distance / sample.length
        rows.append(
            {
                "times": times,
                "t_D": diffusivity * times / sample.length**2,
                "computed": bin_means(place, (sample.first - pressure) / fall, edges),
                "expected": bin_means(place, (sample.first - formula) / fall, edges),
                "initial": (sample.first - initial) / fall,
                "porosity": phi,
                "flow": flow,
                "darcy_flow": k * sample.width * fall / (fluid.viscosity * sample.length),
            }
        )
        titles.append(case_title(dataset, index))
        places.append(place)
    every = np.concatenate(places)
    return LinearComparison(
        x_D=bin_means(every, every, edges), titles=tuple(titles), **stacked(rows)
    )


def linear_tables(result: LinearComparison) -> list[Table]:
    """The comparison in numbers: per time, and per case."""
    difference = result.computed - result.expected
    by_time = np.sqrt(np.nanmean(difference**2, axis=2))
    overall = result.rms
    per_time = [
        (t.mean(), t_D.mean(), rms.mean(), spread(rms), rms.max())
        for t, t_D, rms in zip(result.times.T, result.t_D.T, by_time.T, strict=True)
    ]
    per_time.append(("all", "", overall.mean(), spread(overall), overall.max()))
    per_case = [
        (title or "only case", phi, rms, np.nanmax(np.abs(gap)), flow, darcy, flow / darcy - 1.0)
        for title, phi, rms, gap, flow, darcy in zip(
            result.titles,
            result.porosity,
            overall,
            difference,
            result.flow,
            result.darcy_flow,
            strict=True,
        )
    ]
    return [
        table(
            f"P_D against Eq. 24 in {len(result.x_D)} bins along the flow, {len(overall)} cases",
            ("time (s), mean", "t_D, mean", "RMS, mean", "RMS, spread", "RMS, worst case"),
            per_time,
        ),
        table(
            "P_D against Eq. 24, and the flow at the last time against Darcy's law, case by case",
            (
                "case",
                "porosity",
                "RMS of P_D",
                "largest difference of P_D",
                "flow (m³/s)",
                "Darcy (m³/s)",
                "relative difference of flow",
            ),
            per_case,
        ),
    ]
