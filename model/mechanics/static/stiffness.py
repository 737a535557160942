"""Stiffness of bonded grains between walls: assembled, factored once, solved many times.

Unknowns are each grain's displacement and rotation (u_x, u_y, θ), 3 n of them, then the
outward displacement of the right wall and that of the top wall; the left and bottom walls
stand. A contact strains by Δu·n and slides by Δu·t − θ_a l_a − θ_b l_b, as `contacts` has it.
Grains that nothing holds would make the matrix singular: every unknown is held besides by
a spring of ANCHOR, which corrections against the true forces (`static`) take out again.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import qdldl
from scipy.sparse import coo_array, csc_array

from demflow.model.compile import kernel
from demflow.model.mechanics.contact.bonds import PARALLEL_BONDS, BondState
from demflow.model.mechanics.contact.grains import Array, Grains
from demflow.model.mechanics.contact.law import Law, relative_radius, stiffnesses
from demflow.model.outcome import ModelError

ANCHOR = 1e-8  # over k_n
LEAST_PIVOT = 1e-13  # of its diagonal: less is round-off of what was taken away
MOVES = 1e-3  # part of the largest in a motion
MOST_NAMED = 8
TOUCHING = 1e-6  # gap, in mean radii, below which grains count as touching


class Factor(NamedTuple):
    """P K Pᵀ = L D Lᵀ, L with a unit diagonal."""

    order: Array  # (m,) unknown eliminated k-th
    start: Array  # (m + 1,) first entry of each column of L
    row: Array  # (entries,) int32
    lower: Array  # (entries,)
    pivot: Array  # (m,)


class Contacts(NamedTuple):
    """Contacts of a stiffness matrix: c between grains, and those with the four walls."""

    a: Array  # (c,) a < b
    b: Array
    bond: Array  # (c,) index of the bond, −1 for none
    walls: tuple[Array, ...]  # grains at left, right, bottom, top


def matrix(
    grains: Grains,
    contacts: Contacts,
    bonds: BondState,
    law: Law,
    wall_stiffness: float | None = None,
) -> csc_array:
    """The stiffness matrix (3 n + 2, 3 n + 2) about the present positions, over k_n.

    Every contact carries tension as it does compression, see `springs`.

    Parameters
    ----------
    grains : the grains (n,), in units of mean radius and k_n
    contacts : contacts (c,) of the specimen, with their bonds
    bonds : bonds (b,)
    law : law of contact, a named tuple that chooses what is done by its type
    wall_stiffness : of walls; None: they are as stiff as grains are
    """
    wall_kn = law.kn if wall_stiffness is None else wall_stiffness
    n = len(grains.x)
    a, b = contacts.a, contacts.b
    dx, dy = grains.x[b] - grains.x[a], grains.y[b] - grains.y[a]
    distance = np.hypot(dx, dy)
    nx, ny = dx / distance, dy / distance
    overlap = grains.radius[a] + grains.radius[b] - distance
    arm_a, arm_b = grains.radius[a] - 0.5 * overlap, grains.radius[b] - 0.5 * overlap
    kn, ks, kr = springs(overlap, contacts, grains, bonds, law)
    zero, one = np.zeros(len(a)), np.ones(len(a))
    strains = (
        (kn, (-nx, -ny, zero, nx, ny, zero)),
        (ks, (ny, -nx, -arm_a, -ny, nx, -arm_b)),
        (kr, (zero, zero, -one, zero, zero, one)),
    )
    local = np.zeros((len(a), 6, 6))
    for stiffness, strain in strains:
        column = np.column_stack(strain)
        local += (stiffness[:, None] * column)[:, :, None] * column[:, None, :]
    unknown = np.column_stack([3 * a, 3 * a + 1, 3 * a + 2, 3 * b, 3 * b + 1, 3 * b + 2])
    rows = [np.repeat(unknown, 6, axis=1).ravel()]
    columns = [np.tile(unknown, 6).ravel()]
    values = [local.ravel()]
    every = np.arange(3 * n + 2)
    rows.append(every)
    columns.append(every)
    values.append(np.full(3 * n + 2, ANCHOR * law.kn))
    for side, held in enumerate(contacts.walls):
        at = 3 * held + side // 2
        k = np.full(len(held), wall_kn)
        rows.append(at)
        columns.append(at)
        values.append(k)
        if side % 2 == 1:
            wall = np.full(len(held), 3 * n + side // 2)
            rows += [wall, at, wall]
            columns += [wall, wall, at]
            values += [k, -k, -k]
    return coo_array(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))),
        shape=(3 * n + 2, 3 * n + 2),
    ).tocsc()


def springs(
    overlap: Array, contacts: Contacts, grains: Grains, bonds: BondState, law: Law
) -> tuple[Array, Array, Array]:
    """Normal, shear and bending stiffness (c,) of contacts, by their overlaps (c,) and bonds.

    A parallel bond adds its own to the grains', and stands alone across a gap. Contact bonds
    are as stiff there as grains that touch.

    Parameters
    ----------
    overlap : U_n (c,)
    contacts : contacts (c,) of the specimen, with their bonds
    grains : the grains (n,), in units of mean radius and k_n
    bonds : bonds (b,)
    law : law of contact, a named tuple that chooses what is done by its type
    """
    bond, radius = (
        contacts.bond,
        relative_radius(grains.radius[contacts.a], grains.radius[contacts.b]),
    )
    kn, ks = stiffnesses(law, overlap, radius)
    kr = np.zeros(len(bond))
    if bonds.kind == PARALLEL_BONDS:
        apart = overlap < -TOUCHING
        kn[apart] = ks[apart] = 0.0
        glued = bond >= 0
        of = bond[glued]
        kn[glued] += bonds.kn[of]
        ks[glued] += bonds.ks[of]
        kr[glued] += bonds.kr[of]
    return kn, ks, kr


def factorise(stiffness: csc_array) -> Factor:
    """Factor a symmetric matrix, in approximate-minimum-degree order.

    Raises `ModelError`, naming the grains that move together, where nothing holds some of them:
    qdldl itself stops at a pivot of exactly zero only, which round-off hardly ever leaves.
    """
    lower, pivot, order = qdldl.Solver(_upper(stiffness), upper=True).factors()
    lower = csc_array(lower)
    factor = Factor(
        np.asarray(order, dtype=np.int64),
        lower.indptr.astype(np.int64),
        lower.indices.astype(np.int32),
        lower.data.astype(float),
        np.array(pivot, dtype=float),
    )
    held = LEAST_PIVOT * np.abs(stiffness.diagonal()[factor.order])
    lost = np.flatnonzero(~(factor.pivot > held))
    if len(lost):
        loose = np.unique(moving_together(factor, int(lost[0])) // 3)
        named = ", ".join(str(k) for k in loose[:MOST_NAMED])
        raise ModelError(
            f"nothing holds {len(loose)} grains against one another, so that any force moves them "
            f"without end, first {named}; give them bonds, friction or a larger packing stress"
        )
    return factor


def _upper(symmetric: csc_array) -> csc_array:
    """The upper triangle of a matrix, with its diagonal."""
    keep = symmetric.indices <= np.repeat(np.arange(symmetric.shape[1]), np.diff(symmetric.indptr))
    counts = np.concatenate([[0], np.cumsum(keep)])[symmetric.indptr]
    return csc_array((symmetric.data[keep], symmetric.indices[keep], counts), shape=symmetric.shape)


class Quasidefinite:
    """Factor of a symmetric matrix [[K, −A], [−Aᵀ, −S]], K and S positive definite.

    Such a matrix has an LDLᵀ in any order (Vanderbei 1995, SIAM J. Optim. 5, 100). Others of the
    same pattern are factored in the same order.
    """

    def __init__(self, matrix: csc_array) -> None:
        self._solver = qdldl.Solver(_upper(matrix), upper=True)

    def update(self, matrix: csc_array) -> None:
        """Factor another matrix that has the same entries, not the same values."""
        self._solver.update(_upper(matrix), upper=True)

    def solve(self, load: Array) -> Array:
        """The solution (m,) for a right-hand side (m,)."""
        return np.asarray(self._solver.solve(load))


def moving_together(factor: Factor, eliminated: int) -> Array:
    """Unknowns that move where the pivot of the one eliminated k-th is lost.

    The column of L⁻ᵀ of that pivot is the motion that meets no resistance.
    """
    motion = np.zeros(len(factor.pivot))
    motion[eliminated] = 1.0
    for k in range(eliminated - 1, -1, -1):
        entries = slice(factor.start[k], factor.start[k + 1])
        motion[k] = -factor.lower[entries] @ motion[factor.row[entries]]
    moves = np.abs(motion) > MOVES * np.abs(motion).max()
    found: Array = factor.order[moves]
    return found


def solve(factor: Factor, load: Array) -> Array:
    """Displacements (m,) under loads (m,)."""
    work = load[factor.order]
    _substitute(factor.start, factor.row, factor.lower, factor.pivot, work)
    found: Array = np.empty_like(work)
    found[factor.order] = work
    return found


@kernel
def _substitute(start: Array, row: Array, lower: Array, pivot: Array, x: Array) -> None:
    """Solve L D Lᵀ x = x in place."""
    for k in range(x.size):
        value = x[k]
        for p in range(start[k], start[k + 1]):
            x[row[p]] -= lower[p] * value
    for k in range(x.size - 1, -1, -1):
        value = x[k] / pivot[k]
        for p in range(start[k], start[k + 1]):
            value -= lower[p] * x[row[p]]
        x[k] = value
