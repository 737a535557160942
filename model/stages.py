"""The stages of a case and how they are wired: pack → stress → network → open → flow → observe.

Each stage is a pure function. Its positional arguments are the products of earlier
stages, its keyword arguments the parts of the scene that it reads; it can read nothing
else, which is what lets a sweep share a product between all cases that agree on them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from model.scene import Scene

Product = tuple  # a NamedTuple of arrays from `model.products`


@dataclass(frozen=True)
class Stage:
    """One row of the table of stages."""

    name: str
    run: Callable[..., Product]
    version: int  # raise it whenever the stage's results change
    parents: tuple[str, ...]  # stages whose products are the positional arguments (None if not run)
    reads: Mapping[str, Callable[[Scene], Any]]  # keyword argument -> the part of the scene
    wanted: Callable[[Scene], bool]  # whether a scene needs this stage
    product: type  # the NamedTuple it returns
