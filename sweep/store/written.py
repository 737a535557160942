"""Files that a program writes into a folder which its user writes into too.

A list beside them, `SHA256SUMS` as `sha256sum --check` reads it, tells which files are ours: those
that it names and whose content is still what was written. Only these are ever removed or replaced,
and nothing is done through a link. What is the user's and in the way of a new file is renamed.
"""

from __future__ import annotations

import hashlib
import itertools
import os
import re
import stat
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path

from demflow.sweep.store.durable import naming, write_durably
from demflow.sweep.store.products import StoreError

LIST = "SHA256SUMS"
_LINE = re.compile(r"([0-9a-f]{64})  ([^/\0\n]+)")


def listed(folder: Path) -> dict[str, set[str]]:
    """Names of the files that were written into a folder, in their order, and their hashes.

    A file has two hashes where a run was ended while it replaced the file.
    """
    found: dict[str, set[str]] = {}
    if not folder.is_symlink() and _is_file(folder / LIST):
        text = (folder / LIST).read_text(encoding="utf-8", errors="replace")
        for line in map(_LINE.fullmatch, text.splitlines()):
            if line and line[2] not in (LIST, ".", ".."):
                found.setdefault(line[2], set()).add(line[1])
    return found


def ours(folder: Path) -> list[Path]:
    """The files of the list that are there as they were written."""
    return [
        folder / name for name, known in listed(folder).items() if _hash(folder / name) in known
    ]


def is_whole(folder: Path) -> bool:
    """Whether there is a list, and every file of it as it was written."""
    return _is_file(folder / LIST) and len(ours(folder)) == len(listed(folder))


def check_folder(folder: Path) -> None:
    """Raise StoreError where a folder to write into is a link or a file."""
    if folder.is_symlink():
        raise StoreError(f"{folder} is a link, through which nothing is written; remove it")
    if folder.exists() and not folder.is_dir():
        raise StoreError(f"{folder} is no folder; rename it")


def replace_files(folder: Path, made: Mapping[str, Path]) -> list[str]:
    """Put new files into a folder in place of those of its list.

    Parameters
    ----------
    folder : is made where it is missing.
    made : where each new file lies now, in the same file system, by its name in the folder.

    Returns
    -------
    What was the user's own and is kept under another name, in words. Raises StoreError where the
    folder is a link, OSError.
    """
    check_folder(folder)
    with naming(folder):
        folder.mkdir(parents=True, exist_ok=True)
        before = listed(folder)
        new = {name: _hash(path) or "" for name, path in made.items()}
        moved: list[str] = []
        # what is there under both lists is known as ours whenever this ends
        old = [(name, sha256) for name, known in before.items() for sha256 in sorted(known)]
        _write_list(folder, [*old, *new.items()])
        for path in ours(folder):
            if path.name not in made:
                path.unlink()
        for name, path in made.items():
            target = folder / name
            if os.path.lexists(target) and _hash(target) not in {*before.get(name, ()), new[name]}:
                kept = _free_name(target)
                target.rename(kept)
                moved.append(f"{target} was not written by demflow; it is kept as {kept.name}")
            path.replace(target)
        _write_list(folder, new.items())
    return moved


def _write_list(folder: Path, lines: Iterable[tuple[str, str]]) -> None:
    path = folder / LIST
    if path.is_symlink():
        path.rename(_free_name(path))
    write_durably(path, "".join(f"{sha256}  {name}\n" for name, sha256 in lines).encode())


def _free_name(path: Path) -> Path:
    """A name beside a file that nothing has yet."""
    names = (path.with_name(f"{path.name}.kept{k or ''}") for k in itertools.count())
    return next(name for name in names if not os.path.lexists(name))


def _is_file(path: Path) -> bool:
    with suppress(OSError):
        return stat.S_ISREG(path.lstat().st_mode)
    return False


def _hash(path: Path) -> str | None:
    """SHA-256 of a regular file, None of anything else."""
    if not _is_file(path):
        return None
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
