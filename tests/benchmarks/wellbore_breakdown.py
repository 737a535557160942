"""Breakdown pressure and direction of a wellbore's fracture against 3 σ3 − σ1 + T.

Fluid is injected into a hole of five and of ten mean radii, under stresses of 1:1, 2:1 and 3:1,
until a fracture runs from it (Hubbert & Willis 1957). T is what a test in direct tension measures
on grains of the same packing and cement. Breakdown is the pressure from which the well first falls
while fluid is still injected (as in a field test: Haimson & Cornet 2003, Int. J. Rock Mech. Min.
Sci. 40, 1011); what the fracture needs to grow through grains afterwards may be higher, the more so
near walls, and is none of the formula's.

The formula is of an elastic rock without grains or end, of a fluid that stays in the hole, and of a
T that no compression across it lessens. What comes near to that, and how near:

- *Fluid.* It is injected so fast that little leaks before breakdown, which is told. At 1:1 and 10 R
  the threefold rate moves the mean of three packings by 0.1 %; a third of it, at which 8 % leak and
  not 4, lowers it by 12 %: two of them by 3 % or less, one that broke late by 30. Where fluid
  enters the wall in full, the formula is 3 σ3 − σ1 + T over 2 (1 − η), η = (1 − 2 ν) / (2 (1 − ν))
  (Haimson & Fairhurst 1967, Soc. Petrol. Engrs. J. 7, 310). By the ν' of plane strain in the plane,
  ν' = ν / (1 − ν), that is a factor of 1 / (1 + ν'); it stands beside.
- *Walls.* They stand 6.2 and 4.4 hole radii from its middle, at 5 and 10 R, and keep stresses. By
  Lamé's solution a hole breaks 3 and 6 % earlier there than in rock without end, at 1:1.
- *Grains.* A wall that the stresses stretch over a grain's size alone bears more than T, so that
  the ratio is above 1 where they differ, the less the more grains the wall has.
- *T* is of tension alone. Where something presses across it as the fluid does on a wall, bonded
  grains bear less: their bonds break by what they are stretched, so that the ratio is below 1 at
  1:1. Pressed across by 1.2 T, three specimens of 300 grains bore 0.65 T, by 2.5 T a fifth of it.
- *Loose grains.* Those that bear no load once packed are fitted into their voids and cemented, and
  cement fills gaps up to a tenth of a radius: voids left open are flaws of the rock.

The rock is the same in all three states of stress. Its cement set at depth: grains are packed,
without friction, under the least stress, and only what drilling and the larger stress add loads
bonds, so that hardly a contact breaks as the hole is drilled. What sets in free grains has to bear
more, and stresses guide a fracture the less, the more T is above their difference: with cement of
twice each state's largest stress, set in free grains, voids and gaps left open, ten packings gave
0.88, 0.83, 1.49 and 1.31, and one of them was 45° off at 2:1. The recipe was chosen on packings 1
to 10; on 11 to 20, not seen before, it gave 0.96, 0.86, 1.42 and 1.20, 8° and at most 17° off at
2:1, 9° at 3:1, and one to five contacts broke before in three of 50 runs.

The fracture's direction is read once it has run as far into the rock as the hole is wide: the
principal axis through the hole of the contacts that injection broke, weighed by their widths, off
the largest stress. The variable FIRST says which packing is the first, PACKINGS how many there are,
PROCESSES how many run at once.
"""

from __future__ import annotations

import dataclasses
import math
import os
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import NamedTuple

import numpy as np

from demflow.model.coupling.breaking import March, Wells, start
from demflow.model.coupling.setting import setting
from demflow.model.scene import Bonds, FailureTest
from demflow.model.stages import STAGES, run_stages
from tests.benchmarks.breaking_keeps_its_books import bored
from tests.benchmarks.result import Result

FIRST = int(os.environ.get("FIRST", "1"))
SEEDS = tuple(range(FIRST, FIRST + int(os.environ.get("PACKINGS", "10"))))
PROCESSES = int(os.environ.get("PROCESSES", "1"))
STRESS, RATE = 10e6, -3e-3
CEMENT, GAP = 30e6, 0.1  # its tensile strength; mean radii between grains that it fills
HOLES = {5.0: 1000, 10.0: 2000}  # radii of the hole in mean radii: grains
CASES = ((1.0, 5.0), (1.0, 10.0), (2.0, 5.0), (2.0, 10.0), (3.0, 5.0))  # σ1 / σ3, radii
LOW, HIGH, AT_TWO = 0.8, 1.1, 1.4
MEAN_OFF, EACH_OFF = {2.0: 15.0, 3.0: 12.0}, {2.0: 30.0, 3.0: math.inf}  # degrees
EVERY, MOST = 0.01, 400  # s between looks at the well, and most of them
FALLEN = 0.99  # of its highest pressure, at which a well counts as broken down
FAR = 3.0  # hole radii from its middle: there a fracture's direction is read


class Broken(NamedTuple):
    """One packing's breakdown."""

    ratio: float  # of the highest pressure to 3 σ3 − σ1 + T
    off: float  # degrees between the fracture and the largest stress
    entered: float  # the same of the formula for a wall that fluid enters, of the packing's own ν
    leaked: float  # part of what was injected that is not in the hole as it breaks
    at_zero: int  # contacts that broke before anything was injected


