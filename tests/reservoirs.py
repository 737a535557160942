"""Small reservoirs for tests of the network and of flow, put together without mechanics."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from demflow.model.controls import Controls, sites
from demflow.model.flow.equation.sites import WellSite
from demflow.model.flow.equation.system import System, assemble
from demflow.model.flow.solvers.registry import flow
from demflow.model.history import superposed
from demflow.model.network.apertures import open_pipes
from demflow.model.network.domains import network
from demflow.model.network.fractures.walk import walk
from demflow.model.observe import observe_flow
from demflow.model.products import Apertures, Network, Packing, Permeability, Responses
from demflow.model.region import Region
from demflow.model.scene import Fracture, Matrix, Probe, Well, flow_lines


class Reservoir(NamedTuple):
    """An open network and the constants of its fluid."""

    region: Region
    network: Network
    apertures: Apertures
    bulk_modulus: float

    def assembled(self, wells: tuple[WellSite, ...] = (), sides: tuple[str, ...] = ()) -> System:
        """The flow equation."""
        return assemble(
            self.network,
            self.apertures,
            region=self.region,
            bulk_modulus=self.bulk_modulus,
            wells=wells,
            sides=sides,
        )

    def respond(
        self,
        wells: tuple[Well, ...] = (),
        sides: tuple[str, ...] = (),
        times: tuple[float, ...] = (),
        method: str = "krylov",
        tolerance: float = 1e-9,
        safety_factor: float = 0.9,
        step: str = "corrected",
        probes: tuple[Probe, ...] = (),
        record_map: bool = True,
    ) -> Responses:
        """Unit step responses; every source acts."""
        return flow(
            self.network,
            self.apertures,
            region=self.region,
            bulk_modulus=self.bulk_modulus,
            wells=sites(wells),
            sides=sides,
            active=(True,) * (len(sides) + len(wells)),
            probes=probes,
            times=tuple(float(t) for t in times),
            method=method,
            tolerance=tolerance,
            safety_factor=safety_factor,
            step=step,
            record_map=record_map,
            fine=any(well.decides for well in wells),
        )

    def observed(
        self,
        wells: tuple[Well, ...] = (),
        boundaries: tuple[tuple[str, float], ...] = (),
        initial_pressure: float = 0.0,
        times: tuple[float, ...] = (),
        **solver,
    ) -> dict[str, np.ndarray]:
        """What a study would see; steady where no times are given."""
        sides = tuple(name for name, _ in boundaries)
        responses = self.respond(wells, sides, times, **solver)
        controls = Controls(
            reference=initial_pressure,
            initial=initial_pressure,
            side_pressures=tuple(p for _, p in boundaries),
            wells=wells,
            times=tuple(float(t) for t in times),
            transient=bool(times),
        )
        return observe_flow(superposed(responses, controls), controls)


def reservoir(
    packing: Packing,
    region: Region,
    aperture: float = 1e-5,
    fractures: tuple[Fracture, ...] = (),
    viscosity: float = 1e-3,
    bulk_modulus: float = 1e9,
    unit_permeability: Permeability | None = None,
) -> Reservoir:
    """A packing made into an open network whose matrix has one aperture."""
    net = network(packing, region=region)
    lines = flow_lines(fractures, region)
    opened = open_pipes(
        net,
        walk(net, region=region, lines=lines) if lines else None,
        None,
        unit_permeability,
        region=region,
        matrix=Matrix(aperture=aperture),
        fractures=fractures,
        viscosity=viscosity,
    )
    return Reservoir(region, net, opened, bulk_modulus)


def dense_matrices(system: System) -> tuple[np.ndarray, np.ndarray]:
    """G of all unknowns and C of the pores, (n, n) and (pores,), written out edge by edge."""
    matrix = np.zeros((system.n, system.n))
    for i, j, g in zip(system.edge_i, system.edge_j, system.edge_g, strict=True):
        matrix[i, i] += g
        matrix[j, j] += g
        matrix[i, j] -= g
        matrix[j, i] -= g
    for i, g in zip(system.fixed_node, system.fixed_g, strict=True):
        matrix[i, i] += g
    return matrix, system.storage[: system.pores]


class Modes(NamedTuple):
    """The pores' part of a system, decayed into modes; what joins the wells to it."""

    decay: np.ndarray
    modes: np.ndarray
    root: np.ndarray
    beside: np.ndarray
    wells: np.ndarray


_decomposed: dict[int, tuple[System, Modes]] = {}  # the last few: one serves all its sources
DECOMPOSED_AT_MOST = 4


def modes_of(system: System) -> Modes:
    """The dense eigen-decomposition of a system, which nobody changes."""
    if id(system) not in _decomposed:
        matrix, storage = dense_matrices(system)
        m = system.pores
        wells, root = np.linalg.inv(matrix[m:, m:]), np.sqrt(storage)
        reduced = matrix[:m, :m] - matrix[:m, m:] @ wells @ matrix[m:, :m]
        decay, modes = np.linalg.eigh(reduced / np.outer(root, root))
        if len(_decomposed) == DECOMPOSED_AT_MOST:
            del _decomposed[next(iter(_decomposed))]
        made = Modes(np.maximum(decay, 0.0), modes, root, matrix[:m, m:], wells)
        _decomposed[id(system)] = system, made
    return _decomposed[id(system)][1]


def exact_response(system: System, source: int, times: np.ndarray) -> np.ndarray:
    """All unknowns (t, n) after a unit step of a source, by dense eigen-decomposition."""
    decay, modes, root, beside, wells = modes_of(system)
    m, rhs = system.pores, system.source(source)
    weight = modes.T @ ((rhs[:m] - beside @ (wells @ rhs[m:])) / root)
    z = np.outer(times, decay)
    grown = np.where(z < 1e-9, times[:, None] * (1 - z / 2), -np.expm1(-z) / np.where(z, decay, 1))
    pores = (grown * weight) @ modes.T / root
    return np.concatenate([pores, (rhs[m:] - pores @ beside) @ wells.T], axis=1)
