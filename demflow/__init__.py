"""Pressure in fractured porous rock: distinct elements, pore networks and parameter sweeps.

`run` runs a study, `open_results` and `open_case` open what it left, `write_case` writes a case
for other programs, `load_study` reads and checks a study file, `simulate` runs one `Scene`.
`demflow.model` is the pure model, `demflow.sweep` the study layer. Heavy imports wait until they
are needed.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from demflow.model import Scene, simulate
    from demflow.sweep import load_study, open_case, open_results, run, write_case

__all__ = ["Scene", "load_study", "open_case", "open_results", "run", "simulate", "write_case"]

_ROOMS = {"Scene": "demflow.model", "simulate": "demflow.model"}


def __getattr__(name: str) -> Any:
    if name in __all__:
        return getattr(import_module(_ROOMS.get(name, "demflow.sweep")), name)
    raise AttributeError(f"module 'demflow' has no attribute {name!r}")
