"""A study from its file to its dataset: plan, run what is missing, collect, draw."""

from __future__ import annotations

import hashlib
import itertools
import multiprocessing
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from demflow.model.outcome import Status
from demflow.sweep.dataset import DATASET_FILE, STUDY_FILE
from demflow.sweep.dataset.folder import (
    FIGURES,
    REPORT_FILE,
    UNFINISHED_FILE,
    check_free,
    keep_source,
    remove_partial,
)
from demflow.sweep.errors import ResultsError
from demflow.sweep.execution import certificate
from demflow.sweep.execution.limits import in_force
from demflow.sweep.execution.memory import peak_memory
from demflow.sweep.execution.progress import Progress
from demflow.sweep.execution.schedule import Schedule
from demflow.sweep.plan.table import MODEL
from demflow.sweep.prepared import Project, prepare
from demflow.sweep.store.durable import naming, unflushed
from demflow.sweep.store.inherited import inherited, note
from demflow.sweep.store.kept import keep_study
from demflow.sweep.store.lock import FolderLock
from demflow.sweep.store.origins import note_origins
from demflow.sweep.store.products import StoreError
from demflow.sweep.store.written import is_whole, ours
from demflow.sweep.study.expect import ends_as_expected

if TYPE_CHECKING:
    import xarray as xr

    from demflow.sweep.dataset.verdict import Verdict
    from demflow.sweep.execution.ledger import Executed

COLLECTOR = 6  # raise it whenever the dataset made of the same products changes
ROUNDS = 4  # times that damaged products are found and computed again before giving up


@dataclass(frozen=True)
class Finished:
    """What a run did, and where its results lie."""

    folder: Path
    cases: int
    failed: int  # cases that did not end as the study expects
    inaccurate: int  # of these, such whose numbers are beyond their bounds
    stopped: int  # of these, such that came to an early end; what came before is kept
    missing: int  # cases that were not run
    executed: Executed | None  # None where everything was stored already
    collected: bool  # whether the dataset was written anew
    dataset: Path
    figures: tuple[Path, ...] = ()
    report: Path | None = None
    damaged: list[str] = field(default_factory=list)
    notes: tuple[str, ...] = ()  # what its numbers say, be the cases good
    drawing: tuple[str, ...] = ()  # what could not be drawn, or stood in the way
    changed: bool = False  # whether the study file is no longer the one that was run

    def messages(self) -> Iterator[str]:
        """What whoever ran it should know beside its results."""
        for message in self.damaged:
            yield f"damaged, computed again: {message}"
        for message in self.executed.refused if self.executed else ():
            yield f"not used: {message}"
        yield from (*self.notes, *self.drawing)
        for folder in sorted(unflushed)[:1]:
            yield (
                f"the file system of {folder} cannot flush folders: after a power cut the results "
                "written last may be missing, and are computed again then"
            )
        if self.changed:
            kept = self.folder / STUDY_FILE
            yield f"the study file has changed meanwhile; the results are those of {kept}"


