"""One offline page about a study: what was varied, what came out, how far to trust it."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import jinja2
import xarray as xr
from markdown_it import MarkdownIt
from markupsafe import Markup

from demflow.sweep.analysis.compare import MapsOf
from demflow.sweep.figures import maps_reader, representative_cases
from demflow.sweep.report.carried import MOST_CASES, carried, cases_with_maps
from demflow.sweep.report.html import escape, visible
from demflow.sweep.report.promises import promises
from demflow.sweep.report.sections import axes_table, figures, key_numbers, outcome, provenance
from demflow.sweep.report.size_effect import size_section
from demflow.sweep.store.durable import write_durably
from demflow.sweep.study.load import Study

__all__ = ["write_report"]

# uPlot formats numbers in the browser's language when it is loaded, and a browser that runs in the
# C locale names one that no browser knows
_LANGUAGE = """\
try { new Intl.NumberFormat(navigator.language); }
catch { Object.defineProperty(navigator, "language", { value: "en" }); }
"""


def write_report(
    dataset: xr.Dataset,
    results_dir: Path,
    study: Study,
    figure_paths: Sequence[Path],
    maps_of: MapsOf | None = None,
) -> Path:
    """Write `results_dir/report.html`, which needs no network, and no file but its pictures.

    Parameters
    ----------
    dataset : the study's dataset.
    results_dir : the study's folder.
    study : the study, for its title, axes and text.
    figure_paths : PNG files from `sweep.figures.write_figures`, in the order of the page, which
        shows them from where they lie; the CSV files beside them (`NAME_*.csv`) become tables.
    maps_of : reads the maps of a case, where others read them too.

    Returns
    -------
    Path of the page.
    """
    folder = Path(results_dir)
    path = folder / "report.html"
    data = _data(dataset, study, maps_of or maps_reader(dataset, folder, study))
    script = _LANGUAGE + _text("vendor/uPlot.iife.min.js") + "\n" + _text("page.js")
    page = _template().render(
        policy=_policy(script),
        style=Markup(_text("vendor/uPlot.min.css") + _text("page.css")),
        title=Markup(escape(study.title)),
        name=visible(study.name),
        notes=Markup(_notes(study.report.notes)),
        outcome=Markup(outcome(dataset)),
        promises=Markup(promises(dataset, study)),
        size=Markup(size_section(dataset, study)),
        axes=Markup(axes_table(dataset, study)),
        numbers=Markup(key_numbers(dataset)),
        figures=Markup(figures(figure_paths, folder)),
        provenance=Markup(provenance(dataset)),
        study_text=visible(study.text),
        data=Markup(_json(data)) if data else "",
        many=dataset["status"].size > MOST_CASES,
        left_out=data["left_out"] if data else [],
        script=Markup(script),
    )
    write_durably(path, page.encode())
    return path


def _data(dataset: xr.Dataset, study: Study, maps_of: MapsOf) -> Any:
    """What the page carries to answer questions."""
    if not (dataset["status"].values == 0).any():
        return None
    return carried(dataset, study, cases_with_maps(dataset, representative_cases(dataset)), maps_of)


def _notes(text: str) -> str:
    """A text in Markdown as HTML: no HTML of its own, no picture from elsewhere."""
    rules = MarkdownIt("commonmark", {"html": False}).enable("table").disable("image")
    return rules.render(visible(text)) if text.strip() else ""


def _json(data: Any) -> str:
    """JSON inside a page: no text of it can end the element that it stands in."""
    text = json.dumps(data, allow_nan=False, ensure_ascii=True, separators=(",", ":"))
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def _policy(script: str) -> str:
    """What the page may do: run its own script, by its hash, and show pictures beside it."""
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
    return (
        f"default-src 'none'; script-src 'sha256-{digest}'; style-src 'unsafe-inline'; "
        "img-src 'self' file: data: blob:; base-uri 'none'; form-action 'none'"
    )


@cache
def _text(name: str) -> str:
    return files("demflow.sweep.report").joinpath(name).read_text(encoding="utf-8")


@cache
def _template() -> jinja2.Template:
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.from_string(_text("page.html"))
