"""Whoever calls a function is told what each of its parameters is."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MANY = 3  # parameters from which on they are listed
TOLD = re.compile(r"^(\w+(?:, \w+)*) : ", re.MULTILINE)


@cache
def public_functions() -> list[tuple[str, ast.FunctionDef]]:
    """Functions and methods of many parameters, but for those that override others."""
    found = []
    for path in sorted([*(ROOT / "model").rglob("*.py"), *(ROOT / "sweep").rglob("*.py")]):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        owners = [tree, *(n for n in tree.body if isinstance(n, ast.ClassDef))]
        stated = {f.name for owner in owners if _is_base(owner) for f in _functions(owner)}
        for owner in owners:
            derived = isinstance(owner, ast.ClassDef) and bool(owner.bases) and not _is_base(owner)
            if isinstance(owner, ast.ClassDef) and owner.name.startswith("_"):
                continue
            for function in _functions(owner):
                overrides = derived and function.name in (stated | {"read", "build"})
                if not overrides and len(parameters(function)) >= MANY:
                    found.append((f"{path.relative_to(ROOT)}:{function.name}", function))
    return found


def _is_base(owner: ast.Module | ast.ClassDef) -> bool:
    return isinstance(owner, ast.ClassDef) and any("ABC" in ast.unparse(b) for b in owner.bases)


def _functions(owner: ast.Module | ast.ClassDef) -> list[ast.FunctionDef]:
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef)
    return [f for f in owner.body if isinstance(f, kinds) and not f.name.startswith("_")]


def parameters(function: ast.FunctionDef) -> set[str]:
    """Names of the parameters."""
    given = (*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs)
    return {a.arg for a in given} - {"self", "cls"}


def described(function: ast.FunctionDef) -> set[str]:
    """Names that stand under *Parameters* in the docstring."""
    _, _, listed = (ast.get_docstring(function) or "").partition("Parameters\n----------\n")
    listed = re.split(r"\n\w+\n-{4,}", listed)[0]  # up to what is returned or raised
    return {name for names in TOLD.findall(listed) for name in names.split(", ")}


@pytest.mark.slow
def test_parameters_are_named_with_shape_unit_and_meaning():
    """Of public functions with three and more, at least nine of ten list every one."""
    found = {name: parameters(f) <= described(f) for name, f in public_functions()}
    lacking = [name for name, told in found.items() if not told]
    assert len(found) > 200
    assert len(lacking) <= 0.1 * len(found), lacking


@pytest.mark.slow
def test_no_docstring_names_a_parameter_that_is_none():
    for name, function in public_functions():
        several = {a.arg for a in (function.args.vararg, function.args.kwarg) if a is not None}
        assert described(function) <= parameters(function) | several | {"cls"}, name
