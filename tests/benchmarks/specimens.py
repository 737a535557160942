"""Packed rocks and their stress states, as a user of the stages gets them."""

from __future__ import annotations

import time
from functools import cache

import numpy as np

from demflow.model.products import Packing, StressState, UnitLoads
from demflow.model.region import Rectangle
from demflow.model.scene import Bonds, Stress
from demflow.model.stages import pack, stress, unit_loads

CONTACTS = {"normal_stiffness": 40e9, "stiffness_ratio": 2.5, "friction": 0.5}  # E_c = 40 GPa
STRENGTHS = {"tensile_strength": 60e6, "shear_strength": 120e6}
CEMENTS = {
    "contact bonds": Bonds(kind="contact", installation_gap=0.01, **STRENGTHS),
    "parallel bonds": Bonds(kind="parallel", **STRENGTHS),
}


@cache
def packed(count: int, *, porosity: float = 0.165, seed: int = 1, floaters: str = "fit") -> Packing:
    """Discs of sizes 1 to 1.66 in a square."""
    return pack(
        region=Rectangle(10.0, 10.0),
        count=count,
        mean_radius=None,
        packing="random",
        radius_ratio=1.66,
        porosity=porosity,
        seed=seed,
        floaters=floaters,
    )


@cache
def responses(rock: str, count: int) -> UnitLoads:
    """What all stress states of a rock share, one of those in CEMENTS."""
    elastic = {k: v for k, v in CONTACTS.items() if k != "normal_stiffness"}
    bonds = CEMENTS[rock].elastic(CONTACTS["normal_stiffness"])
    return unit_loads(packed(count), bonds=bonds, **elastic)


def loaded(
    packing: Packing, target: Stress, bonds: Bonds | None, units: UnitLoads | None = None
) -> tuple[StressState, float]:
    """A stress state, and the processor time it took."""
    start = time.process_time()
    state = stress(packing, units, bonds=bonds, stress=target, **CONTACTS)
    return state, time.process_time() - start


def difference(one: StressState, other: StressState) -> float:
    """Difference of the contact forces, L2, relative to the other's."""
    n = len(one.x)
    keys = [state.contact_a * n + state.contact_b for state in (one, other)]
    every = np.union1d(*keys)
    forces = np.zeros((2, 2, len(every)))
    for k, state in enumerate((one, other)):
        forces[k][:, np.searchsorted(every, keys[k])] = state.normal_force, state.shear_force
    return float(np.linalg.norm(forces[0] - forces[1]) / np.linalg.norm(forces[1]))
