"""What a step costs, here and elsewhere, on the same discs."""

from __future__ import annotations

import time
from functools import cache

import numpy as np

from demflow.model.mechanics.loading.stress import DAMPING, straight_path
from demflow.model.mechanics.motion.equilibrium import NEVER, Specimen
from demflow.model.mechanics.packing.packing import pack
from demflow.model.mechanics.specimen.rock import build_specimen
from demflow.model.products import Packing
from demflow.model.region import Rectangle
from demflow.model.scene import Bonds
from tests.benchmarks.result import Result
from tests.peers.yade import PeerMissingError, run_in_yade

KN, STIFFNESS_RATIO, FRICTION = 40e9, 2.5, 0.5
REPEATS = 5
PARTICLE_STEPS = 8_000_000  # of a run that is timed
# A packing without its walls is held by its own images in a periodic box that is smaller by
# this, in mean radii: it then has as many contacts or fewer.
SHRUNK = 0.2


@cache
def rock(count: int) -> Packing:
    """A random packing of about so many discs in all, margin included."""
    inner = round((np.sqrt(count) - 9.2) ** 2) if count > 2000 else count // 3
    return pack(
        region=Rectangle(1.0, 1.0),
        count=inner,
        mean_radius=None,
        packing="random",
        radius_ratio=1.66,
        porosity=0.165,
        seed=1,
    )


def our_steps(packing: Packing, bonds: Bonds | None) -> tuple[list[float], Specimen]:
    """Nanoseconds of processor per disc and step of runs towards 2:1, with all that a real one
    does: neighbours made anew, stress path and servo, damping, and what would stop it."""
    seconds = []
    pressure = float(packing.packing_pressure)
    path = straight_path(pressure, 2.0 * pressure, pressure)
    n = len(packing.x)
    steps = max(200, PARTICLE_STEPS // n)
    specimen = build_specimen(packing, KN, STIFFNESS_RATIO, FRICTION, bonds)
    specimen.relax(path, NEVER, damping=DAMPING, steps=1)
    for _ in range(REPEATS):
        start = time.process_time()
        specimen.relax(path, NEVER, damping=DAMPING, steps=steps)
        seconds.append((time.process_time() - start) / steps / n * 1e9)
    return seconds, specimen


def periodic(packing: Packing) -> dict[str, np.ndarray]:
    """The discs in units of the mean radius, and the periodic box that holds them."""
    unit = packing.radius.mean()
    box = packing.box / unit
    low = np.array([box[0], box[2]]) + 0.5 * SHRUNK
    return {
        "x": packing.x / unit - low[0],
        "y": packing.y / unit - low[1],
        "radius": packing.radius / unit,
        "size": np.array([box[1] - box[0], box[3] - box[2]]) - SHRUNK,
    }


def against_yade(count: int, bonds: Bonds | None, bound: float) -> Result:
    """Our time over Yade's."""
    packing = rock(count)
    n = len(packing.x)
    try:
        steps = 600
        told = run_in_yade(
            "yade_steps.py", **periodic(packing), friction=FRICTION, bonded=bonds is not None,
            steps=steps, repeats=3,
        )  # fmt: skip
    except PeerMissingError as missing:
        return Result("not measured", f"≤ {bound:g}", False, str(missing))
    ours, specimen = our_steps(packing, bonds)
    theirs = [s / steps / n * 1e9 for s in told["seconds"]]
    ratio = min(ours) / min(theirs)
    return Result(
        f"{ratio:.3g} of Yade's time",
        f"≤ {bound:.3g}",
        bool(ratio <= bound),
        f"{n} discs; ours {_listed(ours)} ns per disc and step, {specimen.sums.contacts / n:.2f} "
        f"contacts a disc; Yade {_listed(theirs)}, {float(told['contacts']) / n:.2f}",
    )


def _listed(times: list[float]) -> str:
    return ", ".join(f"{t:.1f}" for t in sorted(times))
