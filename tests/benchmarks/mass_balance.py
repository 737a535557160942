"""Fluid stored, produced and let in balance in every case of every study."""

from __future__ import annotations

import numpy as np

from tests.benchmarks.ran import ran
from tests.benchmarks.result import Result, at_most

STUDIES = ("quickstart", "paper_linear", "paper_radial", "paper_fractured")


def run() -> Result:
    """Largest relative imbalance over all cases, as stored in the datasets."""
    worst, lines = 0.0, []
    for name in STUDIES:
        error = ran(name).dataset["mass_balance_error"].values
        worst = max(worst, float(np.max(error)))
        lines.append(f"{name}: {error.size} cases, largest {np.max(error):.1e}")
    return at_most(worst, 1e-10, "largest relative imbalance", "\n".join(lines))
