"""Smooth joints: fractures along which grains slide past each other, not over each other.

Where a trace runs between two grains their contact takes the orientation of the trace instead
of the grains' (Pierce et al. 2007; Mas Ivars et al. 2008, 2011). It has a stiffness per area of
its cross-section 2 R̄, R̄ the smaller radius; its gap is followed along the joint's normal, and
overlap of the grains as such gives no force. Grains that come to touch across a trace later on
join it there, with no gap and no force. A joint contact ends when its grains have slid past each
other. Where traces cross, the one named first has the contact.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from demflow.model.compile import kernel
from demflow.model.mechanics.contact.bonds import (
    BROKEN_IN_SHEAR,
    BROKEN_IN_TENSION,
    INTACT,
    Cracks,
    no_cracks,
    note_crack,
)
from demflow.model.mechanics.contact.energy import BREAKAGE, ELASTIC, JERKS, SLIP
from demflow.model.mechanics.contact.grains import Array, Grains
from demflow.model.mechanics.contact.law import Law, presses, relative_radius
from demflow.model.mechanics.contact.laws import bond_shear, bond_shear_strength, slip, spent
from demflow.model.mechanics.contact.neighbours import JOINED, Pairs

LOOSE, APART = 3, 4  # states beside those of bonds: never cemented; not touching (yet, any more)


class JointState(NamedTuple):
    """All contacts across joints, m of them."""

    a: Array  # (m,) grains, int64, a < b
    b: Array
    nx: Array  # (m,) normal of the joint, from the side of a to that of b
    ny: Array
    half_width: Array  # (m,) R̄
    kn: Array  # (m,) stiffness across and along the joint, force per length
    ks: Array
    friction: Array  # (m,)
    tensile_strength: Array  # (m,) stress
    cohesion: Array  # (m,) stress
    dilation: Array  # (m,) opening per slip
    gap: Array  # (m,) along the normal
    normal: Array  # (m,) force along the normal, compression positive
    shear: Array  # (m,) force along the joint, on b towards the normal turned by +90°
    slipped: Array  # (m,) length of its slip so far
    state: Array  # (m,) int8
    cracks: Cracks


class Trace(NamedTuple):
    """A straight joint, in the units of the specimen."""

    start: tuple[float, float]
    end: tuple[float, float]
    normal_stiffness: float  # force per length and area
    shear_stiffness: float
    friction: float
    tensile_strength: float
    cohesion: float
    dilation: float  # tangent of the dilation angle

    @property
    def cemented(self) -> bool:
        """Whether it has any strength beside friction."""
        return self.tensile_strength > 0.0 or self.cohesion > 0.0


def no_joints() -> JointState:
    """The joints of a rock without fractures."""
    grains = [np.empty(0, np.int64) for _ in range(2)]
    numbers = [np.empty(0) for _ in range(13)]
    return JointState._make([*grains, *numbers, np.empty(0, np.int8), no_cracks(0)])


def any_of(joints: JointState) -> JointState | None:
    """The same, or None where there are none: kernels are compiled without them then."""
    return joints if len(joints.a) else None


class Joints:
    """The joints of a specimen: their traces, and the sides on which grains lay when they came."""

    def __init__(self, traces: Sequence[Trace], grains: Grains):
        self.traces = tuple(traces)
        self.x, self.y = grains.x.copy(), grains.y.copy()
        self.made = False
        self.found = np.zeros(len(self.traces), dtype=bool)  # whether it ever crossed a contact

    def join(self, grains: Grains, pairs: Pairs, law: Law, known: JointState) -> JointState:
        """Let every pair across a trace that is new to the list join it; marks it in the list.

        Pairs that touch hand their force (by the `law` of contact, and their shear) to the joint
        as far as it can carry it.

        Parameters
        ----------
        grains : the grains (n,), in units of mean radius and k_n
        pairs : pairs of grains near each other, (m,)
        law : law of contact, a named tuple that chooses what is done by its type
        known : joint contacts that there were
        """
        if not self.traces and not len(known.a):
            return known
        a, b = pairs.one.astype(np.int64), pairs.other.astype(np.int64)
        n = np.int64(len(grains.x))
        old = np.isin(a * n + b, known.a * n + known.b)
        pairs.bond[old] = JOINED
        new = np.ones(len(a), dtype=bool)
        if self.made:  # what touches or is cemented beside a trace stays as it is
            gap = np.hypot(grains.x[b] - grains.x[a], grains.y[b] - grains.y[a])
            new = (pairs.bond == -1) & (gap >= grains.radius[a] + grains.radius[b])
        self.made = True
        for index, trace in enumerate(self.traces):
            free = np.flatnonzero(new & (pairs.bond != JOINED))
            across, sign = self._across(trace, grains, a[free], b[free])
            if not len(across):
                continue
            pair = free[across]
            self.found[index] = True
            made = _contacts(trace, grains, pairs, a[pair], b[pair], pair, sign, law)
            known = _joined(known, made)
            pairs.bond[pair], pairs.shear[pair] = JOINED, 0.0
        return known

    def among(self, kept: Array) -> Joints:
        """The same for some of the grains (n,) bool, in their new numbers."""
        part = copy.copy(self)
        part.x, part.y, part.found = self.x[kept], self.y[kept], self.found.copy()
        return part

    def _across(self, trace: Trace, grains: Grains, a: Array, b: Array) -> tuple[Array, Array]:
        """Which pairs lie on two sides of a trace, and +1 where a lies on its right."""
        (x0, y0), (x1, y1) = trace.start, trace.end
        length = np.hypot(x1 - x0, y1 - y0)
        tx, ty = (x1 - x0) / length, (y1 - y0) / length
        # zero counts as the right side, as it does for the pipes along a trace
        left = tx * (self.y - y0) - ty * (self.x - x0) > 0.0
        found = np.flatnonzero(left[a] != left[b])
        a, b = a[found], b[found]
        height = tx * (grains.y - y0) - ty * (grains.x - x0)
        along = tx * (grains.x - x0) + ty * (grains.y - y0)
        ha, hb = np.abs(height[a]), np.abs(height[b])
        part = np.divide(ha, ha + hb, where=ha + hb > 0.0, out=np.full(len(a), 0.5))
        place = along[a] + part * (along[b] - along[a])
        within = (place >= 0.0) & (place <= length)
        return found[within], np.where(left[b[within]], 1.0, -1.0)


def _contacts(
    trace: Trace,
    grains: Grains,
    pairs: Pairs,
    a: Array,
    b: Array,
    pair: Array,
    sign: Array,
    law: Law,
) -> JointState:
    """Contacts of pairs with one trace; `sign` tells which way its left normal points."""
    (x0, y0), (x1, y1) = trace.start, trace.end
    length = np.hypot(x1 - x0, y1 - y0)
    nx, ny = -sign * (y1 - y0) / length, sign * (x1 - x0) / length
    dx, dy = grains.x[b] - grains.x[a], grains.y[b] - grains.y[a]
    distance = np.hypot(dx, dy)
    overlap = grains.radius[a] + grains.radius[b] - distance
    touch = overlap > 0.0
    fn = presses(law, overlap, relative_radius(grains.radius[a], grains.radius[b]))
    fs = np.where(touch, pairs.shear[pair], 0.0)
    fx, fy = (fn * dx - fs * dy) / distance, (fn * dy + fs * dx) / distance
    half = np.minimum(grains.radius[a], grains.radius[b])
    stiff_n, stiff_s = trace.normal_stiffness * 2.0 * half, trace.shear_stiffness * 2.0 * half
    normal = np.maximum(fx * nx + fy * ny, 0.0)
    limit = trace.friction * normal + trace.cohesion * 2.0 * half
    many = np.full(len(a), 1.0)
    state = np.where(touch, INTACT if trace.cemented else LOOSE, APART).astype(np.int8)
    return JointState(
        a=a,
        b=b,
        nx=nx * many,
        ny=ny * many,
        half_width=half,
        kn=stiff_n,
        ks=stiff_s,
        friction=trace.friction * many,
        tensile_strength=trace.tensile_strength * many,
        cohesion=trace.cohesion * many,
        dilation=trace.dilation * many,
        gap=-normal / stiff_n,
        normal=normal,
        shear=np.clip(fy * nx - fx * ny, -limit, limit),
        slipped=0.0 * many,
        state=state,
        cracks=no_cracks(len(a)),
    )


def among(joints: JointState, kept: Array) -> JointState:
    """The contacts between grains that are kept (n,) bool, in their new numbers; a copy."""
    stays = kept[joints.a] & kept[joints.b]
    number = np.cumsum(kept) - 1
    fields = [field[stays] for field in joints[:-1]]
    cracks = Cracks(*(field[stays] for field in joints.cracks))
    some = JointState._make([*fields, cracks])
    return some._replace(a=number[some.a], b=number[some.b])


def _joined(one: JointState, two: JointState) -> JointState:
    """Both lists of contacts in one."""
    cracks = Cracks(*map(np.concatenate, zip(one.cracks, two.cracks, strict=True)))
    fields = map(np.concatenate, zip(one[:-1], two[:-1], strict=True))
    return JointState._make([*fields, cracks])


@kernel
def joint_forces(  # noqa: C901 (a kernel)
    grains: Grains,
    joints: JointState,
    box: Array,
    step: int,
    dt: float,
    stretch_x: float,
    stretch_y: float,
    ledger: Array | None,
) -> tuple[int, float]:
    """Add the forces and torques of all joint contacts; returns (contacts, Σ |F|).

    The step is that of `contacts.contact_forces`. The contact point lies between the grains;
    its displacement, b's past a's, is taken in the middle of the step and resolved along the
    joint. Both grains feel the force there, so that angular momentum is kept.

    Parameters
    ----------
    grains : the grains (n,), in units of mean radius and k_n
    joints : contacts (j,) across joints
    box : walls xmin, xmax, ymin, ymax, (4,)
    step : number of the time step
    dt : time step
    stretch_x : affine strain of the step along x, extension positive
    stretch_y : the same along y
    ledger : energies (13,), see `energy`, or None
    """
    contacts, total = 0, 0.0
    for k in range(joints.a.size):
        a, b = joints.a[k], joints.b[k]
        dx, dy = grains.x[b] - grains.x[a], grains.y[b] - grains.y[a]
        ra, rb = grains.radius[a], grains.radius[b]
        reach = ra + rb
        d2 = dx * dx + dy * dy
        nx, ny = joints.nx[k], joints.ny[k]
        state = joints.state[k]
        if state == APART:
            if d2 >= reach * reach:
                continue
            joints.state[k] = LOOSE
            joints.gap[k] = joints.normal[k] = joints.shear[k] = 0.0
            continue
        kn, ks, half = joints.kn[k], joints.ks[k], joints.half_width[k]
        held_n, held_s = joints.normal[k], joints.shear[k]
        d = np.sqrt(d2)
        arm_a, arm_b = 0.5 * (d + ra - rb), 0.5 * (d + rb - ra)  # r less half the overlap
        ux = dt * (grains.vx[b] - grains.vx[a]) + stretch_x * dx
        uy = dt * (grains.vy[b] - grains.vy[a]) + stretch_y * dy
        mx, my = dx - 0.5 * ux, dy - 0.5 * uy  # branch in the middle of the step
        m = np.sqrt(mx * mx + my * my)
        h = 0.5 * (d - m)
        turn = dt * (grains.spin[a] * (arm_a - h) + grains.spin[b] * (arm_b - h)) / m
        cx, cy = ux + turn * my, uy - turn * mx
        un, us = cx * nx + cy * ny, cy * nx - cx * ny
        gap = joints.gap[k] + un
        fn = -kn * gap
        fs = held_s - ks * us
        broke = False
        if state == INTACT:
            if -fn / (2.0 * half) > joints.tensile_strength[k]:
                state = BROKEN_IN_TENSION
            elif bond_shear(fs, half) > bond_shear_strength(
                joints.cohesion[k], joints.friction[k], fn, half
            ):
                state = BROKEN_IN_SHEAR
            if state != INTACT:
                broke = True
                joints.state[k] = state
                px, py = grains.x[a] + arm_a / d * dx, grains.y[a] + arm_a / d * dy
                note_crack(joints.cracks, k, state, step, px, py, box)
        if state != INTACT:
            fn = max(fn, 0.0)
            trial = fs
            fs = slip(fs, joints.friction[k] * fn)
            slid = abs(trial - fs) / ks
            if fn > 0.0 and slid > 0.0:
                joints.slipped[k] += slid
                gap -= slid * joints.dilation[k]
                fn = -kn * gap
        along = dy * nx - dx * ny
        parted = state != INTACT and abs(along) > reach  # they have slid past each other
        if parted:
            joints.state[k] = APART
            fn = fs = gap = 0.0
        if ledger is not None:
            lost = spent(held_s, fs, ks, us)
            pressed = spent(held_n, fn, kn, un)
            if (held_n > 0.0 and fn > 0.0) or broke or parted:
                lost += pressed
            else:  # the force begins or ends within the step, which the trapezoid misses
                ledger[JERKS] += pressed
            ledger[BREAKAGE if broke else SLIP] += lost
            ledger[ELASTIC] += 0.5 * fn * fn / kn + 0.5 * fs * fs / ks
        joints.gap[k], joints.normal[k], joints.shear[k] = gap, fn, fs
        fx, fy = fn * nx - fs * ny, fn * ny + fs * nx
        across = (dx * fy - dy * fx) / d
        grains.fx[a] -= fx
        grains.fy[a] -= fy
        grains.torque[a] -= arm_a * across
        grains.fx[b] += fx
        grains.fy[b] += fy
        grains.torque[b] -= arm_b * across
        if state == INTACT or fn > 0.0:
            contacts += 1
            total += np.sqrt(fn * fn + fs * fs)
    return contacts, total
