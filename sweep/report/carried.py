"""The numbers that the page carries, so that it can show any case without asking for anything.

Arrays travel as base64 of little-endian float64, bit by bit those of the dataset; maps are rounded
to one part in 65,535 of their range, which no eye tells. What would be too large or is gone is left
out, and `left_out` says so.
"""

from __future__ import annotations

import base64
from collections.abc import Callable
from typing import Any

import numpy as np
import xarray as xr

from demflow.model.outcome import Status
from demflow.model.scene import Scene
from demflow.sweep.analysis.cases import (
    Index,
    axes,
    axis_title,
    axis_value,
    display,
    done,
    with_unit,
)
from demflow.sweep.analysis.periods import period_starts
from demflow.sweep.errors import ResultsError
from demflow.sweep.figures.maps import map_times, polygons
from demflow.sweep.study.cases import case_at
from demflow.sweep.study.load import Study
from demflow.sweep.study.scenes import SceneBuilder

MOST_CASES = 5_000  # that the page can show one by one
MOST_BYTES = 6_000_000  # of one quantity over all cases
MOST_MAPPED = 4  # cases whose maps are carried
MOST_TIMES = 8  # of each map
MOST_PORES = 20_000  # of a map
LARGE = "(too large for this page; the dataset or `demflow.open_case` has them)"

# quantities in time and what they belong to, in the order of the choice
_HISTORIES = (
    "pressure_change",
    "pressure_derivative",
    "well_pressure",
    "well_rate",
    "boundary_flow",
    "probe_pressure",
)

MapsOf = Callable[[Index], xr.Dataset]


def carried(dataset: xr.Dataset, study: Study, mapped: dict[int, Index], maps_of: MapsOf) -> Any:
    """What the page's script reads, as JSON takes it; None where there is nothing to pick.

    Parameters
    ----------
    dataset : the study's dataset.
    study : for the scenes of its cases.
    mapped : cases whose maps are carried, by their number.
    maps_of : the maps of a case.
    """
    names, status = axes(dataset), np.asarray(dataset["status"].values).astype(int).ravel()
    if status.size > MOST_CASES or not np.any(status == Status.DONE):
        return None
    left_out: list[str] = []
    histories = _histories(dataset, left_out)
    return {
        "study": study.name,
        "axes": [
            {
                "name": name,
                "title": axis_title(name),
                "values": [axis_value(dataset, name, k) for k in range(dataset.sizes[name])],
                **_plain_numbers(dataset, name),
                "ensemble": axis.seeds,
                "unordered": axis.seeds or name == "sample",
            }
            for name, axis in zip(names, study.axes, strict=True)
        ],
        "status": [Status(one).words for one in status],
        "message": _messages(dataset),
        "times": _packed(dataset["elapsed_time"].values) if "elapsed_time" in dataset else None,
        "periods": _periods(dataset, study) if "pressure_change" in histories else None,
        "histories": histories,
        "scalars": _scalars(dataset),
        "permeability": _permeability(dataset),
        "maps": _maps(study, mapped, maps_of, left_out),
        "left_out": left_out,
    }


def _packed(values: Any) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f8").tobytes()).decode("ascii")


def _plain_numbers(dataset: xr.Dataset, name: str) -> dict[str, Any]:
    """Values along an axis that is one quantity, and the unit in which they are shown."""
    if name not in dataset.coords or dataset[name].dtype.kind not in "fiu":
        return {"numbers": None, "unit": ""}
    values = np.asarray(dataset[name].values, dtype=float)
    if not np.all(np.isfinite(values)):
        return {"numbers": None, "unit": ""}
    factor, unit = display(str(dataset[name].attrs.get("units", "1")), values)
    return {"numbers": (values * factor).tolist(), "unit": unit}


def _messages(dataset: xr.Dataset) -> dict[int, str]:
    texts = map(str, np.asarray(dataset["message"].values).ravel())
    return {k: text for k, text in enumerate(texts) if text}


