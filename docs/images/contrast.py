"""Draws contrast.png: errors of steady solvers against the contrast of a fracture's pipes.

PYTHONPATH=. python docs/images/contrast.py
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import qdldl
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import splu

from demflow.model.controls import sites
from demflow.model.flow.equation.balance import steady_flow
from demflow.model.flow.equation.system import System
from demflow.model.flow.linear.factor import analyse, factorise
from demflow.sweep.figures.style import BLACK, BLUE, VERMILION, house_style, new_figure, save
from tests.benchmarks.contrasts import WELL, cut, pores, reference

CONTRASTS = np.logspace(0, 14, 15)
SOURCE = 1  # of the well; the side held at a pressure is the source before it

Solution = tuple[np.ndarray, float]  # pressures, flow let in by the side


def matrix(system: System) -> csc_array:
    """G, its diagonal stored."""
    n, i, j, g = system.n, system.edge_i, system.edge_j, system.edge_g
    diagonal = system.excess + np.bincount(i, g, n) + np.bincount(j, g, n)
    rows = np.concatenate([i, j, np.arange(n)])
    columns = np.concatenate([j, i, np.arange(n)])
    return csc_array(
        coo_array((np.concatenate([-g, -g, diagonal]), (rows, columns)), shape=(n, n)).tocsc()
    )


def with_inflow(system: System, p: np.ndarray) -> Solution:
    """The side's inflow from the pressures beside it."""
    return p, float(-(system.fixed_g * p[system.fixed_node]).sum())


def by_splu(system: System) -> Solution:
    """SciPy's SuperLU."""
    return with_inflow(system, splu(matrix(system)).solve(system.source(SOURCE)))


def by_qdldl(system: System) -> Solution:
    """LDLᵀ by qdldl."""
    return with_inflow(system, qdldl.Solver(matrix(system)).solve(system.source(SOURCE)))


def by_demflow(system: System) -> Solution:
    """The factor from conductances and excesses, pressures of two doubles."""
    factor = factorise(
        analyse(system.n, system.edge_i, system.edge_j), system.edge_g, system.excess
    )
    found = steady_flow(system, factor, SOURCE)
    return found.pressure, float(found.inflow(system, SOURCE)[0])


SOLVERS: dict[str, tuple[Callable[[System], Solution], str, str]] = {
    "SciPy splu": (by_splu, VERMILION, "s"),
    "qdldl": (by_qdldl, BLACK, "^"),
    "demflow": (by_demflow, BLUE, "o"),
}


def main() -> None:
    """Solve at every contrast and draw."""
    rock = pores(1_500)
    errors = {name: np.empty((len(CONTRASTS), 2)) for name in SOLVERS}
    for k, contrast in enumerate(CONTRASTS):
        system = cut(rock, "fracture", contrast).assembled(sites((WELL,)), ("left",))
        exact = reference(system, system.source(SOURCE))
        for name, (solver, _, _) in SOLVERS.items():
            p, inflow = solver(system)
            errors[name][k] = np.abs(p / exact - 1.0).max(), abs(inflow - 1.0)
            print(f"{contrast:.0e} {name}: {errors[name][k]}")
    with house_style():
        figure = new_figure(7.2, 3.0)
        axes = figure.subplots(1, 2, sharex=True, sharey=True)
        titles = ("largest relative error of a pressure", "side's inflow less the well's rate")
        for column, (axis, title) in enumerate(zip(axes, titles, strict=True)):
            for name, (_, colour, marker) in SOLVERS.items():
                shown = np.maximum(errors[name][:, column], 1e-17)
                axis.loglog(CONTRASTS, shown, marker=marker, ms=3.5, color=colour, label=name)
            axis.set_title(title)
            axis.set_xlabel("contrast of conductances")
        axes[0].set_ylabel("error")
        axes[0].legend(loc="upper left")
        save(
            figure,
            Path(__file__).with_suffix(".png"),
            f"Steady flow to a well on a fracture, {system.pores} pores.",
        )


if __name__ == "__main__":
    main()
