"""What a solver records: linear functionals of the pressure, one row each."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

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


def outputs(system: System, probe_domains: np.ndarray) -> Records:
    """Set up the outputs of a case; `probe_domains` are the domains in which the probes lie."""
    wells, fixed, probes = len(system.rate_wells), system.fixed_count, len(probe_domains)
    rows = [np.arange(wells), wells + system.fixed_source]
    columns = [system.well_node, system.fixed_node]
    values = [np.ones(wells), -system.fixed_g]
    node = system.node_of_domain[probe_domains]
    known = node >= 0
    rows.append(wells + fixed + np.flatnonzero(known))
    columns.append(node[known])
    values.append(np.ones(np.count_nonzero(known)))
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
    source = system.source_of_domain[probe_domains]
    held = np.flatnonzero(source >= 0)
    direct[source[held], wells + fixed + held] = 1.0
    return Records(matrix, direct, wells, fixed)


def map_rows(system: System, domains: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unknown (−1 none) and fixed source (−1 none) that give the pressure of each domain."""
    return system.node_of_domain[domains], system.source_of_domain[domains]
