"""How much error each source may have, where several make up what is recorded.

The pressure of a well that has just begun to flow is small beside what a source far away will
have done to it later. The tolerance is stated for sums, on the scales below; each of K sources
may use up one K-th of it. How large the sums are a few Krylov vectors of each source tell, and
the sizes of their steps, known to within ten times, so that rates may vary and share responses.

- The pressure of a well at a rate counts at every lag against what the well itself has changed it
  by; of a well that is shut in for good, and of probes, against the largest change of its own, or
  a tenth (`FAINT`) of the largest change of any.
- A flow counts against the largest of its own, or `FAINT_FLOW` of the largest flow or rate of
  all, or `FAINT` of what would fill all pores to its pressure in the time asked for.
- A map counts against the largest change of any pore.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from demflow.model.flow.equation.problem import FAINT, Problem, Share, Steps
from demflow.model.outcome import ModelError

# Tolerance of the responses that tell how large sums are.
ROUGH = 0.1

# How much smaller the part of another source may be than the decades of the steps say.
SLACK = 10.0

# Part of the largest flow below which a flow's own size no longer counts.
FAINT_FLOW = 1e-6


class Rough(NamedTuple):
    """Responses that tell how large sums are."""

    output: np.ndarray  # (sources, l, o)
    pressure: dict[int, np.ndarray]  # maps of each source that acts, at the lags that are `told`


def shared_out(problem: Problem, run: Callable[[Problem], Rough]) -> Problem:
    """The problem with the share of each source; as it is where a source is judged by itself.

    That is where one acts alone, or several whose steps are not known.
    `run` is a solver that gives rough responses.
    """
    sources = problem.active_sources
    if not sources or (len(sources) > 1 and problem.steps is None):
        return problem
    own_flow_only = problem.records.flow_rows == 1 and sources == [0]
    several = problem.steps is not None and np.any(problem.steps.number[sources] > 1)
    summed = len(sources) > 1 or (several and any(problem.far(k) for k in sources))
    if not (summed or (problem.flows_count and not own_flow_only)):
        return problem
    try:
        rough = run(problem._replace(tolerance=max(ROUGH, problem.tolerance)))
    except ModelError:
        return problem  # the solver itself will say what is wrong
    return problem._replace(share=_share(problem, rough))


def told(problem: Problem, source: int) -> np.ndarray:
    """Lags at which maps of a rough response are needed, (l,) bool.

    They tell its largest pressure: what a single step of a rate or of a fixed pressure moves only
    grows with time.
    """
    later: np.ndarray = problem.lag > 0.0
    steps = problem.steps or one_step_each(problem)
    grows = source < problem.system.source_count - len(problem.system.initial)
    if grows and steps.number[source] <= 1:
        later[:-1] = False
    return later


def one_step_each(problem: Problem) -> Steps:
    """A step of each source, all alike."""
    ones = np.ones(problem.system.source_count)
    return Steps(ones, ones, np.inf * ones)


def _share(problem: Problem, rough: Rough) -> Share:
    """What errors of each source are compared with."""
    sources = problem.active_sources
    steps = problem.steps or one_step_each(problem)
    part = np.abs(rough.output) * steps.size[:, None, None]  # (sources, l, o)
    part[~problem.active] = 0.0
    part[:, problem.lag == 0.0] = 0.0  # what a step lets in at once is not recorded
    field = np.zeros(len(part))
    for k in sources:
        lag = problem.lag[told(problem, k)]
        moved = pulse(lag, rough.pressure[k], steps.number[k], steps.shortest[k])
        field[k] = moved.max(initial=0.0) * steps.size[k]
    parts = steps.number[sources].sum()
    slack = SLACK if len(sources) > 1 else 1.0
    unit = 1.0 / (parts * slack * steps.size)
    output = _sizes(problem, steps, part) * unit[:, None, None]
    return Share(output, field[problem.active].max(initial=0.0) * unit)


def pulse(lag: np.ndarray, response: np.ndarray, number: float, shortest: float) -> np.ndarray:
    """The most that a source certainly moves, (o,), if its steps may take each other back.

    In closed rock the response to a rate rises for ever, while a well that was shut in has moved
    only what its first hours did. Of all pulses that fit into a while, one moves at least the mean:
    what the response has moved in that while over their number.

    Parameters
    ----------
    lag : (l,) s
    response : to one step, (l, o)
    number : of the source's steps
    shortest : time between two of them, s
    """
    if number <= 1:
        return np.abs(response).max(axis=0, initial=0.0)
    before = np.searchsorted(lag, 0.5 * lag, side="right") - 1
    span = lag - np.where(before < 0, 0.0, lag[before])
    since = np.where((before < 0)[:, None], 0.0, response[before])
    part = np.minimum(1.0, shortest / np.where(span > 0.0, span, np.inf))
    least = np.abs(response - since) * part[:, None]
    first = np.abs(response[lag <= shortest])
    return np.max(np.concatenate([least, first]), axis=0, initial=0.0)


def _sizes(problem: Problem, steps: Steps, part: np.ndarray) -> np.ndarray:
    """Size of the sum of each output at each lag, (l, o), from the parts (sources, l, o) in it."""
    records, sources = problem.records, problem.active_sources
    is_flow = np.zeros(part.shape[2], dtype=bool)
    is_flow[records.well_rows : records.well_rows + records.flow_rows] = True
    pressure, flow = np.max(
        [steps.size[k] * np.array(problem.own_size(k)) for k in sources], axis=0
    )
    largest = np.max(  # (o,)
        [pulse(problem.lag, part[k], steps.number[k], steps.shortest[k]) for k in sources], axis=0
    )
    for kind, least, faint in ((~is_flow, pressure, FAINT), (is_flow, flow, FAINT_FLOW)):
        floor = faint * np.max(largest[kind], initial=least)
        largest[kind] = np.maximum(largest[kind], floor)
    for k in sources:
        if k < records.flow_rows:  # what has filled the pores flows no more
            row = records.well_rows + k
            filling = FAINT * steps.size[k] * problem.own_size(k)[1]
            largest[row] = max(largest[row], filling)
    largest[is_flow & (not problem.check_flows)] = 0.0
    sizes = np.tile(largest, (part.shape[1], 1))
    for well in range(records.well_rows):
        source = problem.system.fixed_count + well
        if problem.active[source]:
            own = np.maximum.accumulate(part[source, :, well])
            # a build-up gives back what the time at a rate has taken
            last = np.searchsorted(problem.lag, steps.shortest[source], side="right") - 1
            sizes[:, well] = np.minimum(own, own[last])
    return sizes
