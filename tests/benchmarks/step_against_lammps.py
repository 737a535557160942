"""A step with friction and history against LAMMPS gran/hooke/history with damping/cundall.

The same packings of 5,000 and 50,000 discs. Ours is a real run towards 2:1, with its walls,
servo, stress path and measures; LAMMPS holds the packing by its periodic images, at rest, so
that it rebuilds no list. One thread each; processor time.
"""

from __future__ import annotations

from tests.benchmarks.result import Result
from tests.benchmarks.steps import FRICTION, REPEATS, our_steps, periodic, rock
from tests.peers.lammps import lammps_steps
from tests.peers.yade import PeerMissingError

SIZES = (5_000, 50_000)
BOUND = 0.28


def run() -> Result:
    """Best of several runs on either side."""
    worst, lines = 0.0, []
    for size in SIZES:
        packing = rock(size)
        n = len(packing.x)
        steps = max(100, 4_000_000 // n)
        try:
            seconds, touching = lammps_steps(
                **periodic(packing), friction=FRICTION, steps=steps, repeats=REPEATS
            )
        except PeerMissingError as missing:
            return Result("not measured", f"≤ {BOUND}", False, str(missing))
        ours, specimen = our_steps(packing, None)
        theirs = [s / steps / n * 1e9 for s in seconds]
        ratio = min(ours) / min(theirs)
        worst = max(worst, ratio)
        lines.append(
            f"{n} discs: ratio {ratio:.3f}; ours {min(ours):.1f} to {max(ours):.1f} ns per disc "
            f"and step ({specimen.sums.contacts / n:.2f} contacts a disc), LAMMPS "
            f"{min(theirs):.1f} to {max(theirs):.1f} ns ({touching:.2f})"
        )
    return Result(f"{worst:.3g} of its time", f"≤ {BOUND}", worst <= BOUND, "\n".join(lines))
