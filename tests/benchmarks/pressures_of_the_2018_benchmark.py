"""Pressures along the lines of the 2018 benchmark's regular and complex fracture networks.

Six fractures at right angles, all open or all tight, and ten at random of which two are tight,
in a unit square (Flemisch et al. 2018, Adv. Water Resour. 111, 239–258): apertures of 1e-4 and
permeabilities of 1e4 and 1e-4 of the rock's. The regular network flows from left to right
between pressures, as the complex one does, which flows from top to bottom besides. Against a
grid of 401 × 401 squares (`tests/traces_on_a_grid.py`), which differs from that of 201 by as
much as is told.
"""

from __future__ import annotations

import numpy as np

from demflow.model import simulate
from demflow.model.scene import Fluid, Grains, Matrix, Probe, Rectangle, Scene, Trace
from tests.benchmarks.result import Result
from tests.traces_on_a_grid import solved

GRAINS, PACKINGS, POINTS, SQUARES, BOUND = 20_000, 3, 72, (201, 401), 0.015
ROCK = 1e-14  # m²
APERTURE, OPEN, TIGHT = 1e-4, 1e4, 1e-4

REGULAR = np.array(
    [
        [0, 0.5, 1, 0.5],
        [0.5, 0, 0.5, 1],
        [0.5, 0.75, 1, 0.75],
        [0.75, 0.5, 0.75, 1],
        [0.5, 0.625, 0.75, 0.625],
        [0.625, 0.5, 0.625, 0.75],
    ]
)
COMPLEX = np.array(
    [
        [0.05, 0.416, 0.22, 0.0624],
        [0.05, 0.275, 0.25, 0.135],
        [0.15, 0.63, 0.45, 0.09],
        [0.7, 0.235, 0.849723, 0.167625],
        [0.6, 0.38, 0.85, 0.2675],
        [0.35, 0.9714, 0.8, 0.7143],
        [0.75, 0.9574, 0.95, 0.8155],
        [0.15, 0.8363, 0.4, 0.9727],
    ]
)
COMPLEX_TIGHT = np.array([[0.15, 0.9167, 0.4, 0.5], [0.65, 0.8333, 0.849723, 0.167625]])
NONE = np.empty((0, 4))

along = (np.arange(POINTS) + 0.5) / POINTS
RISING = np.column_stack([along, 0.5 + 0.4 * along])
# of each case: open fractures, tight ones, sides held, and the benchmark's lines
CASES = {
    "1, open": (
        REGULAR,
        NONE,
        ("left", "right"),
        (np.column_stack([along, np.full(POINTS, 0.7)]), np.column_stack([0 * along + 0.5, along])),
    ),
    "1, tight": (
        NONE,
        REGULAR,
        ("left", "right"),
        (np.column_stack([0.9 * along, 0.1 + 0.9 * along]),),
    ),
    "3, from the top": (COMPLEX, COMPLEX_TIGHT, ("top", "bottom"), (RISING,)),
    "3, from the left": (COMPLEX, COMPLEX_TIGHT, ("left", "right"), (RISING,)),
}


def modelled(name: str, seed: int, grains: int = GRAINS) -> list[np.ndarray]:
    """Pressures along the lines of a case, for a drop of one."""
    open_, tight, held, lines = CASES[name]
    wide = (12 * OPEN * APERTURE * ROCK) ** (1 / 3)
    traces = [
        Trace(
            name=f"open{k}", aperture=wide, start=tuple(line[:2] - 0.5), end=tuple(line[2:] - 0.5)
        )
        for k, line in enumerate(open_)
    ] + [
        Trace(
            name=f"tight{k}",
            thickness=APERTURE,
            permeability=TIGHT * ROCK,
            start=tuple(line[:2] - 0.5),
            end=tuple(line[2:] - 0.5),
        )
        for k, line in enumerate(tight)
    ]
    points = np.concatenate(lines) - 0.5
    found = simulate(
        Scene(
            region=Rectangle(1.0, 1.0),
            grains=Grains(count=grains, seed=seed, porosity=0.17),
            matrix=Matrix(permeability=ROCK),
            fluid=Fluid(viscosity=1.0, bulk_modulus=1e9),
            fractures=tuple(traces),
            boundaries=((held[0], 1.0), (held[1], 0.0)),
            probes=tuple(Probe(f"p{k}", (float(x), float(y))) for k, (x, y) in enumerate(points)),
            observe=("probe_pressure",),
        )
    )
    return np.split(found["probe_pressure"], len(lines))


def on_a_grid(name: str, n: int) -> list[np.ndarray]:
    """The same on n × n squares."""
    open_, tight, held, lines = CASES[name]
    wide, thick = OPEN * APERTURE, APERTURE / TIGHT
    grid = solved(n, open_, wide, tight, thick, held, (1.0, 0.0))
    return [grid.at(line) for line in lines]


def rms(one: np.ndarray, other: np.ndarray) -> float:
    """Root of the mean square of the difference."""
    return float(np.sqrt(np.mean((one - other) ** 2)))


def run() -> Result:
    """Mean over packings of the RMS along each line, of a drop of one."""
    figures, lines = [], []
    for name in CASES:
        coarse, fine = (on_a_grid(name, n) for n in SQUARES)
        every = np.array(
            [
                [rms(p, q) for p, q in zip(modelled(name, seed + 1), fine, strict=True)]
                for seed in range(PACKINGS)
            ]
        )
        for k, off in enumerate(every.T):
            figures.append(off.mean())
            lines.append(
                f"case {name}, line {k + 1}: {100 * off.mean():.2f} % of the drop, "
                f"{np.round(100 * off, 2)}; the grids {100 * rms(coarse[k], fine[k]):.2f} %"
            )
    return Result(
        f"at most {100 * max(figures):.2f} % of the drop",
        f"≤ {100 * BOUND:g} %",
        max(figures) <= BOUND,
        "\n".join(lines),
    )
