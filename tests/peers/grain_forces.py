"""Contact forces of the same grains under the same walls, here and in Yade.

    python -m tests.peers.grain_forces

A consolidated packing is loaded by the *stress* stage, and in Yade (the Debian package `yade`)
by walls that move on a straight line to where ours came to stand. The grains and Yade's forces
are kept in tests/mechanics/data, so that the test suite repeats the comparison without it. The
states are ones whose forces are unique: no loose grains, and bonds or small steps.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from demflow.model.products import Packing, StressState
from demflow.model.scene import Bonds, Rectangle, Stress
from demflow.model.stages import pack, stress
from tests.peers.yade import run_in_yade

DATA = Path(__file__).parent.parent / "mechanics" / "data"
STIFFNESS_RATIO, FRICTION = 2.5, 0.5
MODULUS = 1.0  # of parallel bonds, over k_n


class Case(NamedTuple):
    """How a consolidated packing is loaded; stresses over k_n."""

    bonds: str | None  # their kind
    xx: float
    yy: float
    friction: float = FRICTION

    def load(self, packing: Packing) -> StressState:
        """The packing under these stresses, by the public stage."""
        strong = None
        if self.bonds is not None:
            strong = Bonds(
                kind=self.bonds,
                modulus=MODULUS if self.bonds == "parallel" else None,
                tensile_strength=1e9,
                shear_strength=1e9,
            )
        return stress(
            packing,
            normal_stiffness=1.0,
            stiffness_ratio=STIFFNESS_RATIO,
            friction=self.friction,
            bonds=strong,
            stress=Stress(xx=self.xx, yy=self.yy),
        )

    def springs(self, packing: Packing) -> dict[str, np.ndarray]:
        """Stiffness (c,) of each contact and its bond, over k_n and in mean radii.

        A parallel bond, k̄_n = Ē_c 2 R̄ / (R_a + R_b) and k̄_n R̄² / 3 against rotation, stands
        beside its contact and is free of force where that overlaps by `installed`: one spring
        of k_n + k̄_n that starts from a smaller overlap, for Yade's law has but one. Contacts
        must neither open nor slip (a high friction) for that.
        """
        unit = float(packing.radius.mean())
        a, b, radius = packing.contact_a, packing.contact_b, packing.radius / unit
        bond = np.zeros(len(a))
        half = np.minimum(radius[a], radius[b])
        if self.bonds == "parallel":
            bond = MODULUS * 2.0 * half / (radius[a] + radius[b])
        installed = packing.normal_force / unit
        return {
            "kn": 1.0 + bond,
            "kr": bond * half**2 / 3.0,
            "unloaded": bond * installed / (1.0 + bond),
        }


PRESSURE = 5e-4  # under which the packings are consolidated
CASES = {
    "unbonded": Case(None, PRESSURE, 1.2 * PRESSURE),
    "bonded": Case("contact", PRESSURE, 2.0 * PRESSURE),
    "parallel": Case("parallel", 2.0 * PRESSURE, 4.0 * PRESSURE, friction=1e3),
}


def specimen() -> Packing:
    """A dense packing, consolidated without bonds, without the grains that carry nothing."""
    packing = pack(
        region=Rectangle(1.0, 1.0),
        count=300,
        mean_radius=None,
        packing="random",
        radius_ratio=1.66,
        porosity=0.158,
        seed=4,
    )
    state = Case(None, PRESSURE, PRESSURE).load(packing)
    consolidated = packing._replace(
        x=state.x,
        y=state.y,
        contact_a=state.contact_a,
        contact_b=state.contact_b,
        normal_force=state.normal_force,  # k_n is 1 N/m
        shear_force=state.shear_force,
        box=state.box,
        packing_pressure=np.array(PRESSURE),
    )
    return without_floaters(consolidated)


def without_floaters(packing: Packing) -> Packing:
    """The grains that carry load. A loose grain may be caught anywhere, in either code."""
    kept = np.arange(len(packing.x))
    a, b = packing.contact_a, packing.contact_b
    while True:
        contacts = np.isin(a, kept) & np.isin(b, kept)
        count = np.bincount(np.concatenate([a[contacts], b[contacts]]), minlength=len(packing.x))
        if len(still := np.flatnonzero(count >= 2)) == len(kept):
            break
        kept = still
    number = np.full(len(packing.x), -1)
    number[kept] = np.arange(len(kept))
    return packing._replace(
        x=packing.x[kept],
        y=packing.y[kept],
        radius=packing.radius[kept],
        contact_a=number[a[contacts]],
        contact_b=number[b[contacts]],
        normal_force=packing.normal_force[contacts],
        shear_force=packing.shear_force[contacts],
    )


class Forces(NamedTuple):
    """Contacts of grains a < b and their forces over k_n, in mean radii."""

    a: np.ndarray
    b: np.ndarray
    normal: np.ndarray
    shear: np.ndarray


def forces_of(state: StressState, unit: float) -> Forces:
    """The contact forces of a stressed state with k_n = 1 N/m."""
    return Forces(
        state.contact_a, state.contact_b, state.normal_force / unit, state.shear_force / unit
    )


def difference(ours: Forces, theirs: Forces) -> float:
    """RMS difference of the contact forces over their mean; a contact that one lacks is zero."""
    rows: dict[tuple[int, int], np.ndarray] = {}
    for sign, forces in ((1.0, ours), (-1.0, theirs)):
        for a, b, normal, shear in zip(*forces, strict=True):
            entry = rows.setdefault((int(a), int(b)), np.zeros(2))
            entry += sign * np.array([normal, shear])
    squares = np.array([np.sum(row**2) for row in rows.values()])
    return float(np.sqrt(squares.mean()) / np.hypot(ours.normal, ours.shear).mean())


def yade_forces(
    packing: Packing, case: Case, state: StressState, *, steps: int = 40_000
) -> dict[str, np.ndarray]:
    """Load the packing in Yade to where `state` has its walls; what `yade_load.py` returns."""
    unit = float(packing.radius.mean())
    centre = 0.5 * np.array([packing.box[0] + packing.box[1], packing.box[2] + packing.box[3]])
    limit = case.friction * packing.normal_force
    return run_in_yade(
        "yade_load.py",
        x=(packing.x - centre[0]) / unit,
        y=(packing.y - centre[1]) / unit,
        radius=packing.radius / unit,
        a=packing.contact_a,
        b=packing.contact_b,
        shear=np.clip(packing.shear_force, -limit, limit) / unit,
        box=(packing.box - np.repeat(centre, 2)) / unit,
        box_end=(state.box - np.repeat(centre, 2)) / unit,
        **{f"spring_{key}": value for key, value in case.springs(packing).items()},
        ks=1.0 / STIFFNESS_RATIO,
        friction=case.friction,
        bonded=case.bonds is not None,
        steps=steps,
        ratio=float(state.unbalanced_ratio),
        damping=0.2,
    )


def main() -> None:
    """Compare all cases, keep Yade's forces, print the table."""
    DATA.mkdir(exist_ok=True)
    print("case       grains  contacts  RMS difference / mean force  unbalanced ours, Yade's")
    packing = specimen()
    kept = {f"packing_{key}": getattr(packing, key) for key in packing._fields}
    for name, case in CASES.items():
        state = case.load(packing)
        found = yade_forces(packing, case, state)
        theirs = Forces(found["a"], found["b"], found["normal"], found["shear"])
        ours = forces_of(state, float(packing.radius.mean()))
        print(
            f"{name:10s} {len(packing.x):6d}  {len(ours.a):8d}  {difference(ours, theirs):27.2%}"
            f"  {float(state.unbalanced_ratio):.1e}, {float(found['ratio']):.1e}"
        )
        kept |= {f"{name}_{key}": found[key] for key in ("a", "b", "normal", "shear")}
    np.savez_compressed(DATA / "yade.npz", version=found["version"], **kept)


if __name__ == "__main__":
    main()
