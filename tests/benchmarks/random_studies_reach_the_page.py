"""Random valid studies run to their page, whichever of their cases fail.

Shipped studies, of a few dozen grains, a time per decade and two values an axis, in which a few
numbers are changed at random by up to three times, as far as they stay valid. Each is run as a
user would, but that its stages run in this very process, and fails where it must. Then random
patterns of its cases are taken for failed, and its figures and page drawn anew from what is left.
STUDIES of them from FIRST on, every EVERY-th with PATTERNS patterns, from SEED.
"""

from __future__ import annotations

import copy
import math
import os
import random
import shutil
import signal
import tempfile
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any
from unittest import mock

import numpy as np
import xarray as xr
import yaml

from demflow import sweep
from demflow.model.outcome import Status
from demflow.sweep.execution import loop
from demflow.sweep.execution.ledger import Executed, Ledger
from demflow.sweep.execution.limits import Verdict
from demflow.sweep.execution.lots import Lots
from demflow.sweep.execution.pool import Pool
from demflow.sweep.execution.schedule import FAILED, Schedule
from demflow.sweep.execution.worker import run_lot
from demflow.sweep.figures import style, write_figures
from demflow.sweep.report import write_report
from demflow.sweep.store.products import Store
from demflow.sweep.study.load import Limits, Study, StudyError
from tests.benchmarks.every_failure_reaches_the_page import random_pattern
from tests.benchmarks.ran import STUDIES
from tests.benchmarks.result import Result
from tests.sweep.damaged_studies import numbers_of
from tests.sweep.test_failed_patterns import with_failures

if TYPE_CHECKING:
    from demflow.model.scene import Scene

SEED, FIRST = int(os.environ.get("SEED", "1")), int(os.environ.get("FIRST", "0"))
COUNT = int(os.environ.get("STUDIES", "2000"))
PATTERNS, EVERY = int(os.environ.get("PATTERNS", "3")), int(os.environ.get("EVERY", "5"))
MOST_CASES, TRIES = 6, 60
LONGEST = 3.0  # s of processor time of a stage run


def few(block: Any) -> None:
    """Two values of an axis, or of its ranges (in place)."""
    if isinstance(block, dict):
        for key, value in block.items():
            if key in ("values", "count") and value:
                block[key] = value[:2] if isinstance(value, list) else "2"
            else:
                few(value)


def random_study(number: int, folder: Path) -> Path:
    """Write a random valid study of few cases."""
    chance = random.Random(f"{SEED}/{number}")
    shipped = sorted(STUDIES.glob("*.yaml"))
    path = folder / "study.yaml"
    for _ in range(TRIES):
        tree = yaml.load(chance.choice(shipped).read_text(), Loader=yaml.BaseLoader)
        tree["study"] = f"random_{number}"
        tree.setdefault("smoke", {})["grains.count"] = chance.choice(("40", "60", "90"))
        if isinstance(tree["scene"].get("times"), dict):
            tree["scene"]["times"]["per_decade"] = "1"
        few(tree.get("vary"))
        changed = copy.deepcopy(tree)
        spots = [*numbers_of({key: changed[key] for key in ("scene", "vary") if key in changed})]
        for inside, key in chance.sample(spots, min(len(spots), chance.choice((1, 2, 4)))):
            first, _, unit = inside[key].partition(" ")
            factor = math.exp(chance.uniform(-1.0, 1.0) * math.log(3.0))
            whole = first.lstrip("-").isdigit() and not unit
            try:
                value = round(int(first) * factor) if whole else float(first) * factor
            except ValueError:
                continue
            inside[key] = f"{value:.6g} {unit}".strip()
        path.write_text(yaml.safe_dump(changed, sort_keys=False))
        try:
            study = sweep.load_study(path, smoke=True)
        except StudyError:
            continue
        if math.prod(study.shape) <= MOST_CASES:
            return path
    raise AssertionError(f"no valid study of {TRIES}")


