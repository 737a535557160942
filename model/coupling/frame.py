"""The grains that bear load between walls, as a linear elastic frame: its stiffness, factored once.

Every contact holds, bonded or not, about the packed state. The left and the bottom wall stand; the
right and the top one may move. A wall stands for a mirror: what presses a grain on it is half of a
contact between two grains, hence twice as stiff. Grains that nothing holds take no part. A smooth
joint is a spring across and one along it at each contact that it crosses; it neither parts nor
slides.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array, csc_array, diags_array

from demflow.model.mechanics.contact.grains import Array
from demflow.model.mechanics.contact.joints import APART
from demflow.model.mechanics.contact.neighbours import JOINED
from demflow.model.mechanics.motion.equilibrium import Specimen
from demflow.model.mechanics.specimen.rock import build_specimen
from demflow.model.mechanics.static.load_carrying import (
    brakes,
    carrying,
    carrying_beside_joints,
    contacts_of,
)
from demflow.model.mechanics.static.stiffness import (
    ANCHOR,
    Contacts,
    Factor,
    factorise,
    matrix,
    solve,
    springs,
)
from demflow.model.network.connectivity import component_labels
from demflow.model.network.enclosure import feet
from demflow.model.outcome import ModelError
from demflow.model.products import Packing
from demflow.model.scene import Bonds, JointLine

WALLS = ("left", "right", "bottom", "top")
REFINEMENTS = 1  # of each solve


class Frame(NamedTuple):
    """What moves, and how stiffly; lengths over the mean radius, forces over it and k_n."""

    unit: float  # m: the mean radius
    grain_count: int  # n
    radius: Array  # (n,) m
    free: Array  # (m,) entries of the place (3 n + 4,) that move, see `duality.Pores`
    stiffness: csc_array  # (m, m) K
    between: csc_array  # (m, m) the same without walls
    standing: csc_array  # (m, 2) force on what moves by the way of a right, a top wall that stands
    factor: Factor
    contacts: Contacts
    springs: tuple[Array, Array]  # (c,) normal and shear stiffness of the contacts over k_n

    def moved(self, force: Array, refinements: int = REFINEMENTS) -> Array:
        """Displacements (m,) under forces (m,)."""
        found = solve(self.factor, force)
        for _ in range(refinements):
            found += solve(self.factor, force - self.stiffness @ found)
        return found

    def wall(self, name: str) -> int:
        """Where a wall stands among what moves, −1 where it does not."""
        at = np.flatnonzero(self.free == 3 * self.grain_count + WALLS.index(name))
        return int(at[0]) if len(at) else -1


def frame_of(
    packing: Packing,
    *,
    stiffness_ratio: float,
    friction: float,
    bonds: Bonds | None,
    held: tuple[str, ...] = (),
    gone: Array | None = None,
    joints: tuple[JointLine, ...] = (),
) -> Frame:
    """The frame of a packing.

    Parameters
    ----------
    packing : grains between walls.
    stiffness_ratio, friction : of contacts, as `mechanics.specimen.rock.build_specimen` has them.
    bonds : cement, its modulus over k_n; None for grains that stick by friction alone.
    held : names of the walls that stand besides the left and the bottom one.
    gone : grains that holes took, (n,) bool, or None.
    joints : smooth joints, their stiffnesses over k_n.

    Raises `ModelError` where nothing bears load, or parts of it are loose.
    """
    specimen = build_specimen(packing, 1.0, stiffness_ratio, friction, bonds, joints)
    grains, n = specimen.grains, len(packing.x)
    stands = feet(packing)
    walls = tuple(stands.grain[stands.wall == wall] for wall in range(4))
    contacts = contacts_of(specimen)._replace(walls=walls)
    if gone is not None:
        stays = ~(gone[contacts.a] | gone[contacts.b])
        contacts = Contacts(contacts.a[stays], contacts.b[stays], contacts.bond[stays], walls)
    own = carrying_beside_joints(specimen) if joints else np.ones(n, bool)
    carries = _joined(n, contacts, own & carrying(n, contacts))
    if not carries.any():
        raise ModelError(
            "no grain bears load between the walls; raise grains.count, or lower grains.porosity"
        )
    kept = carries[contacts.a] & carries[contacts.b] & (contacts.bond != JOINED)
    contacts = Contacts(
        contacts.a[kept],
        contacts.b[kept],
        contacts.bond[kept],
        tuple(wall[carries[wall]] for wall in walls),
    )
    overlap = _overlaps(grains.x, grains.y, grains.radius, contacts.a, contacts.b)
    normal, shear, _ = springs(overlap, contacts, grains, specimen.bonds, specimen.law)
    whole = matrix(grains, contacts, specimen.bonds, specimen.law, 2.0 * float(normal.mean()))
    none = contacts._replace(walls=(contacts.a[:0],) * 4)
    between = matrix(grains, none, specimen.bonds, specimen.law)
    if joints:
        crossed = _of_joints(specimen, carries)
        whole, between = csc_array(whole + crossed), csc_array(between + crossed)
    turning = np.zeros(3 * n + 2)
    turning[2:-2:3] = specimen.law.kn * np.where(carries, brakes(grains, contacts, carries), 0.0)
    whole = csc_array(whole + diags_array(turning - ANCHOR * specimen.law.kn))
    moving = [name for name in ("right", "top") if name not in held]
    rest = np.flatnonzero(np.repeat(carries, 3))
    free = np.concatenate([rest, [3 * n + WALLS.index(name) for name in moving]]).astype(np.int64)
    rows = np.concatenate([rest, [3 * n + ("right", "top").index(name) for name in moving]])
    rows = rows.astype(np.int64)
    stiffness = csc_array(whole[rows][:, rows])
    stands_still = np.array([float(name in held) for name in ("right", "top")])
    return Frame(
        unit=float(packing.radius.mean()),
        grain_count=n,
        radius=packing.radius,
        free=free,
        stiffness=stiffness,
        between=csc_array(between[rows][:, rows]),
        standing=csc_array(whole[rows][:, 3 * n + np.arange(2)] @ diags_array(stands_still)),
        factor=factorise(stiffness),
        contacts=contacts,
        springs=(normal, shear),
    )


def _of_joints(specimen: Specimen, carries: Array) -> csc_array:
    """Stiffness (3 n + 2, 3 n + 2) of what touches across joints, among grains (n,) bool."""
    grains, joints, n = specimen.grains, specimen.joints, len(specimen.grains.x)
    kept = (joints.state != APART) & carries[joints.a] & carries[joints.b]
    a, b, nx, ny = joints.a[kept], joints.b[kept], joints.nx[kept], joints.ny[kept]
    dx, dy = grains.x[b] - grains.x[a], grains.y[b] - grains.y[a]
    d = np.hypot(dx, dy)
    arm = 0.5 * (d + grains.radius[a] - grains.radius[b]) / d  # share of the way that is a's
    along, off = (nx * dx + ny * dy), (nx * dy - ny * dx)
    unknown = np.concatenate([3 * a, 3 * a + 1, 3 * a + 2, 3 * b, 3 * b + 1, 3 * b + 2])
    row = np.tile(np.arange(len(a)), 6)
    found = csc_array((3 * n + 2, 3 * n + 2))
    for stiffness, strain in (
        (joints.kn[kept], (-nx, -ny, arm * off, nx, ny, (1.0 - arm) * off)),
        (joints.ks[kept], (ny, -nx, -arm * along, -ny, nx, (arm - 1.0) * along)),
    ):
        shape = (len(a), 3 * n + 2)
        by = coo_array((np.concatenate(strain), (row, unknown)), shape=shape).tocsr()
        found = found + by.T @ diags_array(stiffness) @ by
    return csc_array(found)


def _joined(n: int, contacts: Contacts, carries: Array) -> Array:
    """Those of the grains (n,) bool that hang together with a wall."""
    kept = carries[contacts.a] & carries[contacts.b]
    stands = np.concatenate(contacts.walls)
    label = component_labels(
        n + 1,
        np.append(contacts.a[kept], stands),
        np.append(contacts.b[kept], np.full(len(stands), n)),
    )
    found: Array = carries & (label[:n] == label[n])
    return found


def _overlaps(x: Array, y: Array, radius: Array, a: Array, b: Array) -> Array:
    found: Array = radius[a] + radius[b] - np.hypot(x[b] - x[a], y[b] - y[a])
    return found
