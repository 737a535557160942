"""How every picture looks: sizes, fonts, colours that colour-blind readers can tell apart."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backend_bases import get_registered_canvas_class
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import (
    FuncFormatter,
    LogFormatterMathtext,
    LogFormatterSciNotation,
    LogLocator,
    MaxNLocator,
    NullFormatter,
    NullLocator,
)
from numpy.typing import ArrayLike

from demflow.model.quantities import CASE, COORDINATES, MAPS, TESTS
from demflow.sweep.analysis.cases import display, plain_number, power_of_ten
from demflow.sweep.printable import printable, printable_lines

DPI = 130
FORMATS = ("png", "svg", "pdf")
WIDTHS = {"column": 3.5, "page": 7.2}  # inches: one and two columns of a journal, 89 and 183 mm


class Form(NamedTuple):
    """What figures are made for."""

    format: str = "png"
    width: str = ""  # one of WIDTHS; empty: as wide as what is drawn needs

    @property
    def suffix(self) -> str:
        """Name of the folder of such figures."""
        return f"{self.format}-{self.width}" if self.width else self.format


FOR_REPORT = Form()
_FORM: ContextVar[Form] = ContextVar("form", default=FOR_REPORT)

# Okabe & Ito (2008), the colours that remain apart under every common colour blindness
BLACK, BLUE, VERMILION = "#000000", "#0072B2", "#D55E00"
GREY, LIGHT_GREY = "#6B7280", "#9CA3AF"
SEQUENTIAL = "viridis"  # even in lightness, safe for colour-blind readers and in grey print
LINE_STYLES: tuple[Any, ...] = ("-", "--", ":", "-.")

_RC: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.labelsize": 9.5,
    "legend.fontsize": 8.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#E5E7EB",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "lines.linewidth": 1.6,
    "figure.facecolor": "white",
    "figure.constrained_layout.use": True,
    "axes.formatter.useoffset": False,
    "text.parse_math": False,  # a `$` of a title or a name is a `$`
    "text.usetex": False,
    "svg.fonttype": "none",  # text stays text
    "svg.hashsalt": "demflow",  # the same names of parts in every run
    "pdf.fonttype": 42,
}
# in a journal's column: nothing below 6 points once printed
_NARROW: Any = {
    "font.size": 7.0,
    "axes.titlesize": 7.0,
    "axes.labelsize": 7.0,
    "xtick.labelsize": 6.5,
    "ytick.labelsize": 6.5,
    "legend.fontsize": 6.5,
    "lines.linewidth": 1.1,
    "axes.linewidth": 0.6,
    "savefig.dpi": 300,
}


@contextmanager
def house_style(form: Form = FOR_REPORT) -> Iterator[None]:
    """Draw in the house's style; matplotlib's own settings are as before afterwards.

    Parameters
    ----------
    form : what the figures are made for: a format and a width.
    """
    with matplotlib.rc_context(), warnings.catch_warnings():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_RC | (_NARROW if form.width else {}))
        before = _FORM.set(form)
        # a letter that the font lacks is drawn as a box; the caption beside the picture has it
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        try:
            yield
        finally:
            _FORM.reset(before)


def new_figure(width: float, height: float) -> Figure:
    """An empty figure (inches) that no global list of figures knows, so nothing must close it.

    For a column or a page it has that width, and is a little higher than it would be by that.
    """
    wanted = WIDTHS.get(_FORM.get().width)
    if wanted is not None:
        width, height = wanted, max(0.7 * wanted, height * min(1.0, 1.2 * wanted / width))
    figure = Figure(figsize=(width, height))
    FigureCanvasAgg(figure)
    return figure


def fixed_panels(
    rows: int,
    columns: int,
    size: tuple[float, float],
    *,
    between: tuple[float, float],
    margins: tuple[float, float, float, float],
    shown: int | None = None,
) -> tuple[Figure, list[Axes]]:
    """A figure of equal panels whose places are known beforehand; only the outer ones have labels.

    To find out what room labels take is most of what drawing costs. For a column or a page the
    panels are as much smaller as it takes, their labels and what is between them is not.

    Parameters
    ----------
    rows, columns : of panels
    size : inches of a panel, wide and high
    between : inches from panel to panel, sideways and upwards
    margins : inches left, right, below and above all panels
    shown : how many panels there are; the last row may be short
    """
    left, right, bottom, top = margins
    wide, high = left + right + (columns - 1) * between[0], bottom + top + (rows - 1) * between[1]
    wanted = WIDTHS.get(_FORM.get().width)
    if wanted is not None:
        size = (
            (wanted - wide) / columns,
            (wanted - wide) / columns * size[1] / size[0],
        )
    width, height = wide + columns * size[0], high + rows * size[1]
    figure = Figure(figsize=(width, height))
    figure.set_layout_engine("none")
    FigureCanvasAgg(figure)
    panels = []
    for k in range(shown or rows * columns):
        row, column = divmod(k, columns)
        x = left + column * (size[0] + between[0])
        y = height - top - (row + 1) * size[1] - row * between[1]
        panel = figure.add_axes((x / width, y / height, size[0] / width, size[1] / height))
        panel.tick_params(
            which="both", labelleft=column == 0, labelbottom=k + columns >= (shown or 1)
        )
        panels.append(panel)
    return figure, panels


def save(figure: Figure, path: Path, caption: str) -> Path:
    """Write a figure that carries its caption as its description. Same figure, same bytes.

    Parameters
    ----------
    figure : the figure
    path : where the figure is written, its suffix that of the format
    caption : words under it

    Returns
    -------
    Where it lies.
    """
    form = _FORM.get()
    path = path.with_suffix(f".{form.format}")
    make_printable(figure)
    for panel in figure.axes:
        for axis in (panel.xaxis, panel.yaxis):
            if isinstance(axis.get_major_formatter(), LogFormatterMathtext):
                axis.set_major_formatter(_PlainPowers())
            if isinstance(axis.get_minor_formatter(), LogFormatterMathtext):
                minor = _PlainPowers(labelOnlyBase=False, minor_thresholds=(1, 0.4))
                axis.set_minor_formatter(minor)
    words = printable(caption)
    described: dict[str, dict[str, str | None]] = {
        "png": {"Software": None, "Description": words},
        "svg": {"Date": None, "Creator": None, "Description": words},
        "pdf": {"CreationDate": None, "Producer": None, "Creator": None, "Subject": words},
    }
    figure.set_dpi(matplotlib.rcParams["savefig.dpi"] if form.width else DPI)
    # `savefig` draws twice, the first time to lay the panels out, which every drawing does anyway
    canvas: Any = get_registered_canvas_class(form.format)(figure)  # imports that format alone
    # twice as fast as the default, for files that are a tenth larger
    options = {"pil_kwargs": {"compress_level": 3}} if form.format == "png" else {}
    getattr(canvas, f"print_{form.format}")(path, metadata=described[form.format], **options)
    return path


def make_printable(figure: Figure) -> None:
    """Nothing in the words of a figure that is no letter, before it is drawn."""
    for text in _words(figure):
        text.set_text(printable_lines(text.get_text()))


def _words(figure: Figure) -> Iterator[Text]:
    """Every text of a figure but the labels of ticks (see `name_ticks`)."""
    legends = [*figure.legends, *(panel.get_legend() for panel in figure.axes)]
    yield from figure.texts
    for panel in figure.axes:
        yield from (panel.title, panel.xaxis.label, panel.yaxis.label, *panel.texts)
    for legend in legends:
        if legend is not None:
            yield from (legend.get_title(), *legend.get_texts())


def narrow() -> bool:
    """Whether what is drawn must fit into one column: one panel beside another has no room."""
    return _FORM.get().width == "column"


def form() -> Form:
    """What is drawn for."""
    return _FORM.get()


def few_ticks(panels: Sequence[Axes], columns: int) -> None:
    """A few ticks on the outer panels, none where their labels would stand between panels."""
    for k, panel in enumerate(panels):
        for axis, outer in (
            (panel.xaxis, k + columns >= len(panels)),
            (panel.yaxis, k % columns == 0),
        ):
            few = 3 if narrow() and columns > 1 and axis is panel.xaxis else 5
            axis.set_major_locator(MaxNLocator(few) if outer else NullLocator())


def pixels() -> int:
    """Pixels along the longer side of an image within a figure."""
    return 640 if _FORM.get() == FOR_REPORT else 1600


def heading(figure: Figure, text: str, **look: Any) -> None:
    """A title over all panels; in a journal the words under a figure take its place."""
    if not _FORM.get().width:
        figure.suptitle(text, **look)


def beside(figure: Figure, **legend: Any) -> None:
    """A legend right of the panels."""
    figure.legend(**legend, loc="outside right upper")


class _PlainPowers(LogFormatterSciNotation):
    """Labels the places that matplotlib would, without its markup."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        if not super().__call__(x, pos):
            return ""
        exponent = round(math.log10(x))
        exact = math.isclose(x, 10.0**exponent)
        return power_of_ten(exponent) if exact else plain_number(x, 3)


