"""The study layer: from a study in YAML to a labelled dataset.

`run` runs a study, `open_results` and `open_case` open what it left, `write_case` writes a case
for other programs, `compare` lays studies side
by side, `sensitivity` tells which sampled parameters decide a result, `load_study` reads
and checks a study file. Heavy imports wait until they
are needed.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from demflow.sweep.accessor import compare
    from demflow.sweep.analysis.sensitivity import sensitivity
    from demflow.sweep.dataset.case_file import write_case
    from demflow.sweep.dataset.open import open_case, open_results
    from demflow.sweep.engine import run
    from demflow.sweep.study.load import load_study

__all__ = ["compare", "load_study", "open_case", "open_results", "run", "sensitivity", "write_case"]

_HOMES = {
    "compare": "demflow.sweep.accessor",
    "load_study": "demflow.sweep.study.load",
    "open_case": "demflow.sweep.dataset.open",
    "open_results": "demflow.sweep.dataset.open",
    "write_case": "demflow.sweep.dataset.case_file",
    "run": "demflow.sweep.engine",
    "sensitivity": "demflow.sweep.analysis.sensitivity",
}


_DATASETS = ("open_results", "run")  # what gives datasets, which then know `dataset.demflow`


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        if name in _DATASETS:
            import_module("demflow.sweep.accessor")
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'demflow.sweep' has no attribute {name!r}")


if __name__ == "sweep":
    from demflow.checkout import alias

    alias("sweep")
