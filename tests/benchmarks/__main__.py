"""Run the checks: all of them, or those named.

Each check is a module of this folder with a docstring and `run() -> Result`. Those that are
named print their details, then figure and bound; all of them print one line each and are kept in
docs/benchmarks.json, of which docs/benchmarks.md is the readable form. `--keep` keeps those that
are named, too: each row of the page then has the day on which it was measured. The exit status
is 0 only where every bound holds.
"""

from __future__ import annotations

import argparse
import importlib
import pkgutil
import sys
import traceback
from pathlib import Path

from tests.benchmarks import page
from tests.benchmarks.result import Result

FOLDER = Path(__file__).parent
HELPERS = (
    "__main__",
    "contrasts",
    "grids",
    "outside_data",
    "page",
    "ran",
    "result",
    "specimens",
    "steps",
    "sweeps",
)


def names() -> list[str]:
    """Names of all checks."""
    found = [module.name for module in pkgutil.iter_modules([str(FOLDER)])]
    return sorted(name for name in found if name not in HELPERS)


def run(name: str) -> tuple[str, Result]:
    """Run one check; its first docstring line says what it shows."""
    module = importlib.import_module(f"tests.benchmarks.{name}")
    title = (module.__doc__ or name).strip().splitlines()[0]
    try:
        return title, module.run()
    except Exception as error:  # the other checks go on
        told = traceback.format_exc()
        return title, Result(f"did not run: {type(error).__name__}", "to run", False, told)


def main(arguments: list[str]) -> int:
    """Run the checks and report."""
    parser = argparse.ArgumentParser(prog="tests.benchmarks", description="Run checks.")
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--keep", action="store_true", help="keep the results in the docs")
    asked = parser.parse_args(arguments)
    unknown = [name for name in asked.names if name not in names()]
    if unknown:
        print(f"no check named {', '.join(unknown)}; there are: {', '.join(names())}")
        return 2
    hold = True
    for name in asked.names or names():
        title, result = run(name)
        if asked.names:
            print(result.details)
        print(f"{name}: {result.line}", flush=True)
        if asked.keep or not asked.names:
            page.keep(name, title, result, names())
        hold &= result.holds
    return 0 if hold else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
