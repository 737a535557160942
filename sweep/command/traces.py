"""What `check` tells of traces that a study draws or reads, and of apertures and their stress."""

from __future__ import annotations

import math

import numpy as np

from demflow.model.scene import Grains, RandomSet, Scene, TraceMap, lines_of
from demflow.model.scene.trace_maps import LaidMap
from demflow.sweep.study.cases import case_at
from demflow.sweep.study.load import Study

MOST_TOLD = 20  # maps and sets of which `check` tells


def told_traces(study: Study) -> list[str]:
    """One line for each map and each random set of the first case, of many for the first."""
    scene = case_at(study, (0,) * len(study.axes)).scene
    drawn = [one for one in scene.fractures if isinstance(one, TraceMap | RandomSet)]
    told = [_told(fracture, scene) for fracture in drawn[:MOST_TOLD]]
    if len(drawn) > MOST_TOLD:
        told.append(f"fractures: {len(drawn) - MOST_TOLD} more maps and sets")
    return told


def told_closures(study: Study) -> list[str]:
    """One line for each part of the rock that stays as open as it is while stress is varied."""
    moved = {path for axis in study.axes for path in axis.parameters}
    if not any(path.split(".")[0] in ("stress", "gravity", "excavate") for path in moved):
        return []
    scene = case_at(study, (0,) * len(study.axes)).scene
    stays = "apertures are the same at every stress that is varied"
    told = [
        f"fractures.{fracture.name}: {stays}, "
        + ("as closure: none says" if fracture.closure else "for it has no closure")
        for fracture in scene.fractures
        if fracture.part == "trace" and not (fracture.closure and fracture.closure.closes)
    ]
    matrix = scene.pipes
    if scene.porous and matrix and matrix.half_force is None and matrix.half_stress is None:
        told.append(f"matrix: {stays}, for it has neither half_stress nor half_force")
    return told


def told_partings(study: Study) -> list[str]:
    """A line where grains without bonds may part, and the pipes between them open."""
    scene = case_at(study, (0,) * len(study.axes)).scene
    matrix = scene.pipes
    if scene.stress is None or scene.bonds is not None or matrix is None:
        return []
    if (matrix.half_force is None and matrix.half_stress is None) or not matrix.gap_factor:
        return []
    return [
        "grains: without bonds they may part under the stress, and a few pipes that open by "
        "matrix.gap_factor times their gap then decide the permeability; add bonds, or "
        "gap_factor: 0 (parted_pipes counts them)"
    ]


def told_multipliers(study: Study) -> list[str]:
    """One line for each barrier of the first case whose worth depends on its grains."""
    scene = case_at(study, (0,) * len(study.axes)).scene
    return [
        f"fractures.{fracture.name}: what its transmissibility_multiplier is worth depends on the "
        "size of the grains; thickness with permeability, or resistance, does not"
        for fracture in scene.fractures
        if fracture.transmissibility_multiplier
    ]


def _told(fracture: TraceMap | RandomSet, scene: Scene) -> str:
    lines = lines_of((fracture,), scene.rock)
    length = np.bincount([line.trace for line in lines], [line.length for line in lines])
    length, area = length[length > 0.0], scene.rock.area
    pore = pore_spacing(scene.grains, area)
    parts = [
        f"{len(length)} traces in the region",
        f"P20 {len(length) / area:.3g} 1/m2",
        f"P21 {length.sum() / area:.3g} 1/m",
        f"{np.count_nonzero(length < pore)} shorter than a pore ({pore:.2g} m)",
    ]
    told = ", ".join(parts)
    if isinstance(fracture, TraceMap):
        told = f"{_of_map(fracture, fracture.laid)}; {told}"
    return f"fractures.{fracture.name}: {told}"


def _of_map(fracture: TraceMap, laid: LaidMap) -> str:
    """The whole map, before it is cut."""
    unit = fracture.file.unit if fracture.unit is None else fracture.unit
    parts = [
        f"a map of {laid.traces} traces",
        f"{laid.extent[0]:.4g} by {laid.extent[1]:.4g} m with {unit:g} m a unit",
    ]
    if laid.area is not None:
        parts.append(f"P21 {laid.length / laid.area:.3g} 1/m of its {laid.area:.4g} m2")
    parts.append(f"its ({laid.origin[0]:.9g}, {laid.origin[1]:.9g}) m at the origin")
    if laid.repeated:
        parts.append(f"{laid.repeated} vertices that stand twice count once")
    if laid.vanished:
        parts.append(f"{laid.vanished} traces shorter than the snap left out")
    return ", ".join(parts)


def pore_spacing(grains: Grains, area: float) -> float:
    """About the distance of pores, m: there are nearly as many as grains in the region."""
    if grains.count is not None:
        return math.sqrt(area / grains.count)
    solid = 1.0 - (grains.porosity or 0.17)
    return float(grains.mean_radius or 0.0) * math.sqrt(math.pi / solid)
