"""The stages *pack* and *specimen*: grains at rest in a box larger than the region, or as large.

A packing is made in units of the mean radius and the normal stiffness (`compaction`), by the
recipe that leads to what is wanted of it (`targets`), and scaled here; a lattice is laid.
"""

from __future__ import annotations

import numpy as np

from demflow.model.mechanics.contact.grains import Array
from demflow.model.mechanics.motion.equilibrium import Specimen
from demflow.model.mechanics.packing.cell import Cell
from demflow.model.mechanics.packing.compaction import WALL_LAYER, Trial, attempt
from demflow.model.mechanics.packing.grading import coarse_radius, graded
from demflow.model.mechanics.packing.lattices import CELL_AREA, lattice
from demflow.model.mechanics.packing.packing_targets import Target, meet
from demflow.model.mechanics.packing.sizes import Sizes, sizes_of
from demflow.model.mechanics.packing.tiles import Tiled, bounds, tiled
from demflow.model.mechanics.specimen import measures
from demflow.model.outcome import ModelError
from demflow.model.products import Packing
from demflow.model.region import Region, bounding_box
from demflow.model.scene.lines import RefinedPlace

MARGIN = 9.0  # mean radii between the region and each wall
SIZE_TOLERANCE = 0.01  # relative error of either side of a specimen
SIZE_TRIES = 10
LEAST_WIDTH = 40.0  # mean radii: least width of the inner box, else its porosity is noise


def pack(
    *,
    region: Region,
    count: int | None,
    mean_radius: float | None,
    packing: str,
    radius_ratio: float,
    porosity: float | None,
    seed: int,
    tile: int = 2000,
    packing_pressure: float | None = None,
    packing_friction: float | None = None,
    floaters: str = "leave",
    sizes: str = "uniform",
    radius_deviation: float | None = None,
    radii: tuple[float, ...] | None = None,
    refine: tuple[RefinedPlace, ...] | None = None,
    specimen: bool | None = None,
) -> Packing:
    """Grains at rest that cover the region with a margin, see the head of this file.

    Parameters
    ----------
    region : the shape that will be cut from the packing; its bounding box gets a margin of
        nine mean radii on every side (more around very few grains).
    count : expected number of grains whose centre lies in the region, or
    mean_radius : the mean radius of the grains (m).
    packing : "random", "periodic" (a random packing without walls, repeated as a tile), "square"
        or "hexagonal"; the lattices have equal radii.
    tile : number of grains of a periodic packing's tile.
    radius_ratio : largest over smallest radius of a random packing; for sizes other than
        "uniform" between the two it is not read.
    sizes, radius_deviation, radii : "uniform"; "log-normal", the deviation of ln r given (cut at
        2.5 of it on either side); or a "list" of radii in equal parts, only ratios of which count.
    porosity, packing_pressure, packing_friction : of a random packing, two of the three at most,
        and one of porosity and friction at least; the third follows (see `targets`). Pressures
        are over k_n. A porosity is met within 0.003 as a rule, 0.005 at the worst.
    seed : of the random numbers.
    refine : places around which grains are finer; `mean_radius` is then that of the coarse ones,
        `count` still that of all.
    floaters : "leave" them as they lie, or "fit" them into their voids (`floaters.fit`): a grain
        without load then touches three others without force, and bonds may hold it.
    specimen : the region's bounding box gets no margin: walls stand there, within
        `SIZE_TOLERANCE` of either side, and `porosity` is that away from them. Grains of a given
        `mean_radius` have it within that, too.

    Raises
    ------
    ModelError : the target cannot be reached, or the grains did not come to rest.
    """
    margin = 0.0 if specimen else MARGIN
    box = np.array(bounding_box(region))
    if packing in CELL_AREA:
        if mean_radius is None:
            assert count is not None  # one of the two is given
            mean_radius = float(np.sqrt(region.area / (count * CELL_AREA[packing])))
        grown = box + margin * mean_radius * np.array([-1.0, 1.0, -1.0, 1.0])
        return lattice(packing, mean_radius, tuple(grown.tolist()))
    target = Target(porosity, packing_pressure, packing_friction)
    law = sizes_of(sizes, radius_ratio, radius_deviation, radii)
    grading = graded(refine)
    if mean_radius is None:
        assert count is not None
        solid = (1.0 - target.expected_porosity) * region.area
        mean_radius = float(np.sqrt(solid / (count * np.pi * law.mean_square)))
        if grading is not None:
            share = np.pi * law.mean_square / (1.0 - target.expected_porosity)
            mean_radius = coarse_radius(grading, region, count, share)
    size = np.array([box[1] - box[0], box[3] - box[2]]) / mean_radius + 2.0 * margin
    centre = 0.5 * np.array([box[0] + box[1], box[2] + box[3]])
    if grading is not None:
        law = law._replace(grading=grading.moved(centre, mean_radius))
    fits = floaters == "fit"
    if packing == "periodic":
        side = np.sqrt(tile * np.pi * law.mean_square / (1.0 - target.expected_porosity))
        trial = meet(target, np.array([side, side]), law, seed, fits=fits, periodic=True)
        assert isinstance(trial.specimen, Cell)
        return _tiled_product(trial, tiled(trial.specimen, size, fits=fits), mean_radius, centre)
    roomy = np.maximum(size, LEAST_WIDTH + 2.0 * WALL_LAYER)
    trial = meet(target, roomy, law, seed, fits=fits)
    if specimen:
        trial = _of_size(trial, size, target.expected_porosity, law, seed, fits=fits)
        mean_radius *= float(np.sqrt(np.prod(size) / np.prod(_sides(trial))))
    made = _product(trial, mean_radius, centre)
    if grading is not None:
        scale = grading.size(np.column_stack([made.x, made.y]), mean_radius)
        made = made._replace(scale=scale)
    return made


