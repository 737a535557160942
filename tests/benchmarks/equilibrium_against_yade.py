"""Seconds to equilibrium against Yade with its tuned servo: 5,000 loose discs, then loaded.

The same discs, not touching at a porosity of 0.25, are brought to an isotropic pressure of
1e-3 k_n with friction 0.5 (*compact*), to 1.2 times it, to a ratio of the stresses of 1.3 : 1.1
and to 2 : 1. Both stop at an unbalanced ratio of 1e-3 and stresses within 1 %, measured anew at
the end. Ours stands between walls and follows the quasi-static paths of the *stress* stage;
Yade's cell is periodic, which is the lighter task. One thread each.
"""

import time

import numpy as np

from demflow.model.mechanics.contact.grains import Array, at_rest, scaled_mass
from demflow.model.mechanics.contact.law import Linear
from demflow.model.mechanics.loading.stress import DAMPING, path_between
from demflow.model.mechanics.motion.equilibrium import AT_REST, FIRE, TIME_STEP, Specimen, Stop
from demflow.model.mechanics.packing.compaction import hydrostatic
from tests.benchmarks.result import Result
from tests.benchmarks.steps import rock
from tests.peers.yade import run_in_yade

GRAINS, SOLID = 5000, 0.75
PRESSURE, FRICTION, STIFFNESS_RATIO = 1e-3, 0.5, 2.5
STOP = Stop(ratio=1e-3, stress=1e-2)
GOALS = np.array([(1.0, 1.0), (1.2, 1.2), (1.3, 1.1), (1.6, 0.8)]) * PRESSURE
PHASES = ("compact", "+20 %", "1.3:1.1", "2:1")
BOUNDS = (40.0, 20.0, 10.0, 5.0)


def loose_discs(count: int) -> tuple[Array, Array, Array, Array]:
    """Discs (x, y, radius) of mean radius 1 that do not touch, and the box around them."""
    packing = rock(count)
    unit = packing.radius.mean()
    x, y, radius = packing.x / unit, packing.y / unit, packing.radius / unit
    box = packing.box / unit
    area = (box[1] - box[0]) * (box[3] - box[2])
    grown = np.sqrt(np.pi * np.sum(radius**2) / (SOLID * area))
    return grown * x, grown * y, radius, grown * box


def equilibria(x: Array, y: Array, radius: Array, box: Array) -> list[tuple[float, int, float]]:
    """Seconds, steps and unbalanced ratio of each phase."""
    law = Linear(1.0, 1.0 / STIFFNESS_RATIO, FRICTION)
    start = time.perf_counter()
    specimen = Specimen(at_rest(x, y, radius, scaled_mass(radius, 1.0, TIME_STEP)), box, law)
    found = []
    before = (0.0, 0.0)
    for phase, (xx, yy) in enumerate(GOALS):
        first = specimen.steps
        if phase == 0:
            servo, damping = hydrostatic(xx), FIRE
        else:
            servo, damping = path_between(before, (xx, yy)), DAMPING
        ended = specimen.relax(servo, STOP, damping=damping, steps=200_000)
        if ended != AT_REST:
            raise RuntimeError(f"{PHASES[phase]} did not come to rest: {specimen.run}")
        found.append((time.perf_counter() - start, specimen.steps - first, specimen.run.ratio))
        start, before = time.perf_counter(), (xx, yy)
    return found


def run() -> Result:
    """Measure."""
    equilibria(*loose_discs(300))  # compiles
    x, y, radius, box = loose_discs(GRAINS)
    ours = equilibria(x, y, radius, box.copy())
    size = np.array([box[1] - box[0], box[3] - box[2]])
    theirs = run_in_yade(
        "yade_servo.py",
        x=x - box[0],
        y=y - box[2],
        radius=radius,
        size=size,
        goals=GOALS,
        friction=FRICTION,
        ratio=STOP.ratio,
        error=STOP.stress,
    )
    lines, faster = [], []
    for k, (seconds, steps, ratio) in enumerate(ours):
        faster.append(float(theirs["seconds"][k]) / seconds)
        lines.append(
            f"{PHASES[k]:8s} {seconds:.2f} s, {steps} steps, ratio {ratio:.1e}; Yade "
            f"{theirs['seconds'][k]:.1f} s, {theirs['steps'][k]} steps, {theirs['ratio'][k]:.1e}"
        )
    figure = ", ".join(f"{name} {f:.3g}" for name, f in zip(PHASES, faster, strict=True))
    return Result(
        f"times faster over {len(x)} discs: {figure}",
        "≥ 40, 20, 10, 5",
        all(f >= least for f, least in zip(faster, BOUNDS, strict=True)),
        "\n".join(lines),
    )
