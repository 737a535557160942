"""States that a transient starts from, other than one pressure everywhere.

The flow equation is linear: what a field u does by itself, without any source, adds to what the
sources do. For the linear fields x and y it is found as the response v to the load −G u, which
is at rest at the start, plus u. A field that is the steady state of the fixed pressures stays.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from demflow.model.flow.equation.problem import Answer, Problem, fill_map
from demflow.model.flow.equation.sites import Site, WellSite
from demflow.model.flow.equation.system import System, without_outlet
from demflow.model.flow.solvers.steady import steady
from demflow.model.outcome import ModelError
from demflow.model.products import Apertures, Network

STARTS = ("uniform", "gradient", "steady")


class Initial(NamedTuple):
    """What unit initial fields are recorded as; l = 1 where they stay as they are."""

    output: np.ndarray  # (fields, l, o)
    cumulative: np.ndarray  # (fields, l, fixed + 1)
    pressure: np.ndarray  # (fields, l, m)
    volume: np.ndarray  # (fields,) m³ stored above the mean or lacking below it
    missing: np.ndarray  # (fields, l) m³ that were out of balance before that was mended


def with_linear_fields(
    system: System, network: Network, apertures: Apertures, wells: tuple[Site, ...]
) -> System:
    """The system with the fields x and y (m), for a pressure gradient of 1 Pa/m along either.

    Parameters
    ----------
    system : the flow equation C dp/dt = −G p + f
    network : pores and pipes of the matrix
    apertures : how far they are open, and traces with nodes of their own
    wells : the wells
    """
    fields = np.empty((2, system.n))
    x, y = np.append(network.x, apertures.node_x), np.append(network.y, apertures.node_y)
    for field, places, axis in zip(fields, (x, y), (0, 1), strict=True):
        field[: len(system.domain)] = places[system.domain]
        for node, well in zip(system.well_node, (wells[k] for k in system.rate_wells), strict=True):
            # the pressure of a side with an inflow follows the pores beside it at once
            field[node] = well.at[axis] if isinstance(well, WellSite) else 0.0
    return system._replace(initial=fields)


def decaying(problem: Problem, answer: Answer) -> tuple[Answer, Initial]:
    """The answer without its initial fields, and these with the fields themselves added."""
    system, records = problem.system, problem.records
    first = system.source_count - len(system.initial)
    output, cumulative = answer.output[first:].copy(), answer.cumulative[first:].copy()
    pressure = answer.pressure[first:].copy()
    flows = slice(records.well_rows, records.well_rows + records.flow_rows)
    for k, field in enumerate(system.initial):
        at_start = records.rows @ field
        output[k] += at_start
        cumulative[k, :, :-1] += problem.lag[:, None] * at_start[flows]
        pressure[k] += fill_map(problem, first + k, field[None])
    rest = answer._replace(
        output=answer.output[:first],
        cumulative=answer.cumulative[:first],
        pressure=answer.pressure[:first],
        missing=answer.missing[:first],
    )
    mean = system.initial @ system.storage / system.storage.sum()
    volume = np.abs(system.initial - mean[:, None]) @ system.storage
    return rest, Initial(output, cumulative, pressure, volume, answer.missing[first:])


def at_rest(problem: Problem) -> Initial:
    """Steady states of a unit of each fixed pressure, for a start at rest with all of them.

    Raises `ModelError` where some pore is connected to no fixed pressure.
    """
    system = problem.system
    if without_outlet(system):
        raise ModelError(
            "initial_pressure is steady, but a well, or a side with an "
            "inflow, feeds pores that reach no fixed pressure; give a boundary pressure there, or "
            "a number as initial_pressure"
        )
    fixed = np.arange(system.source_count) < system.fixed_count
    found = steady(problem._replace(lag=np.array([math.inf]), active=problem.active & fixed))
    held = slice(0, system.fixed_count)
    # flows at rest let in as much as they let out
    return Initial(
        output=found.output[held],
        cumulative=np.zeros_like(found.cumulative[held]),
        pressure=found.pressure[held],
        volume=np.zeros(system.fixed_count),
        missing=np.zeros((system.fixed_count, 1)),
    )


def none_at_all(problem: Problem) -> Initial:
    """No initial field: the start is uniform."""
    records = problem.records
    return Initial(
        np.zeros((0, 1, records.rows.shape[0])),
        np.zeros((0, 1, records.flow_rows + 1)),
        np.zeros((0, 1, len(problem.domain))),
        np.zeros(0),
        np.zeros((0, 1)),
    )
