"""Products of cases → the labelled dataset, one netCDF-4 file with CF metadata.

The file is filled tile by tile, a few thousand cases at a time, so that memory does not grow
with their number. It is written aside and renamed. A case without a product is NaN and has its
status and its message. All of it follows from the study but `compute_time` and `stage_time`,
which were measured: they alone differ between two runs that both start from nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import netCDF4

from demflow.model.outcome import Status
from demflow.model.scene import Scene
from demflow.sweep.dataset.file import make_dataset
from demflow.sweep.dataset.labels import labels_of
from demflow.sweep.dataset.source import Source
from demflow.sweep.dataset.tiles import tiles
from demflow.sweep.dataset.verdict import Verdict
from demflow.sweep.dataset.writer import Writer
from demflow.sweep.plan.graph import Plan
from demflow.sweep.store.products import Store
from demflow.sweep.study.load import Study

TILE_CASES = 2048  # cases that are held in memory at once
TILE_BYTES = 16_000_000  # or fewer, if their numbers are many


def collect(
    study: Study,
    plan: Plan,
    store: Store,
    scene_of: Callable[[int], Scene],
    verdicts: Sequence[Verdict],
    path: Path,
    digest: str,
) -> tuple[list[Verdict], list[str]]:
    """Write the dataset of a study.

    Parameters
    ----------
    study, plan, store : what was asked, what that means, and what is there.
    scene_of : the scene of a case by its index in the plan.
    verdicts : how each case ended, (cases,).
    path : the netCDF file to write.
    digest : what the dataset was made from (see `sweep.dataset.file.collected_digest`).

    Returns
    -------
    How each case ended by its numbers too, and messages about products that are damaged. They were
    set aside, nothing was written then: run again.
    """
    judged: list[Verdict] = []
    source = Source(plan, store)
    each = _bytes_of_a_case(plan, store, verdicts)

    def fill(file: netCDF4.Dataset) -> bool:
        writer = Writer(file, study, labels_of(plan, scene_of), source.stages)
        for tile in tiles(study.shape, max(1, min(TILE_CASES, TILE_BYTES // each))):
            writer.begin(tile)
            for case in tile.cases:
                if verdicts[case].status in (Status.DONE, Status.STOPPED):
                    writer.add(case, source.result(case))
                judged.append(writer.end_case(case, verdicts[case], source.spent(case)))
            writer.flush()
        writer.summarise()
        writer.describe(plan, digest, source.origins)
        return not source.damaged

    make_dataset(path, fill)
    return judged, source.damaged


def _bytes_of_a_case(plan: Plan, store: Store, verdicts: Sequence[Verdict]) -> int:
    """About the bytes of one case in the dataset: the size of the first product, or little."""
    for case, ended in enumerate(verdicts):
        if ended.status is Status.DONE:
            with suppress(FileNotFoundError):  # it is missed when it is read
                run, member = plan.result_of(case)
                size = store.path(plan.runs[run].id).stat().st_size
                return size if member < 0 else size // len(plan.runs[run].members)
    return 1000
