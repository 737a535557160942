"""Opening of a pressurised crack in cemented grains against Sneddon's closed form.

A straight row of broken bonds of length 2L in a hexagonal lattice, its pores under one pressure p,
opens by w = 4 p L / E in its middle (Sneddon 1946, Proc. R. Soc. A 187, 229), E the modulus of the
lattice in its plane. The lattice sees the crack in whole grains, so that the error falls as R / L.
"""

from __future__ import annotations

import math

import numpy as np

from demflow.model.coupling.duality import place_of, pores_of, volume_gradient
from demflow.model.coupling.setting import at_rest, fluidless
from demflow.model.coupling.skeleton import NEVER, skeleton_of
from demflow.model.mechanics.packing.packing import pack
from demflow.model.mechanics.specimen.rock import build_specimen
from demflow.model.network.domains import network
from demflow.model.region import Rectangle
from demflow.model.scene import Bonds
from tests.benchmarks.result import Result

KN, RATIO, PRESSURE = 20e9, 2.5, 1e5
BOX = 8.2  # of the crack's length
BOUNDS = {5: 0.04, 10: 0.015}  # 2L in diameters -> error
ORDER = 0.9


def opening(diameters: int) -> float:
    """Opening in the middle over Sneddon's, of a crack so many diameters long."""
    radius = 0.01
    side = BOX * diameters * 2.0 * radius
    region = Rectangle(side, side)
    packing = pack(
        region=region, count=None, mean_radius=radius, packing="hexagonal", radius_ratio=1.0,
        porosity=None, seed=1, specimen=True,
    )  # fmt: skip
    cement = Bonds(kind="contact", tensile_strength=1e12, shear_strength=1e12)
    specimen = build_specimen(packing, KN, RATIO, 0.5, cement)
    skeleton, hold = skeleton_of(specimen)
    grains, n = specimen.grains, len(packing.x)
    rows = np.unique(np.round(grains.y, 6))
    middle = len(rows) // 2
    above, below = (np.abs(grains.y - rows[k]) < 1e-3 for k in (middle, middle - 1))
    a, b = skeleton.a, skeleton.b
    across = (b >= 0) & ((above[a] & below[b]) | (below[a] & above[b]))
    centre = np.round(np.median(skeleton.x[across]) / 1.0) * 1.0
    cut = across & (np.abs(skeleton.x - centre) < diameters)  # in radii: half of the length
    hold = hold._replace(mode=np.where(cut, NEVER, hold.mode).astype(np.int8))
    skeleton = skeleton._replace(beside=np.where(cut, False, skeleton.beside))
    parted = hold.overlap.copy()
    parted[cut] = -1.0  # faces that touched at no force stay apart
    hold = hold._replace(overlap=parted, mode=np.where(cut, 1, hold.mode).astype(np.int8))

    box = packing.box
    net = network(packing, region=Rectangle(box[1] - box[0], box[3] - box[2]), walled=True)
    place = place_of(packing.x, packing.y, box)
    push = volume_gradient(pores_of(packing, net), place)
    keys, cut_keys = net.pipe_grain_a * n + net.pipe_grain_b, a[cut] * n + b[cut]
    pipes = np.isin(keys, cut_keys)
    wet = np.zeros(len(net.x))
    wet[net.pipe_from[pipes]] = wet[net.pipe_to[pipes]] = PRESSURE / KN
    force = push @ wet / packing.radius.mean()
    load = np.append(force[: 3 * n], force[[3 * n + 1, 3 * n + 3]])
    found = at_rest(fluidless(skeleton, load), hold, np.zeros(3 * n + 2))
    assert found.reached
    near = cut & (np.abs(skeleton.x - centre) < 2.0)
    up, down = np.where(above[a], a, b)[near], np.where(above[a], b, a)[near]
    opened = float(np.mean(found.u[3 * up + 1] - found.u[3 * down + 1]))
    ks = 1.0 / RATIO
    modulus = 2.0 * math.sqrt(3.0) * (1.0 + ks) / (3.0 + ks)
    half = 0.5 * np.count_nonzero(cut)  # two bonds a diameter, each half of one long: in radii
    return opened / (4.0 * PRESSURE / KN * half / modulus)


def run() -> Result:
    """Cracks of two lengths, and how the error falls."""
    ratio = {diameters: opening(diameters) for diameters in BOUNDS}
    error = {d: abs(r - 1.0) for d, r in ratio.items()}
    order = math.log2(error[5] / error[10])
    holds = all(error[d] <= bound for d, bound in BOUNDS.items()) and order >= ORDER
    lines = [f"2L = {d} diameters: {r:.4f} of Sneddon's" for d, r in ratio.items()]
    return Result(
        f"opening off by {error[5]:.2%} and {error[10]:.2%} at 5 and 10 diameters, order "
        f"{order:.2f}, box {BOX} · 2L",
        f"≤ {BOUNDS[5]:.1%} and {BOUNDS[10]:.1%}, order ≥ {ORDER}",
        bool(holds),
        "\n".join(lines),
    )