def legend_text(text: str) -> str:
    """A text that a legend shows: matplotlib hides those that begin with an underscore."""
    return f" {text}" if text.startswith("_") else text


def shorten(text: str, most: int = 48) -> str:
    """A text that fits beside others."""
    return text if len(text) <= most else f"{text[: most - 1]}…"


def shades(name: str, count: int) -> np.ndarray:
    """Colours of one family from light to dark, (count, 4); a single one is dark."""
    place = np.linspace(0.45, 0.95, count) if count > 1 else np.array([0.8])
    found: np.ndarray = matplotlib.colormaps[name](place)
    return found


def sequence(count: int) -> np.ndarray:
    """Colours for an ordered series (times), from dark to light but never pale, (count, 4)."""
    return matplotlib.colormaps[SEQUENTIAL](np.linspace(0.0, 0.85, count))


def label(name: str, values: np.ndarray | float) -> tuple[float, str]:
    """Factor and axis label of a quantity: its long name and a unit that suits the values."""
    quantity = {**COORDINATES, **MAPS, **TESTS, **CASE}[name]
    factor, unit = display(quantity.unit, values)
    return factor, f"{quantity.long_name} ({unit})" if unit else quantity.long_name


def time_unit(times: np.ndarray) -> tuple[float, str]:
    """Factor and unit for a logarithmic axis of times, from the middle of their range."""
    return display("s", float(np.sqrt(np.min(times) * np.max(times))))


