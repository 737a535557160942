"""The command `demflow`: new, run, check, plan, status, report, fit and what else there is below.

Data go to stdout, messages and progress to stderr. Exit status: 0 all cases good, 1 some
case failed or the run could not go on, for want of disk or of workers (the rest is there), 2
wrong usage, invalid study, or a results folder or scheduler that cannot be used (nothing was
run), 130 interrupted (what was finished is kept).
"""

from __future__ import annotations

import argparse
import gc
import re
import signal
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FrameType
from typing import Any

# `demflow --help` and `check` must answer at once: whatever needs numba, xarray, Dask or
# matplotlib is imported by the command that needs it
from demflow.sweep.command.beginning import SHELLS, completion, new
from demflow.sweep.command.commands import (
    SOME_FAILED,
    WRONG,
    check,
    clean,
    collect,
    export,
    figures,
    fit,
    plan,
    report,
    run,
    schema,
    status,
    verify,
)
from demflow.sweep.command.terminal import ready, say, settle
from demflow.sweep.errors import ResultsError, RunError, SchedulerError
from demflow.sweep.printable import printable
from demflow.sweep.study.yaml_source import StudyError

INTERRUPTED = 130
ALLOCATED = 100_000  # objects after which Python looks for cycles among them; 700 by itself


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    ready()
    options = parser().parse_args(arguments)
    options.alone = arguments is None  # a program that does nothing else
    if options.alone and options.command in (figures, report):
        # without an array of Dask's: xarray would import what knows these,
        # which is a tenth of the time
        sys.modules.setdefault("dask.array", None)  # type: ignore[arg-type]
    thresholds = gc.get_threshold()
    gc.set_threshold(ALLOCATED)  # to look as often as it does would be a tenth of the time
    before = signal.signal(signal.SIGTERM, _interrupt)
    try:
        status: int = options.command(options)
        sys.stdout.flush()  # what cannot be written is told now, not when Python ends
        return status
    except StudyError as error:
        say(str(error))
        return WRONG
    except KeyboardInterrupt:
        say("interrupted; what was finished is kept, and the next run goes on from there")
        return INTERRUPTED
    except BrokenPipeError:  # the reader of our output has gone
        return SOME_FAILED
    except Exception as error:
        foreseen = _foreseen(error)
        if foreseen is None:
            raise
        say(f"demflow: {_told(error)}")
        return foreseen
    finally:
        settle()
        gc.set_threshold(*thresholds)
        signal.signal(signal.SIGTERM, before)


def _foreseen(error: Exception) -> int | None:
    """Exit status of an error that is not a mistake of this program, None for one that is."""
    from demflow.sweep.store.lock import LockedError
    from demflow.sweep.store.products import StoreError

    if isinstance(error, LockedError | StoreError | SchedulerError | ResultsError):
        return WRONG
    if isinstance(error, OSError | RunError):  # no space, no workers: what was finished is kept
        return SOME_FAILED
    return None


def _told(error: Exception) -> str:
    if not isinstance(error, OSError):
        return str(error)
    where = "" if error.filename is None else f"{error.filename}: "
    return f"{where}{error.strerror or error}; what was finished is kept"


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def _at_least_one(text: str) -> int:
    try:
        number = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number") from None
    if number < 1:
        raise argparse.ArgumentTypeError(f"{number} is below 1")
    return number


def _address(text: str) -> str:
    """An address of a scheduler, of a form that could be one."""
    if not re.fullmatch(r"((tcp|tls|ucx|ws|wss)://)?(\[[0-9A-Fa-f:]+\]|[^\s:/]+):\d{1,5}/?", text):
        what = f"'{printable(text)}' is no address of a scheduler, such as tcp://10.0.0.5:8786"
        raise argparse.ArgumentTypeError(what)
    return text


