"""Whichever cases of a study fail, its figures and its page come out, without a traceback.

Studies of six kinds (wells, build-ups, comparisons with formulas, tests to failure, solvers
against each other), each with random patterns of failures: single survivors, whole values of an
axis that fail, and any share of the cases. COUNT patterns, from SEED.
"""

from __future__ import annotations

import os
import tempfile
import traceback
import warnings
from collections.abc import Mapping
from pathlib import Path
from unittest import mock

import numpy as np

import demflow.sweep.figures as figures
from demflow.sweep.figures import style, write_figures
from demflow.sweep.report import write_report
from tests.benchmarks.result import Result
from tests.sweep import test_failed_patterns as patterns
from tests.sweep.invented import invented_dataset, invented_maps, study_of

SEED, COUNT = 1, int(os.environ.get("PATTERNS", "400"))


def run() -> Result:
    """Draw every pattern, and count those that end in an error."""
    chance = np.random.default_rng(SEED)
    kinds = [_Kind(name) for name in patterns.TEXTS]
    failed: dict[str, int] = {}
    drawn = 0
    with mock.patch.object(style, "DPI", 20), warnings.catch_warnings():
        warnings.simplefilter("error")
        for number in range(COUNT):
            kind = kinds[number % len(kinds)]
            good = random_pattern(kind.study.shape, chance)
            try:
                drawn += kind.draw(good, chance)
            except Exception:
                last = traceback.format_exc().strip().splitlines()[-1]
                failed[f"{kind.name}: {last}"] = failed.get(f"{kind.name}: {last}", 0) + 1
    lines = [f"{COUNT} patterns of failures in studies of {len(kinds)} kinds, {drawn} figures"]
    lines += [f"{count} times {what}" for what, count in failed.items()]
    bad = sum(failed.values())
    return Result(f"{bad} of {COUNT} end in a traceback", "0", bad == 0, "\n".join(lines))


def random_pattern(shape: tuple[int, ...], chance: np.random.Generator) -> np.ndarray:
    """Which cases are good, (axes) bool."""
    good = chance.random(shape) < chance.random()
    match chance.integers(4):
        case 0:  # one survivor, or none
            good = np.zeros(shape, dtype=bool)
            good.flat[chance.integers(good.size)] = chance.random() < 0.9
        case 1:  # a value of an axis fails
            good[:] = True
            axis = int(chance.integers(len(shape)))
            at: list[slice | int] = [slice(None)] * len(shape)
            at[axis] = int(chance.integers(shape[axis]))
            good[tuple(at)] = False
    return good


class _Kind:
    """A study of one kind, with results made by hand."""

    def __init__(self, name: str):
        self.name, self.folder = name, Path(tempfile.mkdtemp(prefix="demflow-bench-"))
        self.study = study_of(patterns.TEXTS[name], self.folder)
        if name == "specimens":
            self.whole = patterns.specimens(self.study)
        else:
            self.whole = invented_dataset(self.study)
        if name == "speed":
            self.whole["solver_time"] = self.whole["time_error"] * 1e5

    def _case_of(self, folder: Path, at: Mapping[str, object], **_: object) -> object:
        if self.name == "specimens":
            return patterns.record_of_a_test()
        index = tuple(
            int(np.flatnonzero(self.whole[axis.name].values == at[axis.name])[0])
            for axis in self.study.axes
        )
        return invented_maps(self.study, index, 6.0)

    def draw(self, good: np.ndarray, chance: np.random.Generator) -> int:
        """Draw a pattern and write its page; the number of figures."""
        dataset = patterns.with_failures(self.whole, good, chance)
        with (
            mock.patch.object(figures, "case_of", self._case_of),
            mock.patch.object(
                figures, "case_at", patterns.shut_in if self.name == "build_up" else figures.case_at
            ),
        ):
            found = write_figures(dataset, self.folder, self.study)
        write_report(dataset, self.folder, self.study, found.paths)
        if bool(found.paths) != bool(good.any()):
            raise AssertionError(f"{len(found.paths)} figures of {good.sum()} good cases")
        return len(found.paths)
