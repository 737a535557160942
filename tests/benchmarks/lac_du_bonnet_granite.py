"""Lac du Bonnet granite of bonded discs, as Potyondy & Cundall (2004) built it."""

from __future__ import annotations

import itertools
import statistics

from demflow.model.mechanics.static.moduli import in_plane_strain
from demflow.model.outcome import ModelError
from demflow.model.products import Packing, StrengthTest
from demflow.model.region import Rectangle
from demflow.model.scene import Bonds, FailureTest
from demflow.model.stages import pack, strength
from tests.benchmarks.result import Result

BONDS = Bonds(
    kind="parallel",
    modulus=62e9,
    tensile_strength=157e6,
    shear_strength=157e6,
    tensile_deviation=36e6,
    shear_deviation=36e6,
)
MODULUS, RATIO, STRENGTH = 70.9e9, 0.237, 199e6  # theirs at 0.1 MPa
WITHIN = (0.10, 0.04, 0.15)
CONFINING = (0.1e6, 10e6, 30e6, 70e6)
PACKINGS, FURTHER = 10, 3  # at the least confinement, at the others
WIDTH, HEIGHT, RADIUS = 0.0317, 0.0634, 0.36e-3


def specimen(seed: int) -> Packing:
    """One of the packings; all of it is tested."""
    return pack(
        region=Rectangle(WIDTH, HEIGHT),
        count=None,
        mean_radius=RADIUS,
        packing="random",
        radius_ratio=1.66,
        porosity=0.16,
        seed=seed,
        floaters="fit",
        specimen=True,
    )


def tested(rock: Packing, confining: float, seed: int) -> StrengthTest:
    """A biaxial test; two grains of 2 E_c in series make a contact of E_c."""
    return strength(
        rock,
        normal_stiffness=62e9,
        stiffness_ratio=2.5,
        friction=0.5,
        bonds=BONDS,
        test=FailureTest(confining_stress=confining),
        seed=seed,
    )


def run() -> Result:
    """Means over packings, and the trend with confinement over three of them."""
    rocks = [specimen(seed) for seed in range(1, PACKINGS + 1)]
    z = statistics.mean(2.0 * len(rock.contact_a) / len(rock.x) for rock in rocks)
    lines = [f"{len(rocks[0].x)} grains, {z:.2f} contacts a grain when packed"]
    strengths, first = [], (0.0, 0.0, 0.0)
    for confining in CONFINING:
        found = []
        for seed, rock in enumerate(rocks if confining == CONFINING[0] else rocks[:FURTHER]):
            try:
                found.append(tested(rock, confining, seed))
            except ModelError as error:
                lines.append(str(error))
        if len(found) < 2:
            continue
        moduli, ratios, peaks, cracks = (
            [float(getattr(one, name)) for one in found]
            for name in ("youngs_modulus", "poissons_ratio", "peak_strength", "cracks_at_peak")
        )
        apparent = statistics.mean(moduli), statistics.mean(ratios)
        spread = statistics.stdev(moduli), statistics.stdev(ratios)
        strain = in_plane_strain(*apparent)
        strengths.append(statistics.mean(peaks))
        lines.append(
            f"{confining / 1e6:5.1f} MPa: E {strain[0] / 1e9:.1f} GPa, nu {strain[1]:.3f} in plane "
            f"strain (in plane stress {apparent[0] / 1e9:.1f} ± {spread[0] / 1e9:.1f}"
            f" GPa, {apparent[1]:.3f} ± {spread[1]:.3f}), strength "
            f"{strengths[-1] / 1e6:.0f} ± {statistics.stdev(peaks) / 1e6:.0f} MPa, "
            f"{statistics.mean(cracks):.0f} cracks at the peak ({len(found)} packings)"
        )
        if confining == CONFINING[0]:
            first = (*strain, strengths[0])
    off = (first[0] / MODULUS - 1.0, first[1] - RATIO, first[2] / STRENGTH - 1.0)
    rises = all(b > a for a, b in itertools.pairwise(strengths))
    held = all(abs(value) <= bound for value, bound in zip(off, WITHIN, strict=True))
    return Result(
        f"E {off[0]:+.0%}, nu {off[1]:+.3f}, strength {off[2]:+.0%} against theirs",
        "within 10 %, 0.04, 15 %; stronger under more confinement",
        held and rises and len(strengths) == len(CONFINING),
        "\n".join(lines),
    )
