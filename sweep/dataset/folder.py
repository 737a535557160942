"""The folder of a study's results: whose it is, and what runs keep in it beside the dataset."""

from __future__ import annotations

import re
import shutil
from contextlib import suppress
from pathlib import Path

from demflow.sweep.dataset import DATASET_FILE, STUDY_FILE
from demflow.sweep.store.durable import write_durably
from demflow.sweep.store.products import StoreError
from demflow.sweep.store.written import check_folder
from demflow.sweep.study.load import Study
from demflow.sweep.study.sections import KEPT

REPORT_FILE, FIGURES = "report.html", "figures"
FITS = "fit"  # folder of what `demflow fit` finds
UNFINISHED_FILE = "unfinished.yaml"  # the study of a run that has not collected yet
SOURCE_FILE = "study.path"  # where the study's own file lies
MARKS = {f"{DATASET_FILE}.sha256", UNFINISHED_FILE, SOURCE_FILE}  # nobody else has such files
OWN = {STUDY_FILE, DATASET_FILE, REPORT_FILE, FIGURES, FITS, KEPT} | MARKS


def check_free(folder: Path, study: Study) -> None:
    """Raise StoreError where a run of a study would take the folder from something else.

    That is: files that are no results, results of another file whose study has the same name,
    or, for a run with its smoke block, the dataset of the study itself.
    """
    check_folder(folder)
    check_folder(folder / FIGURES)
    if not folder.exists():
        return
    names = {path.name for path in folder.iterdir() if not path.name.startswith(".")}
    if not names & MARKS:
        strange = sorted(name for name in names if not is_own(name))
        if STUDY_FILE in names and not _is_of(folder / STUDY_FILE, study.name):
            strange.append(STUDY_FILE)
        if strange:
            raise StoreError(
                f"{folder} holds files that are no results of demflow ({', '.join(strange[:3])}); "
                "rename the study, or take another --results folder"
            )
    other = _other_source(folder, study)
    if other is not None:
        raise StoreError(
            f"{folder} holds the results of {other}, another study of the name '{study.name}'; "
            f"rename one of them, take another --results folder, or remove {folder}"
        )
    if study.smoke and _is_whole(folder / DATASET_FILE):
        raise StoreError(
            f"{folder} holds the dataset of the whole study, which a run with the smoke block "
            "would replace; give that run a --results folder of its own"
        )


def _other_source(folder: Path, study: Study) -> Path | None:
    """Another file that the results come from, if it is still there and says something else."""
    with suppress(OSError, ValueError):
        source = Path((folder / SOURCE_FILE).read_text(encoding="utf-8").rstrip("\n"))
        mine = Path(study.path).resolve()
        if mine in (source, (folder / STUDY_FILE).resolve()) or not _is_of(source, study.name):
            return None
        return None if source.read_bytes() == study.text.encode() else source
    return None


def _is_whole(path: Path) -> bool:
    """Whether a dataset is there that was made without the smoke block."""
    # netCDF is imported only where it is needed
    from demflow.sweep.dataset.file import attribute

    return path.exists() and attribute(path, "study_smoke") == "no"


def keep_source(folder: Path, study: Study) -> None:
    """Note which file the results come from; a copy in the folder itself stands for that file."""
    mine = Path(study.path).resolve()
    if mine == (folder / STUDY_FILE).resolve():
        return
    path, content = folder / SOURCE_FILE, f"{mine}\n".encode()
    if not path.exists() or path.read_bytes() != content:
        write_durably(path, content)


def remove_partial(folder: Path) -> None:
    """Remove half files that interrupted or killed processes have left. Only under the lock."""
    for left in folder.glob("*.partial"):
        if is_own(left.name):
            if left.is_dir() and not left.is_symlink():
                shutil.rmtree(left, ignore_errors=True)
            with suppress(OSError):
                left.unlink()


def is_own(name: str) -> bool:
    """Whether a file of this name in a study's folder is one that runs make there."""
    whole = re.fullmatch(r"(.+?)(\.\d+)?\.partial|(.+?)\.damaged|(.+)", name, re.DOTALL)
    return whole is not None and next(p for p in whole.group(1, 3, 4) if p) in OWN


def _is_of(path: Path, study: str) -> bool:
    """Whether a file is a study of that name, of whatever version."""
    text = path.read_text(encoding="utf-8", errors="replace")
    return re.search(rf"^study:\s*[\"']?{re.escape(study)}[\"']?\s*(#|$)", text, re.M) is not None
