"""What keeps a results folder sound and small: re-hashing it, and freeing what nobody needs."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path

from demflow.sweep.dataset import DATASET_FILE, STUDY_FILE
from demflow.sweep.dataset.file import attribute, dataset_problem
from demflow.sweep.dataset.folder import UNFINISHED_FILE
from demflow.sweep.plan.table import MODEL, stage_table
from demflow.sweep.prepared import planned
from demflow.sweep.store.lock import FolderLock
from demflow.sweep.store.origins import as_made, sources_told, with_origins
from demflow.sweep.store.products import Store, StoreError, put_aside
from demflow.sweep.study.load import load_study


@dataclass(frozen=True)
class Verified:
    """What re-hashing a results folder found."""

    checked: int  # files
    damaged: list[tuple[Path, str]]
    set_aside: bool  # whether the damaged ones were; not in a folder that cannot be written


@dataclass(frozen=True)
class Unwanted:
    """Files that no study of a results folder refers to."""

    files: list[Path]
    bytes: int


def verify(results: str | Path) -> Verified:
    """Re-hash every file of the store of a results folder, and every dataset in it.

    `results` is the folder of all results; one study's folder in it stands for it too. Raises
    StoreError where no store is there, LockedError while a run goes on.
    """
    root = _root(results)
    store = _store(root)
    writable = os.access(root, os.W_OK)
    checked, damaged = 0, []
    with FolderLock(root, "demflow verify") if writable else nullcontext():
        for path, problem in itertools.chain(
            store.verify(set_aside=writable), _verify_datasets(root, set_aside=writable)
        ):
            checked += 1
            if problem is not None:
                damaged.append((path, problem))
    return Verified(checked, damaged, writable)


def _verify_datasets(root: Path, *, set_aside: bool) -> Iterator[tuple[Path, str | None]]:
    for path in sorted(root.glob(f"*/{DATASET_FILE}")):
        try:
            problem = dataset_problem(path)
        except OSError as error:
            yield path, f"it cannot be read: {error.strerror or error}"
            continue
        if problem and set_aside:
            put_aside(path)
        yield path, problem


def unwanted(results: str | Path, *, table: str = MODEL) -> Unwanted:
    """Find what no study of a results folder refers to, and what was set aside as damaged.

    A study refers to the products of all its cases, with its smoke block and without, also
    before its first dataset was collected. Raises StoreError where no store is there,
    StudyError where a study of the folder cannot be read: then nothing can be freed. One study's
    folder stands for that of all, as for `verify`.
    """
    root = _root(results)
    store = _store(root)
    wanted: set[str] = set()
    stages = stage_table(table)
    now = with_origins(stages, store)
    for name in (STUDY_FILE, UNFINISHED_FILE):
        for path in sorted(root.glob(f"*/{name}")):
            made = attribute(path.with_name(DATASET_FILE), "stage_sources") or ""
            for smoke in (False, True):
                study = load_study(path, smoke=smoke)
                # what the dataset is made of, and what the next run takes, be the sources others
                for by in {sources_told(s): s for s in (now, as_made(stages, made))}.values():
                    wanted.update(run.id for run in planned(study, by).runs)
    files = [*store.unwanted(wanted), *sorted(root.glob(f"*/{DATASET_FILE}.damaged"))]
    sizes: dict[Path, int] = {}
    for path in files:
        with suppress(FileNotFoundError):  # what a run wrote aside has its name by now
            sizes[path] = path.stat().st_size
    return Unwanted(list(sizes), sum(sizes.values()))


def free(results: str | Path) -> Unwanted:
    """Remove what `unwanted` finds, while no run goes on. Raises as it does, and LockedError."""
    with FolderLock(_root(results), "demflow clean"):
        found = unwanted(results)
        for path in found.files:
            path.unlink(missing_ok=True)
    return found


def _root(results: str | Path) -> Path:
    """The folder of all results, be it given itself or one study's folder in it."""
    root = Path(results)
    in_it = any((root / name).is_file() for name in (STUDY_FILE, UNFINISHED_FILE, DATASET_FILE))
    return root.resolve().parent if in_it and not _has_store(root) else root


def _has_store(root: Path) -> bool:
    return (root / "store" / "FORMAT").is_file()


def _store(root: Path) -> Store:
    if not _has_store(root):
        raise StoreError(f"{root} is no results folder: there is no store in it")
    return Store.open(root / "store", create=False)
