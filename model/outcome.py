"""How a run ended, as a value whose text says what to try."""

from __future__ import annotations

from enum import IntEnum


class Status(IntEnum):
    """Status of a case, as the CF flags of the dataset have it."""

    DONE = 0
    FAILED = 1
    TIMED_OUT = 2
    OUT_OF_MEMORY = 3
    WORKER_DIED = 4
    NOT_RUN = 5
    STOPPED = 6  # early; what came before is kept
    INACCURATE = 7  # its numbers are there, but beyond the bounds of a good result
    LEFT_OUT = 8  # no case of the study: its `where` does not hold

    @property
    def words(self) -> str:
        """As people read it."""
        early = " early" if self is Status.STOPPED else ""
        return self.name.replace("_", " ").lower() + early


class ModelError(RuntimeError):
    """A stage could not reach its result. The text says why and what to try."""


class OutOfMemory(ModelError):
    """Something would not fit into memory; it was not begun."""
