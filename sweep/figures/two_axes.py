"""Over two axes of a study: a number as a map of colours, permeability as ellipses."""

from __future__ import annotations

import textwrap
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.image import AxesImage

from demflow.sweep.analysis.cases import axes, axis_title, axis_value, display
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

MOST_TICKS = 7


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

    Half axes are the principal permeabilities, all at one scale, directions those in the rock. The
    mean over the other axes is drawn.

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
    scale = 0.9 / float(np.nanmax(largest))
    drawn = np.nan_to_num(largest) > 0.0
    panel.add_collection(
        EllipseCollection(
            largest[drawn] * scale,
            np.maximum(smallest[drawn], 0.0) * scale,
            direction[drawn],
            units="xy",
            offsets=np.argwhere(drawn)[:, ::-1],
            offset_transform=panel.transData,
            facecolors=BLUE,
            alpha=0.75,
            linewidths=0,
        ),
        autolim=False,
    )
    panel.set(
        xlim=(-0.6, largest.shape[1] - 0.4), ylim=(-0.6, largest.shape[0] - 0.4), aspect="equal"
    )
    _name_places(dataset, x, y, panel)
    factor, unit = display("m2", largest)
    panel.set_title(f"largest {factor * float(np.nanmax(largest)):.3g} {unit}")
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
        name_ticks(axis, places, [shorten(axis_value(dataset, name, k), 14) for k in places])
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
    if "permeability" not in dataset or not np.any(np.isfinite(dataset["permeability"].values)):
        return None
    tensor = dataset["permeability"]
    varied = [a for a in axes(dataset) if dataset.sizes[a] > 1]

    def effect(axis: str) -> float:
        return float(np.nan_to_num(abs(tensor.max(axis) - tensor.min(axis)).max()))

    strong = sorted(varied, key=effect, reverse=True)[:2]
    size = float(abs(tensor).max())
    if len(strong) < 2 or min(map(effect, strong)) <= 1e-9 * size:
        return None
    x, y = sorted(strong, key=lambda axis: -dataset.sizes[axis])
    if dataset.sizes[x] * dataset.sizes[y] <= 8:
        return None  # few enough for lines
    figure, panels = fixed_panels(
        3 if narrow() else 1,
        1 if narrow() else 3,
        (2.5, 2.5),
        between=(1.25, 1.2),
        margins=(1.0, 0.6, 0.95, 0.6),
    )
    width = figure.get_size_inches()[0]
    for k, (panel, name) in enumerate(zip(panels[:2], ("k_xx", "k_yy"), strict=True)):
        values = tensor.isel(row=k, column=k).rename(name)
        plot_over(dataset, values.assign_attrs(long_name=name), x, y, panel)
        image = panel.images[0]
        box = panel.get_position()
        bar = figure.add_axes((box.x1 + 0.08 / width, box.y0, 0.1 / width, box.height))
        _colour_bar(image, bar)
        panel.set_title(str(image.get_label()))
    panels[2].set_anchor("W")
    plot_ellipses(dataset, x, y, panels[2])
    for panel in panels:
        panel.tick_params(labelleft=narrow() or panel is panels[0], labelbottom=True)
    for panel in panels[1:] if not narrow() else []:
        panel.set_ylabel("")
    heading(figure, f"Permeability over {axis_title(x)} and {axis_title(y)}", fontsize=11)
    others = [axis_title(a) for a in varied if a not in (x, y)]
    told = f", means over {', '.join(others)}" if others else ""
    caption = (
        f"Permeability over {axis_title(x)} and {axis_title(y)}{told}: its diagonal as colours, "
        "ellipses whose half axes are the principal permeabilities."
    )
    return save(figure, path, caption)


def _colour_bar(image: AxesImage, bar: Axes) -> None:
    figure = image.get_figure(root=True)
    assert figure is not None
    figure.colorbar(image, cax=bar)