def _histories(dataset: xr.Dataset, left_out: list[str]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name in _HISTORIES:
        if name not in dataset or "elapsed_time" not in dataset[name].dims:
            continue
        values = dataset[name]
        (of,) = (str(d) for d in values.dims if d not in (*axes(dataset), "elapsed_time"))
        if values.size * 8 > MOST_BYTES:
            left_out.append(f"{values.attrs.get('long_name', name)} {LARGE}")
            continue
        factor, unit = display(str(values.attrs.get("units", "1")), values.values)
        found[name] = {
            "title": str(values.attrs.get("long_name", axis_title(name))),
            "of": [str(one) for one in dataset[of].values],
            "what": of,
            "factor": factor,
            "unit": unit,
            "values": _packed(values.transpose(*axes(dataset), of, "elapsed_time").values),
        }
    return found


def _periods(dataset: xr.Dataset, study: Study) -> Any:
    """When the flow periods of each case and well start: distinct lists, and which is whose.

    A case without a result has none: what is left out, or failed, may be no scene at all.
    """
    lists: dict[tuple[float, ...], int] = {(): 0}
    wells = [str(one) for one in dataset["well"].values]
    status = np.asarray(dataset["status"].values)
    which = np.zeros((*status.shape, len(wells)), dtype=int)
    scenes = SceneBuilder(study.values, study.axes)
    known: dict[tuple[int, ...], list[int]] = {}  # by the point of the axes that touch the wells
    for position in np.ndindex(*status.shape):
        if status[position] in (Status.DONE, Status.INACCURATE, Status.STOPPED):
            at = tuple(position[axis] for axis in scenes.touching("wells"))
            if at not in known:
                starts = period_starts(scenes.scene(position), wells)
                known[at] = [lists.setdefault(tuple(one), len(lists)) for one in starts]
            which[position] = known[at]
    return {"lists": list(lists), "which": which.ravel().tolist()}


def _scalars(dataset: xr.Dataset) -> list[dict[str, Any]]:
    """Every quantity that is one number a case."""
    found = []
    for name, values in dataset.data_vars.items():
        if values.dims != dataset["status"].dims or values.dtype.kind not in "fiu":
            continue
        numbers = np.asarray(values.values, dtype=float)
        if name == "status" or not np.any(np.isfinite(numbers)):
            continue
        factor, unit = display(str(values.attrs.get("units", "1")), numbers)
        title = str(values.attrs.get("long_name", axis_title(str(name))))
        found.append(
            {"name": str(name), "title": title, "factor": factor, "unit": unit,
             "values": _packed(numbers)}
        )  # fmt: skip
    return found


def _permeability(dataset: xr.Dataset) -> Any:
    if "permeability" not in dataset:
        return None
    tensor = dataset["permeability"].transpose(*axes(dataset), "row", "column").values
    factor, unit = display("m2", tensor[..., [0, 1], [0, 1]])
    return {"factor": factor, "unit": unit, "values": _packed(tensor)}


def _maps(
    study: Study, mapped: dict[int, Index], maps_of: MapsOf, left_out: list[str]
) -> list[dict[str, Any]]:
    """Pressure over the pores of a few cases; cases on one network share its polygons."""
    found: list[dict[str, Any]] = []
    shapes: dict[bytes, int] = {}
    for number, index in mapped.items():
        scene = case_at(study, tuple(index[axis.name] for axis in study.axes)).scene
        if "pressure_map" not in scene.observe:
            continue
        try:
            maps = maps_of(index)
        except ResultsError as error:  # its products are gone, or lie elsewhere
            left_out.append(f"pressure maps ({error})")
            break
        if maps.sizes["domain"] > MOST_PORES:
            left_out.append(f"pressure maps {LARGE}")
            break
        one = _map(maps, scene, number)
        key = one["shape"]["x"].encode()
        if key in shapes:
            one["shape"] = shapes[key]
        else:
            shapes[key] = len(found)
        found.append(one)
    return found


def _map(maps: xr.Dataset, scene: Scene, number: int) -> dict[str, Any]:
    pressure = maps["pressure"]
    if "elapsed_time" in pressure.dims:
        times = maps["elapsed_time"].values
        even = np.geomspace(times[0], times[-1], MOST_TIMES) if times[0] > 0 else times
        chosen = map_times(times, list(even))[:MOST_TIMES]
        fields = pressure.transpose("elapsed_time", "domain").values[chosen]
        words = [with_unit(float(times[k]), "s") for k in chosen]
    else:
        fields, words = pressure.values[None], ["steady state"]
    corners = polygons(maps)
    nodes = np.concatenate(corners)
    low, high = nodes.min(axis=0), nodes.max(axis=0)
    scale = float(max(high - low)) or 1.0
    factor, unit = display("Pa", fields)
    least, most = float(np.nanmin(fields)), float(np.nanmax(fields))
    span = most - least or 1.0
    return {
        "case": number,
        "shape": {
            "low": low.tolist(),
            "scale": scale,
            "x": _rounded((nodes[:, 0] - low[0]) / scale),
            "y": _rounded((nodes[:, 1] - low[1]) / scale),
            "corners": [len(one) for one in corners],
        },
        "times": words,
        "fields": [_rounded((one - least) / span) for one in fields],
        "least": least * factor,
        "most": most * factor,
        "unit": unit,
        "traces": _traces(maps),
        "wells": [[*map(float, well.at), float(well.radius)] for well in scene.wells],
    }


def _rounded(share: np.ndarray) -> str:
    """Numbers from 0 to 1 as base64 of little-endian uint16."""
    whole = np.round(np.clip(np.nan_to_num(share), 0.0, 1.0) * 65535.0).astype("<u2")
    return base64.b64encode(whole.tobytes()).decode("ascii")


def _traces(maps: xr.Dataset) -> list[list[float]]:
    if "trace_from_x" not in maps:
        return []
    ends = ("trace_from_x", "trace_from_y", "trace_to_x", "trace_to_y")
    return [
        [round(float(v), 6) for v in row]
        for row in zip(*(maps[n].values for n in ends), strict=True)
    ]


def cases_with_maps(dataset: xr.Dataset, chosen: list[Index]) -> dict[int, Index]:
    """The cases whose maps are carried, by their number among all."""
    shape = dataset["status"].shape
    good = [index for index in done(dataset) if index in chosen][:MOST_MAPPED]
    names = axes(dataset)
    return {
        int(np.ravel_multi_index([i[a] for a in names], shape)) if names else 0: i for i in good
    }