def broken(stresses: float, radii: float, seed: int) -> Broken:
    """Break one packing down, at a ratio of the stresses."""
    scene = bored(seed, count=HOLES[radii], stress=(STRESS, stresses * STRESS))
    packed_at_depth = dataclasses.replace(
        scene.grains, porosity=None, packing_friction=0.0, packing_stress=STRESS, floaters="fit"
    )
    scene = dataclasses.replace(
        scene,
        grains=packed_at_depth,
        bonds=Bonds(
            kind="parallel",
            tensile_strength=CEMENT,
            shear_strength=4.0 * CEMENT,
            installation_gap=GAP,
        ),
    )
    tested = dataclasses.replace(
        scene,
        stress=None,
        wells=(),
        boundaries=(),
        coupling=None,
        matrix=None,
        fluid=None,
        initial_pressure=None,
        times=(),
        test=FailureTest(kind="tension"),
        observe=("peak_strength", "elastic_moduli"),
    )
    products = run_stages(tested)
    packed, measured = products["pack"], products["observe"]
    strength, poisson = float(measured["peak_strength"]), float(measured["elastic_poissons_ratio"])
    well = dataclasses.replace(
        scene.wells[0], radius=radii * float(packed.radius.mean()), rate=RATE
    )
    scene = dataclasses.replace(scene, wells=(well,))
    told = next(s for s in STAGES if s.name == "fracture").given(scene, 0)
    keepers = len(told["wet"].sides)
    given = setting(packed, None, rock=told["rock"], wet=told["wet"], wells=told["wells"])
    march = March(given, given.u, keepers, told["tolerance"])
    state = march.drained(start(given, keepers))
    march.origin, at_zero, mass = state.u, len(march.events), state.mass
    bore, none = given.well[0], np.zeros(len(mass))
    inflow = none.copy()
    inflow[bore] = -RATE / given.case.unit**2
    wells = Wells(inflow, none.astype(bool), none, np.empty(0, np.int64))
    peak = leaked = math.nan
    for end in np.arange(1, MOST + 1) * EVERY:
        before, state = state, march.to(state, float(end), wells)
        if math.isnan(peak) and (state.p[bore] < FALLEN * march.highest[0] or state.stopped):
            peak = given.case.stiffness * float(march.highest[0])
            leaked = 1.0 - float(before.mass[bore] - mass[bore]) / before.ledger.injected
        broke = np.array([event.contact for event in march.events[at_zero:]], dtype=np.int64)
        x, y = (given.case.unit * c[broke] for c in (given.case.skeleton.x, given.case.skeleton.y))
        far = np.hypot(x, y).max(initial=0.0) / well.radius
        if state.stopped or (not math.isnan(peak) and (stresses == 1.0 or far > FAR)):
            break
    length = given.case.skeleton.half_width[broke]
    return Broken(
        peak / ((3.0 - stresses) * STRESS + strength),
        off_axis(x, y, length),
        1.0 / (1.0 + poisson),
        leaked,
        at_zero,
    )


def off_axis(x: np.ndarray, y: np.ndarray, length: np.ndarray) -> float:
    """Degrees between the principal axis through (0, 0) of places (m), weighed, and y, (0 … 90)."""
    axis = 0.5 * math.atan2(2.0 * float(length @ (x * y)), float(length @ (x**2 - y**2)))
    return 90.0 - abs(math.degrees(axis))


def run(seeds: tuple[int, ...] = SEEDS) -> Result:
    """Every case, in the mean over packings."""
    asked = [(*case, seed) for case in CASES for seed in seeds]
    with ProcessPoolExecutor(PROCESSES, get_context("spawn")) as lanes:
        each = list(lanes.map(broken, *zip(*asked, strict=True)))
    n = len(seeds)
    return judged({case: each[k * n : (k + 1) * n] for k, case in enumerate(CASES)})


def judged(found: dict[tuple[float, float], list[Broken]]) -> Result:
    """What was found of each case against the bounds."""
    mean = {case: float(np.mean([one.ratio for one in each])) for case, each in found.items()}
    holds = all(LOW <= mean[case] <= HIGH for case in CASES if case[0] == 1.0)
    holds &= mean[2.0, 10.0] < mean[2.0, 5.0] and mean[2.0, 10.0] <= AT_TWO
    holds &= all(one.at_zero == 0 for each in found.values() for one in each)
    off = {}
    for stresses in MEAN_OFF:
        each = [one.off for case, ones in found.items() if case[0] == stresses for one in ones]
        off[stresses] = f"{np.mean(each):.0f}° in the mean, {max(each):.0f}° at most"
        holds &= float(np.mean(each)) <= MEAN_OFF[stresses] and max(each) <= EACH_OFF[stresses]
    return Result(
        "breakdown over 3 σ3 − σ1 + T: "
        + ", ".join(f"{m:.2f} at {c[0]:g}:1 and {c[1]:g} R" for c, m in mean.items() if c[0] < 3.0)
        + "; off the largest stress "
        + ", ".join(f"{told} at {stresses:g}:1" for stresses, told in off.items()),
        f"{LOW} to {HIGH} at 1:1; falling, ≤ {AT_TWO} at 2:1 and 10 R; ≤ 15° and 30° each at 2:1, "
        "≤ 12° at 3:1; none broken before",
        bool(holds),
        "\n".join(
            f"{case[0]:g}:1, {case[1]:g} R, packing {FIRST + k}: {one.ratio:.3f} "
            f"({one.entered:.3f} if fluid enters the wall), {one.leaked:.1%} leaked, "
            f"{one.off:.0f}° off, {one.at_zero} broken before"
            for case, each in found.items()
            for k, one in enumerate(each)
        ),
    )
