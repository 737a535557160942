"""What a solver records: linear functionals of the pressure, one row each."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from demflow.model.flow.equation.probes import Probes, at_pores
from demflow.model.flow.equation.system import System


class Records(NamedTuple):
    """Outputs o = rows @ p + direct[source]: wells, inflow of fixed pressures, probes.

    The order is: pressure of each well at a rate (system.rate_wells), inflow at each fixed
    pressure (sides, then wells at a pressure), pressure of each probe.
    """

    rows: csr_array  # (outputs, n)
    direct: np.ndarray  # (sources, outputs) what a unit source adds by itself
    well_rows: int  # the first rows: wells at a rate
    flow_rows: int  # the next: fixed pressures


def outputs(system: System, probed: Probes | np.ndarray) -> Records:
    """Set up the outputs of a case; probes as domains take the pressure of one pore each."""
    at = probed if isinstance(probed, Probes) else at_pores(probed)
    wells, fixed, probes = len(system.rate_wells), system.fixed_count, at.points
    rows = [np.arange(wells), wells + system.fixed_source]
    columns = [system.well_node, system.fixed_node]
    values = [np.ones(wells), -system.fixed_g]
    pore = at.domain >= 0
    node = np.where(pore, system.node_of_domain[at.domain], -1)
    known = node >= 0
    rows.append(wells + fixed + at.probe[known])
    columns.append(node[known])
    values.append(at.part[known])
    matrix = csr_array(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))),
        shape=(wells + fixed + probes, system.n),
    )
    direct = np.zeros((system.source_count, wells + fixed + probes))
    for k in range(fixed):
        direct[k, wells + k] = system.fixed_g[system.fixed_source == k].sum()
    for one, other in ((system.short_a, system.short_b), (system.short_b, system.short_a)):
        np.add.at(direct, (one, wells + one), system.short_g)
        np.subtract.at(direct, (one, wells + other), system.short_g)
    source = np.where(pore, system.source_of_domain[at.domain], at.source)
    held = source >= 0
    np.add.at(direct, (source[held], wells + fixed + at.probe[held]), at.part[held])
    return Records(matrix, direct, wells, fixed)


def map_rows(system: System, domains: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unknown (−1 none) and fixed source (−1 none) that give the pressure of each domain."""
    return system.node_of_domain[domains], system.source_of_domain[domains]
