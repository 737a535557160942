"""Pressure maps: the pores' polygons, grains, fractures and wells of one case."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import (
    EllipseCollection,
    LineCollection,
    PathCollection,
    PolyCollection,
)
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Circle as CirclePatch
from matplotlib.patches import Patch
from matplotlib.patches import Polygon as PolygonPatch
from matplotlib.patheffects import withStroke
from PIL import Image, ImageDraw

from demflow.model.region import Circle, bounding_box, contains, parts_of
from demflow.model.scene import Fracture, Scene, lines_of
from demflow.sweep.analysis.cases import display, with_unit
from demflow.sweep.errors import ResultsError
from demflow.sweep.figures.style import (
    BLACK,
    SEQUENTIAL,
    VERMILION,
    WIDTHS,
    few_ticks,
    fixed_panels,
    form,
    label,
    narrow,
    pixels,
    save,
)
from demflow.sweep.figures.style import heading as title_over

MOST_GRAINS = 3000  # with more, grains are too small to be seen
NARROWEST, WIDEST = 0.4, 1.4  # points of a fracture's line, from closed to the most open
TINY = 1e-300
CLIP = (1.0, 99.0)  # percentiles at which the colours end, so that a well does not take them all
SMALL_CHANGE = 0.1  # of the initial pressure: below it, the change is drawn
PANELS = 4  # map times where the study names none


_EXTEND = {
    (False, False): "neither",
    (True, False): "min",
    (False, True): "max",
    (True, True): "both",
}


def map_times(times: np.ndarray, wanted: Sequence[float] | None, most: int = PANELS) -> list[int]:
    """Positions of the times to draw: the nearest to those wanted, else `most`, evenly in log."""
    if wanted:
        return sorted({int(np.argmin(np.abs(times - t))) for t in wanted})
    if len(times) <= most:
        return list(range(len(times)))
    even = np.geomspace(times[0], times[-1], most + 1)[1:]
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
    corners = (faces[kept] - offset).astype(np.int64)
    counts = np.count_nonzero(kept, axis=1)
    return _split(nodes.tobytes(), corners.tobytes(), counts.tobytes())


@lru_cache(maxsize=1)  # cases that differ in more than their grains have the same
def _split(nodes: bytes, corners: bytes, counts: bytes) -> list[np.ndarray]:
    """Corners of each polygon, from those of all, one after the other."""
    at = np.frombuffer(nodes).reshape(-1, 2)[np.frombuffer(corners, dtype=np.int64)]
    return np.split(at, np.cumsum(np.frombuffer(counts, dtype=np.int64))[:-1])


class Pores(NamedTuple):
    """Pores on a grid of pixels, so that many fields of them are drawn at the price of one."""

    number: np.ndarray  # (rows, columns) of the pore at each pixel, from below; -1 where none is
    extent: tuple[float, float, float, float]  # left, right, bottom, top, m


def pores_on_pixels(maps: xr.Dataset) -> Pores:
    """Which pore lies at each pixel.

    Parameters
    ----------
    maps : of one case, with the mesh of its domains
    """
    corners = polygons(maps)
    counts = np.array([len(one) for one in corners])
    return _rastered(np.concatenate(corners).tobytes(), counts.tobytes(), pixels())


@lru_cache(maxsize=1)
def _rastered(corners: bytes, counts: bytes, longer: int) -> Pores:
    """Pores on as many pixels along the longer side, from their corners one after the other."""
    nodes = np.frombuffer(corners).reshape(-1, 2)
    low, high = nodes.min(axis=0), nodes.max(axis=0)
    scale = longer / float(np.max(high - low))
    columns, rows = (max(int(np.ceil(size)), 1) for size in (high - low) * scale)
    canvas = Image.new("I", (columns, rows), 0)
    pen = ImageDraw.Draw(canvas)
    flat = ((nodes - low) * scale - 0.5).ravel().tolist()
    end = 0
    for number, count in enumerate(np.frombuffer(counts, dtype=int).tolist(), start=1):
        begin, end = end, end + 2 * count
        pen.polygon(flat[begin:end], fill=number)
    left, bottom = map(float, low)
    right, top = left + columns / scale, bottom + rows / scale
    return Pores(np.asarray(canvas) - 1, (left, right, bottom, top))


def draw_pores(panel: Axes, pores: Pores, values: np.ndarray, norm: Normalize) -> AxesImage:
    """Colour pores by values; returns the image.

    Parameters
    ----------
    panel : where to draw
    pores : on pixels
    values : (domain,), in the unit of the colours
    norm : limits of the colours
    """
    return panel.imshow(
        coloured(pores, values, norm), extent=pores.extent, origin="lower",
        interpolation="nearest", zorder=1,
    )  # fmt: skip


def coloured(pores: Pores, values: np.ndarray, norm: Normalize) -> np.ndarray:
    """RGBA bytes of each pixel, see `draw_pores`, (rows, columns, 4)."""
    # each pore's colour is found once, and not each pixel's; none at the end, where -1 points
    colours = np.zeros((len(values) + 1, 4), dtype=np.uint8)
    colours[:-1] = colormaps[SEQUENTIAL](norm(values), bytes=True)
    colours[:-1][~np.isfinite(values)] = 0
    found: np.ndarray = colours[pores.number]
    return found


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


def readable(pressure: np.ndarray, scene: Scene | None) -> tuple[np.ndarray, float, str]:
    """What to colour, its factor and label: the pressure, or its change where that is small."""
    initial = scene.uniform_pressure if scene is not None else None
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
    most: int = PANELS,
    breaks: xr.Dataset | None = None,
) -> Path:
    """Pressure over the pores at a few times (or the steady state), one colour bar.

    Parameters
    ----------
    maps : maps of one case, with `pressure` and the domains' mesh.
    scene : its scene, for the region and the wells.
    heading : what tells this case from others.
    path : PNG to write.
    wanted : times in s; the nearest recorded ones are drawn.
    most : how many times are drawn where none is wanted.
    breaks : what broke in this case, with `event_time`, `event_x` and `event_y`: those until each
        time are drawn, the path of the crack.
    """
    transient = "elapsed_time" in maps["pressure"].dims
    if transient:
        times = maps["elapsed_time"].values
        chosen = map_times(times, wanted, most)
        pressure = maps["pressure"].transpose("elapsed_time", "domain").values[chosen]
        titles = [f"t = {with_unit(t, 's')}" for t in times[chosen]]
        until = times[chosen]
    else:
        pressure, titles, until = (
            maps["pressure"].values[None],
            ["steady state"],
            np.array([np.inf]),
        )
    pressure, factor, name = readable(pressure, scene)
    drawn = draw_fields(
        maps, scene, heading, Fields(pressure * factor, name, titles, until), breaks, len(titles)
    )
    shown = ", ".join(titles)
    caption = f"Pore pressure, {heading.replace(chr(10), ', ')}: {shown}. Each polygon is a pore"
    barriers = [_is_barrier(fracture) for fracture in scene.fractures]
    caption += "" if all(barriers) else ", white lines are fractures, the wider the more open"
    caption += ", dashed black lines are barriers" if any(barriers) else ""
    caption += ", white dots are what broke until then" if breaks is not None else ""
    caption += ", wells are circles." if scene.wells else "."
    if any(drawn.beyond):
        caption += f" Colours end at the percentiles {CLIP[0]:g} and {CLIP[1]:g}."
    return save(drawn.figure, path, caption)


class Fields(NamedTuple):
    """Fields over the pores of one case."""

    values: np.ndarray  # (time, domain), in the unit of the colours
    name: str  # at the colours
    titles: Sequence[str]  # of each time
    until: np.ndarray  # (time,) s


class Drawn(NamedTuple):
    """Panels of fields, and what changes on them in time."""

    figure: Figure
    panels: list[Axes]
    images: list[AxesImage]
    breaks: list[PathCollection]  # none where nothing broke
    pores: Pores
    norm: Normalize
    beyond: tuple[bool, bool]  # whether values lie below and above the colours


def draw_fields(
    maps: xr.Dataset,
    scene: Scene | None,
    heading: str,
    fields: Fields,
    breaks: xr.Dataset | None,
    count: int,
) -> Drawn:
    """Panels of the first `count` times, with colours for all of them.

    Parameters
    ----------
    maps : of one case, with the mesh of its domains
    scene : its scene; without one no rims, grains and barriers are drawn
    heading : over all panels
    fields : what to colour
    breaks : see `draw_maps`
    count : of panels
    """
    pores = pores_on_pixels(maps)
    low, high = colour_limits(fields.values)
    norm = Normalize(low, high)
    columns = 1 if narrow() and count == 1 else min(count, 2 if narrow() else 4)
    columns = 2 if count == 4 else 3 if count in (5, 6) and not narrow() else columns
    rows = -(-count // columns)
    xmin, xmax, ymin, ymax = pores.extent if scene is None else bounding_box(scene.region)
    margin = 0.03 * max(xmax - xmin, ymax - ymin)
    aspect = (ymax - ymin + 2 * margin) / (xmax - xmin + 2 * margin)
    side = {1: 4.4, 2: 3.6}.get(columns, 3.0)
    over = 0.15 + 0.2 * len(heading.splitlines()) if not WIDTHS.get(form().width) else 0.05
    figure, panels = fixed_panels(
        rows, columns, (side / max(aspect / 2.0, 1.0), side * min(aspect, 2.0)),
        between=(0.12, 0.32), margins=(0.7, 1.15, 0.55, 0.3 + over), shown=count,
    )  # fmt: skip
    images: list[AxesImage] = []
    dots: list[PathCollection] = []
    for k, panel in enumerate(panels):
        outlines = [panel.add_patch(rim) for rim in (rims(scene) if scene is not None else ())]
        images.append(draw_pores(panel, pores, fields.values[k], norm))
        if scene is not None:
            _grains(panel, maps, scene)
        draw_traces(panel, maps)
        if scene is not None:
            _barriers(panel, scene)
        for part in (images[-1], *panel.collections) if outlines else ():
            part.set_clip_path(outlines[0])
        if breaks is not None:
            dots.append(_breaks(panel, breaks, fields.until[k]))
        draw_wells(panel, maps)
        panel.set(
            xlim=(xmin - margin, xmax + margin),
            ylim=(ymin - margin, ymax + margin),
            aspect="auto",  # the panel has that of the region
            title=fields.titles[k],
        )
        panel.grid(False)
    few_ticks(panels, columns)
    for panel in panels[-columns:]:
        panel.set_xlabel("x (m)")
    for panel in panels[::columns]:
        panel.set_ylabel("y (m)")
    beyond = (bool(np.nanmin(fields.values) < low), bool(np.nanmax(fields.values) > high))
    width, height = figure.get_size_inches()
    bar = figure.add_axes((1.0 - 1.0 / width, 0.55 / height, 0.16 / width, 1 - 1.1 / height))
    colours = ScalarMappable(norm, SEQUENTIAL)
    figure.colorbar(colours, cax=bar, label=fields.name, extend=_EXTEND[beyond])
    title_over(figure, heading, fontsize=10.5)
    return Drawn(figure, panels, images, dots, pores, norm, beyond)


def plot_map(maps: xr.Dataset, panel: Axes, time: float | None = None) -> Axes:
    """Draw pressure over the pores with grains (where observed), fractures and wells.

    The colours are those of `panel.collections[0]`, for a colour bar.

    Parameters
    ----------
    maps : of one case, as `open_case` gives them
    panel : where to draw
    time : s, the nearest recorded one; by default the last

    Raises ResultsError where no pressure was mapped.
    """
    if "pressure" not in maps:
        raise ResultsError("the maps hold no pressure: observe pressure_map")
    pressure, title = maps["pressure"], "steady state"
    if "elapsed_time" in pressure.dims:
        times = maps["elapsed_time"].values
        k = len(times) - 1 if time is None else int(np.argmin(np.abs(times - time)))
        pressure, title = pressure.isel(elapsed_time=k), f"t = {with_unit(times[k], 's')}"
    factor, name = label("pressure", pressure.values)
    values = pressure.values * factor
    norm = Normalize(*colour_limits(values))
    draw_pores(panel, pores_on_pixels(maps), values, norm)
    colours = PolyCollection([], array=[], cmap=SEQUENTIAL, norm=norm, label=name)
    panel.add_collection(colours, autolim=False)
    _grains(panel, maps, None)
    draw_traces(panel, maps)
    draw_wells(panel, maps)
    panel.set(aspect="equal", xlabel="x (m)", ylabel="y (m)", title=title)
    low, high = (end(np.concatenate(polygons(maps)), axis=0) for end in (np.min, np.max))
    room = 0.03 * float(np.max(high - low))  # grains of a packing reach beyond the region
    panel.set(xlim=(low[0] - room, high[0] + room), ylim=(low[1] - room, high[1] + room))
    panel.grid(False)
    return panel


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


def _grains(panel: Axes, maps: xr.Dataset, scene: Scene | None) -> None:
    if "radius" not in maps:
        return
    centres = np.stack([maps["grain_x"].values, maps["grain_y"].values], axis=1)
    everywhere = np.ones(len(centres), dtype=bool)
    inside = everywhere if scene is None else contains(scene.rock, centres)
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


def draw_traces(panel: Axes, maps: xr.Dataset) -> None:
    """Fractures as the straight lines that they are, wider where they are more open.

    Parameters
    ----------
    panel : where to draw
    maps : of one case
    """
    if "branch_from" in maps:
        nodes = np.stack([maps["fracture_node_x"].values, maps["fracture_node_y"].values], axis=1)
        segments = nodes[np.stack([maps[f"branch_{end}"].values for end in ("from", "to")], axis=1)]
        aperture = maps["branch_aperture"].values
        widths = NARROWEST + (WIDEST - NARROWEST) * aperture / max(aperture.max(initial=0.0), TINY)
    elif "trace_from_x" in maps:
        ends = [[maps[f"trace_{end}_{axis}"].values for axis in "xy"] for end in ("from", "to")]
        segments = np.moveaxis(np.array(ends), -1, 0)
        widths = np.full(len(segments), NARROWEST)
    else:
        return
    for colour, more in (((0, 0, 0, 0.55), 0.8), ("white", 0.0)):
        lines = LineCollection(segments, colors=colour, linewidths=widths + more, zorder=3)
        lines.set_capstyle("round")
        panel.add_collection(lines)


def _breaks(panel: Axes, breaks: xr.Dataset, time: float) -> PathCollection:
    """The breaks until a time, s."""
    x, y = broken_until(breaks, time).T
    return panel.scatter(
        x,
        y,
        s=7.0,
        color="white",
        edgecolors=BLACK,
        linewidths=0.4,
        zorder=4.5,
    )


def broken_until(breaks: xr.Dataset, time: float) -> np.ndarray:
    """Places of the breaks until a time (s), (event, 2) m."""
    until = breaks["event_time"].values <= time
    return np.stack([breaks[f"event_{axis}"].values[until] for axis in "xy"], axis=1)


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


def draw_wells(panel: Axes, maps: xr.Dataset) -> None:
    """Wells as circles of their size, with a cross that is seen where they are small.

    Parameters
    ----------
    panel : where to draw
    maps : of one case
    """
    if "well_x" not in maps:
        return
    at = np.stack([maps[f"well_{name}"].values for name in ("x", "y", "radius")], axis=1)
    for x, y, radius in at:
        panel.add_patch(
            CirclePatch(
                (x, y), radius, facecolor="none", edgecolor=VERMILION, linewidth=1.6, zorder=5
            )
        )
        panel.plot(x, y, marker="+", color=VERMILION, markersize=4, zorder=5)
