"""Contact forces of one stress path do not depend on damping, gain or increments.

Unbonded grains, from the pressure of their packing to 1.5 : 1 and to 1.9 : 1, some 80 % of their
strength, in packings of about 3.86 contacts a grain. Lines besides: packings at 3.80, the edge
below which forces are not unique, where even noise of 1e-8 radii in the coordinates is seen.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from demflow.model.mechanics.loading import stress as stage
from demflow.model.mechanics.motion.equilibrium import Stop
from demflow.model.mechanics.specimen.measures import listed
from demflow.model.mechanics.specimen.rock import build_specimen
from demflow.model.products import Packing
from tests.benchmarks.result import Result, at_most
from tests.benchmarks.specimens import CONTACTS, packed

RATIOS = (1.5, 1.9)  # of the stresses; the strength is near 2.4
PRESSURE = 2e-4  # over k_n, as packed
DENSE, EDGE = 0.16, 0.165  # porosities
SEEDS = (1, 2, 3)
NOISE = 1e-8  # mean radii


class Way(NamedTuple):
    """How a path is followed."""

    damping: float = 0.5
    gain: float = 0.05
    pace: float = 1.0
    noise: float = 0.0


WAYS = {
    "as it is": Way(),
    "damping 0.8": Way(damping=0.8),
    "gain 0.02": Way(gain=0.02),
    "half the increments": Way(pace=0.5),
}


def forces(rock: Packing, ratio: float, way: Way) -> np.ndarray:
    """Normal and shear forces of all pairs that touched at first, unbonded."""
    random = np.random.default_rng(1)
    shift = way.noise * rock.radius.mean() * random.standard_normal(len(rock.x))
    specimen = build_specimen(rock._replace(x=rock.x + shift), bonds=None, **CONTACTS)
    path = stage.straight_path(PRESSURE, ratio * PRESSURE, PRESSURE)
    path = path._replace(gain=way.gain, pace=way.pace * path.pace)
    specimen.relax(path, Stop(ratio=1e-4, stress=1e-4), damping=way.damping, steps=200_000)
    grains, pairs = specimen.grains, specimen.pairs
    a, b = listed(pairs)
    distance = np.hypot(grains.x[b] - grains.x[a], grains.y[b] - grains.y[a])
    normal = np.maximum(grains.radius[a] + grains.radius[b] - distance, 0.0)
    every = np.zeros((2, len(rock.contact_a)))
    n = len(grains.x)
    first = rock.contact_a * n + rock.contact_b
    at = np.searchsorted(first, a * n + b)
    known = (at < len(first)) & (first[np.minimum(at, len(first) - 1)] == a * n + b)
    every[:, at[known]] = normal[known], pairs.shear[known]
    return every


def spread(rock: Packing, ratio: float, ways: Mapping[str, Way]) -> tuple[float, str]:
    """Largest L2 difference between any two ways, and which two."""
    found = {name: forces(rock, ratio, way) for name, way in ways.items()}
    apart = {
        f"{one} against {other}": float(
            np.linalg.norm(found[one] - found[other]) / np.linalg.norm(found[other])
        )
        for one, other in itertools.combinations(ways, 2)
    }
    widest = max(apart, key=lambda pair: apart[pair])
    return apart[widest], widest


def run() -> Result:
    """Largest L2 difference between any two ways along the path."""
    worst, lines = 0.0, []
    for porosity, seed, ratio in itertools.product((DENSE, EDGE), SEEDS, RATIOS):
        rock = packed(5000, porosity=porosity, seed=seed, floaters="leave")
        apart, widest = spread(rock, ratio, WAYS)
        noise, _ = spread(rock, ratio, {"as it is": Way(), "noise": Way(noise=NOISE)})
        if porosity == DENSE:
            worst = max(worst, apart)
        lines.append(
            f"{float(rock.coordination):.3f} contacts a grain, seed {seed}, {ratio} : 1: {widest} "
            f"{apart:.2%}; noise alone {noise:.2%}"
        )
    return at_most(worst, 0.01, "largest difference", "\n".join(lines))
