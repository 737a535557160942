"""One offline page about a study: what was varied, what came out, how far to trust it."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from string import Template

import xarray as xr

from demflow.sweep.report.html import escape
from demflow.sweep.report.promises import promises
from demflow.sweep.report.sections import axes_table, figures, key_numbers, outcome, provenance
from demflow.sweep.report.size_effect import size_section
from demflow.sweep.store.durable import write_durably
from demflow.sweep.study.load import Study

__all__ = ["write_report"]


def write_report(
    dataset: xr.Dataset, results_dir: Path, study: Study, figure_paths: Sequence[Path]
) -> Path:
    """Write `results_dir/report.html`, which needs no other file and no network.

    Parameters
    ----------
    dataset : the study's dataset.
    results_dir : the study's folder.
    study : the study, for its title, axes and text.
    figure_paths : PNG files from `sweep.figures.write_figures`, in the order of the page;
        the CSV files beside them (`NAME_*.csv`) become tables.

    Returns
    -------
    Path of the page.
    """
    package = files("demflow.sweep.report")
    page = Template((package / "page.html").read_text(encoding="utf-8")).substitute(
        style=(package / "page.css").read_text(encoding="utf-8"),
        title=escape(study.title),
        name=escape(study.name),
        outcome=outcome(dataset),
        promises=promises(dataset, study),
        size=size_section(dataset, study),
        axes=axes_table(dataset, study),
        numbers=key_numbers(dataset),
        figures=figures(figure_paths),
        provenance=provenance(dataset),
        study_text=escape(study.text),
    )
    path = Path(results_dir) / "report.html"
    write_durably(path, page.encode())
    return path
