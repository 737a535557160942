"""The stage *pack*: grains at rest in a box that is larger than the region.

A random packing is made in units of the mean radius, the normal stiffness and the mass of
a grain (so that forces over k_n are lengths) and scaled at the end:

1. Radii are drawn uniformly between r and ratio · r, strewn over a box, and parted without
   friction. Strewn so densely that they overlap, grains end dense; strewn loosely, they end
   where friction lets them jam.
2. With the packing friction, the servo brings the box to the pressure COMPACTION.
3. Still with the packing friction, the pressure falls to PRESSURE.
4. Friction is raised, so that the last motion dies quickly, until grains are at REST. Forces
   hardly change.

Solid fraction at the start and packing friction, the recipe, decide the porosity; it is
searched for along RECIPES.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from model.mechanics import measures
from model.mechanics.contacts import ContactLaw
from model.mechanics.equilibrium import AT_REST, FIRE, TIME_STEP, Specimen, Stop
from model.mechanics.floaters import fit
from model.mechanics.grains import Array, along_hilbert_curve, at_rest, scaled_mass
from model.mechanics.lattices import CELL_AREA, lattice
from model.mechanics.neighbours import find_pairs
from model.mechanics.servo import STANDING, Servo
from model.mechanics.sizes import Sizes, draw_radii, sizes_of
from model.outcome import ModelError
from model.products import Packing
from model.region import Region, bounding_box

# pressures over the normal stiffness; 2e-4 is 8 MPa for grains of 20 GPa
COMPACTION, PRESSURE = 1e-3, 2e-4
SHEAR_STIFFNESS = 1.0 / 2.5  # over the normal stiffness, while packing

MARGIN = 9.0  # mean radii between the region and each wall
WALL_LAYER = 6.0  # mean radii from each wall in which porosity is not measured
LEAST_WIDTH = 40.0  # mean radii: least width of the inner box, else its porosity is noise

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
PATCH = 16  # grains strewn over each patch
RESTING_FRICTION = 10.0  # of the last phase
SCATTER = 0.15  # of the porosity between draws, times the root of the number of grains
ACCEPTED, TOLERATED = 0.003, 0.005  # error in porosity: at once; after the last try
TRIES = 10

REST = Stop(ratio=1e-3, stress=5e-3)


def pack(
    *,
    region: Region,
    count: int | None,
    mean_radius: float | None,
    packing: str,
    radius_ratio: float,
    porosity: float | None,
    seed: int,
    floaters: str = "leave",
    sizes: str = "uniform",
    radius_deviation: float | None = None,
    radii: tuple[float, ...] | None = None,
) -> Packing:
    """Grains at rest that cover the region with a margin, see the head of this file.

    Parameters
    ----------
    region : the shape that will be cut from the packing; its bounding box gets a margin of
        nine mean radii on every side (more around very few grains).
    count : expected number of grains whose centre lies in the region, or
    mean_radius : the mean radius of the grains (m).
    packing : "random", "square" or "hexagonal"; the lattices have equal radii.
    radius_ratio : largest over smallest radius of a random packing; for sizes other than
        "uniform" between the two it is not read.
    sizes, radius_deviation, radii : "uniform"; "log-normal", the deviation of ln r given (cut at
        2.5 of it on either side); or a "list" of radii in equal parts, only ratios of which count.
    porosity : wanted porosity of a random packing, met within 0.003 as a rule, 0.005 at the worst.
    seed : of the random numbers.
    floaters : "leave" them as they lie, or "fit" them into their voids (`floaters.fit`): a grain
        without load then touches three others without force, and bonds may hold it.

    Raises
    ------
    ModelError : the porosity cannot be reached, or the grains did not come to rest.
    """
    box = np.array(bounding_box(region))
    if packing != "random":
        if mean_radius is None:
            assert count is not None  # one of the two is given
            mean_radius = float(np.sqrt(region.area / (count * CELL_AREA[packing])))
        grown = box + MARGIN * mean_radius * np.array([-1.0, 1.0, -1.0, 1.0])
        return lattice(packing, mean_radius, tuple(grown.tolist()))
    assert porosity is not None  # a random packing has one
    law = sizes_of(sizes, radius_ratio, radius_deviation, radii)
    if mean_radius is None:
        assert count is not None
        solid = (1.0 - porosity) * region.area
        mean_radius = float(np.sqrt(solid / (count * np.pi * law.mean_square)))
    size = np.array([box[1] - box[0], box[3] - box[2]]) / mean_radius
    size = np.maximum(size + 2.0 * MARGIN, LEAST_WIDTH + 2.0 * WALL_LAYER)
    trial = search(porosity, size, law, seed, fits=floaters == "fit")
    centre = 0.5 * np.array([box[0] + box[1], box[2] + box[3]])
    return _product(trial, mean_radius, centre)


class Trial(NamedTuple):
    """A packing by one recipe."""

    specimen: Specimen
    friction: float  # packing friction
    porosity: float  # of the inner box
    rested: bool  # whether it came to rest
    fitted: tuple[Array, Array]  # contacts without force of floaters that were fitted


def search(wanted: float, size: Array, law: Sizes, seed: int, *, fits: bool) -> Trial:
    """A packing at rest of the wanted porosity, in a box of about `size` (mean radii).

    Recipes are named by the porosity that the table promises. The first is the wanted one;
    the next is corrected by what came out, or lies between two that missed on either side. At
    the end of the table grains are drawn anew as long as scatter may explain the miss.
    """
    least, greatest = float(RECIPES[0, 0]), float(RECIPES[-1, 0])
    recipe = min(max(wanted, least), greatest)
    dense = loose = None  # recipes on either side of the wanted porosity
    best: Trial | None = None
    draw = steps = 0
    for _ in range(TRIES):
        trial = attempt(recipe, wanted, size, law, [seed, draw], fits=fits)
        steps += trial.specimen.steps
        trial.specimen.steps = steps  # what the tries before it took is part of the cost
        miss = trial.porosity - wanted
        if trial.rested and (best is None or abs(miss) < abs(best.porosity - wanted)):
            best = trial
        if best is not None and abs(best.porosity - wanted) <= ACCEPTED:
            return best
        if miss < 0:
            dense = recipe
        else:
            loose = recipe
        if dense is not None and loose is not None:
            recipe = 0.5 * (dense + loose)
        elif (miss < 0 and recipe == greatest) or (miss > 0 and recipe == least):
            scatter = SCATTER / np.sqrt(len(trial.specimen.grains.x))
            if abs(miss) > TOLERATED + scatter:
                break
            draw += 1
        else:
            recipe = min(max(recipe - 1.2 * miss, least), greatest)
    if best is not None and abs(best.porosity - wanted) <= TOLERATED:
        return best
    if dense is None or loose is None:
        ends = (
            attempt(end, wanted, size, law, [seed, 0], fits=fits).porosity
            for end in (least, greatest)
        )
        reached = "about {:.3f} to {:.3f}".format(*ends)
        raise ModelError(
            f"porosity {wanted:g} cannot be reached: random packings of radius ratio "
            f"{law.ratio:g} reach {reached}; choose grains.porosity in that range"
        )
    raise ModelError(
        f"no packing of porosity {wanted:g} came to rest in {TRIES} tries (radius ratio "
        f"{law.ratio:g}); try another grains.seed, a porosity nearer to 0.17, or more grains"
    )


def attempt(
    recipe: float,
    porosity: float,
    size: Array,
    law: Sizes,
    seeds: list[int],
    *,
    fits: bool,
) -> Trial:
    """Pack by one recipe of the table, interpolated; with floaters fitted, if wanted."""
    start, friction = (float(np.interp(recipe, RECIPES[:, 0], RECIPES[:, k])) for k in (1, 2))
    rng = np.random.Generator(np.random.PCG64(seeds))
    specimen = strewn(size, law, porosity, start, rng)
    rested = compact(specimen, friction)
    grains = specimen.grains
    none = np.empty(0, np.int64)
    fitted = fit_floaters(specimen) if fits else (none, none)
    found = measures.porosity(grains.x, grains.y, grains.radius, inner_box(specimen.box))
    return Trial(specimen, friction, found, rested, fitted)


def strewn(
    size: Array, law: Sizes, porosity: float, start: float, rng: np.random.Generator
) -> Specimen:
    """Grains strewn at the solid fraction `start`, parted without friction in a standing box.

    At the wanted porosity they fill a box of `size` (width, height; mean radii).
    """
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
    order = along_hilbert_curve(x, y)
    x, y, radius = x[order], y[order], radius[order]
    half = 0.5 * box
    specimen = Specimen(
        at_rest(x, y, radius, scaled_mass(radius, 1.0, TIME_STEP)),
        np.array([-half[0], half[0], -half[1], half[1]]),
        ContactLaw(1.0, SHEAR_STIFFNESS, 0.0),
    )
    apart = Stop(ratio=0.1, stress=np.inf, force=0.05 * PRESSURE)
    specimen.relax(STANDING, apart, damping=FIRE, steps=3000)
    specimen.stand_still()
    return specimen


def compact(specimen: Specimen, friction: float) -> bool:
    """Phases 2 to 4 of a packing with this packing friction; False if it does not come to rest."""
    specimen.law = specimen.law._replace(friction=friction)
    loosely = Stop(ratio=0.1, stress=0.05)
    specimen.relax(hydrostatic(COMPACTION), loosely, damping=FIRE, steps=4000)
    nearly = Stop(ratio=0.03, stress=0.02)
    specimen.relax(hydrostatic(PRESSURE), nearly, damping=FIRE, steps=1000)
    specimen.law = specimen.law._replace(friction=RESTING_FRICTION)
    return specimen.relax(hydrostatic(PRESSURE), REST, damping=FIRE, steps=12000) == AT_REST


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
    specimen.pairs = find_pairs(grains, specimen.skin, specimen.pairs)
    return found


def _product(trial: Trial, mean_radius: float, centre: Array) -> Packing:
    """The packing in metres, its box centred on `centre`."""
    specimen = trial.specimen
    grains, box = specimen.grains, specimen.box
    shift_x, shift_y = 0.5 * (box[0] + box[1]), 0.5 * (box[2] + box[3])
    x = centre[0] + mean_radius * (grains.x - shift_x)
    y = centre[1] + mean_radius * (grains.y - shift_y)
    radius = mean_radius * grains.radius
    walls = mean_radius * (box - np.array([shift_x, shift_x, shift_y, shift_y])) + np.repeat(
        centre, 2
    )
    a, b = measures.listed(specimen.pairs)
    overlap = measures.overlaps(x, y, radius, a, b)
    touch = overlap > 0.0
    touch |= np.isin(a * len(x) + b, trial.fitted[0] * len(x) + trial.fitted[1])
    a, b = a[touch], b[touch]
    counts = measures.contact_counts(x, y, radius, walls, a, b)
    return Packing(
        x=x,
        y=y,
        radius=radius,
        contact_a=a,
        contact_b=b,
        normal_force=np.maximum(overlap[touch], 0.0),
        shear_force=mean_radius * specimen.pairs.shear[touch],
        box=walls,
        porosity=np.array(trial.porosity),
        coordination=np.array(counts[counts >= 2].mean()),
        floaters=np.array(np.count_nonzero(counts < 2)),
        packing_friction=np.array(trial.friction),
        packing_pressure=np.array(PRESSURE),
        unbalanced_ratio=np.array(specimen.run.ratio),
        steps=np.array(specimen.steps),
    )
