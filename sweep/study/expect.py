"""What a study promises of its cases, and whether it came out so."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields

from demflow.model.outcome import Status
from demflow.model.parameters import parameter
from demflow.sweep.study.blocks import block_of

STATUSES = tuple(s.name.lower() for s in Status if s not in (Status.NOT_RUN, Status.LEFT_OUT))


@dataclass(frozen=True)
class Expectation:
    """How a case should end, and how far its numbers may be off."""

    status: str = parameter(default="done", choices=STATUSES, help="how the case ends")
    message: str | None = parameter(
        default=None, help="words that the message of a case that is not done holds"
    )
    may_fail: str | None = parameter(
        default=None, help="words of a failure that is as good an outcome as the expected one"
    )
    time_error: float | None = parameter(default=None, at_least=0, help="largest time_error")
    mass_balance_error: float | None = parameter(
        default=None, at_least=0, help="largest mass_balance_error"
    )
    mass_imbalance: float | None = parameter(
        default=None, at_least=0, help="largest mass_imbalance, before volumes are put right"
    )
    flow_balance_error: float | None = parameter(
        default=None, at_least=0, help="largest flow_balance_error"
    )
    residual: float | None = parameter(default=None, at_least=0, help="largest residual")
    range_error: float | None = parameter(default=None, at_least=0, help="largest range_error")
    loaded_overlap: float | None = parameter(
        default=None, at_least=0, help="largest loaded_overlap of grains, over the mean radius"
    )
    smallest_pore: float | None = parameter(
        default=None, at_least=0, help="largest smallest_pore: slivers were there"
    )
    estimated_error: float | None = parameter(
        default=None, at_least=0, help="largest estimated_error, in place of solver.tolerance"
    )
    lowest_pressure: float | None = parameter(
        "Pa", default=None, help="least lowest_pressure, for instance 0 Pa"
    )


EXPECT = block_of(Expectation)
BOUNDED = tuple(f.name for f in fields(Expectation) if f.type == "float | None")
LEAST = ("lowest_pressure",)  # bounded from below
# A result that is beyond these is not good, where the study says nothing else: wide, so that what
# exceeds them is broken and not merely rough.
DEFAULTS = {
    "mass_balance_error": 1e-6,
    "mass_imbalance": 1e-3,
    "flow_balance_error": 0.1,
    "residual": 0.1,
    "range_error": 0.1,
    "loaded_overlap": 0.1,
}
JUDGED = (*BOUNDED, "tolerance_met")


def ends_as_expected(expected: Expectation, status: Status, message: str) -> bool:
    """Whether a case ended in the way that was stated; its numbers are not looked at.

    Of what is no case of the study nothing is expected.

    Parameters
    ----------
    expected : as the study states
    status : how it ended
    message : its words
    """
    if status is Status.LEFT_OUT:
        return True
    if status is Status.FAILED and expected.may_fail and expected.may_fail in message:
        return True
    if status.name.lower() != expected.status:
        return False
    return status is Status.DONE or (expected.message or "") in message


def beyond_bounds(expected: Expectation, numbers: Mapping[str, float]) -> list[str]:
    """Why a case that is done is not good, in words: numbers that exceed their bounds.

    `numbers` are those of `JUDGED` that the case has. What the study bounds must be there.
    """
    found = []
    for name in BOUNDED:
        own = getattr(expected, name)
        bound = DEFAULTS.get(name) if own is None else own
        value = numbers.get(name, math.nan)
        if bound is None or (own is None and name not in numbers):
            continue
        good, sign = (value >= bound, "≥") if name in LEAST else (value <= bound, "≤")
        if not good:
            found.append(f"{name} is {value:.2g}, not {sign} {bound:g}")
    if expected.estimated_error is None and numbers.get("tolerance_met") == 0.0:
        error = numbers.get("estimated_error", math.nan)
        found.append(f"solver.tolerance is not met: estimated_error is {error:.2g}")
    return found


def in_words(expected: Expectation) -> str:
    """The promise as people read it."""
    if expected.status != "done":
        words = f", saying “{expected.message}”" if expected.message else ""
        return expected.status.replace("_", " ") + words
    bounds = [
        f"{name.replace('_', ' ')} {'≥' if name in LEAST else '≤'} {getattr(expected, name):g}"
        for name in BOUNDED
        if getattr(expected, name) is not None
    ]
    if expected.may_fail:
        bounds.append(f"or failed, saying “{expected.may_fail}”")
    return "; ".join(["done", *bounds])
