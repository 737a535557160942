"""A specimen held whole, as a product: what a march goes on from, in its next leg or process.

A `StressState` tells what grains carry; this holds besides all that they and their contacts,
bonds and joints remember, and where their motion stands, so that it goes on with the same bits.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from demflow.model.mechanics.contact.bonds import BondState
from demflow.model.mechanics.contact.contacts import Sums
from demflow.model.mechanics.contact.grains import Array, Grains
from demflow.model.mechanics.contact.joints import Joints, JointState, Trace
from demflow.model.mechanics.contact.law import Law
from demflow.model.mechanics.contact.neighbours import Pairs
from demflow.model.mechanics.motion.equilibrium import Run, Specimen


class Lines(NamedTuple):
    """Traces of smooth joints, and the sides of them on which grains lay when they came."""

    traces: Array  # (k, 10) start x, y, end x, y, then the numbers of `joints.Trace`
    x: Array  # (n,) centres of the grains then
    y: Array
    made: Array  # () bool: whether the first contacts have joined
    found: Array  # (k,) bool: it has crossed a contact


class Body(NamedTuple):
    """All of a specimen of n grains but the law of its contacts; in the specimen's units."""

    grains: Grains
    pairs: Pairs
    bonds: BondState
    joints: JointState
    lines: Lines
    box: Array  # (4,) walls xmin, xmax, ymin, ymax
    first_box: Array  # (4,) as the specimen was made
    run: Run
    sums: Sums
    swings: Array  # (2, 4) memory of `servo.oscillates`
    dt: float
    skin: float
    steps: int
    rebuilds: int
    ledger: Array  # (13,) of energies, empty where none is kept
    opening: Array


def body_of(specimen: Specimen) -> Body:
    """A specimen that was moved, as it stands; whatever becomes of it, the body stays."""
    lines = specimen.lines
    rows = [[*trace.start, *trace.end, *trace[2:]] for trace in lines.traces]
    none = np.empty(0)
    found: Body = _copied(
        Body(
            grains=specimen.grains,
            pairs=specimen.pairs,
            bonds=specimen.bonds,
            joints=specimen.joints,
            lines=Lines(
                traces=np.array(rows, dtype=float).reshape(-1, 10),
                x=lines.x,
                y=lines.y,
                made=np.asarray(lines.made),
                found=lines.found,
            ),
            box=specimen.box,
            first_box=specimen.first_box,
            run=specimen.run,
            sums=specimen.sums,
            swings=specimen.swings,
            dt=specimen.dt,
            skin=specimen.width,
            steps=specimen.steps,
            rebuilds=specimen.rebuilds,
            ledger=none if specimen.ledger is None else specimen.ledger,
            opening=none if specimen.opening is None else specimen.opening,
        )
    )
    return found


def specimen_of(body: Body, law: Law) -> Specimen:
    """The specimen that a body holds, to be moved on; the body stays as it is.

    Under the servo that it was under it goes on as if it had never been put away, bit by bit.
    `law` is that of its contacts, which the parameters of a scene say.
    """
    own = _copied(body)
    specimen = Specimen(own.grains, own.box, law, dt=own.dt, bonds=own.bonds, known=own.pairs)
    traces = [
        Trace((row[0], row[1]), (row[2], row[3]), *row[4:]) for row in own.lines.traces.tolist()
    ]
    lines = Joints(traces, own.grains)
    lines.x, lines.y, lines.found = own.lines.x, own.lines.y, own.lines.found
    lines.made = bool(own.lines.made)
    specimen.pairs, specimen.joints, specimen.lines = own.pairs, own.joints, lines
    specimen.width = own.skin
    specimen.first_box, specimen.run, specimen.sums = own.first_box, own.run, own.sums
    specimen.swings, specimen.steps, specimen.rebuilds = own.swings, own.steps, own.rebuilds
    if own.ledger.size:
        specimen.ledger, specimen.opening = own.ledger, own.opening
    return specimen


def _copied(value: Any) -> Any:
    """A named tuple with arrays of its own, and so are those in it."""
    if hasattr(value, "_fields"):
        return type(value)(*map(_copied, value))
    return value.copy() if isinstance(value, np.ndarray) else value
