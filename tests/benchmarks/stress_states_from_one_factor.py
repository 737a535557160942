"""Each further stress state of a bonded, unbroken rock is nearly free, and is the explicit one's.

Every state is asked of the stage *stress* as a user has it. The figure is that of contact bonds
that also bridge the gaps between near grains, at stresses about 20 MPa (40 GPa grains, packed at
8 MPa): whatever is loaded there holds, and at the tolerance that `stress` has by itself a state is
the sum of unit loads. Its explicit run goes to a ratio of 1e-4. The residual is that of the linear
equilibrium, K u = f, with a stiffness assembled anew. Lines besides: the same states asked for
1e-4 and for 1e-10 by the true law on the moved grains, a short way from the packed state, and
parallel bonds, under which the grains' own contacts slip, open and close.
"""

from __future__ import annotations

import statistics

import numpy as np

from demflow.model.mechanics.specimen.rock import build_specimen
from demflow.model.mechanics.static.load_carrying import carrying, contacts_of
from demflow.model.mechanics.static.stiffness import ANCHOR, matrix
from demflow.model.outcome import ModelError
from demflow.model.products import StressState
from demflow.model.scene import Stress
from tests.benchmarks.result import Result
from tests.benchmarks.specimens import CEMENTS, CONTACTS, difference, loaded, packed, responses

STATES = ((20e6, 20e6), (22e6, 20e6), (24e6, 18e6), (30e6, 20e6))
BESIDES = ((10e6, 10e6), (40e6, 36e6))  # near the packed state: a short way; 1e-3 k_n
TIMES, FORCES, RESIDUAL = 100.0, 1e-3, 1e-10
PLAIN, ALIKE, ROUND_OFF = 1e-3, 1e-4, 1e-10
REPEATS = 5


def further(
    rock: str, count: int, xx: float, yy: float, tolerance: float
) -> tuple[StressState, float]:
    """A state by the static solver, and the median of its times."""
    packing, units = packed(count), responses(rock, count)
    target = Stress(xx=xx, yy=yy, method="static", tolerance=tolerance)
    runs = [loaded(packing, target, CEMENTS[rock], units) for _ in range(REPEATS)]
    return runs[0][0], statistics.median(seconds for _, seconds in runs)


def linear_residual(rock: str, count: int) -> float:
    """Largest force that unit loads leave in the linear equilibrium, over the mean it causes."""
    packing, units = packed(count), responses(rock, count)
    elastic = {k: v for k, v in CONTACTS.items() if k != "normal_stiffness"}
    bonds = CEMENTS[rock].elastic(CONTACTS["normal_stiffness"])
    specimen = build_specimen(packing, 1.0, bonds=bonds, **elastic)
    contacts = contacts_of(specimen)
    stiffness = matrix(specimen.grains, contacts, specimen.bonds, specimen.law)
    box = specimen.box
    worst = 0.0
    for k, side in enumerate((box[3] - box[2], box[1] - box[0])):
        left = (stiffness @ units.displacement[k]) - ANCHOR * units.displacement[k]
        left[-2 + k] += side
        loaded_grains = carrying(len(packing.x), contacts)
        on_grains = left[:-2].reshape(-1, 3)[loaded_grains]
        mean = side / np.sqrt(len(packing.x))  # of the contacts' forces under a unit stress
        worst = max(worst, float(np.abs(on_grains).mean()) / mean)
    return worst


def run() -> Result:
    """Times, forces and residuals at 5,000 and 20,000 grains."""
    ratios, apart, lines = [], [], []
    left = max(linear_residual("contact bonds", count) for count in (5000, 20_000))
    lines.append(f"residual of the linear equilibrium: {left:.0e} of the mean force")
    for rock in CEMENTS:
        elastic = rock == "contact bonds"
        for count in (5000, 20_000) if elastic else (5000,):
            further(rock, count, *STATES[0], PLAIN)  # compiles
            for xx, yy in (*STATES, *BESIDES):
                target = Stress(xx=xx, yy=yy, method="explicit", tolerance=ALIKE)
                reference, explicit = loaded(packed(count), target, CEMENTS[rock])
                name = f"{rock}, {count} grains, {xx / 1e6:.0f}:{yy / 1e6:.0f} MPa"
                for tolerance in (PLAIN, ALIKE, ROUND_OFF)[: 3 if elastic else 2]:
                    try:
                        found, seconds = further(rock, count, xx, yy, tolerance)
                    except ModelError as error:
                        lines.append(f"{name}: {error}")
                        continue
                    differ, residual = difference(found, reference), float(found.unbalanced_ratio)
                    if elastic and tolerance == PLAIN and (xx, yy) in STATES:
                        ratios.append(explicit / seconds)
                        apart.append(differ)
                    lines.append(
                        f"{name}: explicit {1e3 * explicit:.0f} ms, static {1e3 * seconds:.1f} ms "
                        f"({int(found.steps)} corrections, unbalance {residual:.0e}), "
                        f"{explicit / seconds:.0f} times faster, forces {differ:.3%} apart"
                    )
    return Result(
        f"{min(ratios):.0f} to {max(ratios):.0f} times faster, residual {left:.0e}, "
        f"forces {max(apart):.3%} apart at most",
        f"≥ {TIMES:.0f} times, ≤ {RESIDUAL:.0e}, ≤ {FORCES:.1%}",
        min(ratios) >= TIMES and left <= RESIDUAL and max(apart) <= FORCES,
        "\n".join(lines),
    )
