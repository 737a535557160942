"""Over two axes of a study: a number as a map of colours, permeability as ellipses."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Literal

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure

from demflow.sweep.analysis.cases import axes, axis_title, axis_value, display, plain_number
from demflow.sweep.analysis.permeability import principal_permeability
from demflow.sweep.errors import ResultsError
from demflow.sweep.figures.style import (
    BLUE,
    SEQUENTIAL,
    fixed_panels,
    heading,
    name_ticks,
    narrow,
    save,
    shorten,
)

MOST_TICKS, LETTERS, LINES = 7, 24, 3  # names along an axis, and of each
FEW = 8  # values over two axes that lines can still tell


def plot_over(dataset: xr.Dataset, values: xr.DataArray, x: str, y: str, panel: Axes) -> Axes:
    """Draw a number over two axes of a study as colours, means over the others; return the axes.

    Each value of an axis is as wide as any other, and written below. Cases without a result are
    white. The colours are those of `panel.images[0]`, for a colour bar.

    Parameters
    ----------
    dataset : as `open_results` gives it
    values : one number a case, over axes of the study, in SI
    x, y : names of two axes
    panel : where to draw

    Raises ResultsError where one is no axis of the values.
    """
    _check(values, x, y)
    field = values.mean([d for d in values.dims if d not in (x, y)]).transpose(y, x)
    factor, unit = display(str(values.attrs.get("units", "1")), field.values)
    shown = field.values[np.isfinite(field.values)]
    decades = len(shown) > 0 and 0.0 < 10.0 * shown.min() < shown.max()
    image = panel.imshow(
        field.values * factor,
        norm="log" if decades else None,
        origin="lower",
        aspect="auto",
        cmap=SEQUENTIAL,
        interpolation="nearest",
    )
    name = str(values.attrs.get("long_name", axis_title(str(values.name or ""))))
    image.set_label(textwrap.fill(f"{name} ({unit})" if unit else name, 40))
    _name_places(dataset, x, y, panel)
    return panel


def plot_ellipses(dataset: xr.Dataset, x: str, y: str, panel: Axes) -> Axes:
    """Draw permeability tensors over two axes of a study as ellipses; return the axes.

    Half axes are the principal permeabilities, directions those in the rock: all at one scale, or,
    where they span more than a decade, each at its own. The mean over the other axes is drawn.

    Parameters
    ----------
    dataset : as `open_results` gives it, with `permeability`
    x, y : names of two axes
    panel : where to draw

    Raises ResultsError where there is no permeability, or one is no axis.
    """
    if "permeability" not in dataset:
        raise ResultsError("the dataset has no permeability: observe it")
    tensor = dataset["permeability"]
    _check(tensor, x, y)
    kept = (x, y, "row", "column")
    found = principal_permeability(tensor.mean([d for d in tensor.dims if d not in kept]))
    largest, smallest, direction = (
        found[name].transpose(y, x).values for name in ("largest", "smallest", "direction")
    )
    size = panel.get_window_extent()
    by: Literal["x", "y"]
    by = "x" if size.width * largest.shape[0] < size.height * largest.shape[1] else "y"
    drawn = np.nan_to_num(largest) > 0.0
    most = float(np.nanmax(largest))
    alike = bool(np.all(largest[drawn] >= 0.1 * most))
    scale = 0.9 / (np.full(np.count_nonzero(drawn), most) if alike else largest[drawn])
    panel.add_collection(
        EllipseCollection(
            largest[drawn] * scale,
            np.maximum(smallest[drawn], 0.0) * scale,
            direction[drawn],
            units=by,  # of the narrower side of the cells: they are round where the rock is
            offsets=np.argwhere(drawn)[:, ::-1],
            offset_transform=panel.transData,
            facecolors=BLUE,
            edgecolors=BLUE,  # so that the thinnest is a line
            alpha=0.75,
            linewidths=0.6,
        ),
        autolim=False,
    )
    panel.set(xlim=(-0.5, largest.shape[1] - 0.5), ylim=(-0.5, largest.shape[0] - 0.5))
    _name_places(dataset, x, y, panel)
    factor, unit = display("m2", largest)
    told = f"largest {plain_number(factor * most, 3)} {unit}"
    panel.set_title(told if alike else f"{told}, own scales")
    return panel


def _check(values: xr.DataArray, x: str, y: str) -> None:
    for name in (x, y):
        if name not in values.dims or x == y:
            there = ", ".join(str(d) for d in values.dims if d not in ("row", "column")) or "none"
            raise ResultsError(f"{x} and {y} must be two of the axes {there}")


def _name_places(dataset: xr.Dataset, x: str, y: str, panel: Axes) -> None:
    panel.grid(False)
    for axis, name in ((panel.xaxis, x), (panel.yaxis, y)):
        count = dataset.sizes[name]
        places = range(0, count, -(-count // MOST_TICKS))
        names = _names(dataset, name)
        name_ticks(axis, places, [names[k] for k in places])
        axis.set_label_text(axis_title(name))
    for text in panel.get_xticklabels():
        text.set(rotation=35, horizontalalignment="right")


def draw_two_axes(dataset: xr.Dataset, path: Path) -> Path | None:
    """k_xx, k_yy and ellipses over the two axes that change permeability most; None without two.

    Parameters
    ----------
    dataset : as `open_results` gives it
    path : where the figure is written
    """
    if "permeability" not in dataset:
        return None
    tensor = dataset["permeability"]
    found = strongest(dataset, tensor)
    if found is None:
        return None
    x, y = found
    fields = [
        tensor.isel(row=k, column=k).rename(name).assign_attrs(long_name=name)
        for k, name in enumerate(("k_xx", "k_yy"))
    ]
    figure = _figure(dataset, fields, x, y, ellipses=True)
    heading(figure, f"Permeability over {axis_title(x)} and {axis_title(y)}", fontsize=11)
    caption = (
        f"Permeability over {axis_title(x)} and {axis_title(y)}{_means(dataset, x, y)}: its "
        "diagonal as colours, ellipses whose half axes are the principal permeabilities; where "
        "they span more than a decade, each at its own scale."
    )
    return save(figure, path, caption)


def draw_drawdown(dataset: xr.Dataset, well: str, path: Path) -> Path | None:
    """Largest pressure change of a well over the two axes that change it most; None without two.

    Parameters
    ----------
    dataset : as `open_results` gives it, with `pressure_change`
    well : name of the well
    path : where the figure is written
    """
    change = dataset["pressure_change"].sel(well=well, drop=True).max("elapsed_time")
    found = strongest(dataset, change)
    if found is None:
        return None
    x, y = found
    shown = change.assign_attrs(units="Pa", long_name="largest pressure change")
    figure = _figure(dataset, [shown], x, y)
    heading(figure, f"Well {well} over {axis_title(x)} and {axis_title(y)}", fontsize=11)
    caption = (
        f"Largest change of the pressure at {well} within a flow period over {axis_title(x)} and "
        f"{axis_title(y)}{_means(dataset, x, y)}."
    )
    return save(figure, path, caption)


def strongest(dataset: xr.Dataset, values: xr.DataArray) -> tuple[str, str] | None:
    """The two axes along which numbers change most, the longer first.

    None where fewer than two change them, or few enough of their values to be told by lines.
    """
    size = float(np.nan_to_num(abs(values)).max(initial=0.0))
    varied = [a for a in axes(dataset) if dataset.sizes[a] > 1]

    def effect(axis: str) -> float:
        return float(np.nan_to_num(values.max(axis) - values.min(axis)).max())

    strong = [a for a in sorted(varied, key=effect, reverse=True)[:2] if effect(a) > 1e-9 * size]
    if len(strong) < 2 or dataset.sizes[strong[0]] * dataset.sizes[strong[1]] <= FEW:
        return None
    x, y = sorted(strong, key=lambda axis: -dataset.sizes[axis])
    return x, y


def _names(dataset: xr.Dataset, axis: str) -> list[str]:
    """What the values of an axis are called; what several tied ones are on lines of their own."""
    names = []
    for k in range(dataset.sizes[axis]):
        parts = axis_value(dataset, axis, k).split(", ")
        shown = parts if len(parts) <= LINES else [*parts[: LINES - 1], "…"]
        names.append("\n".join(shorten(part, LETTERS) for part in shown))
    return names


def _figure(
    dataset: xr.Dataset, fields: list[xr.DataArray], x: str, y: str, *, ellipses: bool = False
) -> Figure:
    """A panel of colours with its bar for each field; ellipses beside them."""
    count = len(fields) + ellipses
    longest, beside = (
        max(len(line) for name in _names(dataset, one) for line in name.split("\n"))
        for one in (x, y)
    )
    figure, panels = fixed_panels(
        count if narrow() else 1,
        1 if narrow() else count,
        (2.5, 2.5) if count > 1 else (3.4, 2.7),
        between=(1.0, 0.9 + 0.04 * longest),
        margins=(
            0.5 + 0.075 * beside,
            0.25 if ellipses and not narrow() else 0.75,
            0.55 + 0.04 * longest,
            0.6,
        ),
    )
    width = figure.get_size_inches()[0]
    for panel, values in zip(panels, fields, strict=False):
        plot_over(dataset, values, x, y, panel)
        image = panel.images[0]
        box = panel.get_position()
        bar = figure.add_axes((box.x1 + 0.08 / width, box.y0, 0.1 / width, box.height))
        figure.colorbar(image, cax=bar)
        panel.set_title(str(image.get_label()))
    if ellipses:
        plot_ellipses(dataset, x, y, panels[-1])
    for panel in panels:
        panel.tick_params(labelleft=narrow() or panel is panels[0], labelbottom=True)
    for panel in panels[1:] if not narrow() else []:
        panel.set_ylabel("")
    return figure


def _means(dataset: xr.Dataset, x: str, y: str) -> str:
    others = [axis_title(a) for a in axes(dataset) if dataset.sizes[a] > 1 and a not in (x, y)]
    return f", means over {', '.join(others)}" if others else ""
