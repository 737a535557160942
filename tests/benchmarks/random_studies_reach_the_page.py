"""Random valid studies run to their page, whichever of their cases fail.

Shipped studies, of a few dozen grains and a time per decade, in which a few numbers are changed at
random by up to three times, as far as they stay valid. Each is run as a user would, on workers that
stay, and fails where it must; then random patterns of its cases are taken for failed, and its
figures and page drawn anew from what is left. STUDIES of them, each with PATTERNS patterns, from
SEED.
"""

from __future__ import annotations

import copy
import math
import os
import random
import shutil
import tempfile
import traceback
import warnings
from collections import Counter
from pathlib import Path
from unittest import mock

import numpy as np
import xarray as xr
import yaml
from distributed import LocalCluster

from demflow import sweep
from demflow.sweep.figures import style, write_figures
from demflow.sweep.report import write_report
from demflow.sweep.study.load import Study, StudyError
from tests.benchmarks.every_failure_reaches_the_page import random_pattern
from tests.benchmarks.ran import STUDIES
from tests.benchmarks.result import Result
from tests.sweep.damaged_studies import numbers_of
from tests.sweep.test_failed_patterns import with_failures

SEED = int(os.environ.get("SEED", "1"))
COUNT = int(os.environ.get("STUDIES", "2000"))
PATTERNS = int(os.environ.get("PATTERNS", "7"))
MOST_CASES, TRIES = 12, 30


def random_study(number: int, folder: Path) -> Path:
    """Write a random valid study of few cases."""
    chance = random.Random(f"{SEED}/{number}")
    shipped = sorted(STUDIES.glob("*.yaml"))
    path = folder / "study.yaml"
    for _ in range(TRIES):
        tree = yaml.load(chance.choice(shipped).read_text(), Loader=yaml.BaseLoader)
        tree["study"] = f"random_{number}"
        tree.setdefault("limits", {})["time"] = "60 s"
        tree.setdefault("smoke", {})["grains.count"] = chance.choice(("50", "90", "150"))
        if isinstance(tree["scene"].get("times"), dict):
            tree["scene"]["times"]["per_decade"] = "1"
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
    """Run every study, and draw every pattern of failures of it."""
    faults: Counter[str] = Counter()
    pages, cases, failed, unsaid = 0, 0, 0, 0
    chance = np.random.default_rng(SEED)
    home = Path(tempfile.mkdtemp(prefix="demflow-bench-"))
    (home / "maps").symlink_to(STUDIES / "maps")
    with (
        LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as workers,
        mock.patch.object(style, "DPI", 20),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("ignore")
        for number in range(COUNT):
            path = random_study(number, home)
            what = f"study {number}"
            try:
                where = {"scheduler": workers.scheduler_address, "results": home / "results"}
                dataset = sweep.run(path, smoke=True, **where)
                study = sweep.load_study(path, smoke=True)
                pages += 1
                cases += dataset["status"].size
                failed += int((dataset["status"] != 0).sum())
                folder = home / "results" / study.name
                for k in range(PATTERNS):
                    what = f"study {number}, pattern {k}"
                    good = random_pattern(study.shape, chance) if study.shape else np.array(False)
                    left = failing(dataset, study, good, k)
                    found = write_figures(left, folder, study)
                    write_report(left, folder, study, found.paths)
                    pages += 1
                    unsaid += len(found.messages)
            except Exception:
                told = traceback.format_exc().strip().splitlines()
                faults[f"{what}: {' / '.join(told[-3:])}"] += 1
                shutil.copy(path, home / f"fault_{number}.yaml")
    told = f"{cases} cases of which {failed} failed, {unsaid} pictures left out in words"
    lines = [f"{COUNT} studies, {told}, {pages} pages; in {home}"]
    lines += list(faults)[:40]
    bad = len(faults)
    if not bad:
        shutil.rmtree(home)
        lines[0] = lines[0].partition("; in")[0]
    return Result(f"{bad} of {pages} pages end in a traceback", "0", bad == 0, "\n".join(lines))