def run_study(
    path: str | Path,
    *,
    workers: int = 2,
    results: str | Path = "results",
    scheduler: str | None = None,
    retry_failed: bool = False,
    force: bool = False,
    smoke: bool = False,
    progress: Callable[[Progress], None] | None = None,
    tell: Callable[[str], None] | None = None,
    figures: bool = True,
    table: str = MODEL,
    since: float | None = None,
) -> Finished:
    """Run what is missing of a study, collect its dataset and draw its figures.

    Parameters
    ----------
    path : the study file.
    workers : worker processes, one thread each.
    results : folder under which the results of all studies lie.
    scheduler : address of a Dask scheduler, instead of workers of this machine. Its
        workers need not see the results folder: products travel to them and back.
    retry_failed : run again what failed before.
    force : compute everything again, stored or not.
    smoke : apply the study's smoke block.
    progress : called with the state of the run, several times a second.
    tell : called with what a user should know before anything is run.
    figures : whether to draw figures and write the report.
    table : where the table of stages lies, as `module:name`.
    since : when the program began that does nothing else, s since the epoch; how long it took to
        get here counts in forecasts.

    Raises
    ------
    StudyError, StoreError, LockedError, SchedulerError before anything is run; RunError
    where the run as a whole cannot go on. A case that fails is no error: it is in the dataset.
    KeyboardInterrupt after Ctrl-C: the first lets what runs end and collects the dataset of what
    is finished, the second stops at once.
    """
    begin = time.perf_counter() - (0.0 if since is None else max(time.time() - since, 0.0))
    if workers < 1:
        raise ValueError(f"workers is {workers}; at least one is needed")
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        # a worker, importing a script that calls this above `if __name__ == "__main__":`;
        # the run that started it says so, once
        raise SystemExit(1)
    how = _How(workers, scheduler, retry_failed, force)
    prepared = prepare(path, results, smoke=smoke, table=table, create=True)
    root = prepared.store.root.parent
    stages = prepared.plan.stages  # planned before the folder is locked: it may take long
    with ExitStack() as held:
        with _nothing_run_yet(prepared):
            held.enter_context(FolderLock(root, f"demflow run {prepared.study.name}"))
            check_free(prepared.folder, prepared.study)
            prepared.folder.mkdir(exist_ok=True)
            _remove_partial(prepared)
            keep_source(prepared.folder, prepared.study)
            keep_study(prepared.folder / UNFINISHED_FILE, prepared.study)
            if tell and (message := inherited(prepared.store, prepared.plan)):
                tell(message)
            note(prepared.store, prepared.study, prepared.plan)
            note_origins(prepared.store, stages)
        held.push(lambda kind, *_: _remove_partial(prepared) if kind else None)
        executed, damaged = None, []
        for _ in range(ROUNDS):
            done = _execute(prepared, how, progress)
            executed = done if executed is None else executed.joined(done)
            how = replace(how, retry_failed=False, force=False)
            verdicts, collected, found = _collect(prepared)
            damaged += found
            if not found or (executed and executed.interrupted):
                break
        else:
            raise StoreError(f"{prepared.store.root} does not keep what is written: {damaged[-1]}")
        if executed and executed.deaths:
            _remove_partial(prepared)
        if executed and executed.interrupted:
            raise KeyboardInterrupt  # the dataset holds what is finished
        (prepared.folder / UNFINISHED_FILE).unlink(missing_ok=True)
        damaged = [*(executed.damaged if executed else ()), *damaged]
        finished = replace(
            _finished(prepared, verdicts),
            executed=executed,
            collected=collected,
            damaged=damaged,
            changed=_changed(prepared),
        )
        end = time.perf_counter()
        drawn = draw(prepared, finished, again=collected) if figures else finished
        if executed is not None:
            took = {"leading": end - begin - executed.seconds}
            _note(prepared, took | ({"drawing": time.perf_counter() - end} if figures else {}))
        return drawn


def run(
    path: str | Path,
    *,
    workers: int = 2,
    results: str | Path = "results",
    scheduler: str | None = None,
    retry_failed: bool = False,
    force: bool = False,
    smoke: bool = False,
    progress: Callable[[Progress], None] | None = None,
) -> xr.Dataset:
    """Run what is missing of a study, draw its figures and return its dataset.

    Takes and raises what `run_study` does. In a script, call it below
    `if __name__ == "__main__":`, since workers are new processes that import the script.

    Warns with a `RunWarning` of cases that did not end as the study expects, and of what the
    command line tells beside its results.

    Parameters
    ----------
    path : of the study
    workers : processes on this machine
    results : folder that holds the results of all studies
    scheduler : address of a Dask scheduler to use instead
    retry_failed : whether cases that failed are tried again
    force : whether all is computed again
    smoke : whether the overrides under `smoke:` hold
    progress : called with the state of the run, several times a second
    """
    from demflow.sweep.dataset.open import open_results

    finished = run_study(
        path,
        workers=workers,
        results=results,
        scheduler=scheduler,
        retry_failed=retry_failed,
        force=force,
        smoke=smoke,
        progress=progress,
        tell=lambda message: warnings.warn(message, RunWarning, stacklevel=4),
    )
    for message in finished.messages():
        warnings.warn(message, RunWarning, stacklevel=2)
    if finished.failed:
        off = f" or inaccurate ({finished.inaccurate})" if finished.inaccurate else ""
        off += f" or stopped early ({finished.stopped})" if finished.stopped else ""
        message = (
            f"{finished.failed} of {finished.cases} cases failed{off}; `status` and `message` in "
            "the dataset say why, and retry_failed=True tries what failed again"
        )
        warnings.warn(message, RunWarning, stacklevel=2)
    return open_results(finished.folder)


