"""What bounds the grains that are brought to rest, walls or a cell, chosen by its type.

Bounds are a named tuple with the field `box` (4,): xmin, xmax, ymin, ymax of the walls, or of the
cell that repeats itself (`packing.cell`). What the functions below state is done for walls.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from demflow.model.compile import by_type
from demflow.model.mechanics.contact.contacts import Sums
from demflow.model.mechanics.contact.grains import Array, Grains
from demflow.model.mechanics.motion.servo import Servo, move_walls, oscillates, stress_error


class Walls(NamedTuple):
    """Four walls that the servo moves."""

    box: Array


@by_type
def walls_of(bounds: Any) -> Array:
    """Walls (4,) that grains touch."""
    found: Array = bounds.box
    return found


@by_type
def movers(bounds: Any, grains: Grains) -> Grains:
    """The grains that move by themselves."""
    return grains


@by_type
def follow(bounds: Any, grains: Grains) -> None:
    """Let what is no grain of its own follow those that moved."""
    return


@by_type
def unbalance(bounds: Any, grains: Grains, sums: Sums) -> float:
    """Mean unbalanced force over the grains on which anything acts.

    Parameters
    ----------
    bounds : walls or a cell, a named tuple that chooses by its type
    grains : the grains (n,), in units of mean radius and k_n
    sums : sums over contacts and walls of the step
    """
    return sums.unbalanced


@by_type
def follows_path(bounds: Any) -> bool:
    """Whether stresses are led along the servo's path; else its target is held at once."""
    return True


@by_type
def off_target(bounds: Any, servo: Servo, sums: Sums, wanted_xx: float, wanted_yy: float) -> float:
    """Relative error of the stresses that the servo wants.

    Parameters
    ----------
    bounds : walls or a cell, a named tuple that chooses by its type
    servo : what the walls are to do
    sums : sums over contacts and walls of the step
    wanted_xx : stress xx that is wanted now, over k_n
    wanted_yy : stress yy that is wanted now, over k_n
    """
    return stress_error(servo, sums, bounds.box, wanted_xx, wanted_yy)


@by_type
def swings_for_ever(
    bounds: Any, servo: Servo, swings: Array, sums: Sums, wanted_xx: float, wanted_yy: float
) -> bool:
    """Whether the servo overshoots without decay, see `servo.oscillates`.

    Parameters
    ----------
    bounds : walls or a cell, a named tuple that chooses by its type
    servo : what the walls are to do
    swings : memory (2, 4), see `servo.oscillates`
    sums : sums over contacts and walls of the step
    wanted_xx : stress xx that is wanted now, over k_n
    wanted_yy : stress yy that is wanted now, over k_n
    """
    return oscillates(servo, swings, sums, bounds.box, wanted_xx, wanted_yy)


@by_type
def stretch_bounds(
    bounds: Any,
    servo: Servo,
    sums: Sums,
    kn: float,
    wanted_xx: float,
    wanted_yy: float,
    stretch_x: float,
    stretch_y: float,
) -> None:
    """Carry the bounds with a stretch.

    Parameters
    ----------
    bounds : walls or a cell, a named tuple that chooses by its type
    servo : what the walls are to do
    sums : sums over contacts and walls of the step
    kn : normal stiffness of contacts
    wanted_xx : stress xx that is wanted now, over k_n
    wanted_yy : stress yy that is wanted now, over k_n
    stretch_x : affine strain of the step along x, extension positive
    stretch_y : the same along y
    """
    move_walls(servo, sums, bounds.box, kn, wanted_xx, wanted_yy, stretch_x, stretch_y)
