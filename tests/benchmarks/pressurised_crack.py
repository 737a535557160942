"""Opening of a pressurised crack in cemented grains against Sneddon's closed form.

A straight row of broken bonds of length 2L, its pores under one pressure p, opens by w = 4 p L / E
in its middle (Sneddon 1946, Proc. R. Soc. A 187, 229), E the modulus of the specimen in its plane,
measured by its walls. Grains see the crack in whole grains, so that the error falls as R / L. The
closed form has an endless rock: in a box of B crack lengths between plates that are free to move
the opening is wider by c / B² + d / B⁴, which three boxes tell (Richardson). A tip lies in the
middle of the pore at which the crack ends, so that half of its pressure lies on the crack.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.sparse import csc_array, diags_array

from demflow.model.coupling.duality import place_of, pores_of, volume_gradient
from demflow.model.coupling.skeleton import Hold, Skeleton, borne, skeleton_of
from demflow.model.mechanics.packing.packing import pack
from demflow.model.mechanics.specimen.rock import build_specimen
from demflow.model.mechanics.static.moduli import elastic_moduli
from demflow.model.mechanics.static.stiffness import ANCHOR, factorise, solve
from demflow.model.network.domains import network
from demflow.model.products import Packing
from demflow.model.region import Rectangle
from demflow.model.scene import Bonds
from demflow.model.threads import one_blas_thread
from tests.benchmarks.result import Result

KN, RATIO, PRESSURE, RADIUS = 20e9, 2.5, 1e-5, 0.01  # pressure over k_n
BOXES = 4.0, 6.0, 8.0  # of the crack's length, of hexagonal lattices; of random ones the first
CONTACT = Bonds(kind="contact", tensile_strength=1e12, shear_strength=1e12)
PARALLEL = Bonds(kind="parallel", tensile_strength=1e12, shear_strength=1e12)
BOUNDS = {20: 0.03, 40: 0.015}  # 2L in diameters -> error in a hexagonal lattice
ORDER, RANDOM, SEEDS = 0.9, 0.05, tuple(range(1, 9))
ENDS = 0.9  # of the half length: jumps nearer to a tip do not count


class Rock(NamedTuple):
    """A specimen whose contacts hold as they are; lengths over the mean radius, forces over k_n."""

    packing: Packing
    skeleton: Skeleton
    hold: Hold

    @property
    def size(self) -> np.ndarray:
        """Width and height, in mean radii."""
        box = self.packing.box / self.packing.radius.mean()
        return np.array([box[1] - box[0], box[3] - box[2]])

    def solved(self, holds: np.ndarray, loads: np.ndarray) -> np.ndarray:
        """Displacements under `loads` (k, m) where only some contacts `holds` (c,) bool."""
        s = self.skeleton
        now = borne(s, self.hold, np.zeros(loads.shape[1]))
        stiffness = diags_array(np.full(loads.shape[1], ANCHOR))
        for strain, stiff in ((s.parting, now.kn), (s.sliding, now.ks), (s.bending, now.km)):
            stiffness = stiffness + strain.T @ diags_array(np.where(holds, stiff, 0.0)) @ strain
        factor = factorise(csc_array(stiffness))
        return np.array([solve(factor, load) for load in loads])


def rock(kind: str, wide: float, seed: int) -> Rock:
    """Grains in a square of so many diameters, hexagonal or random."""
    side = 2.0 * RADIUS * wide
    hexagonal = kind == "hexagonal"
    packing = pack(
        region=Rectangle(side, side), count=None, mean_radius=RADIUS, packing=kind,
        radius_ratio=1.0 if hexagonal else 1.66, porosity=None if hexagonal else 0.17, seed=seed,
        specimen=True,
    )  # fmt: skip
    cement = CONTACT if hexagonal else PARALLEL
    skeleton, hold = skeleton_of(build_specimen(packing, KN, RATIO, 0.5, cement))
    at_wall = skeleton.b < 0
    touches = np.where(at_wall & (hold.overlap > -1e-6), 1e-9, hold.overlap)
    still = skeleton._replace(friction=np.full(len(skeleton.a), 1e9))
    sealed = np.where(at_wall, touches, hold.overlap)
    return Rock(packing, still, hold._replace(overlap=sealed, shear=0.0 * hold.shear))


def modulus(kind: str, one: Rock) -> float:
    """Young's modulus in the plane: in closed form of a lattice, measured of random grains."""
    if kind == "hexagonal":
        ks = 1.0 / RATIO
        return 2.0 * math.sqrt(3.0) * (1.0 + ks) / (3.0 + ks)
    found = elastic_moduli(
        one.packing, normal_stiffness=KN, stiffness_ratio=RATIO, friction=0.5,
        bonds=PARALLEL,
    )  # fmt: skip
    return float(found.youngs_modulus) / KN


