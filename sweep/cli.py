"""The command `demflow`: run, check, plan, status, report, verify, clean, schema.

Data go to stdout, messages and progress to stderr. Exit status: 0 all cases good, 1 some
case failed or the run could not go on, for want of disk or of workers (the rest is there), 2
wrong usage, invalid study, or a results folder or scheduler that cannot be used (nothing was
run), 130 interrupted (what was finished is kept).
"""

from __future__ import annotations

import argparse
import json
import logging
import os
import signal
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

# `demflow --help` and `check` must answer at once: whatever needs numba, xarray, Dask or
# matplotlib is imported by the command that needs it
from sweep.yaml_source import StudyError

if TYPE_CHECKING:
    from sweep.engine import Finished, Prepared

GOOD, SOME_FAILED, WRONG, INTERRUPTED = 0, 1, 2, 130
MOST_SHOWN = 20  # failed cases that `status` names one by one


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    options = _parser().parse_args(arguments)
    before = signal.signal(signal.SIGTERM, _interrupt)
    try:
        return options.command(options)
    except StudyError as error:
        _say(str(error))
        return WRONG
    except KeyboardInterrupt:
        _say("interrupted; what was finished is kept, and the next run goes on from there")
        return INTERRUPTED
    except BrokenPipeError:
        # the reader of our output has gone; stdout must not be flushed at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return SOME_FAILED
    except Exception as error:
        status = _foreseen(error)
        if status is None:
            raise
        _say(f"demflow: {_told(error)}")
        return status
    finally:
        signal.signal(signal.SIGTERM, before)


def _foreseen(error: Exception) -> int | None:
    """Exit status of an error that is not a mistake of this program, None for one that is."""
    from sweep.errors import RunError, SchedulerError
    from sweep.lock import LockedError
    from sweep.store import StoreError

    if isinstance(error, LockedError | StoreError | SchedulerError):
        return WRONG
    if isinstance(error, OSError | RunError):  # no space, no workers: what was finished is kept
        return SOME_FAILED
    results = sys.modules.get("sweep.results")
    if results is not None and isinstance(error, results.ResultsError):
        return WRONG
    return None


def _told(error: Exception) -> str:
    if not isinstance(error, OSError):
        return str(error)
    where = "" if error.filename is None else f"{error.filename}: "
    return f"{where}{error.strerror or error}; what was finished is kept"


