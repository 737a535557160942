"""What the runs of each stage have cost so far, on average: the base of every forecast.

Kept beside the store, in a file that may be lost without harm.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from sweep.durable import write_durably
from sweep.store import Store

if TYPE_CHECKING:
    from model.stages import Stage


class Spent(NamedTuple):
    """Totals over the runs of one stage."""

    runs: int = 0
    seconds: float = 0.0
    stored: int = 0  # bytes
    memory: int = 0  # largest resident memory of a worker after such a run, bytes


class Costs:
    """Totals by stage and version: another version costs something else."""

    def __init__(self, known: dict[str, Spent] | None = None):
        self.known = dict(known or {})

    @classmethod
    def read(cls, store: Store) -> Costs:
        """Return what earlier runs measured, nothing where that cannot be read."""
        try:
            known = json.loads(_file(store).read_text())
            return cls({key: Spent(*entry) for key, entry in known.items()})
        except (OSError, ValueError, TypeError, AttributeError):
            return cls()

    def write(self, store: Store) -> None:
        """Keep the totals for the next run."""
        write_durably(_file(store), json.dumps(self.known, indent=1).encode())

    def add(self, stage: Stage, seconds: float, stored: int, memory: int = 0) -> None:
        """Count one more run of a stage."""
        old = self._of(stage)
        self.known[_key(stage)] = Spent(
            old.runs + 1, old.seconds + seconds, old.stored + stored, max(old.memory, memory)
        )

    def seconds(self, stage: Stage) -> float | None:
        """Mean seconds of a run, None if none was seen."""
        spent = self._of(stage)
        return spent.seconds / spent.runs if spent.runs else None

    def stored(self, stage: Stage) -> float | None:
        """Mean bytes of a product, None if none was seen."""
        spent = self._of(stage)
        return spent.stored / spent.runs if spent.runs else None

    def memory(self, stage: Stage) -> int | None:
        """Largest memory of a worker after a run of the stage, bytes; None if none was seen."""
        return self._of(stage).memory or None

    def _of(self, stage: Stage) -> Spent:
        return self.known.get(_key(stage), Spent())


def _key(stage: Stage) -> str:
    return f"{stage.name}/{stage.version}"


def _file(store: Store) -> Path:
    return store.root / "costs.json"
