"""Equilibrium of bonded, unbroken grains by one factorisation: the static solver.

The stage *unit_loads* factors the stiffness of the packed, bonded grains once and solves
for three unit loads: σ_xx, σ_yy and σ_xy. While no bond breaks, every stress state is their
sum. What it lacks is solved for with the same factor: first by the law of contacts that hold
(`held`: the geometry of the moved grains is all that is not linear there), and, where some
would slip, open or close, by the *true* law of the explicit solver (`trial.FrictionalTrial`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import csc_array, diags_array

from demflow.model.mechanics.contact.grains import Array
from demflow.model.mechanics.motion.equilibrium import SKIN, Specimen
from demflow.model.mechanics.specimen.measures import listed
from demflow.model.mechanics.static.displaced import FrictionalTrial, Trial
from demflow.model.mechanics.static.load_carrying import (
    at_walls,
    brakes,
    carrying,
    contacts_of,
    load_carrying,
)
from demflow.model.mechanics.static.sticking import StickingTrial
from demflow.model.mechanics.static.stiffness import (
    ANCHOR,
    TOUCHING,
    Factor,
    factorise,
    matrix,
    solve,
)
from demflow.model.mechanics.static.wall_contacts import WallContacts, loose_contacts
from demflow.model.mechanics.static.walls import shear_load, tilt_load, wall_shares
from demflow.model.outcome import ModelError
from demflow.model.products import UnitLoads

MOST_CORRECTIONS = 40
MOST_HELD = 6  # of a state whose contacts hold: each divides its unbalance by a hundred or more
BASE_TOLERANCE, BASE_CORRECTIONS = 1e-9, 100  # of the packed state, from which stresses count
REFINEMENTS = 3  # of each unit load
LEAST_SHEAR = 1e-9  # stiffness against a tilt of the walls, over that of their own contacts
MEMORY = 10  # corrections that the next one takes into account


class Found(NamedTuple):
    """How the static solver ended."""

    reached: bool
    corrections: int
    ratio: float  # mean unbalanced over mean contact force
    why: str = ""
    breaks: bool = False  # bonds would break in a state that is elastic else


def response(specimen: Specimen, packed: Array) -> UnitLoads:
    """Factor the stiffness of a specimen and solve its unit loads.

    Parameters
    ----------
    specimen : grains as they were packed, bonded; it is displaced.
    packed : stresses xx, yy, xy of its walls over k_n.

    Raises ModelError where too few grains touch to resist a shear.
    """
    grains, box, n = specimen.grains, specimen.box, len(specimen.grains.x)
    width, height = box[1] - box[0], box[3] - box[2]
    contacts = contacts_of(specimen)
    carries = carrying(n, contacts)
    turning = np.zeros(3 * n + 2)
    turning[2:-2:3] = specimen.law.kn * brakes(grains, contacts, carries)
    stiffness = matrix(grains, contacts, specimen.bonds, specimen.law)
    factor = factorise(csc_array(stiffness + diags_array(turning)))
    stiffness = csc_array(stiffness - diags_array(np.full(3 * n + 2, ANCHOR * specimen.law.kn)))

    def displaced(load: Array) -> Array:
        found = solve(factor, load)
        for _ in range(REFINEMENTS):  # without brakes and anchors
            found += solve(factor, load - stiffness @ found)
        return found

    reach = at_walls(specimen, carries, SKIN)  # they may come to touch
    near = tuple(np.union1d(w, r) for w, r in zip(contacts.walls, reach, strict=True))
    share = wall_shares(specimen, near, carries)
    loads = np.zeros((3, 3 * n + 2))
    loads[0, -2] = -height  # a compression moves the right wall inwards
    loads[1, -1] = -width
    loads[2] = shear_load(specimen, near, share)
    displacement = np.array([displaced(load) for load in loads])
    # under shear the walls are free to tilt by γ: γ (k_γγ − kᵀ K⁻¹ k) = kᵀ u
    tilt = tilt_load(specimen, contacts.walls)
    tilted = displaced(tilt)
    along = np.concatenate(
        [(grains.y if side < 2 else grains.x)[held] for side, held in enumerate(contacts.walls)]
    )
    own = 0.25 * specimen.law.kn * float(np.sum(along**2))
    resists = own - float(tilt @ tilted)
    if not resists > LEAST_SHEAR * own:
        raise ModelError(
            f"walls around {n} grains tilt without resistance: too few of them touch for a static "
            "solution; raise grains.count, or try stress.method explicit"
        )
    shear = float(tilt @ displacement[2]) / resists
    displacement[2] += shear * tilted
    # what nothing holds is carried along
    free = np.bincount(np.r_[contacts.a, contacts.b], minlength=n) == 0
    carried = displacement[:, :-2].reshape(3, n, 3)
    carried[:, free, 0] = np.outer(displacement[:, -2], (grains.x[free] - box[0]) / width)
    carried[:, free, 1] = np.outer(displacement[:, -1], (grains.y[free] - box[2]) / height)
    carried[2, free, 0] += 0.5 * shear * grains.y[free]
    carried[2, free, 1] += 0.5 * shear * grains.x[free]
    loose = loose_contacts(specimen, near, contacts.walls, displaced)
    pairs = load_carrying(specimen)
    a, b = listed(pairs)
    glued = pairs.bond >= 0
    distance = np.hypot(*(field[b[glued]] - field[a[glued]] for field in (grains.x, grains.y)))
    units = UnitLoads(
        base=np.zeros(3 * n + 2),
        base_ratio=np.array(np.inf),
        packed=np.array(packed, dtype=float),
        displacement=displacement,
        shear_strain=np.array(shear),
        wall_grain=np.concatenate(near),
        wall_start=np.concatenate([[0], np.cumsum([len(held) for held in near])]),
        wall_share=np.concatenate(share),
        contact_a=a[glued],
        contact_b=b[glued],
        contact_shear=pairs.shear[glued],
        contact_distance=distance,
        touching=grains.radius[a[glued]] + grains.radius[b[glued]] > distance - TOUCHING,
        loose=loose.which,
        loose_touching=loose.touching,
        loose_response=loose.response,
        near_a=a[~glued],
        near_b=b[~glued],
        order=factor.order,
        start=factor.start,
        row=factor.row,
        lower=factor.lower,
        pivot=factor.pivot,
    )
    base, trial = np.zeros(3 * n + 2), FrictionalTrial(specimen, units)
    _, ratio = _correct(trial, units, base, packed, BASE_TOLERANCE, BASE_CORRECTIONS)
    return units._replace(base=base, base_ratio=np.array(ratio))


def superpose(trial: StickingTrial, units: UnitLoads, wanted: Array, tolerance: float) -> Found:
    """Bring grains to stresses by their unit loads while all their contacts hold.

    Parameters
    ----------
    trial : the packed grains; left in the state that was found.
    units : their unit loads.
    wanted : stresses xx, yy, xy over k_n.
    tolerance : mean unbalanced over mean contact force, torques over radii included and what
        the true law would change, and the relative error of the walls' stresses.
    """
    elastic = Elastic(units, trial)
    tilt = wanted[2] * float(units.shear_strain)
    u = elastic.superposed(wanted, tilt)
    before = np.inf
    for corrections in range(MOST_HELD + 1):
        residual, ratio = trial.forces(u, tilt, wanted)
        astray = trial.astray()
        hopeless = astray > tolerance or not ratio < 0.5 * before
        if ratio + astray <= tolerance or hopeless or corrections == MOST_HELD:
            break
        u += elastic.step(residual, u, tilt)
        before = ratio
    ratio += astray
    if ratio > tolerance:
        why = "its contacts slip, open or close" + elastic.doubts()
        return Found(False, corrections, ratio, why)
    why = f"{trial.broken} bonds would break" if trial.broken else ""
    return Found(trial.broken == 0, corrections, ratio, why, trial.broken > 0)


def equilibrium(specimen: Specimen, units: UnitLoads, wanted: Array, tolerance: float) -> Found:
    """Bring a specimen, as it was packed, to stresses by its unit loads and the true law.

    Parameters as for `superpose`, but the tolerance holds by the true law, and the specimen is
    left in the state that was found, spoilt where none was.

    Parameters
    ----------
    specimen : grains with bonds, joints and walls, in units of mean radius and k_n
    units : linear response of the packed grains
    wanted : stresses xx, yy, xy that are wanted, (3,) over k_n
    tolerance : unbalanced force that is left, over the mean contact force
    """
    trial = FrictionalTrial(specimen, units)
    elastic = Elastic(units, trial)
    u = elastic.superposed(wanted, wanted[2] * float(units.shear_strain))
    corrections, ratio = _correct(trial, units, u, wanted, tolerance, MOST_CORRECTIONS)
    if ratio > tolerance:
        why = f"its corrections end at an unbalance of {ratio:.1e}" + elastic.doubts()
        return Found(False, corrections, ratio, why)
    broken = trial.broken_bonds()
    trial.accept(ratio)
    return Found(broken == 0, corrections, ratio, f"{broken} bonds would break" if broken else "")


class Elastic:
    """What the factored stiffness tells of a rock that is displaced."""

    def __init__(self, units: UnitLoads, trial: Trial):
        self.units = units
        self.factor = Factor(units.order, units.start, units.row, units.lower, units.pivot)
        self.walls = WallContacts(units, trial.x, trial.y, trial.grains.radius, trial.first_box)

    def superposed(self, wanted: Array, tilt: float) -> Array:
        """Displacement (3 n + 2,) under stresses: the sum of the unit loads."""
        units = self.units
        found: Array = units.base + (wanted - units.packed) @ units.displacement
        self.walls.settle(found, tilt)
        return found

    def step(self, residual: Array, u: Array, tilt: float) -> Array:
        """Displacement that takes an unbalance away, from a state u.

        Parameters
        ----------
        residual : unbalanced forces, (3 n + 2,)
        u : displacement (3 n + 2,): x, y and turn of each grain, then the strains of the box
        tilt : shear of the box
        """
        return self.walls.corrected(solve(self.factor, residual), u, tilt)

    def doubts(self) -> str:
        """What this rests on that did not converge, to be added to why a state is not found."""
        found, ratio = "", float(self.units.base_ratio)
        if not ratio <= BASE_TOLERANCE:
            found += f", the packed state that it starts from has an unbalance of {ratio:.1e} left"
        if not self.walls.settled:
            found += ", contacts with the walls open and close in turns"
        return found


def _correct(
    trial: FrictionalTrial, units: UnitLoads, u: Array, wanted: Array, tolerance: float, most: int
) -> tuple[int, float]:
    """Correct the displacement u in place until balance; returns corrections and the last ratio.

    Steps of the factored stiffness, each combined with those before so that the residual is
    least (Anderson 1965, J. ACM 12, 547): contacts that open, close or slip differ from the
    stiffness in few directions, which are learnt so.
    """
    elastic = Elastic(units, trial)
    shear = wanted[2] * float(units.shear_strain)
    steps, changes = np.empty((2, MEMORY, len(u)))
    learnt = 0
    before, best, correction = u, u.copy(), np.empty(0)
    least, share = np.inf, 1.0
    for corrections in range(most + 1):
        residual, ratio = trial.forces(u, shear, wanted)
        if ratio <= tolerance or corrections == most:
            break
        if not ratio <= 10.0 * least:  # led astray: back to the best, more carefully
            u[:] = best
            learnt, share, correction = 0, 0.3 * share, np.empty(0)
            residual, _ = trial.forces(u, shear, wanted)
        elif ratio < least:
            best, least = u.copy(), ratio
        last, correction = correction, share * elastic.step(residual, u, shear)
        if last.size:
            row = learnt % MEMORY
            changes[row] = correction - last
            steps[row] = u - before + changes[row]
            learnt += 1
        before = u.copy()
        u += correction
        if learnt:
            kept = changes[:learnt]  # all of them, once there are more than MEMORY
            scale = 1.0 / np.maximum(np.sqrt(np.sum(kept * kept, axis=1)), 1e-300)
            gram = scale[:, None] * (kept @ kept.T) * scale
            mix = np.linalg.lstsq(gram, scale * (kept @ correction), rcond=1e-11)[0]
            u -= (scale * mix) @ steps[:learnt]
    return corrections, ratio
