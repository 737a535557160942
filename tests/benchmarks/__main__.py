"""Run the checks: all of them, or those named.

Each check is a module of this folder with a docstring and `run() -> Result`. Those that are
named print their details, then figure and bound; all of them print one line each and are kept in
docs/benchmarks.json, of which docs/benchmarks.md is the readable form. `--keep` keeps those that
are named, too; `--page` writes the page of what is kept, with a row for every check, and runs
nothing. The exit status is 0 only where every bound holds.
"""

from __future__ import annotations

import argparse
import importlib
import sys
import traceback

from tests.benchmarks import page
from tests.benchmarks.result import Result
from tests.peers.yade import PeerMissingError

NOT_RUN = "not run"  # of a check that ended in an error: that is no figure to keep


def run(name: str) -> Result:
    """Run one check."""
    try:
        result: Result = importlib.import_module(f"tests.benchmarks.{name}").run()
        return result
    except Exception as error:  # the other checks go on
        told = "" if isinstance(error, PeerMissingError) else traceback.format_exc()
        return Result(f"{NOT_RUN}: {type(error).__name__}: {error}", "to run", False, told)


def main(arguments: list[str]) -> int:
    """Run the checks and report."""
    parser = argparse.ArgumentParser(prog="tests.benchmarks", description="Run checks.")
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--keep", action="store_true", help="keep the results in the docs")
    parser.add_argument("--page", action="store_true", help="write the page of those kept, no more")
    asked = parser.parse_args(arguments)
    names = list(page.titles())
    unknown = [name for name in asked.names if name not in names]
    if unknown:
        print(f"no check named {', '.join(unknown)}; there are: {', '.join(names)}")
        return 2
    if asked.page:
        page.write()
        return 0
    hold = True
    for name in asked.names or names:
        result = run(name)
        if asked.names:
            print(result.details)
        print(f"{name}: {result.line}", flush=True)
        if (asked.keep or not asked.names) and not result.figure.startswith(NOT_RUN):
            page.keep(name, result)
        hold &= result.holds
    return 0 if hold else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
