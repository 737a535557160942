"""Computed pressures against the continuum's: Eq. 24 for linear, Eq. 29 for radial flow.

This is the *model error*: what is left between a packing of discs and the continuum, as mean
and spread over packings. The time error, against the exact solution of the same network,
stands in the dataset as `time_error`.

Every case is made dimensionless with its own numbers: porosity as measured, permeability as
asked for (as measured where apertures follow stress), the fluid's viscosity and bulk modulus,
and the distances between the places at which the scene imposes pressures and rates. This
module holds what `linear_flow` and `radial_flow` share.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import xarray as xr

from demflow.model.region import Circle, Rectangle
from demflow.model.scene import Fluid, Scene
from demflow.sweep.analysis.cases import Index, case_title, done

SceneOf = Callable[[Index], Scene]  # the scene of a case
MapsOf = Callable[[Index], xr.Dataset]  # the maps of a case


class ComparisonError(ValueError):
    """Cases that cannot be held against a formula; the text says which and why."""


def comparison_problem(scene: Scene, kind: str) -> str | None:
    """Why a scene cannot be held against the formula of `kind` (linear, radial), or None."""
    if kind not in ("linear", "radial"):
        return f"{kind!r} is none of linear, radial"
    if scene.fractures:
        return "the formula knows no fractures"
    if scene.uniform_pressure is None or not scene.times:
        return "the formula needs one initial_pressure everywhere, and times"
    return _linear_problem(scene) if kind == "linear" else _radial_problem(scene)


def _linear_problem(scene: Scene) -> str | None:
    pressures = dict(scene.held_sides)
    if not isinstance(scene.region, Rectangle):
        return "linear flow needs a rectangle"
    opposite = set(pressures) in ({"left", "right"}, {"bottom", "top"})
    if not opposite or scene.wells or scene.inflow_sides:
        return "linear flow needs pressures on two opposite sides and no well"
    if len(set(pressures.values())) == 1:
        return "the two sides have the same pressure"
    if "pressure_map" not in scene.observe:
        return "linear flow is compared on the map: observe pressure_map"
    return None


def _radial_problem(scene: Scene) -> str | None:
    if not isinstance(scene.region, Circle):
        return "radial flow needs a circle"
    if len(scene.wells) != 1 or scene.wells[0].rate in (None, 0):
        return "radial flow needs one well at a constant rate"
    if math.hypot(*scene.wells[0].at) > 1e-9 * scene.region.radius:
        return "the well must stand in the middle"
    if scene.inflow_sides or dict(scene.held_sides) != {"outer": scene.initial_pressure}:
        return "the outer boundary must keep the initial pressure"
    if "well_pressure" not in scene.observe:
        return "radial flow is compared at the well: observe well_pressure"
    return None


def comparable_cases(
    dataset: xr.Dataset, scene_of: SceneOf, kind: str
) -> list[tuple[Index, Scene]]:
    """Every case that is done, with its scene.

    Raises ComparisonError where none is done or a scene is not the formula's, saying why.

    Parameters
    ----------
    dataset : as `open_results` gives it
    scene_of : the scene of the case at an index
    kind : linear or radial
    """
    cases = [(index, scene_of(index)) for index in done(dataset)]
    if not cases:
        raise ComparisonError("no case is done, so there is nothing to compare")
    for index, scene in cases:
        problem = comparison_problem(scene, kind)
        if problem:
            where = case_title(dataset, index) or "the only case"
            raise ComparisonError(f"figures.compare {kind}: {problem} ({where})")
    if len({len(scene.times) for _, scene in cases}) > 1:
        raise ComparisonError(f"figures.compare {kind}: the cases have different numbers of times")
    return cases


def fluid_of(scene: Scene) -> Fluid:
    """The fluid of a scene that is compared with a formula of flow."""
    if scene.fluid is None:
        raise ComparisonError("the comparison needs a fluid")
    return scene.fluid


def initial_pressure_of(scene: Scene) -> float:
    """The pressure everywhere before the first time, Pa."""
    if scene.uniform_pressure is None:
        raise ComparisonError("the comparison needs one initial_pressure everywhere")
    return scene.uniform_pressure


def compared_permeability(scene: Scene, case: xr.Dataset) -> float:
    """Permeability for t_D and Darcy's law, m²: as asked for, or as measured under stress."""
    matrix = scene.pipes
    if matrix is not None and matrix.permeability is not None and scene.stress is None:
        return matrix.permeability
    if "permeability" not in case:
        raise ComparisonError(
            "the comparison needs a permeability: give one, or observe permeability"
        )
    tensor = case["permeability"].values
    return float(0.5 * (tensor[0, 0] + tensor[1, 1]))


def bin_means(place: np.ndarray, values: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Mean of values (..., n) in each bin of places (n,), (..., bins); NaN in empty bins.

    Parameters
    ----------
    place : (n,)
    values : (..., n)
    edges : of the bins, (bins + 1,)
    """
    bins = len(edges) - 1
    member = np.searchsorted(edges, place, side="right") - 1
    (inside,) = np.nonzero((member >= 0) & (member < bins))
    chosen = np.zeros((len(place), bins))
    chosen[inside, member[inside]] = 1.0
    count = chosen.sum(axis=0)
    total = values @ chosen
    found: np.ndarray = np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)
    return found


def spread(values: np.ndarray) -> float:
    """Standard deviation over packings (n − 1 in the divisor); NaN for one."""
    return float(np.std(values, ddof=1)) if len(values) > 1 else math.nan


def stacked(rows: Sequence[dict[str, Any]]) -> dict[str, np.ndarray]:
    """One array a name from one dictionary a case, cases along the first axis."""
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}
