"""Explicit and krylov agree with a dense eigen-solution of the same network of 500 domains."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.linalg

from demflow.model.controls import sites
from demflow.model.flow.equation.system import System, assemble
from demflow.model.flow.solvers.registry import SOLVERS
from demflow.model.scene import Circle, Fluid, Grains, Matrix, Scene, Solver, Trace, Well
from demflow.model.stages import run_stages
from tests.benchmarks.result import Result

TIMES = tuple(np.geomspace(20.0, 2e5, 25))
SCENE = Scene(
    region=Circle(14.0),
    grains=Grains(count=800, porosity=0.17),
    matrix=Matrix(permeability=2e-15),
    fluid=Fluid(viscosity=1e-3, bulk_modulus=2e9),
    fractures=(Trace(name="f", start=(-9.0, 2.0), end=(9.0, 4.0), permeability=2e-14),),
    wells=(Well(name="w", at=(0.5, -0.5), radius=2.0, rate=1e-5),),
    boundaries=(("outer", 0.0),),
    initial_pressure=0.0,
    times=TIMES,
    observe=("well_pressure", "pressure_map"),
)


def eigen_solution(system: System, times: np.ndarray) -> np.ndarray:
    """Well pressure (t,) in Pa for unit production, from all eigenvectors."""
    pores = system.pores
    matrix = np.diag(system.excess)
    np.add.at(matrix, (system.edge_i, system.edge_i), system.edge_g)
    np.add.at(matrix, (system.edge_j, system.edge_j), system.edge_g)
    np.subtract.at(matrix, (system.edge_i, system.edge_j), system.edge_g)
    np.subtract.at(matrix, (system.edge_j, system.edge_i), system.edge_g)
    rhs = system.source(system.source_count - 1)
    inner, across, well = matrix[:pores, :pores], matrix[:pores, pores:], matrix[pores:, pores:]
    reduced = inner - across @ np.linalg.solve(well, across.T)
    load = rhs[:pores] - across @ np.linalg.solve(well, rhs[pores:])
    decay, modes = scipy.linalg.eigh(reduced, np.diag(system.storage[:pores]))
    growth = -np.expm1(-np.outer(times, decay)) / decay
    pressure = (growth * (modes.T @ load)) @ modes.T
    return np.linalg.solve(well, rhs[pores:, None] - across.T @ pressure.T)[0]


def run() -> Result:
    """Largest relative error of the well's pressure change for both solvers."""
    tight = replace(SCENE, solver=Solver(method="krylov", tolerance=1e-9))
    euler = replace(SCENE, solver=Solver(method="explicit"))
    products = run_stages(tight)
    system = assemble(
        products["network"],
        products["open"],
        region=SCENE.region,
        bulk_modulus=SCENE.fluid.bulk_modulus,
        wells=sites(SCENE.wells),
        sides=("outer",),
    )
    exact = 1e-5 * eigen_solution(system, np.array(TIMES))
    by_krylov = products["observe"]["well_pressure"][0]
    by_explicit = run_stages(euler)["observe"]["well_pressure"][0]
    krylov = np.abs(by_krylov / exact - 1).max()
    explicit = np.abs(by_explicit / exact - 1).max()
    return Result(
        f"krylov {krylov:.1e}, explicit {explicit:.1e}",
        "≤ 1e-8 and ≤ 1e-3",
        bool(krylov <= 1e-8 and explicit <= 1e-3),
        f"{system.pores} domains, {len(TIMES)} times over 4 decades, solvers {sorted(SOLVERS)}\n"
        f"krylov at tolerance 1e-9: {krylov:.2e}\nexplicit at 0.9 of its step: {explicit:.2e}",
    )
