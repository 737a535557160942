"""Contact forces of one stress path do not depend on damping, gain or increments."""

from __future__ import annotations

import itertools

import numpy as np

from model.mechanics import stress as stage
from model.mechanics.equilibrium import Stop
from tests.benchmarks.result import Result, at_most
from tests.benchmarks.specimens import CONTACTS, packed

RATIO = 1.9  # of the stresses; the strength is near 2.4
PRESSURE = 2e-4  # over k_n, as packed


def forces(damping: float, gain: float, pace: float) -> np.ndarray:
    """Normal and shear forces of all pairs that touched at first, unbonded."""
    rock = packed(5000, floaters="leave")
    specimen = stage.specimen_of(rock, bonds=None, **CONTACTS)
    path = stage.straight_path(PRESSURE, RATIO * PRESSURE, PRESSURE)
    path = path._replace(gain=gain, pace=pace * path.pace)
    specimen.relax(path, Stop(ratio=1e-4, stress=1e-4), damping=damping, steps=200_000)
    grains, pairs = specimen.grains, specimen.pairs
    a = np.repeat(np.arange(len(grains.x)), np.diff(pairs.start))
    b = pairs.other
    distance = np.hypot(grains.x[b] - grains.x[a], grains.y[b] - grains.y[a])
    normal = np.maximum(grains.radius[a] + grains.radius[b] - distance, 0.0)
    every = np.zeros((2, len(rock.contact_a)))
    n = len(grains.x)
    first = rock.contact_a * n + rock.contact_b
    at = np.searchsorted(first, a * n + b)
    known = (at < len(first)) & (first[np.minimum(at, len(first) - 1)] == a * n + b)
    every[:, at[known]] = normal[known], pairs.shear[known]
    return every


def run() -> Result:
    """Largest L2 difference between any two ways along the path."""
    ways = {
        "damping 0.5": (0.5, 0.05, 1.0),
        "damping 0.8": (0.8, 0.05, 1.0),
        "gain 0.02": (0.5, 0.02, 1.0),
        "half the increments": (0.5, 0.05, 0.5),
    }
    found = {name: forces(*way) for name, way in ways.items()}
    worst, lines = 0.0, [f"coordination {float(packed(5000, floaters='leave').coordination):.2f}"]
    for one, other in itertools.combinations(ways, 2):
        apart = float(np.linalg.norm(found[one] - found[other]) / np.linalg.norm(found[other]))
        worst = max(worst, apart)
        lines.append(f"{one} against {other}: {apart:.2%}")
    return at_most(worst, 0.01, "largest difference", "\n".join(lines))
