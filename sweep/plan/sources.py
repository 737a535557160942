"""The sources that decide what a stage returns: its module and all that this imports, and so on.

Only modules of the same packages count; what libraries do is told by their versions. Modules are
compared by their syntax without docstrings: comments, layout and places change nothing. An import
inside a function counts, one for type checkers does not. Names in strings are not followed, which
is why no stage may import by a string.
"""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import json
import os
from collections.abc import Iterable, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import NamedTuple

PACKAGE = "demflow"
FORMAT = 1  # raise it whenever the digest of the same syntax changes


class Module(NamedTuple):
    """What a source file says."""

    digest: str  # SHA-256 of its syntax
    imports: tuple[str, ...]  # dotted names: modules, or names in them


def closures(functions: Iterable[str]) -> list[str]:
    """Hash of the sources behind each function at `module:name` (SHA-256), "" where none are known.

    Each file is looked at once, however many of the functions stand on it.
    """
    starts = [function.partition(":")[0] for function in functions]
    tops = {PACKAGE, *map(_top, starts)}
    module_of = cache(_module_of)

    @cache
    def said(name: str) -> Module | None:
        """What a module says; its imports are modules."""
        path = _file(name)
        if path is None:
            return None
        module = _module(str(path), path.stat().st_mtime_ns)
        within = {module_of(imported) for imported in module.imports if _top(imported) in tops}
        return Module(module.digest, tuple(within - {""}))

    def behind(start: str) -> str:
        found: dict[str, str] = {}
        waiting = {start}
        while waiting:
            name = waiting.pop()
            module = said(name)
            if module is None:
                return ""
            found[name] = module.digest
            own = (PACKAGE, _top(start))
            waiting.update(i for i in module.imports if i not in found and _top(i) in own)
        return hashlib.sha256(json.dumps(sorted(found.items())).encode()).hexdigest()

    return [behind(start) for start in starts]


def _top(name: str) -> str:
    return name.partition(".")[0]


def _module_of(name: str) -> str:
    """The module that a dotted name is, or is in; "" where there is none."""
    while name and _file(name) is None:
        name = name.rpartition(".")[0]
    return name


def _file(name: str) -> Path | None:
    """The source file of a module, None where there is no such module. Nothing is imported."""
    top, _, rest = name.partition(".")
    spec = importlib.util.find_spec(top)
    locations = (spec.submodule_search_locations or ()) if spec else ()
    return next(filter(None, (_file_in(location, rest) for location in locations)), None)


@cache
def _file_in(location: str, name: str) -> Path | None:
    """The source file of a module by its name inside the package at a location."""
    place = Path(location).joinpath(*name.split("."))
    return next((p for p in (place / "__init__.py", place.with_suffix(".py")) if p.is_file()), None)


@cache
def _module(path: str, _changed: int) -> Module:
    """What the source file at a path says; what was read once is kept in the user's cache."""
    content = Path(path).read_bytes()
    kept = _cache_folder() / hashlib.sha256(b"%d " % FORMAT + content).hexdigest()
    with suppress(OSError, ValueError, TypeError, KeyError):
        record = json.loads(kept.read_text())
        return Module(str(record["digest"]), tuple(map(str, record["imports"])))
    tree = ast.parse(content)
    module = Module(_digest(tree), tuple(sorted(set(_imports(tree)))))
    with suppress(OSError):
        kept.parent.mkdir(parents=True, exist_ok=True)
        aside = kept.with_name(f"{kept.name}.{os.getpid()}.partial")
        aside.write_text(json.dumps(module._asdict()))
        aside.replace(kept)
    return module


def _cache_folder() -> Path:
    home = os.environ.get("XDG_CACHE_HOME", "") or Path.home() / ".cache"
    return Path(home) / "demflow" / "sources"


def _imports(tree: ast.AST) -> Iterator[str]:
    """Dotted names that a syntax tree imports, also inside functions."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and _for_type_checkers(node.test):
            for other in node.orelse:
                yield from _imports(other)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            if node.module and not node.level:
                yield from (f"{node.module}.{alias.name}" for alias in node.names)
        else:
            yield from _imports(node)


def _for_type_checkers(test: ast.expr) -> bool:
    return "TYPE_CHECKING" in (getattr(test, "id", ""), getattr(test, "attr", ""))


def _digest(tree: ast.Module) -> str:
    """SHA-256 of a syntax tree, the same on every version of Python that can parse it."""
    parts: list[str] = []
    _take(tree, parts)
    told = "".join(f"{len(part)}:{part}" for part in parts)
    return hashlib.sha256(told.encode(errors="backslashreplace")).hexdigest()


def _take(node: object, parts: list[str]) -> None:
    """Add what a syntax tree consists of, docstrings and empty fields left out."""
    if isinstance(node, list):
        parts.append(f"[{len(node)}")
        for one in node:
            _take(one, parts)
    elif isinstance(node, ast.AST):
        parts.append(type(node).__name__)
        for name in node._fields:
            value = getattr(node, name, None)
            if name == "body" and isinstance(value, list) and _documented(node):
                value = value[1:]
            if value is None or value == [] or name in ("ctx", "type_comment", "kind"):
                continue
            parts.append(name)
            _take(value, parts)
    else:
        parts.append(f"{type(node).__name__} {node!r}")


def _documented(node: ast.AST) -> bool:
    """Whether a definition or module begins with a docstring."""
    kinds = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
    return isinstance(node, kinds) and ast.get_docstring(node, clean=False) is not None
