"""A transient of tight rock with an open fracture is right, or not called done.

A well in a fracture of 0.1 to 3 mm in rock of 100 nD to 0.01 nD, whose conductances lie up to some
1e14 apart: held at a pressure, at a rate, or both kinds side by side; seen early, late, and over
seven decades between. What a study is told is compared with a solution in extended precision, on
the scales of the check `tolerance_means_error`.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator

import numpy as np

from demflow.model.outcome import ModelError
from demflow.model.region import Rectangle
from demflow.model.scene import BiWing, Fluid, Grains, Matrix, Probe, Scene, Solver, Well
from demflow.sweep.study.expect import JUDGED, Expectation, beyond_bounds
from tests.benchmarks.result import Result
from tests.benchmarks.tolerance_means_error import (
    Recorded,
    open_rock,
    products_of,
    ratios,
    recorded,
    truth,
)
from tests.scenes import START

NANODARCY = 9.869e-22  # m²
PERMEABILITIES = (100.0, 10.0, 1.0, 0.1, 0.01)  # nD
APERTURES = (1e-4, 1e-3, 3e-3)  # m
CONTROLS = ("pressure", "rate", "both")
WINDOWS = {"early": (1e-3, 1e2), "between": (1.0, 1e7), "late": (1e6, 1e11)}  # s
METHODS = ("krylov", "implicit", "auto")
TOLERANCES = (1e-2, 1e-4, 1e-6)
MOST = 3.0  # true over asked error

HELD = Well(name="held", at=(0.3, 0.1), radius=0.1, pressure=5e6)
RATED = Well(name="rated", at=(0.3, 0.1), radius=0.1, rate=1e-12)
CONTROLLED = {
    "pressure": (HELD,),
    "rate": (RATED,),
    "both": (HELD, dataclasses.replace(RATED, at=(-4.0, -4.5))),
}


def tight(
    permeability: float, aperture: float, control: str = "pressure", window: str = "between"
) -> Scene:
    """A well in an open fracture of rock of so many nD, from which a held side lies far."""
    return Scene(
        region=Rectangle(20.0, 16.0),
        grains=Grains(count=60, porosity=0.17, seed=3),
        matrix=Matrix(permeability=permeability * NANODARCY),
        fluid=Fluid(1e-3, 2e9),
        fractures=(BiWing(name="f", aperture=aperture, at=(0.3, 0.1), angle=0.3, half_length=6.0),),
        wells=CONTROLLED[control],
        boundaries=(("left", START),),
        initial_pressure=START,
        times=tuple(np.geomspace(*WINDOWS[window], 15)),
        probes=(Probe("a", (5.0, 4.0)),),
        observe=("well_pressure", "probe_pressure", "pressure_map", "boundary_flow"),
    )


def faults(found: Recorded) -> list[str]:
    """Why a study does not call such a case done; empty where it does."""
    numbers = {name: float(found[name]) for name in JUDGED if name in found}
    return beyond_bounds(Expectation(), numbers)


class Case:
    """A scene, its open network and, once one solver has told the lags, what is right."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.rock = open_rock(scene)
        self.known: tuple[Recorded, Recorded] | None = None

    def worst(self, method: str, tolerance: float) -> tuple[float, str, Recorded]:
        """Largest true over asked error, of what, and all that a study is told.

        Raises `ModelError` where the solver refuses.
        """
        scene = dataclasses.replace(self.scene, solver=Solver(method=method, tolerance=tolerance))
        found = recorded(scene, self.rock)
        if self.known is None:
            self.known = truth(scene, self.rock, products_of(scene, self.rock, "flow")["flow"])
        each = ratios(found, *self.known, tolerance)
        name = max(each, key=lambda key: each[key])
        return each[name], name, found


def cases() -> Iterator[tuple[str, Case]]:
    """All scenes of the family, each with its name."""
    for k, w, control, window in itertools.product(PERMEABILITIES, APERTURES, CONTROLS, WINDOWS):
        yield f"{k:g} nD, {1e3 * w:g} mm, {control}, {window}", Case(tight(k, w, control, window))


def run() -> Result:
    """Error of each case, solver and tolerance, and whether it is called done."""
    done, told, refused = [], [], []
    for name, case in cases():
        for method, tolerance in itertools.product(METHODS, TOLERANCES):
            label = f"{name}, {method}, {tolerance:.0e}"
            try:
                ratio, what, found = case.worst(method, tolerance)
            except ModelError as error:
                refused.append(f"{label}: refused: {error}")
                continue
            why = faults(found)
            line = f"{label}: {ratio:.3g} ({what})"
            if why:
                told.append((ratio, f"{line}: not done: {'; '.join(why)}"))
            else:
                done.append((ratio, line))
    ratio = np.array([r for r, _ in done])
    lines = [text for r, text in sorted(done, reverse=True)[:20]]
    lines += [text for _, text in sorted(told, reverse=True)[:20]] + refused[:20]
    most = float(ratio.max())
    return Result(
        f"{len(done)} answers called done, {np.mean(ratio <= 1.0):.1%} within the tolerance, at "
        f"worst {most:.3g} times it; {len(told)} told as not good, {len(refused)} refused",
        f"{MOST:g} times the tolerance, or not done",
        most <= MOST,
        "\n".join(lines),
    )
