"""How the pages are built: `make docs`, without any request to elsewhere."""

from __future__ import annotations

import importlib.metadata

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