class RunWarning(UserWarning):
    """What should be known of a run that has done what it could."""


def draw_study(
    path: str | Path, results: str | Path = "results", *, smoke: bool = False, table: str = MODEL
) -> Finished:
    """Draw figures and report of a study anew, from the dataset that a run has left.

    Raises StudyError, StoreError, LockedError, and ResultsError where there is no dataset, or
    one of other cases than the study's.

    Parameters
    ----------
    path : of the study
    results : folder that holds the results of all studies
    smoke : whether the overrides under `smoke:` hold
    table : the table of stages, as `module:name`
    """
    from demflow.sweep.dataset.file import recorded

    prepared = prepare(path, results, smoke=smoke, table=table)
    dataset = _own_dataset(prepared)
    finished = _finished(prepared, recorded(dataset))
    with FolderLock(prepared.folder.parent, f"demflow report {prepared.study.name}"):
        return draw(prepared, finished)


def draw_figures(
    path: str | Path,
    results: str | Path = "results",
    *,
    kind: str = "png",
    width: str = "",
    smoke: bool = False,
    table: str = MODEL,
) -> tuple[list[Path], list[str]]:
    """Draw the figures of a study in another format or width, from the dataset of a run.

    Parameters
    ----------
    path : of the study
    results : folder that holds the results of all studies
    kind : png, svg or pdf; gif or mp4: the maps of pressure in time, and nothing else
    width : column or page, of a journal; empty: as wide as what is drawn needs
    smoke : whether the overrides under `smoke:` hold
    table : the table of stages, as `module:name`

    Returns
    -------
    Where the figures lie, and what could not be drawn.

    Raises StudyError, StoreError, LockedError, and ResultsError where there is no dataset, one of
    other cases than the study's, or nothing to animate.
    """
    prepared = prepare(path, results, smoke=smoke, table=table)
    _own_dataset(prepared)
    from demflow.sweep.dataset.open import open_results
    from demflow.sweep.figures import Form, write_animations, write_figures

    write = write_animations if kind in ("gif", "mp4") else write_figures
    with FolderLock(prepared.folder.parent, f"demflow figures {prepared.study.name}"):
        dataset = open_results(prepared.folder)
        drawn = write(dataset, prepared.folder, prepared.study, Form(kind, width))
    return drawn.paths, drawn.messages


def _own_dataset(prepared: Project) -> Path:
    """The dataset of a study. Raises ResultsError where it is not there, or not of its cases."""
    dataset = prepared.folder / DATASET_FILE
    if not dataset.exists():
        raise ResultsError(f"{dataset} does not exist; `demflow run` writes it")
    check_is_of(dataset, prepared)
    return dataset


def collect_study(
    path: str | Path, results: str | Path = "results", *, smoke: bool = False, table: str = MODEL
) -> Finished:
    """Write the dataset of what is finished of a study; nothing is run, missing cases say so.

    Raises StudyError, StoreError, LockedError, OSError.

    Parameters
    ----------
    path : of the study
    results : folder that holds the results of all studies
    smoke : whether the overrides under `smoke:` hold
    table : the table of stages, as `module:name`
    """
    prepared = prepare(path, results, smoke=smoke, table=table)
    root = prepared.folder.parent
    if not prepared.store.root.exists():
        raise StoreError(f"{root} holds no results; `demflow run` computes them")
    damaged: list[str] = []
    with (
        _nothing_run_yet(prepared),
        FolderLock(root, f"demflow collect {prepared.study.name}"),
    ):
        check_free(prepared.folder, prepared.study)
        prepared.folder.mkdir(exist_ok=True)
        _remove_partial(prepared)
        keep_source(prepared.folder, prepared.study)
        for _ in range(ROUNDS):
            verdicts, collected, found = _collect(prepared)
            damaged += found
            if not found:
                break
    return replace(_finished(prepared, verdicts), collected=collected, damaged=damaged)


