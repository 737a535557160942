"""Which sources made the results of a store, so that those of others are never mixed with them.

A stage's version says when its results change, for releases. A checkout under work changes
without it: the first sources that a stage of some version ran with in a store are noted, and its
products are found under that version alone. Other sources of the same version get identities of
their own. So nothing is reused that other code has made, only stages whose sources changed
are computed anew, and who goes back to the first sources finds their results again.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from demflow.sweep.plan.sources import closures
from demflow.sweep.store.durable import write_durably
from demflow.sweep.store.products import Store

if TYPE_CHECKING:
    from demflow.sweep.plan.graph import Stages

NOTE = "sources.json"  # in the store
DIGITS = 16  # of a hash that tell one state of the sources from another


def with_origins(stages: Stages, store: Store) -> Stages:
    """The table of stages, those told apart whose sources are not the first ones of this store."""
    noted = _noted(store)
    found = _states(stages)
    return tuple(
        replace(stage, sources="" if noted.get(key, now) == now else now)
        for stage, key, now in zip(stages, _keys(stages), found, strict=True)
    )


def as_made(stages: Stages, record: str) -> Stages:
    """The table of stages with the sources that a dataset tells (`sources_told`)."""
    sources = dict(part.split(" ", 1) for part in record.split(", ") if " " in part)
    return tuple(replace(stage, sources=sources.get(stage.name, "")) for stage in stages)


def sources_told(stages: Stages) -> str:
    """Which stages ran with other sources than the first ones of the store, as one line."""
    return ", ".join(f"{stage.name} {stage.sources}" for stage in stages if stage.sources)


def note_origins(store: Store, stages: Stages) -> None:
    """Note the sources of stages that run in this store for the first time. Raises OSError."""
    noted = _noted(store)
    new = {
        key: now
        for key, now in zip(_keys(stages), _states(stages), strict=True)
        if key not in noted
    }
    if new:
        write_durably(store.root / NOTE, json.dumps({**noted, **new}, indent=1).encode())


def _noted(store: Store) -> dict[str, str]:
    """The first sources of each stage and version, nothing where that cannot be read."""
    with suppress(OSError, ValueError):
        record: Any = json.loads((store.root / NOTE).read_text())
        if isinstance(record, Mapping):
            return {str(key): str(value) for key, value in record.items()}
    return {}


def _states(stages: Stages) -> list[str]:
    """What tells the sources of each stage, as they are now, from others."""
    return [found[:DIGITS] for found in closures(stage.function for stage in stages)]


def _keys(stages: Stages) -> list[str]:
    return [f"{stage.name}/{stage.version}" for stage in stages]
