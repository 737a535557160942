"""What each command does with its options; data to stdout, messages to stderr.

Each imports what it needs, so that `demflow --help` and `check` answer at once.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from demflow.sweep.command.terminal import say, show
from demflow.sweep.study.yaml_source import StudyError

if TYPE_CHECKING:
    from demflow.sweep.engine import Finished
    from demflow.sweep.prepared import Project

GOOD, SOME_FAILED, WRONG = 0, 1, 2  # exit status
MOST_SHOWN = 20  # failed cases that `status` names one by one


def run(options: argparse.Namespace) -> int:
    """Run what is missing, collect the dataset, draw the figures."""
    from demflow.sweep.command.progress_line import ProgressLine
    from demflow.sweep.engine import run_study
    from demflow.sweep.execution.memory import began

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
            tell=say,
            since=began() if options.alone else None,
        )
    finally:
        line.close()
    for message in finished.messages():
        say(message)
    say(_summary(finished))
    if finished.failed:
        again = finished.failed > finished.inaccurate + finished.stopped
        hint = "; `--retry-failed` tries failed cases again" if again else ""
        say(f"why: demflow status {options.study}{_where(options)}{hint}")
    _tell_places(finished, options)
    return SOME_FAILED if finished.failed else GOOD


def fit(options: argparse.Namespace) -> int:
    """Fit a model to measured data, with intervals.

    The study's block `fit` says what is fitted to which of its `data`: reservoir models by name,
    or parameters of its scene. Numbers and figure go to results/<study>/fit/.
    """
    from demflow.sweep.fitting.fitted import fit_study, summary, told

    fitted = fit_study(
        options.study, options.results, smoke=options.smoke, tell=say, figure=not options.no_figure
    )
    if options.json:
        _print_json(summary(fitted))
    else:
        for line in told(fitted):
            show(line)
    if fitted.figure is not None:
        say(f"figure: {fitted.figure}")
    say(f"numbers: {fitted.folder / 'fit.json'}")
    return GOOD


def check(options: argparse.Namespace) -> int:
    """Validate a study: every problem at once."""
    from demflow.sweep.command.coupling import told_coupling
    from demflow.sweep.command.traces import (
        told_closures,
        told_multipliers,
        told_partings,
        told_traces,
    )
    from demflow.sweep.study.load import load_study

    try:
        study = load_study(options.study, alone=True)
    except StudyError as error:
        if options.json:
            keys = ("path", "line", "column", "message")
            found = [{key: getattr(p, key) for key in keys} for p in error.problems]
            _print_json({"valid": False, "count": error.count, "problems": found})
        else:
            show(str(error), sentences=True)
        return WRONG
    cases = _product(study.shape) if study.kept is None else int(study.kept.sum())
    cases = cases if study.values else 0  # without a scene nothing runs
    told = (told_traces, told_multipliers, told_partings, told_closures, told_coupling)
    summary = [line for one in told for line in one(study)] if study.values else []
    for test in study.data.values():
        summary += [
            f"data.{test.name}: {one}" for one in (_count(len(test.time), "point"), *test.notes)
        ]
    if options.json:
        good = {"valid": True, "problems": [], "study": study.name, "cases": cases}
        _print_json(good | {"traces": summary})
    else:
        show(f"{options.study}: valid, {_count(cases, 'case')}")
        for line in summary:
            show(line, sentences=True)
    return GOOD


def plan(options: argparse.Namespace) -> int:
    """Tell what `run` would do."""
    from demflow.sweep.command.forecast import forecast
    from demflow.sweep.command.progress_line import duration, size

    summary = forecast(_prepare(options), options.workers)
    for warning in summary["warnings"]:
        say(f"warning: {warning}")
    if options.json:
        _print_json(summary)
        return GOOD
    show(f"{_count(summary['cases'], 'case')}, {options.workers} workers")
    if summary["impossible"]:
        show(f"{_count(summary['impossible'], 'case')} cannot be: see demflow status")
    rows = [("stage", "runs", "shared", "stored", "failed", "to run", "each", "time", "disk")]
    for stage in (stage for stage in summary["stages"] if stage["runs"]):
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
        show("  ".join((name.ljust(widths[0]), *numbers)))
    for name, unit in (("seconds", duration), ("bytes", size), ("memory", size)):
        label = {"seconds": "time", "bytes": "disk"}.get(name, name)
        more = "" if summary[name] is not None else "at least "
        least = summary["at_least"][name]
        show(f"expected {label}: {'?' if more and not least else more + unit(least)}")
    if summary["unknown"]:
        show(f"?: never run on this machine: {', '.join(summary['unknown'])}")
    if summary["compiling"]:
        show(f"{duration(summary['compiling'])} of the time: compiling, once on this machine")
    time, memory = summary["limits"]["time"], summary["limits"]["memory"]
    show(f"limits of a case: {duration(time)}, {size(memory)} (the study's limits, or by default)")
    return GOOD


def status(options: argparse.Namespace) -> int:
    """Tell what is done, failed and missing."""
    from demflow.model.outcome import Status
    from demflow.sweep.engine import as_expected, standing

    prepared = _prepare(options)
    verdicts = standing(prepared)
    count = {s: sum(v.status is s for v in verdicts) for s in Status}
    missing, done, off, stopped = (
        count[s] for s in (Status.NOT_RUN, Status.DONE, Status.INACCURATE, Status.STOPPED)
    )
    cases = len(verdicts) - count[Status.LEFT_OUT]
    failed = cases - missing - done - off - stopped
    again = prepared.tried_again(verdicts)
    bad = [
        (case, v)
        for case, v in enumerate(verdicts)
        if v.status not in (Status.DONE, Status.NOT_RUN, Status.LEFT_OUT)
    ]
    if options.json:
        failures = [
            {
                **_at(prepared, case),
                "status": v.status.name.lower(),
                "message": v.message,
                "tried_again": bool(again[case]),
            }
            for case, v in bad
        ]
        counts = {"done": done, "inaccurate": off, "stopped": stopped, "failed": failed}
        named = {"study": prepared.study.name, "cases": cases}
        _print_json({**named, **counts, "missing": missing, "failures": failures})
    else:
        besides = f"{off} inaccurate, " if off else ""
        besides += f"{stopped} stopped early, " if stopped else ""
        show(f"{cases} cases: {done} done, {besides}{failed} failed, {missing} missing")
        for case, v in bad[:MOST_SHOWN]:
            told = f"{_place(prepared, case)}: {v.status.words}: {v.message}"
            show(told, sentences=True)
        if len(bad) > MOST_SHOWN:
            show(f"… and {len(bad) - MOST_SHOWN} more; --json names them all")
        others = failed - int(again.sum()) - len(prepared.plan.impossible)
        for message in _what_next(int(again.sum()), others):
            say(message)
    good = as_expected(prepared, verdicts) | [v.status is Status.NOT_RUN for v in verdicts]
    return GOOD if good.all() else SOME_FAILED


def _what_next(again: int, others: int) -> Iterator[str]:
    """What becomes of cases that failed."""
    if again:
        yield f"{again} of them: tried again by the next run, which has more time or memory"
    if others:
        yield f"`demflow run --retry-failed` tries {'all' if again else 'them'} again"


def collect(options: argparse.Namespace) -> int:
    """Write the dataset of what is finished, without running anything."""
    from demflow.sweep.engine import collect_study

    finished = collect_study(options.study, options.results, smoke=options.smoke)
    for message in finished.messages():
        say(message)
    say(_summary(finished))
    _tell_places(finished, options)
    return SOME_FAILED if finished.failed > finished.missing else GOOD


def report(options: argparse.Namespace) -> int:
    """Draw figures and report from the dataset."""
    from demflow.sweep.engine import draw_study

    finished = draw_study(options.study, options.results, smoke=options.smoke)
    for message in finished.drawing:
        say(message)
    _tell_places(finished, options)
    return SOME_FAILED if finished.failed else GOOD


def figures(options: argparse.Namespace) -> int:
    """Draw the figures as PNG, SVG or PDF, for a column or a page; or maps that move."""
    from demflow.sweep.engine import draw_figures

    paths, messages = draw_figures(
        options.study,
        options.results,
        kind=options.animate or options.format,
        width=options.width or "",
        smoke=options.smoke,
    )
    for message in messages:
        say(message)
    if options.json:
        _print_json({"figures": [str(path) for path in paths]})
    else:
        for path in paths:
            show(str(path))
    return GOOD


def export(options: argparse.Namespace) -> int:
    """Write the maps of one case for other programs: .nc (UGRID), .pvd or .vtu (ParaView)."""
    from demflow.sweep.dataset.case_file import write_case
    from demflow.sweep.dataset.open import case_of, values_of

    at = values_of(options.folder, options.at)
    written = write_case(case_of(options.folder, at), options.file)
    if options.json:
        _print_json({"files": [str(path) for path in written]})
    else:
        for path in written:
            show(str(path))
    return GOOD


def verify(options: argparse.Namespace) -> int:
    """Re-hash every stored product and every dataset."""
    from demflow.sweep.command.upkeep import verify

    found = verify(options.folder)
    if options.json:
        damaged = [{"file": str(path), "problem": what} for path, what in found.damaged]
        summary = {"checked": found.checked, "damaged": damaged, "set_aside": found.set_aside}
        _print_json(summary)
    else:
        for path, what in found.damaged:
            show(f"{path}: {what}")
        show(f"{_count(found.checked, 'file')} checked, {len(found.damaged)} damaged")
    if found.damaged and found.set_aside:
        say("damaged files were set aside; the next run makes them again")
    return SOME_FAILED if found.damaged else GOOD


def clean(options: argparse.Namespace) -> int:
    """Free what no study of a results folder refers to."""
    from demflow.sweep.command.progress_line import size
    from demflow.sweep.command.upkeep import free, unwanted

    found = unwanted(options.folder)
    amount = f"{_count(len(found.files), 'file')}, {size(found.bytes)}"
    say(f"no study in {options.folder} refers to {amount}")
    freed = bool(found.files) and (options.yes or _agreed("free them?"))
    if freed:
        found = free(options.folder)
    elif found.files:
        say("nothing was freed; --yes frees them")
    if options.json:
        _print_json({"files": len(found.files), "bytes": found.bytes, "freed": freed})
    elif freed:
        show(f"freed {_count(len(found.files), 'file')}, {size(found.bytes)}")
    return GOOD


def schema(options: argparse.Namespace) -> int:
    """Print the JSON Schema of a study, or write it and print the line that names it to editors."""
    from demflow.sweep.command.beginning import write_schema
    from demflow.sweep.study.schema import study_schema

    if options.write is None:
        _print_json(study_schema())
        return GOOD
    show(write_schema(options.write))
    say("as its first line this lets editors check and complete a study in the same folder")
    return GOOD


def _prepare(options: argparse.Namespace) -> Project:
    from demflow.sweep.prepared import prepare

    return prepare(options.study, options.results, smoke=options.smoke, tell=say)


def _summary(finished: Finished) -> str:
    from demflow.sweep.command.progress_line import duration

    good = finished.cases - finished.failed
    text = f"{good} of {finished.cases} cases good"
    others = finished.inaccurate + finished.stopped + finished.missing
    if failed := finished.failed - others:
        text += f", {failed} failed"
    if finished.inaccurate:
        text += f", {finished.inaccurate} inaccurate"
    if finished.stopped:
        text += f", {finished.stopped} stopped early"
    if finished.missing:
        text += f", {finished.missing} missing"
    if finished.executed is None:
        stored = "" if finished.missing else "all were stored, "
        return f"{text}; {stored}nothing was computed"
    done = finished.executed
    runs = f"{_count(done.computed, 'stage run')} in {duration(done.seconds)}"
    return f"{text}; {runs}, {duration(done.worked)} of work beside starting and compiling"


def _tell_places(finished: Finished, options: argparse.Namespace) -> None:
    places = {"dataset": finished.dataset, "figures": finished.folder / "figures"}
    if finished.report is not None:
        places["report"] = finished.report
    if options.json:
        summary = {
            "study": finished.folder.name,
            "cases": finished.cases,
            "failed": finished.failed,
        }
        computed = finished.executed.computed if finished.executed else 0
        _print_json({**summary, "computed": computed, **{k: str(v) for k, v in places.items()}})
        return
    for name, path in places.items():
        show(f"{name:8} {path}")


def _at(prepared: Project, case: int) -> dict[str, Any]:
    """Where a case lies, in the coordinates of the dataset."""
    import numpy as np

    from demflow.sweep.study.cases import coordinates

    index = np.unravel_index(case, prepared.study.shape) if prepared.study.axes else ()
    return {
        axis.name: coordinates(axis)[0].values[int(k)].item()
        for axis, k in zip(prepared.study.axes, index, strict=True)
    }


def _place(prepared: Project, case: int) -> str:
    """Where a case lies, in words and with units."""
    import numpy as np

    from demflow.sweep.study.load import setting

    axes = prepared.study.axes
    index = np.unravel_index(case, prepared.study.shape) if axes else ()
    settings = (setting(axis, int(k)) for axis, k in zip(axes, index, strict=True))
    return ", ".join(settings) or "the case"


def _where(options: argparse.Namespace) -> str:
    smoke = " --smoke" if options.smoke else ""
    return smoke if options.results == "results" else f"{smoke} --results {options.results}"


def _agreed(question: str) -> bool:
    """Ask whoever sits at a terminal; where nobody does, the answer is no."""
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return False
    print(f"{question} [y/N] ", end="", file=sys.stderr, flush=True)
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def _print_json(content: Any) -> None:
    show(json.dumps(content, indent=2))


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"


def _product(numbers: Sequence[int]) -> int:
    product = 1
    for number in numbers:
        product *= number
    return product


def _known(number: float | None, shown: Callable[[float], str]) -> str:
    return "?" if number is None else shown(number)
