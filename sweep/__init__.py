"""The study layer: from a study in YAML to a labelled dataset.

`run` runs a study, `open_results` and `open_case` open what it left, `load_study` reads
and checks a study file. Heavy imports wait until they are needed.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sweep.engine import run
    from sweep.results import open_case, open_results
    from sweep.study import load_study

__all__ = ["load_study", "open_case", "open_results", "run"]

_HOMES = {
    "load_study": "sweep.study",
    "open_case": "sweep.results",
    "open_results": "sweep.results",
    "run": "sweep.engine",
}


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'sweep' has no attribute {name!r}")
