"""Force error against CPU time of both mechanical solvers, and the figure of it."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt

from model.outcome import ModelError
from model.scene import Stress
from tests.benchmarks.result import Result
from tests.benchmarks.specimens import difference, loaded, packed, responses

TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
TARGET = {"xx": 30e6, "yy": 25e6}
FIGURE = Path(__file__).parents[2] / "docs" / "mechanics_work_precision.svg"


def run() -> Result:
    """Errors against each solver's own tightest state, 5,000 bonded grains."""
    rock, units = packed(5000), responses(5000)
    rows: dict[str, list[tuple[float, float, float]]] = {}
    lines = []
    ends = {}
    for method in ("explicit", "static"):
        loaded(rock, Stress(**TARGET, method=method), units)  # compiles
        states = []
        for tolerance in TOLERANCES:
            try:
                state, seconds = loaded(
                    rock, Stress(**TARGET, method=method, tolerance=tolerance), units
                )
            except ModelError as error:
                lines.append(f"{method} {tolerance:.0e}: {error}")
                continue
            states.append((tolerance, seconds, state))
        ends[method] = states[-1][2]
        rows[method] = [(t, s, difference(state, ends[method])) for t, s, state in states]
        lines += [
            f"{method:8} {t:.0e}: {1e3 * s:8.1f} ms, force error {error:.1e}"
            for t, s, error in rows[method]
        ]
    apart = difference(ends["static"], ends["explicit"])
    lines.append(f"tightest states {apart:.2e} apart")
    figure, axes = plt.subplots(figsize=(5.0, 3.6), layout="constrained")
    for method, marker in (("explicit", "o"), ("static", "s")):
        points = [(s, error) for _, s, error in rows[method] if error > 0.0]
        axes.loglog(*zip(*points, strict=True), marker=marker, label=method)
    axes.set(xlabel="CPU time, s", ylabel="error of the contact forces (L2)")
    axes.legend()
    figure.savefig(FIGURE, metadata={"Date": None})
    plt.close(figure)
    return Result(
        f"tightest states of both solvers {apart:.1e} apart", "≤ 1e-02", apart <= 1e-2,
        "\n".join(lines),
    )  # fmt: skip
