"""How far a run is."""

from __future__ import annotations

from typing import NamedTuple


class StageProgress(NamedTuple):
    """How many runs of a stage have their product."""

    stage: str
    done: int
    runs: int


class Progress(NamedTuple):
    """How far a run is, in cases."""

    cases: int
    done: int
    failed: int
    seconds_left: float | None  # None while nothing is known of the stages to come
    compiling: bool = False  # whether some worker compiles kernels
    waiting: float = 0.0  # s since there was a worker; 0 while there is one
    still: float = 0.0  # s since a stage run ended
    workers: int = 0  # that can be used
    deaths: int = 0  # of workers
    ending: bool = False  # whether only what runs already is finished
    stages: tuple[StageProgress, ...] = ()  # in the order of the table

    @property
    def left(self) -> int:
        """Cases that are neither done nor failed."""
        return self.cases - self.done - self.failed
