"""The recipe of a packing by what is wanted of it: two of porosity, stress and friction.

For grains strewn and compacted as `compaction` does, porosity, pressure and packing friction
are one relation. Of porosity, pressure and friction any two may be asked for; the third follows:

- porosity (and pressure): friction, and below 0.17 the solid fraction at which grains are
  strewn, are searched for along RECIPES;
- friction (and pressure): one packing, whose porosity is what comes out;
- porosity and friction: the pressure is searched for.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from demflow.model.mechanics.contact.grains import Array
from demflow.model.mechanics.packing.compaction import Recipe, Trial, attempt
from demflow.model.mechanics.packing.sizes import Sizes
from demflow.model.outcome import ModelError
from demflow.model.scene.rock import PACKING_PRESSURES

PRESSURE = 2e-4  # over k_n, where none is asked for: 4 MPa for grains of 20 GPa

# Porosity that a recipe leads to (inner box, at PRESSURE), solid fraction at the start, packing
# friction; measured at radius ratio 1.66 on packings of 5,000 grains.
RECIPES = np.array(
    [
        (0.1565, 0.95, 0.0),
        (0.1597, 0.89, 0.0),
        (0.1641, 0.85, 0.0),
        (0.1675, 0.83, 0.0),
        (0.170, 0.79, 0.0),
        (0.175, 0.782, 0.05),
        (0.188, 0.773, 0.15),
        (0.195, 0.765, 0.25),
        (0.207, 0.755, 0.4),
        (0.219, 0.745, 0.7),
    ]
)
LOOSE = RECIPES[4:]  # those in which friction decides; a given friction starts as they do
SCATTER = 0.15  # of the porosity between draws, times the root of the number of grains
TOLERANCE = 0.003  # error in porosity
TRIES = 10


class Target(NamedTuple):
    """What is wanted of a packing: a porosity, a friction, or both; None is free."""

    porosity: float | None
    pressure: float | None  # over k_n; free and not searched for it is PRESSURE
    friction: float | None

    @property
    def expected_porosity(self) -> float:
        """The porosity wanted, or about the one that the friction leads to."""
        if self.porosity is not None:
            return self.porosity
        return float(np.interp(self.friction or 0.0, LOOSE[:, 2], LOOSE[:, 0]))


class Draw(NamedTuple):
    """What all tries of a packing share."""

    size: Array  # (2,) mean radii, at the expected porosity
    law: Sizes
    seed: int
    fits: bool
    periodic: bool
    expected_porosity: float

    def attempt(self, recipe: Recipe, draw: int = 0) -> Trial:
        """A packing by a recipe, from the numbers of one draw."""
        return attempt(
            recipe, self.expected_porosity, self.size, self.law, [self.seed, draw],
            fits=self.fits, periodic=self.periodic,
        )  # fmt: skip


def meet(
    target: Target,
    size: Array,
    law: Sizes,
    seed: int,
    *,
    fits: bool = False,
    periodic: bool = False,
) -> Trial:
    """A packing at rest as wanted, in a box or cell of about `size` (width, height; mean radii).

    Raises ModelError where the target lies outside what can be reached, naming that, or where
    grains do not come to rest.

    Parameters
    ----------
    target : what is wanted of the packing
    size : width and height, (2,) in mean radii
    law : of the radii
    seed : of what is drawn at random
    fits : whether floaters are fitted into their voids
    periodic : whether in a cell that repeats itself
    """
    draw = Draw(size, law, seed, fits, periodic, target.expected_porosity)
    if target.friction is None:
        assert target.porosity is not None  # one of the two is given
        return find_friction(target.porosity, target.pressure or PRESSURE, draw)
    if target.porosity is not None:
        return find_pressure(target.porosity, target.friction, draw)
    trial = draw.attempt(by_friction(target.friction, target.pressure or PRESSURE))
    if not trial.rested:
        raise ModelError(
            f"no packing of friction {target.friction:g} came to rest (radius ratio "
            f"{law.ratio:g}, stress {trial.recipe.pressure:.3g} k_n); try another grains.seed, a "
            "higher grains.packing_stress or a lower grains.packing_friction"
        )
    return trial


def by_porosity(nominal: float, pressure: float) -> Recipe:
    """The recipe of the table, interpolated, that leads to a porosity at PRESSURE."""
    start, friction = (float(np.interp(nominal, RECIPES[:, 0], RECIPES[:, k])) for k in (1, 2))
    return Recipe(start, friction, pressure)


def by_friction(friction: float, pressure: float) -> Recipe:
    """The recipe of a packing friction: strewn so loosely that friction decides the porosity."""
    return Recipe(float(np.interp(friction, LOOSE[:, 2], LOOSE[:, 1])), friction, pressure)


def find_friction(wanted: float, pressure: float, draw: Draw) -> Trial:
    """A packing of a porosity at a pressure.

    Recipes are named by the porosity that the table promises. The first is the wanted one;
    the next is corrected by what came out, or lies between two that missed on either side. At
    the end of the table grains are drawn anew as long as scatter may explain the miss.

    Parameters
    ----------
    wanted : porosity
    pressure : over k_n
    draw : packs by a recipe
    """
    least, greatest = float(RECIPES[0, 0]), float(RECIPES[-1, 0])
    nominal = min(max(wanted, least), greatest)
    dense = loose = None  # recipes on either side of the wanted porosity
    best: Trial | None = None
    number = steps = 0
    for _ in range(TRIES):
        trial = draw.attempt(by_porosity(nominal, pressure), number)
        steps = _add_steps(trial, steps)
        miss = trial.porosity - wanted
        if trial.rested and (best is None or abs(miss) < abs(best.porosity - wanted)):
            best = trial
        if best is not None and abs(best.porosity - wanted) <= TOLERANCE:
            return best
        if miss < 0:
            dense = nominal
        else:
            loose = nominal
        if dense is not None and loose is not None:
            nominal = 0.5 * (dense + loose)
        elif (miss < 0 and nominal == greatest) or (miss > 0 and nominal == least):
            scatter = SCATTER / np.sqrt(len(trial.specimen.grains.x))
            if abs(miss) > TOLERANCE + scatter:
                break
            number += 1
        else:
            nominal = min(max(nominal - 1.2 * miss, least), greatest)
    ratio = draw.law.ratio
    if dense is None or loose is None:
        low, high = (draw.attempt(by_porosity(end, pressure)).porosity for end in (least, greatest))
        if not low <= wanted <= high:
            raise ModelError(
                f"porosity {wanted:g} cannot be reached: random packings of radius ratio {ratio:g} "
                f"at a stress of {pressure:.3g} k_n reach about {low:.3f} to {high:.3f}; choose "
                "grains.porosity in that range"
            )
    raise ModelError(
        f"no packing of porosity {wanted:g} came to rest in {TRIES} tries (radius ratio "
        f"{ratio:g}); try another grains.seed, a porosity nearer to 0.17, or more grains"
    )


def find_pressure(wanted: float, friction: float, draw: Draw) -> Trial:
    """A packing of a porosity with a packing friction; the pressure is what they need.

    Porosity falls as the pressure rises, about linearly in its root, in which it is interpolated
    between the nearest tries on either side.

    Parameters
    ----------
    wanted : porosity
    friction : Coulomb coefficient while packing
    draw : packs by a recipe
    """
    known: list[tuple[float, float]] = []  # root of the pressure, miss
    steps = 0
    best: Trial | None = None
    low, high = np.sqrt(PACKING_PRESSURES)
    for root in (low, high, *([None] * (TRIES - 2))):
        if root is None:
            loose = max((k for k in known if k[1] > 0.0), default=None)
            dense = min((k for k in known if k[1] <= 0.0), default=None)
            if loose is None or dense is None or loose[0] >= dense[0]:
                break
            part = np.clip(loose[1] / (loose[1] - dense[1]), 0.1, 0.9)
            root = loose[0] + part * (dense[0] - loose[0])
        trial = draw.attempt(by_friction(friction, float(root) ** 2))
        steps = _add_steps(trial, steps)
        miss = trial.porosity - wanted
        known.append((float(root), miss))
        if trial.rested and (best is None or abs(miss) < abs(best.porosity - wanted)):
            best = trial
        if best is not None and abs(best.porosity - wanted) <= TOLERANCE:
            return best
    loosest, densest = (wanted + miss for _, miss in known[:2])
    if densest <= wanted <= loosest:
        raise ModelError(
            f"no packing of porosity {wanted:g} and packing friction {friction:g} came to rest in "
            f"{len(known)} tries, though such packings reach about {densest:.3f} to {loosest:.3f} "
            f"(radius ratio {draw.law.ratio:g}); try another grains.seed, a higher "
            "grains.porosity, more grains, or leave grains.packing_friction out"
        )
    raise ModelError(
        f"porosity {wanted:g} and packing friction {friction:g} contradict each other: with that "
        f"friction packings of radius ratio {draw.law.ratio:g} reach about {densest:.3f} (at "
        f"{PACKING_PRESSURES[1]:g} k_n) to {loosest:.3f} (at {PACKING_PRESSURES[0]:g} k_n); choose "
        "grains.porosity in that range, or leave grains.packing_friction out"
    )


def _add_steps(trial: Trial, before: int) -> int:
    """Count what the tries before it took as part of a trial's cost; returns the sum."""
    trial.specimen.steps += before
    return trial.specimen.steps
