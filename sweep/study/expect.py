"""What a study promises of its cases, and whether it came out so."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields

from demflow.model.outcome import Status
from demflow.model.parameters import parameter
from demflow.sweep.study.blocks import block_of

STATUSES = tuple(s.name.lower() for s in Status if s is not Status.NOT_RUN)


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
    residual: float | None = parameter(default=None, at_least=0, help="largest residual")
    range_error: float | None = parameter(default=None, at_least=0, help="largest range_error")
    smallest_pore: float | None = parameter(
        default=None, at_least=0, help="largest smallest_pore: slivers were there"
    )


EXPECT = block_of(Expectation)
BOUNDED = tuple(f.name for f in fields(Expectation) if f.type == "float | None")


def ends_as_expected(expected: Expectation, status: Status, message: str) -> bool:
    """Whether a case ended in the way that was stated; its numbers are not looked at."""
    if status is Status.FAILED and expected.may_fail and expected.may_fail in message:
        return True
    if status.name.lower() != expected.status:
        return False
    return status is Status.DONE or (expected.message or "") in message


def beyond_bounds(expected: Expectation, numbers: Mapping[str, float]) -> list[str]:
    """What of a case that is done exceeds its bound, or is not a number."""
    found = []
    for name in BOUNDED:
        bound, value = getattr(expected, name), numbers.get(name, math.nan)
        if bound is not None and not value <= bound:
            found.append(f"{name} is {value:.2g}, not ≤ {bound:g}")
    return found


def in_words(expected: Expectation) -> str:
    """The promise as people read it."""
    if expected.status != "done":
        words = f", saying “{expected.message}”" if expected.message else ""
        return expected.status.replace("_", " ") + words
    bounds = [
        f"{name.replace('_', ' ')} ≤ {getattr(expected, name):g}"
        for name in BOUNDED
        if getattr(expected, name) is not None
    ]
    if expected.may_fail:
        bounds.append(f"or failed, saying “{expected.may_fail}”")
    return "; ".join(["done", *bounds])
