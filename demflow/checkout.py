"""`import model` and `import sweep` from a checkout: other names of the same modules."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType


class _Same(Loader):
    """Hands out the module of demflow instead of making another one of its file."""

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        module = import_module(f"demflow.{spec.name}")
        self.own = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        module.__spec__ = self.own  # the import system has put that of the other name there


class _Alias(MetaPathFinder):
    """Finds `model.…` and `sweep.…` once their package was imported from a checkout."""

    def __init__(self, package: str):
        self.package = package

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        inside = name.startswith(f"{self.package}.")
        return ModuleSpec(name, _Same()) if inside else None


def alias(package: str) -> None:
    """Let `package` and all below it name the modules of `demflow.package`."""
    sys.meta_path.insert(0, _Alias(package))
    sys.modules[package] = import_module(f"demflow.{package}")
