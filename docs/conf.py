"""How the pages are built: `make docs`, without any request to elsewhere."""

from __future__ import annotations

import importlib.metadata
import re
from pathlib import Path
from typing import Any

project = "demflow"
author = "the demflow developers"
release = importlib.metadata.version("demflow")

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_heading_anchors = 3
html_theme = "furo"
html_title = "demflow"
html_show_sourcelink = False
html_copy_source = False

autodoc_member_order = "bysource"
autodoc_typehints = "none"
napoleon_google_docstring = False
exclude_patterns = ["images/*.py"]


def _put_contributing(_app: Any, name: str, source: list[str]) -> None:
    """Show CONTRIBUTING.md as a page; its links to files of the repository are names here."""
    if name == "extending":
        text = (Path(__file__).parents[1] / "CONTRIBUTING.md").read_text(encoding="utf-8")
        text = re.sub(r"\[([^\]]+)\]\((?!https?:)[^)]+\)", r"\1", text)
        source[0] += text.partition("\n")[2]


def setup(app: Any) -> None:
    """Called by Sphinx."""
    app.connect("source-read", _put_contributing)
