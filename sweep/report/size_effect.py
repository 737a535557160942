"""The section on how permeability settles with the size of the region, where a study varies it."""

from __future__ import annotations

import xarray as xr

from demflow.sweep.analysis.representative import TOLERANCE, size_effect
from demflow.sweep.report.html import escape, grid
from demflow.sweep.study.axes import Axis
from demflow.sweep.study.load import Study

SIZES = ("region.width", "region.radius")


def size_section(dataset: xr.Dataset, study: Study) -> str:
    """A table by size and a verdict; nothing unless a study varies size and seeds and no more."""
    sized = [axis for axis in study.axes if set(SIZES) & set(axis.parameters)]
    over = [axis.name for axis in study.axes if axis.seeds]
    if len(sized) != 1 or not over or len(study.axes) != 1 + len(over):
        return ""
    if "permeability" not in dataset:
        return ""
    size = _length(dataset, sized[0])
    found = size_effect(dataset["permeability"], size, over)
    rows = [
        (float(s), int(n), *(float(v) for pair in zip(m, d, strict=True) for v in pair))
        for s, n, m, d in zip(found.size, found.members, found.mean, found.spread, strict=True)
    ]
    head = ("size [m]", "realisations", "k_xx [m2]", "its spread", "k_yy [m2]", "its spread")
    if found.representative is None:
        verdict = "No size that was tried is representative"
    else:
        verdict = f"From {found.representative:.4g} m on the region is representative"
    rule = (
        f"{verdict}: at a representative size and at all larger ones, of which there must be one, "
        f"ln k spreads by no more than {TOLERANCE:g} between the realisations and its mean has "
        "moved by no more from that of the largest. k is the geometric mean, its spread the "
        "standard deviation of ln k."
    )
    table = grid(head, rows)
    return f"<section><h2>Size of the region</h2>\n<p>{escape(rule)}</p>{table}</section>"


def _length(dataset: xr.Dataset, axis: Axis) -> xr.DataArray:
    """The sizes along an axis, m."""
    if len(axis.parameters) == 1:
        return dataset[axis.name]
    k = next(k for k, path in enumerate(axis.parameters) if path in SIZES)
    return dataset[axis.labels[k]]
