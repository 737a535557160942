"""Run the checks: all of them, or those named.

Each check is a module of this folder with a docstring and `run() -> Result`. A single
check prints its details, then its figure and bound; all of them print one line each and
write docs/benchmarks.md. The exit status is 0 only where every bound holds.
"""

from __future__ import annotations

import importlib
import pkgutil
import platform
import sys
from pathlib import Path

from tests.benchmarks.result import Result

FOLDER = Path(__file__).parent
HELPERS = ("__main__", "contrasts", "grids", "ran", "result", "specimens", "steps", "sweeps")
PAGE = FOLDER.parents[1] / "docs" / "benchmarks.md"


def names() -> list[str]:
    """Names of all checks."""
    found = [module.name for module in pkgutil.iter_modules([str(FOLDER)])]
    return sorted(name for name in found if name not in HELPERS)


def run(name: str) -> tuple[str, Result]:
    """Run one check; its first docstring line says what it shows."""
    module = importlib.import_module(f"tests.benchmarks.{name}")
    return (module.__doc__ or name).strip().splitlines()[0], module.run()


def main(asked: list[str]) -> int:
    """Run the checks and report."""
    unknown = [name for name in asked if name not in names()]
    if unknown:
        print(f"no check named {', '.join(unknown)}; there are: {', '.join(names())}")
        return 2
    rows = []
    for name in asked or names():
        title, result = run(name)
        if asked:
            print(result.details)
        print(f"{name}: {result.line}", flush=True)
        rows.append((name, title, result))
    if not asked:
        write_page(rows)
    return 0 if all(result.holds for _, _, result in rows) else 1


def write_page(rows: list[tuple[str, str, Result]]) -> None:
    """Write the table of all checks and the details of each."""
    lines = [
        "# Measured claims",
        "",
        "Written by `make bench`; `make bench NAME=…` repeats one of them. Times depend on the "
        f"machine, here {platform.machine()} with Python {platform.python_version()}.",
        "",
        "| check | shows | figure | bound | |",
        "|---|---|---|---|---|",
    ]
    for name, title, result in rows:
        verdict = "holds" if result.holds else "**falls short**"
        lines.append(f"| `{name}` | {title} | {result.figure} | {result.bound} | {verdict} |")
    for name, title, result in rows:
        lines += ["", f"## {name}", "", title, "", "```", result.details.rstrip(), "```"]
    PAGE.parent.mkdir(exist_ok=True)
    PAGE.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
