"""Force error against processor time of both mechanical solvers; draws the figure of the docs.

5,000 grains from the packed state to 24 : 18 MPa, asked for stopping ratios of 1e-2 to 1e-6. The
error of a state is the L2 difference of its contact forces from those of the same solver's
tightest state. For contact bonds both solvers have the same; where contacts slip forces depend on
the path, which the static solver takes in one step, and the figure shows how far that is apart.
"""

from __future__ import annotations

import statistics
import time
from pathlib import Path
from typing import NamedTuple

from demflow.model.outcome import ModelError
from demflow.model.products import StressState
from demflow.model.scene import Bonds, Stress
from demflow.sweep.figures.style import BLACK, BLUE, GREY, VERMILION, house_style, new_figure, save
from tests.benchmarks.result import Result
from tests.benchmarks.specimens import CEMENTS, difference, loaded, packed, responses

RATIOS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
TIGHTEST = 1e-7
TARGET = {"xx": 24e6, "yy": 18e6}
COUNT, REPEATS = 5000, 3
DOCS = Path(__file__).parents[2] / "docs"
FIGURE = DOCS / "images" / "work_against_precision.png"
PAGE = DOCS / "verification.md"
BEGIN, END = "<!-- work_against_precision -->\n", "<!-- end -->\n"


class Point(NamedTuple):
    """One run."""

    ratio: float  # asked for
    seconds: float
    error: float
    steps: int  # or corrections


class Series(NamedTuple):
    """A rock, and a solver."""

    name: str
    rock: str | None  # of CEMENTS; None without bonds
    method: str
    colour: str
    line: str


SERIES = (
    Series("contact bonds, static", "contact bonds", "static", BLUE, "-o"),
    Series("contact bonds, explicit", "contact bonds", "explicit", BLUE, "--s"),
    Series("parallel bonds, static", "parallel bonds", "static", VERMILION, "-o"),
    Series("parallel bonds, explicit", "parallel bonds", "explicit", VERMILION, "--s"),
    Series("no bonds, explicit", None, "explicit", BLACK, "--s"),
)


def state(series: Series, ratio: float) -> tuple[StressState, float]:
    """The state that a solver stops at, and the least of a few times."""
    rock = series.rock
    bonds: Bonds | None = None if rock is None else CEMENTS[rock]
    units = responses(rock, COUNT) if rock is not None and series.method == "static" else None
    target = Stress(**TARGET, method=series.method, tolerance=ratio)
    runs = [loaded(packed(COUNT), target, bonds, units) for _ in range(REPEATS)]
    return runs[0][0], statistics.median(seconds for _, seconds in runs)


def points(series: Series) -> tuple[list[Point], StressState, str]:
    """A solver's points, its tightest state, and what it could not reach."""
    states, refused = [], ""
    for ratio in (*RATIOS, TIGHTEST):
        try:
            states.append((ratio, *state(series, ratio)))
        except ModelError as error:
            refused = f"{series.name}: {error}"
    tightest = states[-1][1]
    found = [
        Point(ratio, seconds, difference(reached, tightest), int(reached.steps))
        for ratio, reached, seconds in states
        if ratio in RATIOS and reached is not tightest
    ]
    return found, tightest, refused


def draw(found: dict[str, list[Point]], once: float, slipping: float) -> None:
    """The figure; `once` is the time of the unit loads, `slipping` what the solvers disagree by."""
    with house_style():
        figure = new_figure(6.4, 3.6)
        axis = figure.subplots()
        for series in SERIES:
            shown = found[series.name]
            axis.loglog(
                [p.seconds for p in shown],
                [p.error for p in shown],
                series.line,
                ms=4,
                color=series.colour,
                label=series.name,
            )
        axis.axvline(once, color=GREY, ls=":", lw=1.2, label="unit loads, once for a rock")
        axis.axhline(
            slipping, color=VERMILION, ls=":", lw=1.2, label="parallel bonds, between solvers"
        )
        axis.set_xlabel("processor time (s)")
        axis.set_ylabel("error of the contact forces (L2, relative)")
        axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        caption = f"{COUNT} grains to 24 : 18 MPa, stopping ratios 1e-2 to 1e-6 from top to bottom."
        save(figure, FIGURE, caption)


def table(found: dict[str, list[Point]]) -> str:
    """The same as a table: milliseconds and error of each."""
    lines = [
        "| stopping ratio | " + " | ".join(series.name for series in SERIES) + " |",
        "|---" * (len(SERIES) + 1) + "|",
    ]
    for ratio in RATIOS:
        cells = []
        for series in SERIES:
            known = [p for p in found[series.name] if p.ratio == ratio]
            cells += [f"{1e3 * p.seconds:.3g} ms, {p.error:.0e}" for p in known] or ["not reached"]
        lines.append(f"| {ratio:.0e} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def run() -> Result:
    """Points of all solvers; the figure and its table in the docs."""
    found, tightest, lines = {}, {}, []
    for series in SERIES:
        state(series, RATIOS[0])  # compiles
        found[series.name], tightest[series.name], refused = points(series)
        lines += [
            f"{series.name:24} {p.ratio:.0e}: {1e3 * p.seconds:8.1f} ms, {p.steps:6} steps, "
            f"error {p.error:.1e}"
            for p in found[series.name]
        ]
        lines += [refused] if refused else []
    agree = difference(tightest["contact bonds, static"], tightest["contact bonds, explicit"])
    slipping = difference(tightest["parallel bonds, static"], tightest["parallel bonds, explicit"])
    start = time.process_time()
    responses.__wrapped__("contact bonds", COUNT)
    once = time.process_time() - start
    draw(found, once, slipping)
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    after = rest.partition(END)[2]
    PAGE.write_text(before + BEGIN + table(found) + END + after, encoding="utf-8")
    lines.append(f"unit loads, once for a rock: {once:.2f} s")
    lines.append(f"tightest states of both solvers: contact bonds {agree:.1e} apart,")
    lines.append(f"parallel bonds {slipping:.1e} apart")
    return Result(
        f"tightest states of both solvers {agree:.1e} apart", "≤ 1e-03", agree <= 1e-3,
        "\n".join(lines),
    )  # fmt: skip
