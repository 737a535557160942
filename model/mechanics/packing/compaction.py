"""One packing by one recipe: grains strewn, parted, compacted and brought to rest.

In units of the mean radius, the normal stiffness and the mass of a grain, so that forces over
k_n are lengths:

1. Radii are drawn by their law, strewn over a box, and parted without friction. Strewn so
   densely that they overlap, grains end dense; strewn loosely, they end where friction lets
   them jam.
2. With the packing friction, the servo brings the box to COMPACTION, or to the recipe's
   pressure if that is higher.
3. Still with the packing friction, the pressure falls to the recipe's, for EASING steps at
   most: near jamming, the last of it would take very many.
4. Friction is raised, so that the last motion dies quickly, until grains are at REST. Forces
   hardly change.

The other phases have bounds that are not met as a rule; a packing that meets one is not at rest.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from demflow.model.mechanics.contact.grains import Array, along_strips, at_rest, scaled_mass
from demflow.model.mechanics.contact.law import Linear
from demflow.model.mechanics.contact.neighbours import find_pairs
from demflow.model.mechanics.motion.equilibrium import AT_REST, FIRE, TIME_STEP, Specimen, Stop
from demflow.model.mechanics.motion.servo import STANDING, Servo
from demflow.model.mechanics.packing.cell import Cell
from demflow.model.mechanics.packing.floaters import fit
from demflow.model.mechanics.packing.grading import strew
from demflow.model.mechanics.packing.sizes import Sizes, draw_radii
from demflow.model.mechanics.packing.tiles import tiled
from demflow.model.mechanics.specimen import measures
from demflow.model.outcome import ModelError

COMPACTION = 1e-3  # least pressure of phase 2, over k_n
SHEAR_STIFFNESS = 1.0 / 2.5  # over the normal stiffness, while packing
WALL_LAYER = 6.0  # mean radii from each wall in which porosity is not measured
PATCH = 16  # grains strewn over each patch
STRIP = 8.0  # mean radii, in which grains follow one another in memory
RING = 12.0  # mean radii around a cell in which floaters are fitted to measure it
RESTING_FRICTION = 10.0  # of the last phase
APART = 1e-5  # mean contact force over k_n r below which strewn grains count as parted
REST = Stop(ratio=1e-3, stress=5e-3)
PARTING, COMPACTING, EASING, RESTING = 3000, 4000, 1000, 12000  # most steps of each phase


class Recipe(NamedTuple):
    """How a packing is made."""

    start: float  # solid fraction at which grains are strewn
    friction: float  # of phases 2 and 3
    pressure: float  # over k_n, at which grains come to rest


class Trial(NamedTuple):
    """A packing by one recipe."""

    specimen: Specimen | Cell
    recipe: Recipe
    porosity: float  # of the inner box, or of a periodic cell
    rested: bool  # whether it came to rest
    fitted: tuple[Array, Array]  # contacts without force of floaters that were fitted


def attempt(
    recipe: Recipe,
    porosity: float,
    size: Array,
    law: Sizes,
    seeds: list[int],
    *,
    fits: bool = False,
    periodic: bool = False,
) -> Trial:
    """Pack by one recipe, between walls or in a periodic cell; other arguments as for `strewn`.

    `fits` fits floaters into their voids; those of a periodic cell where it is repeated, so that
    they count in the porosity only.

    Parameters
    ----------
    recipe : pressure, friction and what else grains are packed by
    porosity : part of the area that no grain covers
    size : width and height, (2,) in mean radii
    law : of the radii
    seeds : of this attempt
    fits : whether floaters are fitted into their voids
    periodic : whether in a cell that repeats itself, without walls
    """
    rng = np.random.Generator(np.random.PCG64(seeds))
    specimen = strewn(size, law, porosity, recipe.start, rng, Cell if periodic else Specimen)
    rested = compact(specimen, recipe)
    none = np.empty(0, np.int64)
    fitted = none, none
    if isinstance(specimen, Cell):
        found = specimen.porosity
        if fits:
            sides = specimen.box[[1, 3]] - specimen.box[[0, 2]]
            part = tiled(specimen, sides + 2.0 * RING, fits=True)
            found = measures.porosity(part.x, part.y, part.radius, specimen.box)
        return Trial(specimen, recipe, found, rested, fitted)
    if fits:
        fitted = fit_floaters(specimen)
    grains = specimen.grains
    found = measures.porosity(grains.x, grains.y, grains.radius, inner_box(specimen.box))
    return Trial(specimen, recipe, found, rested, fitted)


def strewn(
    size: Array,
    law: Sizes,
    porosity: float,
    start: float,
    rng: np.random.Generator,
    kind: type[Specimen] | type[Cell] = Specimen,
) -> Specimen | Cell:
    """Grains strewn at the solid fraction `start`, parted without friction in a standing box.

    At the wanted porosity they fill a box of `size` (width, height; mean radii). Raises
    ModelError where they do not part.

    Parameters
    ----------
    size : width and height, (2,) in mean radii
    law : of the radii
    porosity : that is wanted in the end
    start : solid fraction at which grains are strewn
    rng : source of randomness
    kind : between walls, or in a cell
    """
    if law.grading is None:
        x, y, radius, box = _evenly(size, law, porosity, start, rng)
    else:
        share = np.pi * law.mean_square / (1.0 - porosity)
        place = strew(law.grading, size, share, rng)
        radius = draw_radii(law, len(place), rng) * law.grading.size(place)
        box = size * np.sqrt(np.pi * np.sum(radius**2) / (start * size[0] * size[1]))
        x, y = (place * box / size).T
    order = along_strips(x, y, STRIP)
    x, y, radius = x[order], y[order], radius[order]
    half = 0.5 * box
    specimen = kind(
        at_rest(x, y, radius, scaled_mass(radius, 1.0, TIME_STEP)),
        np.array([-half[0], half[0], -half[1], half[1]]),
        Linear(1.0, SHEAR_STIFFNESS, 0.0),
    )
    apart = Stop(ratio=0.1, stress=np.inf, force=APART)
    if specimen.relax(STANDING, apart, damping=FIRE, steps=PARTING) != AT_REST:
        raise ModelError(
            f"strewn grains did not part in {PARTING} steps: an unbalanced force of "
            f"{specimen.run.ratio:.1e} of the contact force is left; try another grains.seed"
        )
    specimen.stand_still()
    return specimen


def _evenly(
    size: Array, law: Sizes, porosity: float, start: float, rng: np.random.Generator
) -> tuple[Array, Array, Array, Array]:
    """Places and radii (n,) of grains of one law everywhere, and their box (2,)."""
    n = max(4, round((1.0 - porosity) * size[0] * size[1] / (np.pi * law.mean_square)))
    radius = np.sort(draw_radii(law, n, rng))
    box = size * np.sqrt(np.pi * np.sum(radius**2) / (start * size[0] * size[1]))
    # Every patch gets as many grains of every size, so that the density is even over long
    # distances; within its patch a grain lies anywhere.
    columns, rows = np.maximum(1, np.round(box * np.sqrt(n / box.prod() / PATCH))).astype(int)
    patches = np.arange(columns * rows)
    patch = rng.permuted(np.tile(patches, (n // len(patches) + 1, 1)), axis=1).ravel()[:n]
    x = ((patch % columns + rng.random(n)) / columns - 0.5) * box[0]
    y = ((patch // columns + rng.random(n)) / rows - 0.5) * box[1]
    return x, y, radius, box


def compact(specimen: Specimen | Cell, recipe: Recipe) -> bool:
    """Phases 2 to 4 of a packing; False if phase 2 or 4 does not come to rest."""

    def held(pressure: float, stop: Stop, steps: int) -> bool:
        return specimen.relax(hydrostatic(pressure), stop, damping=FIRE, steps=steps) == AT_REST

    specimen.law = specimen.law._replace(friction=recipe.friction)
    compacted = held(max(COMPACTION, recipe.pressure), Stop(ratio=0.1, stress=0.05), COMPACTING)
    held(recipe.pressure, Stop(ratio=0.03, stress=0.02), EASING)
    specimen.law = specimen.law._replace(friction=RESTING_FRICTION)
    return held(recipe.pressure, REST, RESTING) and compacted


def hydrostatic(pressure: float) -> Servo:
    """Servo that holds one pressure over k_n on all walls."""
    return Servo(pressure, pressure, pressure, pressure)


def inner_box(box: Array) -> Array:
    """The box without the layer at the walls in which the packing is looser."""
    return box + WALL_LAYER * np.array([1.0, -1.0, 1.0, -1.0])


def fit_floaters(specimen: Specimen) -> tuple[Array, Array]:
    """Fit what carries no load into its voids; the contacts (a, b) without force that it makes."""
    grains = specimen.grains
    a, b = measures.listed(specimen.pairs)
    touch = measures.overlaps(grains.x, grains.y, grains.radius, a, b) > 0.0
    counts = measures.contact_counts(
        grains.x, grains.y, grains.radius, specimen.box, a[touch], b[touch]
    )
    found = fit(grains.x, grains.y, grains.radius, counts < 2, specimen.box)
    specimen.pairs = find_pairs(grains, specimen.width, specimen.pairs)
    return found