def is_log_spaced(values: np.ndarray) -> bool:
    """Whether positive values span more than a decade or grow by an even factor."""
    if values.dtype.kind not in "iuf" or len(values) < 2 or not np.all(values > 0):
        return False
    if values.max() / values.min() > 10:
        return True
    steps = np.diff(np.log(values))
    return len(values) > 2 and bool(
        np.ptp(steps) < 1e-6 * abs(steps[0]) and values[-1] > 4 * values[0]
    )


def pick(count: int, most: int) -> list[int]:
    """At most `most` positions out of `count`, evenly spread, both ends among them."""
    if count <= most:
        return list(range(count))
    return sorted({round(i) for i in np.linspace(0, count - 1, most)})


def plain_log_ticks(axis: Axis) -> None:
    """Label a short logarithmic axis at 1, 2, 5, 10, … in plain numbers."""
    low, high = axis.get_view_interval()
    if high > 1e3 * low:
        return
    shown = FuncFormatter(lambda value, _: plain_number(value, 3))
    axis.set_major_formatter(shown)
    axis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
    axis.set_minor_formatter(shown)


def decade_ticks(axis: Axis) -> None:
    """Ticks of a logarithmic axis at decades; where it shows fewer than two, between them too."""
    low, high = np.log10(axis.get_view_interval())
    if math.floor(high) - math.ceil(low) < 1:
        plain_log_ticks(axis)
    else:
        axis.set_minor_locator(NullLocator())


def name_ticks(axis: Axis, places: ArrayLike, names: Sequence[str]) -> None:
    """Ticks with names instead of numbers."""
    axis.set_ticks(np.asarray(places), [printable_lines(name) for name in names])


def quiet_minor_labels(axis: Axes, values: Sequence[float]) -> None:
    """Mark the given values on a logarithmic x axis, and nothing between them."""
    axis.set_xticks(values, [f"{v:.4g}" for v in values])
    axis.xaxis.set_minor_formatter(NullFormatter())
