"""The true error of the well's pressure is the tolerance or a little less, for both solvers."""

from __future__ import annotations

import numpy as np

from model.flow.solvers import SOLVERS
from tests.benchmarks.result import Result
from tests.diffusion import reference, relative_error, well_pressure, well_problem

NETWORKS = 100
CONTRASTS = (1.0, 1e3, 1e6, 1e9)
TOLERANCES = tuple(10.0**-k for k in range(2, 9))
LEAST, MOST, SHARE, NEVER = 0.01, 1.0, 0.95, 3.0


def run() -> Result:
    """Ratio of true to asked error over networks of other seed, well, contrast and size."""
    rng = np.random.default_rng(2024)
    ratio: dict[str, list[list[float]]] = {"krylov": [], "implicit": []}
    apart = 0.0
    for k in range(NETWORKS):
        problem = well_problem(
            int(rng.integers(250, 600)),
            contrast=CONTRASTS[k % len(CONTRASTS)],
            seed=1000 + k,
            at=tuple(rng.uniform(-0.7, 0.7, 2)),
            decades=float(rng.uniform(4.0, 8.0)),
            times=41,
        )
        exact = reference(problem)
        for method, rows in ratio.items():
            answers = [
                well_pressure(SOLVERS[method].run(problem._replace(tolerance=tolerance)))
                for tolerance in TOLERANCES
            ]
            rows.append(
                [relative_error(p, exact) / t for p, t in zip(answers, TOLERANCES, strict=True)]
            )
            if method == "implicit":
                apart = max(apart, relative_error(answers[-1], exact))
    figures, lines, holds = [], [], True
    for method, rows in ratio.items():
        found = np.array(rows)
        within = np.mean((found >= LEAST) & (found <= MOST))
        holds &= within >= SHARE and found.max() <= NEVER
        figures.append(f"{method} {within:.1%} within, largest {found.max():.2g}")
        for tolerance, column in zip(TOLERANCES, found.T, strict=True):
            low, middle, high = np.quantile(column, (0.05, 0.5, 0.95))
            lines.append(
                f"{method} {tolerance:.0e}: 5 % {low:.2g}, median {middle:.2g}, 95 % {high:.2g}, "
                f"largest {column.max():.2g}, below {LEAST:g} {np.mean(column < LEAST):.0%}"
            )
    lines.append(
        f"the reference is krylov at 1e-11; implicit at {TOLERANCES[-1]:.0e}, which shares only "
        f"the factor with it, differs by {apart:.1e} at most"
    )
    return Result(
        "; ".join(figures),
        f"{SHARE:.0%} in [{LEAST:g}, {MOST:g}], never above {NEVER:g}",
        bool(holds),
        "\n".join(lines),
    )