def opening(kind: str, diameters: int, times: float, seed: int = 1) -> float:
    """Opening in the middle over Sneddon's, of a crack so many diameters long in a box."""
    one = rock(kind, times * diameters, seed)
    packing, s = one.packing, one.skeleton
    n, unit = len(packing.x), packing.radius.mean()
    x, y = packing.x / unit, packing.y / unit
    level = 0.0
    if kind == "hexagonal":  # between two rows
        rows = np.unique(np.round(y, 6))
        level = 0.5 * float(rows[len(rows) // 2] + rows[len(rows) // 2 - 1])
    above = y > level
    crosses = (s.b >= 0) & (above[s.a] != above[s.b])
    part = (level - y[s.a]) / (y[s.b] - y[s.a] + ~crosses)
    at = x[s.a] + part * (x[s.b] - x[s.a])
    centre = float(np.round(np.median(at[crosses]))) if kind == "hexagonal" else 0.0
    cut = crosses & (np.abs(at - centre) < diameters)  # in radii: half of the length
    # of a hexagonal row the bonds that are broken, each half a diameter long
    half = 0.5 * np.count_nonzero(cut) if kind == "hexagonal" else float(diameters)

    box = packing.box
    net = network(packing, region=Rectangle(box[1] - box[0], box[3] - box[2]), walled=True)
    push = volume_gradient(pores_of(packing, net), place_of(packing.x, packing.y, box))
    pipes = np.isin(net.pipe_grain_a * n + net.pipe_grain_b, s.a[cut] * n + s.b[cut])
    ends = np.append(net.pipe_from[pipes], net.pipe_to[pipes])
    # a tip lies in the middle of the pore at which the crack ends: half of its push is on the crack
    open_ends = np.bincount(ends, minlength=len(net.x))
    force = push @ (PRESSURE * np.minimum(0.5 * open_ends, 1.0)) / unit
    load = np.append(force[: 3 * n], force[[3 * n + 1, 3 * n + 3]])
    (moved,) = one.solved(~cut, load[None, :])
    up, down = np.where(above[s.a], s.a, s.b)[cut], np.where(above[s.a], s.b, s.a)[cut]
    jump = moved[3 * up + 1] - moved[3 * down + 1]
    shape = np.sqrt(np.maximum(1.0 - ((at[cut] - centre) / half) ** 2, 0.0))
    near = np.abs(at[cut] - centre) < (ENDS * half if kind == "random" else 2.0)
    middle = float(jump[near] @ shape[near] / (shape[near] @ shape[near]))
    return middle / (4.0 * PRESSURE * half / modulus(kind, one))


def run() -> Result:
    """Cracks of two lengths in hexagonal lattices, and one of them in random packings."""
    lines, error, wider = [], {}, 0.0
    inverse = np.array(BOXES) ** -2.0
    with one_blas_thread():
        for diameters in BOUNDS:
            found = [opening("hexagonal", diameters, times) for times in BOXES]
            endless = float(np.linalg.solve(np.vander(inverse, increasing=True), found)[0])
            wider = wider or found[0] / endless
            error[diameters] = abs(endless - 1.0)
            lines.append(
                f"hexagonal, 2L = {diameters} diameters: "
                + ", ".join(f"{ratio:.4f}" for ratio in found)
                + " of Sneddon's in boxes of "
                + ", ".join(f"{times:g}" for times in BOXES)
                + f" · 2L, {endless:.4f} endless"
            )
        short, long = BOUNDS
        order = math.log2(error[short] / error[long])
        ratios = [opening("random", short, BOXES[0], seed) / wider for seed in SEEDS]
    mean, apart = np.mean(ratios), np.std(ratios, ddof=1) / math.sqrt(len(ratios))
    lines.append(
        f"random, 2L = {short} diameters, a box of {BOXES[0]:g} · 2L, less what it adds: "
        + ", ".join(f"{ratio:.3f}" for ratio in ratios)
    )
    holds = all(error[d] <= bound for d, bound in BOUNDS.items()) and order >= ORDER
    holds = holds and abs(mean - 1.0) <= RANDOM
    return Result(
        f"hexagonal off by {error[short]:.2%} and {error[long]:.2%} at {short} and {long} "
        f"diameters, order {order:.2f}; {len(ratios)} random packings {mean - 1.0:+.1%} in the "
        f"mean, ± {apart:.1%}",
        f"≤ {BOUNDS[short]:.1%} and {BOUNDS[long]:.1%}, order ≥ {ORDER}; ≤ {RANDOM:.0%}",
        bool(holds),
        "\n".join(lines),
    )
