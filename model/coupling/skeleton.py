"""The grains as what bears load in small displacements: contacts that slide, part and break.

Displacements are small beside grains, so that the geometry stays that of the packed state: a
contact parts by B_n u, slides by B_s u and bends by B_m u. Beside the law of the grains, closed
under compression alone and sliding by Coulomb's law, stands cement, in proportion until it breaks.
Stated once, these are the laws of `mechanics.contact` (linear contacts, contact and parallel
bonds, smooth joints), with the same signs. What remains of it all is a law of forces that is
linear piece by piece, with its exact tangent.

Units are the mean radius and k_n. The m = 3 n + 2 unknowns are displacements and rotation of each
grain, then the outward displacements of the right and the top wall; the left and bottom walls
stand.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array, csr_array

from demflow.model.mechanics.contact.bonds import (
    BROKEN_IN_SHEAR,
    BROKEN_IN_TENSION,
    CONTACT_BONDS,
    INTACT,
    PARALLEL_BONDS,
)
from demflow.model.mechanics.contact.grains import Array
from demflow.model.mechanics.contact.joints import APART
from demflow.model.mechanics.contact.law import Linear
from demflow.model.mechanics.motion.equilibrium import Specimen
from demflow.model.mechanics.specimen.measures import listed
from demflow.model.mechanics.static.load_carrying import carrying_beside_joints

NEAR = 0.05  # gap in mean radii up to which two grains are watched, so that they may close
SOFT = 1e-3  # grip on a grain beside broken cement, over k_n: it follows step by step, as in oil
LOOSE = 0.01  # the same on one that no cement holds any more
FIRM = 1.0  # grip on what came free: it stays
NEVER = -1  # mode of a contact that never had cement
SLID = 3  # and of one across a joint, once it slid


class Skeleton(NamedTuple):
    """Contacts of n grains, c of them, those with walls last."""

    a: Array  # (c,) grains, a < b; of a wall its grain, and −1 … −4 (left, right, bottom, top)
    b: Array
    x: Array  # (c,) the contact's place
    y: Array
    parting: csr_array  # B_n (c, m)
    sliding: csr_array  # B_s (c, m)
    bending: csr_array  # B_m (c, m)
    kn: Array  # (c,) of the grains
    ks: Array
    friction: Array
    adhesion: Array  # shear that holds beside friction, where grains press on each other
    dilation: Array  # opening per slip
    cn: Array  # (c,) of the cement
    cs: Array
    cm: Array
    cement_n: Array  # (c,) what the cement bears at rest: force, shear, moment
    cement_s: Array
    cement_m: Array
    half_width: Array  # (c,) R̄
    tensile_strength: Array
    shear_strength: Array
    cement_friction: Array
    beside: Array  # (c,) bool: grains bear beside their cement, not only once it is broken
    joint: Array  # (c,) bool: across a smooth joint


class Hold(NamedTuple):
    """What contacts remember."""

    overlap: Array  # (c,) at no displacement; negative for a gap; slip that dilates takes from it
    shear: Array  # (c,) of the grains, and how far they had slid when it was noted
    slid: Array  # (c,)
    mode: Array  # (c,) int8: NEVER cemented, INTACT, how it broke, or SLID
    slip: Array  # (c,) length of slip since the rock was loaded
    grip: Array  # (m,) stiffness by which grains beside cracks are held, and where
    place: Array  # (m,)
    oil: Array  # (m,) force of the soft grip in the state before


class Borne(NamedTuple):
    """What contacts bear at a displacement, and how that changes."""

    part: Array  # (c,) B_n u
    slide: Array  # (c,) B_s u
    normal: Array  # (c,) of the grains, compression positive
    shear: Array  # (c,)
    closed: Array  # (c,) bool: the grains press on each other
    slips: Array  # (c,) bool
    cement_n: Array  # (c,) of intact cement
    cement_s: Array
    cement_m: Array
    kn: Array  # (c,) tangent stiffnesses, grains and cement
    ks: Array
    km: Array
    cross: Array  # (c,) change of the shear force by parting, where it slips
    lifts: Array  # (c,) change of the normal force by sliding, where slip dilates
    slid: Array  # (c,) slip since what is remembered

    @property
    def force(self) -> Array:
        """Normal force of grains and cement, (c,)."""
        found: Array = self.normal + self.cement_n
        return found


def skeleton_of(specimen: Specimen) -> tuple[Skeleton, Hold]:
    """The contacts of a specimen of linear contacts, as it stands."""
    specimen.list_within(NEAR)
    grains, bonds, box, n = specimen.grains, specimen.bonds, specimen.box, len(specimen.grains.x)
    a, b = listed(specimen.pairs)
    bond = specimen.pairs.bond.astype(np.int64)
    radius = grains.radius
    reach = radius[a] + radius[b]
    near = np.hypot(grains.x[b] - grains.x[a], grains.y[b] - grains.y[a]) < reach + NEAR
    carries = carrying_beside_joints(specimen)  # what rattles would wander off, once touched
    kept = np.flatnonzero((bond >= 0) | ((bond == -1) & near & carries[a] & carries[b]))
    a, b, bond, shear = a[kept], b[kept], bond[kept], specimen.pairs.shear[kept]
    dx, dy = grains.x[b] - grains.x[a], grains.y[b] - grains.y[a]
    distance = np.hypot(dx, dy)
    overlap = radius[a] + radius[b] - distance
    c = len(a)
    glued = (
        np.flatnonzero((bond >= 0) & (bonds.state[np.maximum(bond, 0)] == INTACT))
        if len(bonds.state)
        else np.empty(0, np.int64)
    )
    of = bond[glued]

    def filled(values: Array | float, default: float = 0.0) -> Array:
        found = np.full(c, default)
        found[glued] = values
        return found

    law = specimen.law
    assert isinstance(law, Linear)
    kn, ks = np.full(c, law.kn), np.full(c, law.ks)
    parallel = bonds.kind == PARALLEL_BONDS
    cement_n = (bonds.kn[of] if parallel else law.kn) * (bonds.length[of] - distance[glued])
    fields = {
        "kn": kn,
        "ks": ks,
        "friction": np.full(c, law.friction),
        "adhesion": np.zeros(c),
        "dilation": np.zeros(c),
        "cn": filled(bonds.kn[of] if parallel else law.kn),
        "cs": filled(bonds.ks[of] if parallel else law.ks),
        "cm": filled(bonds.kr[of] if parallel else 0.0),
        "cement_n": filled(cement_n),
        "cement_s": filled(bonds.shear[of] if parallel else shear[glued]),
        "cement_m": filled(bonds.moment[of] if parallel else 0.0),
        "half_width": filled(bonds.half_width[of], 1.0),
        "tensile_strength": filled(bonds.tensile_strength[of]),
        "shear_strength": filled(bonds.shear_strength[of]),
        "cement_friction": filled(bonds.friction),
    }
    beside = np.ones(c, bool)
    beside[glued] = parallel
    across = np.zeros(c, bool)
    mode = np.full(c, NEVER, np.int8)
    mode[glued] = INTACT
    if bonds.kind == CONTACT_BONDS:
        shear = shear.copy()
    arm_a, arm_b = radius[a] - 0.5 * overlap, radius[b] - 0.5 * overlap
    part = arm_a / distance
    blocks = [
        (a, b, dx / distance, dy / distance, dx / distance, dy / distance, arm_a, arm_b),
    ]
    place = [(grains.x[a] + part * dx, grains.y[a] + part * dy)]

    joints = specimen.joints
    kept = np.flatnonzero((joints.state == INTACT) | (carries[joints.a] & carries[joints.b]))
    if len(kept):
        own = {k: f[kept] for k, f in joints._asdict().items() if k != "cracks"}
        joints = joints._replace(**own)
        ja, jb = joints.a, joints.b
        jx, jy = grains.x[jb] - grains.x[ja], grains.y[jb] - grains.y[ja]
        d = np.hypot(jx, jy)
        la = 0.5 * (d + radius[ja] - radius[jb])
        blocks.append((ja, jb, joints.nx, joints.ny, jx / d, jy / d, la, d - la))
        place.append((grains.x[ja] + la / d * jx, grains.y[ja] + la / d * jy))
        held = joints.state == INTACT
        apart = joints.state == APART
        gap = np.where(apart, d - radius[ja] - radius[jb], joints.gap)
        zero = np.zeros(len(ja))
        more = {
            "kn": joints.kn,
            "ks": joints.ks,
            "friction": joints.friction,
            "adhesion": zero,
            "dilation": joints.dilation,
            "cn": np.where(held, joints.kn, 0.0),
            "cs": np.where(held, joints.ks, 0.0),
            "cm": zero,
            "cement_n": np.where(held, -joints.kn * joints.gap, 0.0),
            "cement_s": np.where(held, joints.shear, 0.0),
            "cement_m": zero,
            "half_width": joints.half_width,
            "tensile_strength": joints.tensile_strength,
            "shear_strength": joints.cohesion,
            "cement_friction": joints.friction,
        }
        fields = {k: np.append(v, more[k]) for k, v in fields.items()}
        beside = np.append(beside, ~held)
        across = np.append(across, np.ones(len(ja), bool))
        mode = np.append(mode, np.where(held, INTACT, NEVER).astype(np.int8))
        overlap, shear = np.append(overlap, -gap), np.append(shear, joints.shear)

    walls = _walls(grains.x, grains.y, radius, box, carries)
    w = len(walls.grain)
    ends = np.append(np.concatenate([block[0] for block in blocks]), walls.grain)
    others = np.append(np.concatenate([block[1] for block in blocks]), -1 - walls.side)
    own = {"kn": law.kn, "half_width": 1.0}
    fields = {k: np.append(v, np.full(w, own.get(k, 0.0))) for k, v in fields.items()}
    parting, sliding, bending = _strains(n, blocks, walls)
    x = np.append(np.concatenate([p[0] for p in place]), walls.x)
    y = np.append(np.concatenate([p[1] for p in place]), walls.y)
    skeleton = Skeleton(
        a=ends,
        b=others,
        x=x,
        y=y,
        parting=parting,
        sliding=sliding,
        bending=bending,
        beside=np.append(beside, np.ones(w, bool)),
        joint=np.append(across, np.zeros(w, bool)),
        **fields,
    )
    hold = Hold(
        overlap=np.append(overlap, walls.overlap),
        shear=np.append(shear, np.zeros(w)),
        slid=np.zeros(len(ends)),
        mode=np.append(mode, np.full(w, NEVER, np.int8)),
        slip=np.zeros(len(ends)),
        grip=np.zeros(3 * n + 2),
        place=np.zeros(3 * n + 2),
        oil=np.zeros(3 * n + 2),
    )
    return skeleton, hold


class _Walls(NamedTuple):
    grain: Array
    side: Array
    overlap: Array
    x: Array
    y: Array


def _walls(x: Array, y: Array, radius: Array, box: Array, carries: Array) -> _Walls:
    """Grains that carry load at walls or within NEAR of them."""
    gaps = (x - radius - box[0], box[1] - x - radius, y - radius - box[2], box[3] - y - radius)
    found = [np.flatnonzero(carries & (gap < NEAR)) for gap in gaps]
    grain = np.concatenate(found)
    side = np.repeat(np.arange(4), [len(f) for f in found])
    overlap = -np.concatenate([gap[f] for gap, f in zip(gaps, found, strict=True)])
    at_x = np.where(side < 2, box[np.minimum(side, 1)], x[grain])
    at_y = np.where(side < 2, y[grain], box[np.maximum(side, 2)])
    return _Walls(grain, side, overlap, at_x, at_y)


def _strains(
    n: int, blocks: Sequence[tuple[Array, ...]], walls: _Walls
) -> tuple[csr_array, csr_array, csr_array]:
    """B_n, B_s, B_m of contacts between grains (with normal, branch and arms), then with walls."""
    rows: list[list[Array]] = [[], [], []]
    columns: list[list[Array]] = [[], [], []]
    values: list[list[Array]] = [[], [], []]

    def put(which: int, row: Array, column: Array, value: Array) -> None:
        rows[which].append(row)
        columns[which].append(column)
        values[which].append(value)

    first = 0
    for a, b, nx, ny, ex, ey, arm_a, arm_b in blocks:
        row = first + np.arange(len(a))
        along, across = nx * ex + ny * ey, nx * ey - ny * ex
        for end, sense, arm in ((a, -1.0, arm_a), (b, 1.0, arm_b)):
            put(0, row, 3 * end, sense * nx)
            put(0, row, 3 * end + 1, sense * ny)
            put(0, row, 3 * end + 2, arm * across)
            put(1, row, 3 * end, -sense * ny)
            put(1, row, 3 * end + 1, sense * nx)
            put(1, row, 3 * end + 2, -arm * along)
            put(2, row, 3 * end + 2, np.full(len(a), sense))
        first += len(a)
    row = first + np.arange(len(walls.grain))
    outwards = np.where(walls.side % 2 == 1, 1.0, -1.0)
    put(0, row, 3 * walls.grain + walls.side // 2, -outwards)
    moving = walls.side % 2 == 1
    put(0, row[moving], 3 * n + walls.side[moving] // 2, np.ones(int(moving.sum())))
    shape = (first + len(walls.grain), 3 * n + 2)

    def made(which: int) -> csr_array:
        place = (np.concatenate(rows[which]), np.concatenate(columns[which]))
        return coo_array((np.concatenate(values[which]), place), shape=shape).tocsr()

    return made(0), made(1), made(2)


def some(skeleton: Skeleton, hold: Hold, which: Array) -> tuple[Skeleton, Hold]:
    """Some of the contacts.

    Parameters
    ----------
    skeleton : what bears between grains: contacts, bonds and joints
    hold : what they remember
    which : of the contacts, bool or int
    """
    kept = Hold._make([*(f[which] for f in hold[:5]), hold.grip, hold.place, hold.oil])
    return Skeleton(*(f[which] for f in skeleton)), kept


def borne(skeleton: Skeleton, hold: Hold, u: Array) -> Borne:
    """What contacts bear at a displacement u (m,), from what they remember.

    Parameters
    ----------
    skeleton : what bears between grains: contacts, bonds and joints
    hold : what they remember
    u : displacement (3 n + 2,): x, y and turn of each grain, then the strains of the box
    """
    s = skeleton
    part, slide, bend = s.parting @ u, s.sliding @ u, s.bending @ u
    intact = hold.mode == INTACT
    overlap = hold.overlap - part
    trial = hold.shear - s.ks * (slide - hold.slid)
    # what dilates as it slides stays closed as far as its own slip lifts it, once it was closed
    lifts = (s.dilation > 0.0) & ((hold.shear != 0.0) | ((hold.slid == 0.0) & (hold.overlap > 0.0)))
    reach = np.zeros(len(trial))
    reach[lifts] = (s.dilation * np.abs(trial) / np.maximum(s.ks, 1e-300))[lifts]
    closed = (s.beside | ~intact) & (overlap + reach > 0.0)
    normal = np.where(closed, s.kn * overlap, 0.0)
    trial = np.where(closed, trial, 0.0)
    slips = closed & (np.abs(trial) > s.friction * normal + s.adhesion)
    sense = np.sign(trial)
    # slip takes from the shear and, where it dilates, adds to the normal force until T = μ N + c
    lifted = s.kn * s.dilation
    gives = s.ks + s.friction * lifted
    slid = np.zeros(len(trial))
    over = np.abs(trial) - s.friction * normal - s.adhesion
    slid[slips] = (over / np.maximum(gives, 1e-300))[slips]
    normal = normal + lifted * slid
    part_of = np.divide(s.ks, gives, out=np.ones(len(gives)), where=slips & (s.dilation > 0.0))
    kn = np.where(closed, s.kn * part_of, 0.0)
    ks = np.where(closed, np.where(slips, s.friction * lifted * part_of, s.ks), 0.0)
    limit = s.friction * normal + s.adhesion
    return Borne(
        part=part,
        slide=slide,
        normal=normal,
        shear=np.where(slips, sense * limit, trial),
        closed=closed,
        slips=slips,
        cement_n=np.where(intact, s.cement_n - s.cn * part, 0.0),
        cement_s=np.where(intact, s.cement_s - s.cs * slide, 0.0),
        cement_m=np.where(intact, s.cement_m - s.cm * bend, 0.0),
        kn=kn + np.where(intact, s.cn, 0.0),
        ks=ks + np.where(intact, s.cs, 0.0),
        km=np.where(intact, s.cm, 0.0),
        cross=np.where(slips, -s.friction * sense * s.kn * part_of, 0.0),
        lifts=np.where(slips, -sense * lifted * part_of, 0.0),
        slid=slid,
    )


def forces(skeleton: Skeleton, hold: Hold, found: Borne, u: Array) -> Array:
    """Forces and torques (m,) of the contacts on grains and walls, and of what grips them.

    Parameters
    ----------
    skeleton : what bears between grains: contacts, bonds and joints
    hold : what they remember
    found : what contacts bear there
    u : displacement (3 n + 2,): x, y and turn of each grain, then the strains of the box
    """
    total: Array = skeleton.parting.T @ (found.normal + found.cement_n)
    total -= hold.grip * (u - hold.place)
    total += skeleton.sliding.T @ (found.shear + found.cement_s)
    total += skeleton.bending.T @ found.cement_m
    return total


def remembered(skeleton: Skeleton, hold: Hold, found: Borne, u: Array) -> Hold:
    """What contacts remember of a state that was found; slip of joints that dilate opens them.

    Parameters
    ----------
    skeleton : what bears between grains: contacts, bonds and joints
    hold : what they remember
    found : what contacts bear there
    u : displacement (3 n + 2,): x, y and turn of each grain, then the strains of the box
    """
    return hold._replace(
        overlap=hold.overlap + skeleton.dilation * found.slid,
        shear=found.shear,
        slid=found.slide,
        slip=hold.slip + found.slid,
        place=np.where(hold.grip < FIRM, u, hold.place),
        oil=np.where(hold.grip < FIRM, hold.grip * (u - hold.place), 0.0),
    )


def load_factors(skeleton: Skeleton, hold: Hold, found: Borne) -> tuple[Array, Array]:
    """Stress over strength of each contact's cement in tension and in shear, (c,) and (c,).

    Zero where there is none. The laws are `contact.laws.bond_tension` and `bond_shear`.

    Parameters
    ----------
    skeleton : what bears between grains: contacts, bonds and joints
    hold : what they remember
    found : what contacts bear there
    """
    half = skeleton.half_width
    tension = -found.cement_n / (2.0 * half) + 1.5 * np.abs(found.cement_m) / half**2
    shear = np.abs(found.cement_s) / (2.0 * half)
    holds = skeleton.shear_strength + skeleton.cement_friction * np.maximum(found.cement_n, 0.0) / (
        2.0 * half
    )
    intact = hold.mode == INTACT
    return (
        _over(np.where(intact, np.maximum(tension, 0.0), 0.0), skeleton.tensile_strength),
        _over(np.where(intact, shear, 0.0), holds),
    )


def _over(stress: Array, strength: Array) -> Array:
    """Their ratio; infinite where what has no strength is loaded."""
    found: Array = np.divide(
        stress, strength, out=np.where(stress > 0.0, np.inf, 0.0), where=strength > 0.0
    )
    return found


def slide_factors(skeleton: Skeleton, hold: Hold, found: Borne) -> Array:
    """Shear force over what friction holds of each joint contact that never slid, (c,).

    Zero of all others. The shear is that which it would bear if it did not slide.

    Parameters
    ----------
    skeleton : what bears between grains: contacts, bonds and joints
    hold : what they remember
    found : what contacts bear there
    """
    s = skeleton
    sticks = s.joint & (hold.mode == NEVER) & found.closed
    shear = np.abs(hold.shear - s.ks * (found.slide - hold.slid))
    return _over(np.where(sticks, shear, 0.0), s.friction * found.normal)


def broken(skeleton: Skeleton, hold: Hold, found: Borne, u: Array, k: int, mode: int) -> Hold:
    """The contacts after the cement of the k-th broke, at displacements u (m,).

    Grains that bore nothing of their own take over its shear, as far as friction holds it. From
    then on they move as in oil: slightly held where they were in the state before, so that one
    that hangs on sliding contacts alone does not spin, and one that no cement holds any more does
    not slide to and fro. Forces of that are some 1e-4 of the rest, and over at the next step.

    Parameters
    ----------
    skeleton : what bears between grains: contacts, bonds and joints
    hold : what they remember
    found : what contacts bear there
    u : displacement (3 n + 2,): x, y and turn of each grain, then the strains of the box
    k : number of the contact
    mode : 1 in tension, 2 in shear
    """
    assert mode in (BROKEN_IN_TENSION, BROKEN_IN_SHEAR)
    modes = hold.mode.copy()
    modes[k] = mode
    shear, slid = hold.shear.copy(), hold.slid.copy()
    if not skeleton.beside[k]:
        shear[k], slid[k] = found.cement_s[k], found.slide[k]
    grip, place = hold.grip.copy(), hold.place.copy()
    for end in (skeleton.a[k], skeleton.b[k]):
        if end < 0:
            continue
        held = np.any((modes == INTACT) & ((skeleton.a == end) | (skeleton.b == end)))
        beside, oil = slice(3 * end, 3 * end + 3), SOFT if held else LOOSE
        place[beside] = np.where(grip[beside] == 0.0, u[beside], place[beside])
        grip[beside] = np.maximum(grip[beside], oil)
    return hold._replace(mode=modes, shear=shear, slid=slid, grip=grip, place=place)


def gripped(hold: Hold, which: Array, u: Array) -> Hold:
    """The contacts with some grains (n,) bool firmly held where they are.

    Parameters
    ----------
    hold : what they remember
    which : of the contacts, bool or int
    u : displacement (3 n + 2,): x, y and turn of each grain, then the strains of the box
    """
    grip, place = hold.grip.copy(), hold.place.copy()
    for part in range(3):
        own = 3 * np.flatnonzero(which) + part
        grip[own], place[own] = FIRM, u[own]
    return hold._replace(grip=grip, place=place)


def damped_energy(hold: Hold, u: Array) -> float:
    """What a soft grip takes on the way to displacements u (m,), by the trapezoidal rule."""
    soft = hold.grip < FIRM
    way = (u - hold.place)[soft]
    return 0.5 * float((hold.oil[soft] + hold.grip[soft] * way) @ way)


def stored_energy(skeleton: Skeleton, hold: Hold, found: Borne, u: Array) -> float:
    """Elastic energy of grains and cement, and of what grips them firmly.

    Parameters
    ----------
    skeleton : what bears between grains: contacts, bonds and joints
    hold : what they remember
    found : what contacts bear there
    u : displacement (3 n + 2,): x, y and turn of each grain, then the strains of the box
    """
    s, firm = skeleton, hold.grip >= FIRM
    total = 0.5 * float(hold.grip[firm] @ (u - hold.place)[firm] ** 2)
    for force, stiffness in (
        (found.normal, s.kn),
        (found.shear, s.ks),
        (found.cement_n, s.cn),
        (found.cement_s, s.cs),
        (found.cement_m, s.cm),
    ):
        total += 0.5 * float(
            np.sum(np.divide(force**2, stiffness, out=np.zeros(len(force)), where=stiffness > 0.0))
        )
    return total
