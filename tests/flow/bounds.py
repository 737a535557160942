"""What each solver may be off by, of the largest value; forward Euler is of first order."""

from __future__ import annotations

from typing import NamedTuple

from numpy import nan


class Off(NamedTuple):
    """Bounds of one solver, relative; NaN where a test does not take it."""

    response: float  # to unit steps, of a small network
    wellbore: float  # where wells store and have skins
    initial: float  # where pressures begin out of balance
    laws: float  # superposition, symmetry and what else holds on any graph
    schedule: float  # between rates that change and the sum of their steps
    peer: float  # from another program's network
    beyond: float  # the pressures that drive


OFF = {
    "explicit": Off(1e-3, 1e-3, 2e-3, 2e-3, 5e-3, 1e-3, 1e-13),
    "implicit": Off(1e-8, 1e-8, 1e-6, 1e-7, 1e-8, 2e-7, 1e-6),
    "krylov": Off(1e-8, 1e-8, 1e-6, 1e-7, 1e-8, 2e-7, 1e-6),
    "steady": Off(1e-9, nan, nan, 1e-9, nan, 1e-8, 1e-13),
}
