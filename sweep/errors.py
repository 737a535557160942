"""Errors of a run as a whole; what goes wrong in a case is its status, and no error."""

from __future__ import annotations


class RunError(RuntimeError):
    """The run as a whole cannot go on; what was finished is stored."""


class SchedulerError(RunError):
    """The workers that were named cannot be used; nothing was run."""