def _finished(prepared: Project, verdicts: list[Verdict]) -> Finished:
    """What stands in a folder, whoever ran it."""
    from demflow.sweep.dataset.file import below_zero

    bad = ~as_expected(prepared, verdicts)
    off, stopped = (
        np.array([v.status is one for v in verdicts], dtype=bool)
        for one in (Status.INACCURATE, Status.STOPPED)
    )
    bounded = any(promise.lowest_pressure is not None for promise in prepared.study.promised)
    dataset = prepared.folder / DATASET_FILE
    return Finished(
        folder=prepared.folder,
        cases=sum(v.status is not Status.LEFT_OUT for v in verdicts),
        failed=int(np.count_nonzero(bad)),
        inaccurate=int(np.count_nonzero(bad & off)),
        stopped=int(np.count_nonzero(bad & stopped)),
        missing=sum(v.status is Status.NOT_RUN for v in verdicts),
        executed=None,
        collected=False,
        dataset=dataset,
        notes=() if bounded else below_zero(dataset),
    )


def check_is_of(path: Path, prepared: Project) -> None:
    """Raise ResultsError where the dataset at a path is not that of a study's cases.

    Another title, other figures and other expectations make no other dataset.
    """
    from demflow.sweep.dataset.file import difference

    study = prepared.study
    why = difference(path, study, lambda: prepared.plan)
    if why is not None:
        raise ResultsError(
            f"{path} is not the dataset of {study.path}: {why}. `demflow run {study.path}` makes "
            f"it that study's; `demflow report {path.with_name(STUDY_FILE)}` draws what is there"
        )


def draw(prepared: Project, finished: Finished, *, again: bool = True) -> Finished:
    """Write figures and report; those that are there, whole, stay unless drawn `again`.

    Parameters
    ----------
    prepared : study, plan and store
    finished : the dataset as a run has left it
    again : whether figures that are there, whole, are drawn too
    """
    folder = prepared.folder
    report = folder / REPORT_FILE
    if not again and report.exists() and is_whole(folder / FIGURES):
        there = tuple(path for path in ours(folder / FIGURES) if path.suffix == ".png")
        return replace(finished, figures=there, report=report)
    from demflow.sweep.dataset.open import open_results
    from demflow.sweep.figures import maps_reader, write_figures
    from demflow.sweep.report import write_report

    with naming(folder):
        dataset = open_results(folder)
        maps_of = maps_reader(dataset, folder, prepared.study)
        figures = write_figures(dataset, folder, prepared.study, maps_of=maps_of)
        report = write_report(dataset, folder, prepared.study, figures.paths, maps_of)
    return replace(
        finished, figures=tuple(figures.paths), report=report, drawing=tuple(figures.messages)
    )


def as_expected(prepared: Project, verdicts: list[Verdict]) -> np.ndarray:
    """Which cases ended as the study says that they should, (cases,) bool.

    Without a word about it in the study, every case should be done.
    """
    study = prepared.study
    promised = map(study.expectation, itertools.product(*map(range, study.shape)))
    pairs = zip(promised, verdicts, strict=True)
    return np.array([ends_as_expected(p, v.status, v.message) for p, v in pairs], dtype=bool)


def standing(prepared: Project) -> list[Verdict]:
    """How each case stands, judged by its numbers too where these products were collected."""
    from demflow.sweep.dataset.file import collected_digest, recorded

    verdicts = prepared.verdicts()
    path = prepared.folder / DATASET_FILE
    there = collected_digest(path) == _digest(prepared, verdicts)
    return recorded(path) if there else verdicts


@dataclass(frozen=True)
class _How:
    """Where what is missing is run, and what counts as missing."""

    workers: int
    scheduler: str | None
    retry_failed: bool
    force: bool


