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
    return bounds.box


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
    """Mean unbalanced force over the grains on which anything acts."""
    return sums.unbalanced


@by_type
def follows_path(bounds: Any) -> bool:
    """Whether stresses are led along the servo's path; else its target is held at once."""
    return True


@by_type
def off_target(bounds: Any, servo: Servo, sums: Sums, wanted_xx: float, wanted_yy: float) -> float:
    """Relative error of the stresses that the servo wants."""
    return stress_error(servo, sums, bounds.box, wanted_xx, wanted_yy)


@by_type
def swings_for_ever(
    bounds: Any, servo: Servo, swings: Array, sums: Sums, wanted_xx: float, wanted_yy: float
) -> bool:
    """Whether the servo overshoots without decay, see `servo.oscillates`."""
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
    """Carry the bounds with a stretch."""
    move_walls(servo, sums, bounds.box, kn, wanted_xx, wanted_yy, stretch_x, stretch_y)