class TooLongError(BaseException):
    """A stage run takes too long; no stage may take this for an error of its own."""


def too_long(_number: int, _frame: FrameType | None) -> None:
    """What the alarm does."""
    raise TooLongError


def execute_here(
    schedule: Schedule,
    store: Store,
    scene_of: Callable[[int], Scene],
    *,
    table: str,
    limits: Limits,
    anew: bool,
    **_elsewhere: object,
) -> Executed:
    """What `sweep.execution.loop.execute` does, without Dask and workers."""
    ledger = Ledger(schedule, store, limits, anew=anew)
    lots = Lots(schedule.plan, store, scene_of, table, mock.Mock(spec=Pool, shares_store=True))
    while runs := schedule.next_lot():
        for run in runs:  # each by itself, so that it is known which one takes too long
            if schedule.state[run] >= FAILED:
                continue
            signal.setitimer(signal.ITIMER_PROF, LONGEST)
            try:
                for outcome in run_lot(lots.make((run,)), {}):
                    ledger.enter(outcome)
            except TooLongError:
                ledger.convict(run, Verdict(Status.TIMED_OUT, f"not done after {LONGEST:g} s"))
            finally:
                signal.setitimer(signal.ITIMER_PROF, 0.0)
    return ledger.report


def failing(dataset: xr.Dataset, study: Study, good: np.ndarray, seed: int) -> xr.Dataset:
    """A dataset in which all but some of its good cases failed."""
    good = good & (dataset["status"].values == 0)
    left = with_failures(dataset, good, np.random.default_rng(seed))
    axes = tuple(axis.name for axis in study.axes)
    for variable in left.data_vars.values():
        if variable.dtype.kind == "f" and axes and variable.dims[: len(axes)] == axes:
            variable.values[~good] = np.nan
    return left


def run() -> Result:
    """Run every study, and draw patterns of failures of it."""
    faults: Counter[str] = Counter()
    pages, cases, failed, unsaid = 0, 0, 0, 0
    chance = np.random.default_rng(SEED)
    home = Path(tempfile.mkdtemp(prefix="demflow-bench-"))
    (home / "maps").symlink_to(STUDIES / "maps")
    signal.signal(signal.SIGPROF, too_long)
    with (
        mock.patch.object(loop, "execute", execute_here),
        mock.patch.object(style, "DPI", 20),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("ignore")
        for number in range(FIRST, FIRST + COUNT):
            path = random_study(number, home)
            what = f"study {number}"
            try:
                dataset = sweep.run(path, smoke=True, results=home / "results")
                study = sweep.load_study(path, smoke=True)
                pages += 1
                cases += dataset["status"].size
                failed += int((dataset["status"] != 0).sum())
                folder = home / "results" / study.name
                for k in range(0 if number % EVERY else PATTERNS):
                    what = f"study {number}, pattern {k}"
                    good = random_pattern(study.shape, chance) if study.shape else np.array(False)
                    left = failing(dataset, study, good, k)
                    found = write_figures(left, folder, study)
                    write_report(left, folder, study, found.paths)
                    pages += 1
                    unsaid += len(found.messages)
                dataset.close()
            except Exception:
                told = traceback.format_exc().strip().splitlines()
                faults[f"{what}: {' / '.join(told[-3:])}"] += 1
                shutil.copy(path, home / f"fault_{number}.yaml")
            shutil.rmtree(home / "results", ignore_errors=True)
    told = f"{cases} cases of which {failed} failed, {unsaid} pictures left out in words"
    lines = [f"{COUNT} studies, {told}, {pages} pages; in {home}"]
    lines += list(faults)[:40]
    bad = len(faults)
    if not bad:
        shutil.rmtree(home)
        lines[0] = lines[0].partition("; in")[0]
    return Result(
        f"{bad} of {pages} pages of {COUNT} studies end in a traceback",
        "0",
        bad == 0,
        "\n".join(lines),
    )
