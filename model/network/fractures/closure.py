"""Hydraulic apertures of traces under the normal stress across them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from demflow.model.outcome import ModelError
from demflow.model.products import StressState, Walk
from demflow.model.scene import BartonBandis, Closure

# Grains around a piece whose mean stress is that across it; fewer scatter by their force chains.
AROUND = 800

# Contacts of a joint whose forces are the stress across one of its pieces.
ALONG = 60

# The layer at the walls, in parts of the specimen, is no sample of its inside.
LAYER = 0.1

# Part of its aperture that a fracture keeps under any stress.
RESIDUAL = 1e-3


def half_stress(w0: np.ndarray, stress: np.ndarray, half: float) -> np.ndarray:
    """W = w0 σ0 / (σ + σ0), m, of apertures w0 (m) under stresses σ ≥ 0 (Pa).

    Parameters
    ----------
    w0 : apertures without stress, (n,) m
    stress : normal stress σ ≥ 0, (n,) Pa
    half : σ0 that halves them, Pa
    """
    return w0 * half / (stress + half)


def hyperbolic(stress: np.ndarray, stiffness: float, largest: np.ndarray) -> np.ndarray:
    """Closure σ V_m / (k_n V_m + σ), m (Bandis, Lumsden & Barton 1983, IJRMMS 20, 249–268).

    Parameters
    ----------
    stress : normal stress σ ≥ 0, (n,) Pa
    stiffness : k_n, Pa/m
    largest : closure V_m, (n,) m
    """
    found: np.ndarray = stress * largest / (stiffness * largest + stress)
    return found


def barton_bandis(w0: np.ndarray, stress: np.ndarray, wall: BartonBandis) -> np.ndarray:
    """Hydraulic aperture, m, by roughness and strength of the walls, first loading.

    Mechanical aperture E and hydraulic e of a rough fracture go as e = E² / JRC^2.5 in µm, e ≤ E;
    E closes hyperbolically from k_ni = −7.15 + 1.75 JRC + 0.02 JCS/E0 (MPa/mm) by at most
    V_m = −0.296 − 0.0056 JRC + 2.241 (JCS/E0)^−0.245 (mm) (Bandis et al. 1983; Barton, Bandis &
    Bakhtar 1985, IJRMMS 22, 121–140), and never by all of E0.

    Parameters
    ----------
    w0 : hydraulic apertures without stress, (n,) m
    stress : normal stress σ ≥ 0, (n,) Pa
    wall : roughness and strength of the walls
    """
    rough = wall.jrc**2.5 * 1e-6
    open_ = np.maximum(np.sqrt(w0 * rough), w0)
    ratio = wall.jcs * 1e-6 / (open_ * 1e3)
    stiffness = (-7.15 + 1.75 * wall.jrc + 0.02 * ratio) * 1e9
    if np.any(stiffness <= 0.0):
        raise ModelError(
            f"barton_bandis gives no stiffness for a JRC of {wall.jrc:g} and apertures up to "
            f"{w0.max():.3g} m; give a rougher or stronger wall, or a stiffness"
        )
    largest = (-0.296 - 0.0056 * wall.jrc + 2.241 * ratio**-0.245) * 1e-3
    largest = np.clip(largest, RESIDUAL * open_, (1.0 - RESIDUAL) * open_)
    left = open_ - stress * largest / (stiffness * largest + stress)
    found: np.ndarray = np.minimum(left, left**2 / rough)
    return found


def closed(w0: np.ndarray, stress: np.ndarray, law: Closure) -> np.ndarray:
    """Apertures (n,) m under normal stresses (n,) Pa; tension leaves them as they are.

    Parameters
    ----------
    w0 : apertures without stress, (n,) m
    stress : normal stress, (n,) Pa, compression positive
    law : how they close
    """
    stress = np.maximum(stress, 0.0)
    if not law.closes:
        return w0.copy()
    if law.table is not None:
        at, aperture = np.array(law.table).T
        result: np.ndarray = w0 * np.interp(stress, at, aperture / aperture[0])
        return result
    if law.half_stress is not None:
        left = half_stress(w0, stress, law.half_stress)
    elif law.barton_bandis is not None:
        left = barton_bandis(w0, stress, law.barton_bandis)
    elif law.stiffness is not None and law.largest_closure is not None:
        largest = np.full(len(w0), law.largest_closure)
        left = w0 - hyperbolic(stress, law.stiffness, largest)
    else:
        left = w0 - stress / (law.stiffness or np.inf)
    found: np.ndarray = np.maximum(left, RESIDUAL * w0)
    return found


def normal_stress(state: StressState, walked: Walk) -> np.ndarray:
    """Stress across each branch, n · σ · n (e,) Pa, compression positive.

    σ is the mean of the `AROUND` grains nearest to its middle, Σ f ⊗ l over half of each contact's
    branch vector l, over the area that as many grains have in the specimen; their mean over its
    inside, where holes bear nothing, is brought to the stress of the specimen.
    """
    a, b = state.contact_a, state.contact_b
    between = np.column_stack([state.x[b] - state.x[a], state.y[b] - state.y[a]])
    n = between / np.hypot(*between.T)[:, None]
    shear = state.shear_force[:, None] * np.column_stack([-n[:, 1], n[:, 0]])
    force = state.normal_force[:, None] * n + shear
    moment = 0.5 * force[:, :, None] * between[:, None, :]
    count = len(state.x)
    grains = np.zeros((count, 2, 2))
    np.add.at(grains, a, moment)
    np.add.at(grains, b, moment)
    ends = np.column_stack([walked.branch_a, walked.branch_b])
    middle = np.column_stack([walked.node_x[ends].mean(axis=1), walked.node_y[ends].mean(axis=1)])
    there = np.flatnonzero(np.isfinite(state.x))
    many = min(AROUND, len(there))
    places = np.column_stack([state.x[there], state.y[there]])
    near = there[cKDTree(places).query(middle, np.arange(1, many + 1))[1]]
    west, east, south, north = state.box
    area = (east - west) * (north - south) * many / count
    along = (walked.line_end - walked.line_start)[walked.branch_line]
    along /= np.hypot(*along.T)[:, None]
    across = np.column_stack([-along[:, 1], along[:, 0]])
    # only the component across is summed over the grains around, a chunk of branches at a time
    inner = (np.abs(state.x - 0.5 * (west + east)) < (0.5 - LAYER) * (east - west)) & (
        np.abs(state.y - 0.5 * (south + north)) < (0.5 - LAYER) * (north - south)
    )
    among = np.count_nonzero(inner) + count - len(there)
    whole = grains[inner].sum(axis=0) / among * many / area
    xx, yy, xy = state.stress
    offset = np.array([[xx, xy], [xy, yy]]) - 0.5 * (whole + whole.T)
    found = np.empty(len(middle))
    for begin in range(0, len(middle), 1000):
        part = slice(begin, begin + 1000)
        tensor = grains[near[part]].sum(axis=1) / area + offset
        found[part] = np.einsum("ei,eij,ej->e", across[part], tensor, across[part])
    return found


class OnJoint(NamedTuple):
    """What the contacts of a joint tell of the pieces of its trace."""

    normal: np.ndarray  # (e,) Pa, compression positive
    shear: np.ndarray  # (e,) Pa along the trace
    opening: np.ndarray  # (e,) m: by slip of a dilating joint, and gaps where nothing presses


def on_joint(
    state: StressState, start: np.ndarray, end: np.ndarray, at: np.ndarray, dilation: float
) -> OnJoint | None:
    """Stresses on, and opening of, pieces of a straight joint; None where no contact crosses it.

    Forces of the `ALONG` joint contacts nearest along the trace, over the length that falls to
    them, half of the way to the next on either side: over the whole trace their sum is the force
    that the rock on one side exerts on the other.

    Parameters
    ----------
    state : grains in equilibrium, with the joints' contacts.
    start, end : of the trace, (2,) m.
    at : places along it, m from its start, (e,).
    dilation : tangent of the joint's dilation angle.
    """
    step = end - start
    length = float(np.hypot(*step))
    along, across = step / length, np.array([-step[1], step[0]]) / length
    joined = np.flatnonzero(np.isfinite(state.joint_gap))
    a, b = state.contact_a[joined], state.contact_b[joined]
    place = np.column_stack([state.x, state.y]) - start
    ha, hb = place[a] @ across, place[b] @ across
    met = np.where(ha != hb, ha / np.where(ha != hb, ha - hb, 1.0), 0.5)
    s = place[a] @ along + met * ((place[b] - place[a]) @ along)
    ours = (met >= 0.0) & (met <= 1.0) & (s >= 0.0) & (s <= length)
    order = np.flatnonzero(ours)[np.argsort(s[ours], kind="stable")]
    if not len(order):
        return None
    joined, a, b, s = joined[order], a[order], b[order], s[order]
    branch = place[b] - place[a]
    normal = branch / np.hypot(*branch.T)[:, None]
    force = state.normal_force[joined, None] * normal
    force += state.shear_force[joined, None] * np.column_stack([-normal[:, 1], normal[:, 0]])
    force *= np.where(hb[order] > ha[order], 1.0, -1.0)[:, None]  # on the left side
    gap = state.joint_gap[joined]
    lifted = np.zeros(len(s))
    if len(state.joint_slip):
        lifted = dilation * np.where(gap < 0.0, state.joint_slip[joined], 0.0)
    many = min(ALONG, len(s))
    edges = np.concatenate([[0.0], 0.5 * (s[:-1] + s[1:]), [length]])
    first = np.clip(np.searchsorted(s, at) - many // 2, 0, len(s) - many)
    span = edges[first + many] - edges[first]

    def summed(values: np.ndarray) -> np.ndarray:
        total = np.concatenate([[0.0], np.cumsum(values)])
        return np.asarray(total[first + many] - total[first])

    pressed = summed(force @ across) / span
    # gaps between single grains say nothing of a joint that is pressed together as a whole
    parted = np.where(pressed > 0.0, 0.0, summed(np.maximum(gap, 0.0)) / many)
    bearing = np.maximum(summed((gap < 0.0).astype(float)), 1.0)
    return OnJoint(pressed, summed(force @ along) / span, parted + summed(lifted) / bearing)
