"""Networks of fractures: where their traces point, how long they are, how they meet."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Polygon, Wedge

from demflow.model.outcome import Status
from demflow.sweep.errors import ResultsError
from demflow.sweep.figures.style import (
    BLACK,
    BLUE,
    GREY,
    LIGHT_GREY,
    fixed_panels,
    heading,
    narrow,
    save,
)

SECTOR = 10.0  # degrees
NODES = ("network_nodes_i", "network_nodes_y", "network_nodes_x")


def trace_vectors(maps: xr.Dataset) -> np.ndarray:
    """From begin to end of each trace, (n, 2) m. Raises ResultsError where there is none.

    Parameters
    ----------
    maps : of one case, as `open_case` gives them
    """
    if "trace_from_x" not in maps:
        raise ResultsError("the maps hold no traces of fractures")
    return np.stack(
        [maps[f"trace_to_{axis}"].values - maps[f"trace_from_{axis}"].values for axis in "xy"],
        axis=1,
    )


def trace_lengths(maps: xr.Dataset) -> np.ndarray:
    """Lengths of traces with all their bends, (t,) m. Raises ResultsError where there is none.

    The straight pieces of one follow each other, and each begins where the one before ends.

    Parameters
    ----------
    maps : of one case, as `open_case` gives them
    """
    length = np.hypot(*trace_vectors(maps).T)
    goes_on = np.zeros(len(length), dtype=bool)
    goes_on[1:] = np.logical_and.reduce(
        [
            maps[f"trace_to_{axis}"].values[:-1] == maps[f"trace_from_{axis}"].values[1:]
            for axis in "xy"
        ]
    )
    return np.asarray(np.bincount(np.cumsum(~goes_on) - 1, length))


def plot_rose(maps: xr.Dataset, panel: Axes) -> Axes:
    """Draw how much length of traces points where, as sectors of 10°; return the axes.

    A sector's area is its part of the length: the eye sees areas (Sanderson & Peacock (2020),
    Earth-Science Reviews 201, 103055). A trace points both ways.

    Parameters
    ----------
    maps : of one case, as `open_case` gives them
    panel : where to draw

    Raises ResultsError where there are no traces.
    """
    vectors = trace_vectors(maps)
    angle = np.degrees(np.arctan2(vectors[:, 1], vectors[:, 0])) % 180.0
    # sectors lie around 0°, 10°, …, so that a set along an axis is one of them
    sector = np.round(angle / SECTOR).astype(int) % round(180.0 / SECTOR)
    length = np.hypot(*vectors.T)
    part = np.bincount(sector, length, round(180.0 / SECTOR)) / length.sum()
    reach = np.sqrt(part / part.max())
    panel.add_patch(Circle((0, 0), 1.0, fill=False, edgecolor=LIGHT_GREY, linewidth=0.8))
    panel.add_patch(Circle((0, 0), 0.5**0.5, fill=False, edgecolor=LIGHT_GREY, linewidth=0.5))
    for k, size in enumerate(reach):
        for back in (0.0, 180.0):
            begin = SECTOR * (k - 0.5) + back
            panel.add_patch(
                Wedge(
                    (0, 0), size, begin, begin + SECTOR, facecolor=BLUE, edgecolor="white", lw=0.5
                )
            )
    for text, x, y in (("0°", 1.1, 0.0), ("90°", 0.0, 1.12)):
        panel.text(x, y, text, ha="center", va="center", color=GREY)
    _bare(panel, (-1.25, 1.25), (-1.25, 1.25))
    count = len(trace_lengths(maps))
    panel.set_title(
        f"{count} trace{'' if count == 1 else 's'}, rim {100 * part.max():.3g} % of length"
    )
    return panel


def plot_lengths(maps: xr.Dataset, panel: Axes) -> Axes:
    """Draw how many traces are at least so long, on log-log axes; return the axes.

    A straight piece is a power law. Ends at the rim of the region cut traces short.

    Parameters
    ----------
    maps : of one case, as `open_case` gives them
    panel : where to draw

    Raises ResultsError where there are no traces.
    """
    length = np.sort(trace_lengths(maps))[::-1]
    panel.plot(length, np.arange(1, len(length) + 1), ".", color=BLUE, markersize=4)
    panel.set(xscale="log", yscale="log", xlabel="length of trace (m)", ylabel="traces as long")
    return panel


def plot_topology(dataset: xr.Dataset, panel: Axes) -> Axes:
    """Draw the parts of I, Y and X nodes of each case in a triangle; return the axes.

    I are free ends, Y ends on another trace, X crossings. On the dashed line branches have one
    connection each, above it fewer (Sanderson & Nixon (2015), J. Struct. Geol. 72, 55-66).

    Parameters
    ----------
    dataset : as `open_results` gives it, of a study that observes `fracture_network`
    panel : where to draw

    Raises ResultsError where no nodes were counted.
    """
    missing = [name for name in NODES if name not in dataset]
    if missing:
        raise ResultsError(f"the dataset has no {missing[0]}: observe fracture_network")
    counts = np.stack([dataset[name].values.ravel() for name in NODES], axis=1).astype(float)
    total = counts.sum(axis=1)
    counts = counts[(dataset["status"].values.ravel() == Status.DONE) & (total > 0)]
    corners = np.array([[0.5, 0.75**0.5], [0.0, 0.0], [1.0, 0.0]])
    panel.add_patch(Polygon(corners, closed=True, fill=False, edgecolor=BLACK, linewidth=0.8))
    for name, (x, y), place in zip("IYX", corners, ("bottom", "top", "top"), strict=True):
        panel.text(x, y + (0.02 if place == "bottom" else -0.02), name, ha="center", va=place)
    # connections a branch, C = (3 Y + 4 X) / ((I + 3 Y + 4 X) / 2), are 1 where I = 3 Y + 4 X
    edge = np.array([[0.75, 0.25, 0.0], [0.8, 0.0, 0.2]]) @ corners
    panel.plot(*edge.T, color=GREY, linestyle="--", linewidth=0.8)
    panel.text(edge[1, 0] + 0.02, edge[1, 1], "1 connection a branch", color=GREY, fontsize=7)
    if len(counts):
        place = counts / counts.sum(axis=1, keepdims=True) @ corners
        panel.plot(*place.T, "o", color=BLUE, markersize=4, alpha=0.7)
    _bare(panel, (-0.1, 1.2), (-0.12, 1.0))
    panel.set_title(f"nodes, {len(counts)} case{'' if len(counts) == 1 else 's'}")
    return panel


def _bare(panel: Axes, x: tuple[float, float], y: tuple[float, float]) -> None:
    panel.set(xlim=x, ylim=y, aspect="equal")
    panel.set_axis_off()


def draw_traces_of(dataset: xr.Dataset, maps: xr.Dataset, title: str, path: Path) -> Path | None:
    """Rose, lengths and nodes of the fractures of a study; None where there is no trace.

    Parameters
    ----------
    dataset : as `open_results` gives it
    maps : of the case whose traces are drawn
    title : what tells it from others
    path : where the figure is written
    """
    if "trace_from_x" not in maps or any(name not in dataset for name in NODES):
        return None
    figure, panels = fixed_panels(
        3 if narrow() else 1,
        1 if narrow() else 3,
        (2.6, 2.6),
        between=(0.75, 0.9),
        margins=(0.7 if narrow() else 0.2, 0.2, 0.6, 0.8),
    )
    for panel in panels:
        panel.tick_params(labelleft=True, labelbottom=True)
    plot_rose(maps, panels[0])
    plot_lengths(maps, panels[1])
    plot_topology(dataset, panels[2])
    heading(figure, title, fontsize=10.5)
    caption = (
        f"Traces of fractures, {title.replace(chr(10), ', ')}: part of their length by direction "
        "(areas of sectors), how many are at least so long, and parts of free ends (I), ends on "
        "others (Y) and crossings (X) of all cases."
    )
    return save(figure, path, caption)