def _of_size(
    trial: Trial, size: Array, porosity: float, law: Sizes, seed: int, *, fits: bool
) -> Trial:
    """A packing by the recipe of another one in a box of a size, where that has not got it.

    Between walls grains lie more loosely than the porosity away from them tells: there are fewer.
    """
    room, recipe, found = size, trial.recipe, trial
    for draw in range(SIZE_TRIES):
        sides = _sides(found)
        if found.rested and np.all(np.abs(sides / size - 1.0) <= SIZE_TOLERANCE):
            return found._replace(porosity=trial.porosity)
        if draw > 0:
            room = room * size / sides
        found = attempt(recipe, porosity, room, law, [seed, draw], fits=fits)
    raise ModelError(
        f"no packing {size[0]:.3g} by {size[1]:.3g} mean radii wide and high came to rest in "
        f"{SIZE_TRIES} tries; try another grains.seed or more grains"
    )


def _sides(trial: Trial) -> Array:
    """Width and height of its box, in mean radii."""
    box = trial.specimen.box
    return np.array([box[1] - box[0], box[3] - box[2]])


def _product(trial: Trial, mean_radius: float, centre: Array) -> Packing:
    """The packing in metres, its box centred on `centre`."""
    specimen = trial.specimen
    assert isinstance(specimen, Specimen)
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
        packing_friction=np.array(trial.recipe.friction),
        packing_pressure=np.array(trial.recipe.pressure),
        unbalanced_ratio=np.array(specimen.run.ratio),
        steps=np.array(specimen.steps),
    )


def _tiled_product(trial: Trial, part: Tiled, mean_radius: float, centre: Array) -> Packing:
    """Copies of a periodic cell in metres; counts leave out what the end of the copies cuts."""
    return Packing(
        x=centre[0] + mean_radius * part.x,
        y=centre[1] + mean_radius * part.y,
        radius=mean_radius * part.radius,
        contact_a=part.a,
        contact_b=part.b,
        normal_force=mean_radius * part.overlap,
        shear_force=mean_radius * part.shear,
        box=mean_radius * bounds(part.x, part.y, part.radius) + np.repeat(centre, 2),
        porosity=np.array(trial.porosity),
        coordination=np.array(part.counts[part.counts >= 2].mean()),
        floaters=np.array(np.count_nonzero(part.counts < 2)),
        packing_friction=np.array(trial.recipe.friction),
        packing_pressure=np.array(trial.recipe.pressure),
        unbalanced_ratio=np.array(trial.specimen.run.ratio),
        steps=np.array(trial.specimen.steps),
    )