def _execute(
    prepared: Project, how: _How, progress: Callable[[Progress], None] | None
) -> Executed | None:
    """Run what is missing; None where nothing is, and then no worker is started."""
    plan, store = prepared.plan, prepared.store
    stored = prepared.stored()
    if how.force:
        stored[:] = False
    limits = in_force(prepared.study.limits, how.workers if how.scheduler is None else None)
    failed = prepared.failed(stored, limits)
    if how.retry_failed or how.force:
        failed[:] = False
    if how.retry_failed:  # a run of a family is stored, whatever its members end with
        stored &= ~prepared.unanswered(stored)
    costs = prepared.costs()
    start = costs.start
    schedule = Schedule(plan, stored, failed, costs)
    if not schedule.pending:
        return None
    if how.scheduler is None:
        certificate.begin()
    try:
        # Dask is imported only where something must run
        from demflow.sweep.execution.loop import execute

        return execute(
            schedule,
            store,
            prepared.scene_of,
            table=prepared.table,
            workers=how.workers,
            scheduler=how.scheduler,
            limits=limits,
            progress=progress,
            anew=how.force,
        )
    finally:
        certificate.forget()
        if how.scheduler is not None:
            costs.start = start  # of workers of this machine
        costs.led(peak_memory())
        with suppress(OSError):
            prepared.keep(costs)


def _note(prepared: Project, took: dict[str, float]) -> None:
    """Keep what parts of a run took that come once, s, for forecasts."""
    costs = prepared.costs()
    for part, seconds in took.items():
        costs.note(part, seconds)
    with suppress(OSError):
        prepared.keep(costs)


@contextmanager
def _nothing_run_yet(prepared: Project) -> Iterator[None]:
    """Say of a folder that cannot be written that it is the wrong one."""
    try:
        yield
    except OSError as error:
        where = error.filename or prepared.folder
        raise StoreError(f"{where} cannot be written: {error.strerror or error}") from error


def _changed(prepared: Project) -> bool:
    """Whether the study file, or one that it names, was changed or is gone since it was read."""
    try:
        if Path(prepared.study.path).read_bytes() != prepared.study.text.encode():
            return True
        return any(file.path.read_bytes() != file.content for file in prepared.study.files.values())
    except OSError:
        return True


def _remove_partial(prepared: Project) -> None:
    """Remove half files that interrupted or killed processes have left. Only under the lock."""
    prepared.store.remove_partial()
    remove_partial(prepared.folder)


def _collect(prepared: Project) -> tuple[list[Verdict], bool, list[str]]:
    """Write the dataset unless it is that of these products.

    Returns how each case ended, whether the dataset was written, and what is damaged.

    The study file is kept beside it, so that a case can be opened without the original.
    """
    # netCDF and xarray are imported only where they are needed
    from demflow.sweep.dataset.collect import collect
    from demflow.sweep.dataset.file import collected_digest, recorded

    study, plan = prepared.study, prepared.plan
    verdicts = prepared.verdicts()
    digest = _digest(prepared, verdicts)
    path = prepared.folder / DATASET_FILE
    keep_study(prepared.folder / STUDY_FILE, prepared.study)
    if collected_digest(path) == digest:
        return recorded(path), False, []
    # figures and report belong to one dataset: without a report they are drawn again
    (prepared.folder / REPORT_FILE).unlink(missing_ok=True)
    store, scene_of = prepared.store, prepared.scene_of
    judged, damaged = collect(study, plan, store, scene_of, verdicts, path, digest)
    return verdicts if damaged else judged, True, damaged


def _digest(prepared: Project, verdicts: list[Verdict]) -> str:
    """What a dataset of these products and verdicts is made from, as a hash."""
    study = prepared.study
    made = f"{COLLECTOR} {study.sha256} {study.smoke} {prepared.plan.digest()}"
    made_from = hashlib.sha256(made.encode())
    for ended in verdicts:
        made_from.update(f"{int(ended.status)} {ended.message}\n".encode())
    return made_from.hexdigest()
