"""Steady flow of a million pores against qdldl's own factor and solve."""

from __future__ import annotations

import ctypes
import gc
import threading
import time

import numpy as np
import psutil
import qdldl
from scipy.sparse import coo_array, csc_array

from demflow.model.flow.equation.problem import Problem
from demflow.model.flow.equation.system import System
from demflow.model.flow.solvers.registry import SOLVERS
from tests.benchmarks.result import Result
from tests.diffusion import well_problem

SIZES = (10_000, 100_000, 1_000_000)
REPEATS = 3
RATIO, MEMORY, EXPONENT = 1.5, 1e9, 1.4


def upper(system: System) -> csc_array:
    """The upper triangle of the matrix."""
    n, i, j, g = system.n, system.edge_i, system.edge_j, system.edge_g
    diagonal = system.excess + np.bincount(i, g, n) + np.bincount(j, g, n)
    rows = np.concatenate([np.minimum(i, j), np.arange(n)])
    columns = np.concatenate([np.maximum(i, j), np.arange(n)])
    return csc_array(
        coo_array((np.concatenate([-g, diagonal]), (rows, columns)), shape=(n, n)).tocsc()
    )


def theirs(matrix: csc_array, rhs: np.ndarray) -> tuple[float, np.ndarray]:
    """Seconds of one core and the solution."""
    start = time.process_time()
    x = qdldl.Solver(matrix, upper=True).solve(rhs)
    return time.process_time() - start, x


def ours(problem: Problem, turn: int) -> tuple[float, np.ndarray]:
    """Seconds of one core and the well's pressure; the edges turn, so that no analysis is known."""
    system = problem.system
    if turn % 2:
        system = system._replace(edge_i=system.edge_j, edge_j=system.edge_i)
    moved = np.roll(np.arange(len(system.edge_g)), turn)
    system = system._replace(
        edge_i=system.edge_i[moved], edge_j=system.edge_j[moved], edge_g=system.edge_g[moved]
    )
    start = time.process_time()
    answer = SOLVERS["steady"].run(problem._replace(system=system))
    return time.process_time() - start, answer.output[1, 0, :1]


def memory(problem: Problem, turn: int) -> float:
    """Bytes that a solution takes at its peak above what the process held before."""
    process = psutil.Process()
    gc.collect()
    # what was freed goes back to the system, or it would be taken again without being seen
    ctypes.CDLL("libc.so.6").malloc_trim(0)
    before = process.memory_info().rss
    most, done = before, threading.Event()

    def watch() -> None:
        nonlocal most
        while not done.wait(0.002):
            most = max(most, process.memory_info().rss)

    watcher = threading.Thread(target=watch)
    watcher.start()
    ours(problem, turn)
    done.set()
    watcher.join()
    return float(most - before)


def run() -> Result:
    """Order, factor, solve and balance on one side, order, factor and solve on the other."""
    took, lines = [], []
    ours(well_problem(1_000)._replace(lag=np.array([np.inf])), 0)
    for size in SIZES:
        problem = well_problem(size)._replace(lag=np.array([np.inf]))
        matrix, rhs = upper(problem.system), problem.system.source(1)
        runs = [ours(problem, turn) for turn in range(REPEATS)]
        mine, pressure = min(seconds for seconds, _ in runs), runs[0][1]
        grown = memory(problem, REPEATS)
        pairs = [theirs(matrix, rhs) for _ in range(REPEATS)]
        peer = min(seconds for seconds, _ in pairs)
        agree = abs(pressure[0] / pairs[0][1][problem.system.well_node[0]] - 1.0)
        took.append(mine)
        lines.append(
            f"{problem.system.pores} pores: {mine:.3f} s, qdldl {peer:.3f} s, "
            f"ratio {mine / peer:.2f}, {grown / 1e6:.0f} MB, well pressures differ by {agree:.0e}"
        )
    exponent = float(np.polyfit(np.log(SIZES), np.log(took), 1)[0])
    ratio = mine / peer
    return Result(
        f"{ratio:.2f} times the time, {grown / 1e6:.0f} MB, exponent {exponent:.2f}",
        f"≤ {RATIO:g} times, ≤ {MEMORY / 1e6:.0f} MB, exponent ≤ {EXPONENT:g}",
        bool(ratio <= RATIO and grown <= MEMORY and exponent <= EXPONENT),
        "\n".join(lines),
    )
