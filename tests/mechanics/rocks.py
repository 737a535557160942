"""Packings that several tests look at, made once, and what is measured on them anew."""

from functools import cache

import numpy as np

from demflow.model.mechanics.packing.packing import pack
from demflow.model.products import Packing
from demflow.model.region import Circle, Rectangle

REGIONS = {"square": Rectangle(2.0, 2.0), "disc": Circle(1.0), "slab": Rectangle(3.0, 1.0)}


@cache
def packed(
    porosity: float | None = 0.165,
    *,
    count: int = 400,
    region: str = "square",
    kind: str = "random",
    ratio: float = 1.66,
    seed: int = 1,
    specimen: bool | None = None,
) -> Packing:
    """Grains that cover a region; a specimen has as many as are counted, without a margin."""
    return pack(
        region=REGIONS[region],
        count=count,
        mean_radius=None,
        packing=kind,
        radius_ratio=ratio,
        porosity=porosity,
        seed=seed,
        specimen=specimen,
    )


def wall_forces(state, radius: np.ndarray, stiffness: float) -> np.ndarray:
    """Forces (n, 4) of the walls left, right, bottom, top on each grain, inwards."""
    x, y, box = state.x, state.y, state.box
    overlap = np.array(
        [box[0] - x + radius, x + radius - box[1], box[2] - y + radius, y + radius - box[3]]
    )
    return stiffness * np.maximum(overlap, 0.0).T


def net_forces(state, radius: np.ndarray, stiffness: float) -> tuple[np.ndarray, np.ndarray]:
    """Sum of forces (n, 2) and torques (n,) on each grain, from a product's named arrays."""
    a, b, fn, fs = state.contact_a, state.contact_b, state.normal_force, state.shear_force
    branch = np.column_stack((state.x[b] - state.x[a], state.y[b] - state.y[a]))
    distance = np.hypot(*branch.T)
    normal = branch / distance[:, None]
    tangent = np.column_stack((-normal[:, 1], normal[:, 0]))
    on_b = fn[:, None] * normal + fs[:, None] * tangent
    force, torque = np.zeros((len(state.x), 2)), np.zeros(len(state.x))
    np.add.at(force, b, on_b)
    np.subtract.at(force, a, on_b)
    middle = 0.5 * (radius[a] + radius[b] - distance)
    np.subtract.at(torque, a, (radius[a] - middle) * fs)
    np.subtract.at(torque, b, (radius[b] - middle) * fs)
    walls = wall_forces(state, radius, stiffness)
    force[:, 0] += walls[:, 0] - walls[:, 1]
    force[:, 1] += walls[:, 2] - walls[:, 3]
    return force, torque