def run(options: argparse.Namespace) -> int:
    """Run what is missing, collect the dataset, draw the figures."""
    from sweep.engine import run_study
    from sweep.progress import ProgressLine

    # what Dask's loops report of a dead worker is judged by the run, and told as an outcome
    for name in ("asyncio", "distributed.batched", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    line = ProgressLine()
    try:
        finished = run_study(
            options.study,
            workers=options.workers,
            results=options.results,
            scheduler=options.scheduler,
            retry_failed=options.retry_failed,
            force=options.force,
            smoke=options.smoke,
            progress=line,
            tell=_say,
        )
    finally:
        line.close()
    for message in finished.damaged:
        _say(f"damaged, computed again: {message}")
    for message in finished.executed.refused if finished.executed else ():
        _say(f"not used: {message}")
    _say(_summary(finished))
    if finished.changed:
        kept = finished.folder / "study.yaml"
        _say(f"{options.study} has changed meanwhile; the results are those of {kept}")
    if finished.failed:
        _say(f"why: demflow status {options.study}{_where(options)}")
    _tell_places(finished, options)
    return SOME_FAILED if finished.failed else GOOD


def check(options: argparse.Namespace) -> int:
    """Validate a study: every problem at once."""
    from sweep.study import load_study

    try:
        study = load_study(options.study)
    except StudyError as error:
        if options.json:
            keys = ("path", "line", "column", "message")
            found = [{key: getattr(p, key) for key in keys} for p in error.problems]
            _print_json({"valid": False, "problems": found})
        else:
            print(error)
        return WRONG
    cases = _product(study.shape)
    if options.json:
        _print_json({"valid": True, "problems": [], "study": study.name, "cases": cases})
    else:
        print(f"{options.study}: valid, {_count(cases, 'case')}")
    return GOOD


def plan(options: argparse.Namespace) -> int:
    """Tell what `run` would do."""
    from sweep.forecast import forecast
    from sweep.progress import duration, size

    told = forecast(_prepare(options), options.workers)
    if options.json:
        _print_json(told)
        return GOOD
    print(f"{_count(told['cases'], 'case')}, {options.workers} workers")
    if told["impossible"]:
        print(f"{_count(told['impossible'], 'case')} cannot be: see demflow status")
    rows = [("stage", "runs", "shared", "stored", "failed", "to run", "each", "time", "disk")]
    for stage in told["stages"]:
        counts = (stage[key] for key in ("runs", "shared", "stored", "failed", "to_run"))
        needed = stage["to_run"] > 0
        rows.append(
            (
                stage["name"],
                *map(str, counts),
                _known(stage["seconds_each"], duration),
                _known(stage["seconds"], duration) if needed else "-",
                _known(stage["bytes"], size) if needed else "-",
            )
        )
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for name, *cells in rows:
        numbers = (c.rjust(w) for c, w in zip(cells, widths[1:], strict=True))
        print("  ".join((name.ljust(widths[0]), *numbers)))
    for name, unit in (("seconds", duration), ("bytes", size), ("memory", size)):
        label = {"seconds": "time", "bytes": "disk"}.get(name, name)
        print(f"expected {label}: {_known(told[name], unit)}")
    if told["seconds"] is None:
        print("?: depends on a stage that was never run in this results folder")
    return GOOD


def status(options: argparse.Namespace) -> int:
    """Tell what is done, failed and missing."""
    from sweep.stages import Status

    prepared = _prepare(options)
    verdicts = prepared.verdicts()
    count = {s: sum(v.status is s for v in verdicts) for s in Status}
    missing, done = count[Status.NOT_RUN], count[Status.DONE]
    failed = len(verdicts) - missing - done
    bad = [
        (case, v)
        for case, v in enumerate(verdicts)
        if v.status not in (Status.DONE, Status.NOT_RUN)
    ]
    if options.json:
        cases = [
            {**_at(prepared, case), "status": v.status.name.lower(), "message": v.message}
            for case, v in bad
        ]
        told = {"study": prepared.study.name, "cases": len(verdicts), "done": done}
        _print_json({**told, "failed": failed, "missing": missing, "failures": cases})
    else:
        print(f"{len(verdicts)} cases: {done} done, {failed} failed, {missing} missing")
        for case, v in bad[:MOST_SHOWN]:
            print(f"{_place(prepared, case)}: {v.status.name.lower()}: {v.message}")
        if len(bad) > MOST_SHOWN:
            print(f"… and {len(bad) - MOST_SHOWN} more; --json names them all")
    good = prepared.as_expected(verdicts) | [v.status is Status.NOT_RUN for v in verdicts]
    return GOOD if good.all() else SOME_FAILED


def report(options: argparse.Namespace) -> int:
    """Draw figures and report from the dataset."""
    from sweep.engine import draw_study

    finished = draw_study(options.study, options.results, smoke=options.smoke)
    _tell_places(finished, options)
    return SOME_FAILED if finished.failed else GOOD


def verify(options: argparse.Namespace) -> int:
    """Re-hash every stored product and every dataset."""
    from sweep.upkeep import verify

    found = verify(options.folder)
    if options.json:
        damaged = [{"file": str(path), "problem": what} for path, what in found.damaged]
        told = {"checked": found.checked, "damaged": damaged, "set_aside": found.set_aside}
        _print_json(told)
    else:
        for path, what in found.damaged:
            print(f"{path}: {what}")
        print(f"{_count(found.checked, 'file')} checked, {len(found.damaged)} damaged")
    if found.damaged and found.set_aside:
        _say("damaged files were set aside; the next run makes them again")
    return SOME_FAILED if found.damaged else GOOD


def clean(options: argparse.Namespace) -> int:
    """Free what no study of a results folder refers to."""
    from sweep.progress import size
    from sweep.upkeep import free, unwanted

    found = unwanted(options.folder)
    amount = f"{_count(len(found.files), 'file')}, {size(found.bytes)}"
    _say(f"no study in {options.folder} refers to {amount}")
    freed = bool(found.files) and (options.yes or _agreed("free them?"))
    if freed:
        found = free(options.folder)
    elif found.files:
        _say("nothing was freed; --yes frees them")
    if options.json:
        _print_json({"files": len(found.files), "bytes": found.bytes, "freed": freed})
    elif freed:
        print(f"freed {_count(len(found.files), 'file')}, {size(found.bytes)}")
    return GOOD


def schema(options: argparse.Namespace) -> int:
    """Print the JSON Schema of a study."""
    from sweep.schema import study_schema

    _print_json(study_schema())
    return GOOD


def _prepare(options: argparse.Namespace) -> Prepared:
    from sweep.engine import prepare

    return prepare(options.study, options.results, smoke=options.smoke)


def _summary(finished: Finished) -> str:
    from sweep.progress import duration

    good = finished.cases - finished.failed
    text = f"{good} of {finished.cases} cases good"
    if finished.failed:
        text += f", {finished.failed} failed"
    if finished.executed is None:
        return f"{text}; all were stored, nothing was computed"
    done = finished.executed
    return f"{text}; {_count(done.computed, 'stage run')} in {duration(done.seconds)}"


def _tell_places(finished: Finished, options: argparse.Namespace) -> None:
    places = {"dataset": finished.dataset, "figures": finished.folder / "figures"}
    if finished.report is not None:
        places["report"] = finished.report
    if options.json:
        told = {"study": finished.folder.name, "cases": finished.cases, "failed": finished.failed}
        computed = finished.executed.computed if finished.executed else 0
        _print_json({**told, "computed": computed, **{k: str(v) for k, v in places.items()}})
        return
    for name, path in places.items():
        print(f"{name:8} {path}")


def _at(prepared: Prepared, case: int) -> dict[str, Any]:
    """Where a case lies, in the coordinates of the dataset."""
    import numpy as np

    from sweep.cases import coordinates

    index = np.unravel_index(case, prepared.study.shape) if prepared.study.axes else ()
    return {
        axis.name: coordinates(axis)[0].values[int(k)].item()
        for axis, k in zip(prepared.study.axes, index, strict=True)
    }


def _place(prepared: Prepared, case: int) -> str:
    """Where a case lies, in words and with units."""
    import numpy as np

    from sweep.study import setting

    axes = prepared.study.axes
    index = np.unravel_index(case, prepared.study.shape) if axes else ()
    settings = (setting(axis, int(k)) for axis, k in zip(axes, index, strict=True))
    return ", ".join(settings) or "the case"


def _where(options: argparse.Namespace) -> str:
    smoke = " --smoke" if options.smoke else ""
    return smoke if options.results == "results" else f"{smoke} --results {options.results}"


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def _agreed(question: str) -> bool:
    """Ask whoever sits at a terminal; where nobody does, the answer is no."""
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return False
    print(f"{question} [y/N] ", end="", file=sys.stderr, flush=True)
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def _say(message: str) -> None:
    print(message, file=sys.stderr, flush=True)


def _print_json(content: Any) -> None:
    print(json.dumps(content, indent=2))


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"


def _product(numbers: Sequence[int]) -> int:
    product = 1
    for number in numbers:
        product *= number
    return product


def _known(number: float | None, shown: Callable[[float], str]) -> str:
    return "?" if number is None else shown(number)


def _at_least_one(text: str) -> int:
    try:
        number = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number") from None
    if number < 1:
        raise argparse.ArgumentTypeError(f"{number} is below 1")
    return number


def _parser() -> argparse.ArgumentParser:
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
        if command is not schema:
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

    running = add_workers(add_results(add(run)))
    running.add_argument(
        "--scheduler",
        metavar="tcp://HOST:PORT",
        help="use the workers of this Dask scheduler, wherever they are: products travel "
        "to them and back (tls:// with Dask's own configuration)",
    )
    running.add_argument("--retry-failed", action="store_true", help="run again what failed before")
    running.add_argument("--force", action="store_true", help="compute everything again")
    add(check)
    add_workers(add_results(add(plan)))
    add_results(add(status))
    add_results(add(report))
    add(verify, takes_study=False).add_argument(
        "folder", metavar="RESULTS_DIR", type=Path, help="folder of all results"
    )
    cleaning = add(clean, takes_study=False)
    cleaning.add_argument("folder", metavar="RESULTS_DIR", type=Path, help="folder of all results")
    cleaning.add_argument("--yes", action="store_true", help="free without asking")
    add(schema, takes_study=False)
    return parser


class _Version(argparse.Action):
    """Looks the version up only when it is asked for."""

    def __init__(self, option_strings: Sequence[str], dest: str, help: str | None = None):
        super().__init__(option_strings, dest, nargs=0, help=help)

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from sweep.versions import installed

        print(f"demflow {installed('demflow')}")
        parser.exit()


def _first_line(command: Callable[..., Any]) -> str:
    return (command.__doc__ or "").splitlines()[0].rstrip(".").lower()


if __name__ == "__main__":
    sys.exit(main())
