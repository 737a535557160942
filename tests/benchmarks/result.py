"""What a check found."""

from __future__ import annotations

from typing import NamedTuple


class Result(NamedTuple):
    """Figure against bound, as words, and whether the bound holds."""

    figure: str
    bound: str
    holds: bool
    details: str = ""

    @property
    def line(self) -> str:
        """One line: figure, bound, verdict."""
        return f"{self.figure}; bound {self.bound}: {'holds' if self.holds else 'falls short'}"


def at_most(value: float, bound: float, what: str, details: str = "") -> Result:
    """A figure that must not exceed its bound."""
    return Result(f"{what} {value:.3g}", f"≤ {bound:.3g}", bool(value <= bound), details)
