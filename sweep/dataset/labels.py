"""What labels the numbers of a dataset: times, and names of wells, sides and probes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from demflow.model.products import ENERGIES
from demflow.model.quantities import Quantity
from demflow.model.scene import Scene
from demflow.sweep.plan.graph import Plan

CONVENTIONS = "CF-1.11"
FIXED = {
    "row": ("x", "y"),
    "column": ("x", "y"),
    "component": ("xx", "yy", "xy"),
    "direction": ("x", "y"),
    "energy_part": ENERGIES,
    "wall": ("left", "right", "bottom", "top"),
}


def quantity_attributes(quantity: Quantity) -> dict[str, str | float]:
    """CF attributes of a quantity; what is a name has no unit."""
    unit = {"units": quantity.unit} if quantity.unit else {}
    comment = {"comment": quantity.comment} if quantity.comment else {}
    standard = {"standard_name": quantity.standard_name} if quantity.standard_name else {}
    named = {**standard, "long_name": quantity.long_name}
    return {**unit, **named, **comment, **dict(quantity.constants)}


class Layout(NamedTuple):
    """What a case has along the dimensions of the dataset."""

    times: tuple[float, ...]  # s
    names: dict[str, tuple[str, ...]]  # dimension -> names, in the order of the stages' results


@dataclass(frozen=True)
class Labels:
    """Coordinates of the dataset that the scenes give: times, and names of things."""

    times: np.ndarray  # (times,) s, of all cases
    names: dict[str, tuple[str, ...]]  # dimension -> names
    probes: list[dict[str, tuple[float, float]]]  # the different places of probes, m, by name
    probes_of: np.ndarray  # (cases,) index of each case's own; −1 where it cannot be
    observed: tuple[str, ...]
    seeds: tuple[int, ...]
    layouts: list[Layout]  # the different ones
    layout_of: np.ndarray  # (cases,) index of each case's own; −1 where it cannot be


def labels_of(plan: Plan, scene_of: Callable[[int], Scene]) -> Labels:
    """What all scenes together name. Cases may differ in times, wells, sides and probes."""
    names: dict[str, dict[str, None]] = {"well": {}, "boundary": {}, "probe": {}}
    probes: dict[tuple[Any, ...], int] = {}
    probes_of = np.full(len(plan.cases), -1, dtype=np.int32)
    observed: dict[str, None] = {}
    seeds: set[int] = set()
    layouts: dict[tuple[Any, ...], int] = {}
    layout_of = np.full(len(plan.cases), -1, dtype=np.int32)
    for case in range(len(plan.cases)):
        if case in plan.impossible or case in plan.left_out:
            continue
        scene = scene_of(case)
        observed |= dict.fromkeys(scene.observe)
        seeds.add(scene.grains.seed)
        own = {
            "well": tuple(well.name for well in scene.wells),
            "boundary": scene.side_names,
            "probe": tuple(probe.name for probe in scene.probes),
        }
        for dimension, named in own.items():
            names[dimension] |= dict.fromkeys(named)
        places = tuple((probe.name, probe.at) for probe in scene.probes)
        probes_of[case] = probes.setdefault(places, len(probes))
        key = (scene.times, *own.values())
        layout_of[case] = layouts.setdefault(key, len(layouts))
    times = {key[0] for key in layouts}
    every = np.unique(np.concatenate([np.array(t, dtype=float) for t in times] or [np.empty(0)]))
    found = [Layout(key[0], dict(zip(names, key[1:], strict=True))) for key in layouts]
    return Labels(
        times=every,
        names={dimension: tuple(named) for dimension, named in names.items()},
        probes=[dict(places) for places in probes],
        probes_of=probes_of,
        observed=tuple(observed),
        seeds=tuple(sorted(seeds)),
        layouts=found,
        layout_of=layout_of,
    )
