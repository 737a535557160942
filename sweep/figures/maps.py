"""Pressure maps: the pores' polygons, grains, fractures and wells of one case."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection, PolyCollection
from matplotlib.colors import Normalize
from matplotlib.patches import Circle as CirclePatch
from matplotlib.patches import Patch
from matplotlib.patches import Polygon as PolygonPatch
from matplotlib.patheffects import withStroke

from demflow.model.region import Circle, bounding_box, contains, parts_of
from demflow.model.scene import Fracture, Scene, lines_of
from demflow.sweep.analysis.cases import display, with_unit
from demflow.sweep.figures.style import (
    BLACK,
    SEQUENTIAL,
    VERMILION,
    label,
    new_figure,
    save,
)
from demflow.sweep.figures.style import heading as title_over

MOST_GRAINS = 3000  # with more, grains are too small to be seen
CLIP = (1.0, 99.0)  # percentiles at which the colours end, so that a well does not take them all
SMALL_CHANGE = 0.1  # of the initial pressure: below it, the change is drawn
PANELS = 4  # map times where the study names none


_EXTEND = {
    (False, False): "neither",
    (True, False): "min",
    (False, True): "max",
    (True, True): "both",
}


def map_times(times: np.ndarray, wanted: Sequence[float] | None) -> list[int]:
    """Positions of the times to draw: the nearest to those wanted, else four, evenly in log."""
    if wanted:
        return sorted({int(np.argmin(np.abs(times - t))) for t in wanted})
    if len(times) <= PANELS:
        return list(range(len(times)))
    even = np.geomspace(times[0], times[-1], PANELS + 1)[1:]
    return sorted({int(np.argmin(np.abs(np.log(times / t)))) for t in even})


def polygons(maps: xr.Dataset) -> list[np.ndarray]:
    """Corners of each domain's polygon, (k, 2) m, from the UGRID mesh of the maps.

    Raises ValueError where the maps hold no face-node mesh.
    """
    meshes = [v for v in maps.variables.values() if v.attrs.get("cf_role") == "mesh_topology"]
    if not meshes:
        raise ValueError("the maps hold no UGRID mesh")
    topology = meshes[0].attrs
    nodes = np.stack(
        [maps[name].values for name in topology["node_coordinates"].split()], axis=1
    ).astype(float)
    connectivity = maps[topology["face_node_connectivity"]]
    faces = connectivity.values
    offset = int(connectivity.attrs.get("start_index", 0))
    # a decoded file has NaN, a raw one its fill value (negative here) where a face has no corner
    kept = np.isfinite(faces) & (faces >= offset)
    return [nodes[row[good].astype(int) - offset] for row, good in zip(faces, kept, strict=True)]


def colour_limits(values: np.ndarray) -> tuple[float, float]:
    """Ends of the colour scale: those of the values, unless a few of them take most of it.

    It ends at the percentiles `CLIP` where the values beyond would stretch it fourfold.
    """
    least, low, high, most = np.nanpercentile(values, [0.0, *CLIP, 100.0])
    if most - least < 1e-9 * max(abs(most), abs(least), 1e-300):  # one colour, ends kept apart
        room = 0.5 * max(abs(most), 1.0)
        return float(least - room), float(most + room)
    room = 3.0 * (high - low)
    return float(low if low - least > room else least), float(high if most - high > room else most)


def _readable(pressure: np.ndarray, scene: Scene) -> tuple[np.ndarray, float, str]:
    """What to colour, its factor and label: the pressure, or its change where that is small."""
    initial = scene.uniform_pressure
    if initial is None or np.nanmax(np.abs(pressure - initial)) > SMALL_CHANGE * abs(initial):
        return pressure, *label("pressure", pressure)
    change = pressure - initial
    factor, unit = display("Pa", float(np.nanmax(np.abs(change))))
    return change, factor, f"pore pressure − initial {with_unit(initial, 'Pa')} ({unit})"


def draw_maps(
    maps: xr.Dataset,
    scene: Scene,
    heading: str,
    path: Path,
    wanted: Sequence[float] | None = None,
) -> Path:
    """Pressure over the pores at a few times (or the steady state), one colour bar.

    Parameters
    ----------
    maps : maps of one case, with `pressure` and the domains' mesh.
    scene : its scene, for the region and the wells.
    heading : what tells this case from others.
    path : PNG to write.
    wanted : times in s; the nearest recorded ones are drawn.
    """
    transient = "elapsed_time" in maps["pressure"].dims
    if transient:
        times = maps["elapsed_time"].values
        chosen = map_times(times, wanted)
        pressure = maps["pressure"].transpose("elapsed_time", "domain").values[chosen]
        titles = [f"t = {with_unit(t, 's')}" for t in times[chosen]]
    else:
        pressure, titles = maps["pressure"].values[None], ["steady state"]
    pressure, factor, name = _readable(pressure, scene)
    shapes = polygons(maps)
    low, high = colour_limits(pressure * factor)
    norm = Normalize(low, high)
    columns = len(titles) if len(titles) <= 2 else -(-len(titles) // 2) if len(titles) <= 6 else 4
    rows = -(-len(titles) // columns)
    xmin, xmax, ymin, ymax = bounding_box(scene.region)
    aspect = (ymax - ymin) / (xmax - xmin)
    side = {1: 5.0, 2: 3.9}.get(columns, 3.2)
    figure = new_figure(side * columns + 1.1, side * rows * min(aspect, 2.0) + 0.75)
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for panel, field, title in zip(panels.flat, pressure, titles, strict=False):
        patches = PolyCollection(
            shapes,
            array=field * factor,
            cmap=SEQUENTIAL,
            norm=norm,
            edgecolors="face",
            linewidths=0.3,
        )
        outline, *_ = [panel.add_patch(rim) for rim in rims(scene)]
        panel.add_collection(patches)
        _grains(panel, maps, scene)
        _fractures(panel, maps)
        _barriers(panel, scene)
        for collection in panel.collections:
            collection.set_clip_path(outline)
        _wells(panel, scene)
        margin = 0.03 * max(xmax - xmin, ymax - ymin)
        panel.set(
            xlim=(xmin - margin, xmax + margin),
            ylim=(ymin - margin, ymax + margin),
            aspect="equal",
            title=title,
        )
        panel.grid(False)
    for panel in panels.flat[len(titles) :]:
        panel.set_visible(False)
    for panel in panels[-1]:
        panel.set_xlabel("x (m)")
    for panel in panels[:, 0]:
        panel.set_ylabel("y (m)")
    beyond = (bool(np.nanmin(pressure) * factor < low), bool(np.nanmax(pressure) * factor > high))
    figure.colorbar(patches, ax=panels, label=name, shrink=0.85, aspect=30, extend=_EXTEND[beyond])
    title_over(figure, heading, fontsize=10.5)
    shown = ", ".join(titles)
    caption = f"Pore pressure, {heading.replace(chr(10), ', ')}: {shown}. Each polygon is a pore"
    barriers = [_is_barrier(fracture) for fracture in scene.fractures]
    caption += "" if all(barriers) else ", white lines are fractures"
    caption += ", dashed black lines are barriers" if any(barriers) else ""
    caption += ", wells are circles." if scene.wells else "."
    if any(beyond):
        caption += f" Colours end at the percentiles {CLIP[0]:g} and {CLIP[1]:g}."
    return save(figure, path, caption)


def rims(scene: Scene) -> list[Patch]:
    """The rim of the region, and those of its holes, which are white."""
    rims: list[Patch] = []
    for shape, at, _ in parts_of(scene.rock):
        fill = "white" if rims else "none"
        look = {"facecolor": fill, "edgecolor": BLACK, "linewidth": 0.8, "zorder": 4}
        if isinstance(shape, Circle):
            rims.append(CirclePatch(tuple(at), shape.radius, **look))
        else:
            rims.append(PolygonPatch(np.asarray(shape.vertices) + at, closed=True, **look))
    return rims


def _grains(panel: Axes, maps: xr.Dataset, scene: Scene) -> None:
    if "radius" not in maps:
        return
    centres = np.stack([maps["grain_x"].values, maps["grain_y"].values], axis=1)
    inside = contains(scene.rock, centres)
    if np.count_nonzero(inside) > MOST_GRAINS:
        return
    centres, size = centres[inside], 2.0 * maps["radius"].values[inside]
    panel.add_collection(
        EllipseCollection(
            size,
            size,
            np.zeros_like(size),
            units="xy",
            offsets=centres,
            offset_transform=panel.transData,
            facecolors="none",
            edgecolors=(0, 0, 0, 0.28),
            linewidths=0.35,
        )
    )


def _fractures(panel: Axes, maps: xr.Dataset) -> None:
    if "on_fracture" not in maps:
        return
    start, end = maps["from_domain"].values, maps["to_domain"].values
    along = (maps["on_fracture"].values >= 0) & (start >= 0) & (end >= 0)
    branches = "branch_from" in maps
    if branches:  # the last pipes, which have places of their own
        along[len(along) - len(maps["branch_from"]) :] = False
    places = np.stack([maps["x"].values, maps["y"].values], axis=1)
    segments = np.stack([places[start[along]], places[end[along]]], axis=1)
    if branches:
        nodes = np.stack([maps["fracture_node_x"].values, maps["fracture_node_y"].values], axis=1)
        ends = np.stack([maps["branch_from"].values, maps["branch_to"].values], axis=1)
        segments = np.concatenate([segments, nodes[ends]])
    panel.add_collection(
        LineCollection(
            list(segments),
            colors="white",
            linewidths=0.9,
            path_effects=[withStroke(linewidth=1.7, foreground=(0, 0, 0, 0.55))],
        )
    )


def _is_barrier(fracture: Fracture) -> bool:
    return fracture.part in ("barrier", "multiplier")


def _barriers(panel: Axes, scene: Scene) -> None:
    barriers = tuple(fracture for fracture in scene.fractures if _is_barrier(fracture))
    segments = [(line.start, line.end) for line in lines_of(barriers, scene.rock)]
    panel.add_collection(
        LineCollection(
            segments,
            colors=BLACK,
            linewidths=1.3,
            linestyles=(0, (4, 2)),
            path_effects=[withStroke(linewidth=2.4, foreground=(1, 1, 1, 0.7))],
        )
    )


def _wells(panel: Axes, scene: Scene) -> None:
    for well in scene.wells:
        panel.add_patch(
            CirclePatch(
                well.at, well.radius, facecolor="none", edgecolor=VERMILION, linewidth=1.6, zorder=5
            )
        )
        panel.plot(*well.at, marker="+", color=VERMILION, markersize=4, zorder=5)
