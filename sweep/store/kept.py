"""The copy of a study beside its results, with the maps that it names: it stays readable."""

from __future__ import annotations

from pathlib import Path

from demflow.sweep.store.durable import write_durably
from demflow.sweep.study.load import Study


def keep_study(path: Path, study: Study) -> None:
    """Write a study to a path, and what it names into the folder `files` beside. Raises OSError."""
    named = [(name, file.content) for name, file in study.files.items()]
    for name, content in (*named, (path.name, study.text.encode())):
        copy = path.parent / name
        if not copy.exists() or copy.read_bytes() != content:
            copy.parent.mkdir(exist_ok=True)
            write_durably(copy, content)
