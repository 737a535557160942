"""What each further case of a study takes, by another build and by this one."""

from __future__ import annotations

import statistics
from pathlib import Path
from typing import NamedTuple

import xarray as xr

from tests.benchmarks.ran import results_folder
from tests.benchmarks.sweeps import ROOT, timed_run


class Further(NamedTuple):
    """A study of many cases, and one of the first of them alone, by one build."""

    cases: int
    single: float  # s of processor, of all processes, without figures
    many: float
    computed: int  # stage runs of many
    stored: float  # MB that its products take
    tensors: xr.DataArray  # the permeabilities of many
    off: float  # how far that of the first is from what it is alone, relative

    @property
    def each(self) -> float:
        """What a further case takes, s of processor."""
        return (self.many - self.single) / (self.cases - 1)

    def line(self, build: str) -> str:
        """All of it in words."""
        return (
            f"{build}: {self.many:.1f} s of processor, {self.computed} stage runs, "
            f"{self.stored:.0f} MB; a single case {self.single:.1f} s, each further one "
            f"{1e3 * self.each:.1f} ms"
        )


def further_cases(name: str, single: str, many: str, base: Path, rounds: int) -> dict[str, Further]:
    """Run two studies, named `single` and `many`, by both builds in turns, on two workers.

    Medians of the rounds after a first one, which compiles.

    Parameters
    ----------
    name : of the folder for the results
    single, many : their texts
    base : folder of the other build
    rounds : after the first one
    """
    folder = results_folder() / name
    folder.mkdir()
    found = {}
    laps: dict[tuple[str, str], list[float]] = {}
    for lap in range(rounds + 1):
        for study, text in (("single", single), ("many", many)):
            path = folder / f"{study}.yaml"
            path.write_text(text)
            for build, root in (("other", base), ("own", ROOT)):
                results = folder / f"{build}_{study}_{lap}"
                done = timed_run(path, results, root=root, workers=2)
                laps.setdefault((build, study), []).append(done.cpu)
                stored = sum(p.stat().st_size for p in results.rglob("*.product"))
                with xr.open_dataset(results / study / "dataset.nc") as dataset:
                    found[build, study] = done.computed, stored, dataset.permeability.load()
    took = {which: statistics.median(each[1:]) for which, each in laps.items()}
    told = {}
    for build in ("other", "own"):
        computed, stored, tensors = found[build, "many"]
        alone = found[build, "single"][2].values.ravel()
        off = abs(tensors.values.ravel()[: alone.size] - alone).max() / abs(alone).max()
        spent = took[build, "single"], took[build, "many"]
        cases = tensors.size // alone.size
        told[build] = Further(cases, *spent, computed, 1e-6 * stored, tensors, float(off))
    return told
