"""Errors of runs and results as a whole; what goes wrong in a case is its status instead."""

from __future__ import annotations


class RunError(RuntimeError):
    """The run as a whole cannot go on; what was finished is stored."""


class SchedulerError(RunError):
    """The workers that were named cannot be used; nothing was run."""


class ResultsError(ValueError):
    """A folder or a case that cannot be opened; the text says why and what would be valid."""