def parser() -> argparse.ArgumentParser:
    """What the command line takes."""
    parser = argparse.ArgumentParser(
        prog="demflow",
        description="Parameter sweeps of flow in fractured rock: from a study file to a dataset.",
        epilog="Exit status: 0 all cases good, 1 some failed or the disk or the workers did, "
        "2 wrong usage, invalid study, unusable folder or scheduler (nothing was run), "
        "130 interrupted. What is finished is always kept.",
    )
    parser.add_argument("--version", action=_Version, help="show the version and exit")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    def add(command: Callable[[argparse.Namespace], int], takes_study: bool = True) -> Any:
        sub = commands.add_parser(
            command.__name__, help=_first_line(command), description=command.__doc__
        )
        sub.set_defaults(command=command)
        if takes_study:
            sub.add_argument("study", metavar="STUDY.yaml", help="the study file")
        if command not in (schema, new, completion):
            sub.add_argument("--json", action="store_true", help="print JSON for a machine")
        return sub

    def add_results(sub: Any) -> Any:
        sub.add_argument(
            "--results", metavar="DIR", default="results", help="folder of all results (results)"
        )
        sub.add_argument(
            "--smoke", action="store_true", help="apply the study's smoke block: small and quick"
        )
        return sub

    def add_workers(sub: Any) -> Any:
        sub.add_argument(
            "--workers", type=_at_least_one, default=2, metavar="N", help="worker processes (2)"
        )
        return sub

    beginning = add(new, takes_study=False)
    beginning.add_argument(
        "name",
        metavar="NAME",
        nargs="?",
        help="of a study that comes with demflow, or a word of its name or title, as radial",
    )
    beginning.add_argument(
        "file", metavar="FILE", nargs="?", type=Path, help="what to write (NAME.yaml)"
    )
    running = add_workers(add_results(add(run)))
    running.add_argument(
        "--scheduler",
        type=_address,
        metavar="tcp://HOST:PORT",
        help="use the workers of this Dask scheduler, wherever they are: products travel "
        "to them and back (tls:// with Dask's own configuration)",
    )
    running.add_argument("--retry-failed", action="store_true", help="run again what failed before")
    running.add_argument("--force", action="store_true", help="compute everything again")
    add(check)
    add_workers(add_results(add(plan)))
    add_results(add(status))
    add_results(add(collect))
    add_results(add(report))
    drawing = add_results(add(figures))
    kinds = drawing.add_mutually_exclusive_group()
    kinds.add_argument(
        "--format", choices=("png", "svg", "pdf"), default="pdf", help="by default pdf"
    )
    kinds.add_argument(
        "--animate",
        choices=("gif", "mp4"),
        help="the maps of pressure in time instead; mp4 needs ffmpeg",
    )
    drawing.add_argument(
        "--width",
        choices=("column", "page"),
        help="89 or 183 mm; by default as wide as what is drawn needs",
    )
    add_results(add(fit)).add_argument(
        "--no-figure", action="store_true", help="write the numbers only"
    )
    exporting = add(export, takes_study=False)
    exporting.add_argument(
        "folder", metavar="RESULTS/STUDY", type=Path, help="folder of the study's results"
    )
    exporting.add_argument("file", metavar="FILE", type=Path, help="what to write")
    exporting.add_argument(
        "at", metavar="AXIS=VALUE", nargs="*", help="which case: a value on every axis"
    )
    add(verify, takes_study=False).add_argument(
        "folder", metavar="RESULTS_DIR", type=Path, help="folder of all results"
    )
    cleaning = add(clean, takes_study=False)
    cleaning.add_argument("folder", metavar="RESULTS_DIR", type=Path, help="folder of all results")
    cleaning.add_argument("--yes", action="store_true", help="free without asking")
    add(schema, takes_study=False).add_argument(
        "--write", metavar="FILE", type=Path, help="where to write it, instead of printing it"
    )
    completing = add(completion, takes_study=False)
    completing.add_argument("shell", choices=SHELLS, help="the shell")
    completing.set_defaults(described=_described(commands.choices))
    return parser


def _described(commands: dict[str, argparse.ArgumentParser]) -> dict[str, tuple[str, list[str]]]:
    """First line and options of each command."""
    return {
        name: (
            (sub.description or "").splitlines()[0],
            [text for action in sub._actions for text in action.option_strings],
        )
        for name, sub in commands.items()
    }


class _Version(argparse.Action):
    """Looks the version up only when it is asked for."""

    def __init__(self, option_strings: Sequence[str], dest: str, help: str | None = None):
        super().__init__(option_strings, dest, nargs=0, help=help)

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from demflow.sweep.store.versions import installed

        print(f"demflow {installed('demflow')}")
        parser.exit()


def _first_line(command: Callable[..., Any]) -> str:
    line = (command.__doc__ or "").splitlines()[0].rstrip(".")
    return line[0].lower() + line[1:]


if __name__ == "__main__":
    sys.exit(main())
