"""Four frictionless walls and an affine strain rate, servo-controlled to wanted stresses.

Walls alone need steps in proportion to the width of the specimen, since each pushes only
its own neighbours. Here the mean stress drives a uniform stretch of grains and walls, and
each wall besides follows the error of its own force. Stresses are positive in compression.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from demflow.model.compile import kernel
from demflow.model.mechanics.contact.contacts import Sums
from demflow.model.mechanics.contact.grains import Array


class Servo(NamedTuple):
    """A straight stress path from start to target, and how it is followed."""

    start_xx: float
    start_yy: float
    target_xx: float
    target_yy: float
    pace: float = np.inf  # part of the path covered by one step, over √(smaller stress)
    band: float = np.inf  # relative lag of the stresses behind the path at which it waits
    calm: float = np.inf  # unbalance, over what the run allows at its end, that halves the pace
    gain: float = 0.05  # part of the error in the mean stress that one step corrects; 0: no servo
    wall_gain: float = 0.3  # part of the error in each wall's force that one step corrects
    modulus: float = 0.5  # stress per strain that the gain assumes, in units of k_n
    limit: float = 5e-5  # largest strain in one step
    drive_x: float = np.nan  # strain of each step in x, extension positive, in place of a stress
    drive_y: float = np.nan
    lift: float = 0.0  # half of the grains' weight: what the bottom wall bears more, the top less


SWINGS = 100  # of the mean stress about its target, without decay, at which a servo oscillates
DECAY = 0.8  # of the largest error, from swing to swing or over all of them, that counts as such
STRONG = 0.05  # error of the mean stress, relative, below which a swing is noise
TOO_STIFF = (  # why a servo oscillates, and what to try
    "the specimen is far stiffer than its grains; try a bonds.modulus of less than some 30 times "
    "theirs"
)

LEAD = 5e-3  # weight of a step in the mean strain of the steps before, with which a path goes on

STANDING = Servo(1.0, 1.0, 1.0, 1.0, gain=0.0)  # a box that does not move


@kernel
def setpoint(servo: Servo, progress: float) -> tuple[float, float]:
    """Wanted stresses (xx, yy) at a fraction of the path."""
    return (
        servo.start_xx + progress * (servo.target_xx - servo.start_xx),
        servo.start_yy + progress * (servo.target_yy - servo.start_yy),
    )


@kernel
def advanced(servo: Servo, wanted_xx: float, wanted_yy: float, ratio: float) -> float:
    """Part of the path that one step covers: less, the further from equilibrium.

    `ratio` is the mean unbalanced force over what the run allows at its end.

    Parameters
    ----------
    servo : what the walls are to do
    wanted_xx : stress xx that is wanted now, over k_n
    wanted_yy : stress yy that is wanted now, over k_n
    ratio : mean unbalanced force over what the run allows at its end
    """
    found: float = servo.pace * np.sqrt(min(wanted_xx, wanted_yy)) / (1.0 + ratio / servo.calm)
    return found


@kernel
def clip(value: float, limit: float) -> float:
    """Value within ±limit."""
    return min(max(value, -limit), limit)


@kernel
def mean_stresses(sums: Sums, box: Array) -> tuple[float, float]:
    """Mean stresses (xx, yy) over the box: at rest those of its walls.

    Loads from outside, such as a pressure in a hole, bear their part: without their moment the
    stretch would be set against the walls.
    """
    area = (box[1] - box[0]) * (box[3] - box[2])
    return (sums.virial_xx + sums.load_xx) / area, (sums.virial_yy + sums.load_yy) / area


@kernel
def stretches(
    servo: Servo,
    sums: Sums,
    box: Array,
    wanted_xx: float,
    wanted_yy: float,
    lead_x: float = 0.0,
    lead_y: float = 0.0,
) -> tuple[float, float]:
    """Strains of one step in x and y, extension positive: clip[ε_lead + g (σ − σ_wanted) / M].

    σ is the mean stress by the actual branch vectors; r_a + r_b instead would set the stretch
    against the walls. ε_lead, the mean strain of the steps before, lets the stresses follow a
    path without lagging behind in proportion to 1 / g.

    Parameters
    ----------
    servo : what the walls are to do
    sums : sums over contacts and walls of the step
    box : walls xmin, xmax, ymin, ymax, (4,)
    wanted_xx : stress xx that is wanted now, over k_n
    wanted_yy : stress yy that is wanted now, over k_n
    lead_x : mean strain of the steps before, along x
    lead_y : the same along y
    """
    mean_xx, mean_yy = mean_stresses(sums, box)
    factor = servo.gain / servo.modulus
    stretch_x, stretch_y = servo.drive_x, servo.drive_y
    if np.isnan(stretch_x):
        stretch_x = clip(lead_x + factor * (mean_xx - wanted_xx), servo.limit)
    if np.isnan(stretch_y):
        stretch_y = clip(lead_y + factor * (mean_yy - wanted_yy), servo.limit)
    return stretch_x, stretch_y


@kernel
def move_walls(
    servo: Servo,
    sums: Sums,
    box: Array,
    kn: float,
    wanted_xx: float,
    wanted_yy: float,
    stretch_x: float,
    stretch_y: float,
) -> None:
    """Carry the walls with the stretch, and correct each by its own force error.

    A wall's stiffness is that of its contacts, n k_n. Walls that are driven are not corrected.

    Parameters
    ----------
    servo : what the walls are to do
    sums : sums over contacts and walls of the step
    box : walls xmin, xmax, ymin, ymax, (4,)
    kn : normal stiffness of contacts
    wanted_xx : stress xx that is wanted now, over k_n
    wanted_yy : stress yy that is wanted now, over k_n
    stretch_x : affine strain of the step along x, extension positive
    stretch_y : the same along y
    """
    width, height = box[1] - box[0], box[3] - box[2]
    far_x, far_y = servo.limit * width, servo.limit * height
    gain = servo.wall_gain / kn
    push_x, push_y = wanted_xx * height, wanted_yy * width
    correct_x = 1.0 if np.isnan(servo.drive_x) else 0.0
    correct_y = 1.0 if np.isnan(servo.drive_y) else 0.0
    box[0] += stretch_x * box[0] - correct_x * clip(
        gain * (sums.left - push_x) / max(sums.left_contacts, 1), far_x
    )
    box[1] += stretch_x * box[1] + correct_x * clip(
        gain * (sums.right - push_x) / max(sums.right_contacts, 1), far_x
    )
    box[2] += stretch_y * box[2] - correct_y * clip(
        gain * (sums.bottom - (push_y + servo.lift)) / max(sums.bottom_contacts, 1), far_y
    )
    box[3] += stretch_y * box[3] + correct_y * clip(
        gain * (sums.top - (push_y - servo.lift)) / max(sums.top_contacts, 1), far_y
    )


@kernel
def stress_error(servo: Servo, sums: Sums, box: Array, wanted_xx: float, wanted_yy: float) -> float:
    """Largest relative error of the wall stresses and the mean stresses that are wanted.

    Parameters
    ----------
    servo : what the walls are to do
    sums : sums over contacts and walls of the step
    box : walls xmin, xmax, ymin, ymax, (4,)
    wanted_xx : stress xx that is wanted now, over k_n
    wanted_yy : stress yy that is wanted now, over k_n
    """
    width, height = box[1] - box[0], box[3] - box[2]
    mean_xx, mean_yy = mean_stresses(sums, box)
    worst_x = max(
        abs(sums.left / height - wanted_xx),
        abs(sums.right / height - wanted_xx),
        abs(mean_xx - wanted_xx),
    )
    worst_y = max(
        abs((sums.bottom - servo.lift) / width - wanted_yy),
        abs((sums.top + servo.lift) / width - wanted_yy),
        abs(mean_yy - wanted_yy),
    )
    error_x = worst_x / wanted_xx if np.isnan(servo.drive_x) else 0.0
    error_y = worst_y / wanted_yy if np.isnan(servo.drive_y) else 0.0
    return max(error_x, error_y)


@kernel
def oscillates(
    servo: Servo, swings: Array, sums: Sums, box: Array, wanted_xx: float, wanted_yy: float
) -> bool:
    """Whether a mean stress swung about its target SWINGS times in a row without decay.

    `swings` (2, 4) remembers of xx and yy: the last error, the largest one since its sign
    changed, that of the swing with which others are compared, and how many did not fall below
    DECAY of it. It starts as zeros. A direction that is driven is not watched.

    Parameters
    ----------
    servo : what the walls are to do
    swings : memory (2, 4), see `servo.oscillates`
    sums : sums over contacts and walls of the step
    box : walls xmin, xmax, ymin, ymax, (4,)
    wanted_xx : stress xx that is wanted now, over k_n
    wanted_yy : stress yy that is wanted now, over k_n
    """
    mean_xx, mean_yy = mean_stresses(sums, box)
    for k in range(2):
        if not np.isnan(servo.drive_x if k == 0 else servo.drive_y):
            continue
        error = mean_xx / wanted_xx - 1.0 if k == 0 else mean_yy / wanted_yy - 1.0
        if error * swings[k, 0] < 0.0:
            swing = swings[k, 1]
            if swing < STRONG or swing < DECAY * swings[k, 2] or swings[k, 2] == 0.0:
                swings[k, 2], swings[k, 3] = swing, 0.0
            else:
                swings[k, 3] += 1.0
            swings[k, 1] = 0.0
        swings[k, 0], swings[k, 1] = error, max(swings[k, 1], abs(error))
    found: bool = max(swings[0, 3], swings[1, 3]) >= SWINGS
    return found
