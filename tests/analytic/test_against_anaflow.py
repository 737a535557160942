"""Wells against AnaFlow: line source, finite radius, and a circle of constant pressure.

AnaFlow inverts by Stehfest's method, which is right to some four digits.
"""

import numpy as np
import pytest

from demflow.model.analytic.radial import (
    finite_radius_well,
    line_source,
    radial_dimensionless_pressure,
)
from tests.peers.pressures import ANAFLOW

REACH = 150.0  # rim over √(T t / S), up to which AnaFlow's bounded wells are right


@pytest.mark.parametrize("name", ["line_source", "finite_radius", "bounded"])
def test_pressure_falls_are_those_of_anaflow(name):
    """Kept by `tests/peers/pressures.py`."""
    with np.load(ANAFLOW) as kept:
        t, r, bound = kept["times"][:, None], kept["radii"], float(kept["bound"])
        theirs = kept[name]
    solutions = {
        "line_source": lambda: line_source(r, t),
        "finite_radius": lambda: finite_radius_well(r, t),
        "bounded": lambda: np.log(bound) * radial_dimensionless_pressure(r, t, bound),
    }
    # where the rim lies farther off than this, AnaFlow's bounded wells lose their digits
    assert bound <= REACH * np.sqrt(t.min())
    within = 1e-9 if name == "line_source" else 2e-4
    np.testing.assert_allclose(solutions[name](), theirs, rtol=within, atol=within)
