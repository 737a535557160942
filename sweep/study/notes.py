"""What the author of a study says about it: a text in Markdown for the report."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from demflow.model.parameters import parameter
from demflow.sweep.study.blocks import block_of
from demflow.sweep.study.map_files import MapError
from demflow.sweep.study.scene import contents
from demflow.sweep.study.sections import NoParameter, Parameter, Reading, Section
from demflow.sweep.study.yaml_source import Node, Scalar

LONGEST = 200_000  # bytes


@dataclass(frozen=True)
class Report:
    """What the report holds beside its own."""

    notes: str = parameter(default="", help="file in Markdown that the report begins with")


@dataclass(frozen=True)
class TextFile(Section):
    """A file with text, its name relative to the study; or a kept copy beside the study."""

    declared: dataclasses.Field[Any]

    def read(self, node: Node, path: str, reading: Reading) -> Any:
        """The text."""
        try:
            if not isinstance(node, Scalar):
                raise MapError(["a file is named by its path relative to the study"])
            (content,) = contents(node.text, reading).values()
            if len(content) > LONGEST:
                raise MapError([f"it is longer than {LONGEST // 1000} kB"])
            return content.decode("utf-8")
        except (MapError, OSError, UnicodeDecodeError) as error:
            found = error.problems if isinstance(error, MapError) else [str(error)]
            named = node.text if isinstance(node, Scalar) else "this"
            for what in found:
                reading.report(node.place, f"{path}: {named}: {what}", path)
            return ""

    def find(self, values: Any, parts: tuple[str, ...]) -> Parameter:
        """Never: notes are of the study."""
        raise NoParameter

    def stand_in(self) -> str:
        """No text."""
        return ""


REPORT = block_of(Report, {"notes": TextFile(dataclasses.fields(Report)[0])})
