"""Data that others made and that is not part of the project: where a check finds it."""

from __future__ import annotations

import os
from pathlib import Path

VARIABLE = "DEMFLOW_DATA"


def outside(name: str) -> Path:
    """A file below the folder that DEMFLOW_DATA names, by default `data` beside the project.

    Raises FileNotFoundError, which a check does not catch: without its data it is not met.
    """
    folder = Path(os.environ.get(VARIABLE, Path(__file__).parents[2] / "data"))
    path = folder / name
    if not path.is_file():
        raise FileNotFoundError(f"{path} is not there; set {VARIABLE} to the folder with {name}")
    return path
