"""What a march through breaking bonds starts from: a loaded specimen with its pores and wells.

Bonds are installed on the packed grains, the walls then press with the wanted stresses and grains
weigh what they weigh in the fluid, all in small displacements (`skeleton`). A well that is wide
enough to hold grains is a hole: they are taken away once the stresses are on, and the face that
they leave is the well's. So is what is excavated, whose face has the pressure of its side. Until
time zero pressures are the initial ones everywhere and nothing but bonds that do not bear this
breaks.

Stresses are those that the grains carry at the initial pressure; pressures act on grains by how
they differ from it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array, eye_array
from scipy.spatial import cKDTree

from demflow.model.coupling.balance import (
    Balanced,
    Case,
    Conduits,
    Fluid,
    balanced,
    by_turns,
    through_oil,
)
from demflow.model.coupling.duality import place_of, pores_of, volume_gradient
from demflow.model.coupling.matrix import StepMatrix
from demflow.model.coupling.skeleton import (
    NEVER,
    SLID,
    Hold,
    Skeleton,
    remembered,
    skeleton_of,
    some,
)
from demflow.model.coupling.told import BreakingFluid, BreakingRock
from demflow.model.mechanics.contact.grains import Array
from demflow.model.mechanics.loading.ground import dug_out
from demflow.model.mechanics.specimen.rock import build_specimen
from demflow.model.mechanics.static.stiffness import ANCHOR
from demflow.model.network.domains import domains_at, network
from demflow.model.outcome import ModelError
from demflow.model.products import Network, Packing, Permeability
from demflow.model.region import Rectangle
from demflow.model.scene import Ground, Stress, Well

LOST = 1e-4  # of the stress, in a pipe that carries all that wells inject: wider conducts no better
WIDEST = 100.0  # times the unstressed aperture, up to which every pipe conducts as it opens
WIDEST_OF_RADIUS = 1e-3, 0.3  # of the mean radius: the same, and beyond which none does
WALLS = ("left", "right", "bottom", "top")
PARTS = 8  # of the load, where it is not found at once
PATIENCE = 150  # with it: it is found once, and all else hangs on it


class Setting(NamedTuple):
    """A case and where its march starts."""

    case: Case
    hold: Hold
    u: Array  # (m,) of the loaded rock
    network: Network  # of the grains that are left
    pore: Array  # (d,) its domains that are unknowns
    well: Array  # (wells,) pore of each, as an unknown
    link_side: Array  # (q,) which of the sides that keep their pressure
    side: Array  # (domains,) and which of them holds a domain, −1 none
    grains: Array  # (n,) bool: those that are left and bear load
    box: Array  # (4,) m of the packing
    area: float  # of the box, in units of the case
    pipe_length: Array  # (pipes,) m: of the network's pipes, as long as they are
    unopened: Array  # (pipes,) m: their apertures at no force and no gap


def setting(
    packing: Packing,
    unit_permeability: Permeability | None,
    *,
    rock: BreakingRock,
    wet: BreakingFluid,
    wells: tuple[Well, ...],
    start: tuple[Array, Hold] | None = None,
) -> Setting:
    """Set up a case; its loaded rock is found unless a march that goes on gives its `start`.

    Raises ModelError where the rock does not bear the stresses.

    Parameters
    ----------
    packing : grains at rest under the packing pressure
    unit_permeability : of the network with unit conductances, or None
    rock : grains, cement and loads
    wet : fluid and pipes
    wells : the wells
    start : displacement and memory to go on from, or None
    """
    specimen = build_specimen(
        packing, rock.normal_stiffness, rock.stiffness_ratio, rock.friction, rock.bonds,
        rock.joints, rock.seed,
    )  # fmt: skip
    skeleton, hold = skeleton_of(specimen)
    n, unit, box = len(packing.x), float(packing.radius.mean()), specimen.box
    ground = Ground(0.0, (), ()) if rock.ground is None else rock.ground
    holes = dug_out(packing, ground.holes)
    taken = np.any([_taken(packing, wells), *holes], axis=0)
    stays = ~(taken[skeleton.a] | (taken[skeleton.b] & (skeleton.b >= 0)))
    left = _without(packing, taken)
    size = (packing.box[1] - packing.box[0], packing.box[3] - packing.box[2])
    net = network(left, region=Rectangle(*map(float, size)), walled=True)
    gradient = _gradient(left, net, np.flatnonzero(~taken), n) / unit
    faces = _faces(net, packing, holes)
    load = np.zeros(3 * n + 2)
    load[-2] = -rock.stress.xx / rock.normal_stiffness * (box[3] - box[2])
    load[-1] = -rock.stress.yy / rock.normal_stiffness * (box[1] - box[0])
    heavy = ground.unit_weight * unit / rock.normal_stiffness
    weight = _weight(packing, skeleton, np.zeros(n, bool), heavy)
    load[-1] -= 0.5 * weight.sum()  # the vertical stress is that at mid-height
    whole = load + weight
    if start is None:
        u, hold = _loaded(skeleton, hold, whole)
    skeleton, hold = some(skeleton, hold, stays)
    load += _weight(packing, skeleton, taken, heavy)
    load += gradient[:, faces] @ (np.array(ground.pressures) / rock.normal_stiffness)
    if start is None:
        u, hold = _relaxed(skeleton, hold, load, u)
        mode = np.where(skeleton.joint & (hold.mode == NEVER) & (hold.slip > 0.0), SLID, hold.mode)
        hold = hold._replace(mode=mode.astype(np.int8), slip=np.zeros_like(hold.slip))
    else:
        u, hold = start
    names = tuple(name for name, _ in wet.sides)
    side = _side_of(net, left, names)
    for hole, face in zip(ground.holes, faces, strict=True):
        side[face] = names.index(hole.name)
    held = np.array([p for _, p in wet.sides]) - wet.initial
    pore, rim = np.flatnonzero(side < 0), np.flatnonzero(side >= 0)
    beyond = held[side[rim]] / rock.normal_stiffness
    push = csr_array(gradient[:, pore])
    conduits, link_side, pipe_length, unopened = _conduits(
        net,
        side,
        held,
        skeleton,
        wet,
        rock,
        np.flatnonzero(~taken),
        left.scale,
        n,
        unit,
        unit_permeability,
    )
    well = _well_pores(net, pore, wells)
    storage = net.volume[pore] / unit**2 * rock.normal_stiffness / wet.bulk_modulus
    for k, site in zip(well, wells, strict=True):
        storage[k] += site.wellbore_storage * rock.normal_stiffness / unit**2
    w0 = float(conduits.wide.max(initial=0.0))
    least = -np.inf
    if wet.least_pressure is not None:
        least = (wet.least_pressure - wet.initial) / rock.normal_stiffness
    case = Case(
        unit=unit,
        stiffness=rock.normal_stiffness,
        skeleton=skeleton,
        load=load + gradient[:, rim] @ beyond,
        push=push,
        pull=push.T.tocsr(),
        storage=storage,
        conduits=conduits,
        gap_factor=wet.matrix.gap_factor,
        widest=_widest(rock.stress, wet, w0, unit),
        matrix=StepMatrix(
            _strains(skeleton),
            np.full(3 * n + 2, ANCHOR),
            push,
            storage,
            conduits.i,
            conduits.j,
            conduits.link,
        ),
        least_pressure=least,
    )
    bears = np.zeros(n, bool)
    ends = np.append(skeleton.a, skeleton.b[skeleton.b >= 0])
    bears[ends] = True
    area = (box[1] - box[0]) * (box[3] - box[2])
    return Setting(
        case,
        hold,
        u,
        net,
        pore,
        well,
        link_side,
        side,
        bears & ~taken,
        packing.box,
        area,
        pipe_length,
        unopened,
    )


def _widest(stress: Stress, wet: BreakingFluid, w0: float, unit: float) -> float:
    """Aperture, m, beyond which a pipe conducts no better: what it loses is nothing by then.

    Pipes that conduct without end beside tight ones would make equations hard to solve.
    """
    least, most = WIDEST_OF_RADIUS
    whole, lost = most * unit, LOST * 0.5 * (stress.xx + stress.yy)
    if wet.largest_rate and lost > 0.0:
        length = 2.0 * unit
        whole = min(whole, float(np.cbrt(12.0 * wet.viscosity * length * wet.largest_rate / lost)))
    return max(WIDEST * w0, least * unit, whole)


def _taken(packing: Packing, wells: tuple[Well, ...]) -> Array:
    """Grains that lie in wells, (n,) bool."""
    found = np.zeros(len(packing.x), bool)
    for well in wells:
        found |= np.hypot(packing.x - well.at[0], packing.y - well.at[1]) < well.radius
    return found


def _faces(net: Network, packing: Packing, holes: list[Array]) -> Array:
    """The domain of each hole, in a network without the grains that they took (n,) bool each.

    Raises ModelError where the rock around leaves it in parts, or two are one.
    """
    found = []
    for gone in holes:
        face = np.unique(domains_at(net, np.column_stack([packing.x[gone], packing.y[gone]])))
        if len(face) > 1 or int(face[0]) in found:
            raise ModelError(
                "grains around a hole do not close its rim; raise grains.count, move it away from "
                "the walls, or add bonds with an installation_gap"
            )
        found.append(int(face[0]))
    return np.array(found, dtype=np.int64)


def _weight(packing: Packing, skeleton: Skeleton, taken: Array, heavy: float) -> Array:
    """Weights (3 n + 2,) of the grains that are not taken (n,) bool; `heavy` is γ over k_n.

    What nothing holds has its own borne by the nearest grain that carries load.
    """
    n = len(packing.x)
    found = np.zeros(3 * n + 2)
    if heavy:
        own = -heavy * np.pi * (packing.radius / packing.radius.mean()) ** 2
        carries = np.unique(np.append(skeleton.a, skeleton.b[skeleton.b >= 0]))
        places = np.column_stack([packing.x, packing.y])
        bearer = carries[cKDTree(places[carries]).query(places[~taken])[1]]
        found[1:-2:3] = np.bincount(bearer, own[~taken], n)
    return found


def _without(packing: Packing, taken: Array) -> Packing:
    """The packing without some of its grains."""
    if not taken.any():
        return packing
    kept = np.flatnonzero(~taken)
    number = np.cumsum(~taken) - 1
    stays = ~(taken[packing.contact_a] | taken[packing.contact_b])
    return packing._replace(
        x=packing.x[kept],
        y=packing.y[kept],
        radius=packing.radius[kept],
        contact_a=number[packing.contact_a[stays]],
        contact_b=number[packing.contact_b[stays]],
        normal_force=packing.normal_force[stays],
        shear_force=packing.shear_force[stays],
        scale=packing.scale[kept] if len(packing.scale) else packing.scale,
    )


def _gradient(left: Packing, net: Network, kept: Array, n: int) -> csr_array:
    """A (3 n + 2, domains) in metres for all grains, from that of the grains that are left."""
    place = place_of(left.x, left.y, left.box)
    found = volume_gradient(pores_of(left, net), place).tocoo()
    own = len(left.x)
    row_of = np.full(3 * own + 4, -1)
    for part in range(3):
        row_of[part : 3 * own : 3] = 3 * kept + part
    row_of[3 * own + 1], row_of[3 * own + 3] = 3 * n, 3 * n + 1  # right and top walls
    row = row_of[found.row]
    moves = row >= 0
    return csr_array(
        (found.data[moves], (row[moves], found.col[moves])), shape=(3 * n + 2, found.shape[1])
    )


def _strains(skeleton: Skeleton) -> tuple[csr_array, ...]:
    """What contacts strain by, and what grips each unknown."""
    every = csr_array(eye_array(skeleton.parting.shape[1]))
    return skeleton.parting, skeleton.sliding, skeleton.bending, every


def fluidless(skeleton: Skeleton, load: Array) -> Case:
    """A case without pores."""
    none, whole = np.empty(0), np.empty(0, np.int64)
    push = csr_array((len(load), 0))
    conduits = Conduits(whole, whole, whole, none, none, none, whole, whole, none, none, none, none)
    matrix = StepMatrix(
        _strains(skeleton), np.full(len(load), ANCHOR), push, none, whole, whole, whole
    )
    return Case(
        1.0, 1.0, skeleton, load, push, push.T.tocsr(), none, conduits, 0.0, np.inf, matrix, -np.inf
    )


def at_rest(case: Case, hold: Hold, u: Array) -> Balanced:
    """The state of a case without pores at its load.

    Parameters
    ----------
    case : the specimen and its loads
    hold : what they remember
    u : displacement (3 n + 2,): x, y and turn of each grain, then the strains of the box
    """
    none = np.empty(0)
    keeps = np.empty(0, bool)
    fluid = Fluid(0.0, none, keeps)
    found = balanced(case, hold, u, none, none, fluid, keeps)
    if not found.reached:
        found = by_turns(case, hold, u, none, none, fluid, keeps)
    if found.reached:
        return found
    return through_oil(case, hold, u, none, none, fluid, keeps, found, patience=PATIENCE)


def _loaded(skeleton: Skeleton, hold: Hold, load: Array) -> tuple[Array, Hold]:
    """The packed rock under the load of its walls."""
    whole = fluidless(skeleton, load)
    u = np.zeros(len(load))
    for parts in (1, PARTS):
        state, now = u, hold
        for part in range(parts):
            case = whole._replace(load=load * (part + 1) / parts)
            found = at_rest(case, now, state)
            if not found.reached:
                break
            state, now = found.u, remembered(skeleton, found.hold, found.found, found.u)
        else:
            return state, now
    raise ModelError(
        "the rock does not bear its stresses before anything is injected: contacts slide without "
        "end; try stronger bonds, more friction or a smaller stress difference"
    )


def _relaxed(skeleton: Skeleton, hold: Hold, load: Array, u: Array) -> tuple[Array, Hold]:
    """The same once its holes are made."""
    found = at_rest(fluidless(skeleton, load), hold, u)
    if not found.reached:
        raise ModelError(
            "the rock does not bear its stresses once the wells are drilled: grains around them "
            "find no hold; try stronger bonds or narrower wells"
        )
    return found.u, remembered(skeleton, found.hold, found.found, found.u)


def _side_of(net: Network, left: Packing, names: tuple[str, ...]) -> Array:
    """Which of the named sides holds the pressure of each pore, (d,), −1 none.

    A side holds the pores that have an edge on its wall; in a corner the one that is named first.
    """
    count = np.diff(net.corner_start)
    pore = np.repeat(np.arange(len(count)), count)
    foot = net.corner_grain >= len(left.x)
    place = np.column_stack([net.grain_x, net.grain_y])[net.corner_grain]
    found = np.full(len(count), -1)
    for k in reversed(range(len(names))):
        for wall, name in enumerate(WALLS):
            if names[k] in (name, "outer"):
                on = foot & (place[:, wall // 2] == left.box[wall])
                found[np.bincount(pore[on], minlength=len(count)) > 1] = k
    return found


def _conduits(
    net: Network,
    side: Array,
    held: Array,
    skeleton: Skeleton,
    wet: BreakingFluid,
    rock: BreakingRock,
    kept: Array,
    scale: Array,
    n: int,
    unit: float,
    unit_permeability: Permeability | None,
) -> tuple[Conduits, Array, Array, Array]:
    """Pipes between the pores that are unknowns, and links to those whose pressure a side keeps.

    `kept` are the numbers of the grains that are left, of n, and `scale` their sizes where graded.
    """
    number = np.cumsum(side < 0) - 1
    matrix = wet.matrix
    if matrix.aperture is not None:
        w0 = matrix.aperture
    elif unit_permeability is not None and matrix.permeability is not None:
        w0 = float(np.cbrt(matrix.permeability / (0.5 * np.trace(unit_permeability.tensor))))
    else:
        raise ModelError("a permeability is asked for, but the network's own was not computed")
    grain = np.append(kept, np.full(len(net.grain_x) - len(kept), -1))
    contact = _contact_of(skeleton, n, grain[net.pipe_grain_a], grain[net.pipe_grain_b])
    half = np.full(len(contact), np.inf)
    if matrix.half_force is not None:
        half[:] = matrix.half_force / (rock.normal_stiffness * unit)
    elif matrix.half_stress is not None:
        reach = net.grain_radius[net.pipe_grain_a] + net.grain_radius[net.pipe_grain_b]
        half = matrix.half_stress * reach / (rock.normal_stiffness * unit)
    # Where grains are graded, pipes of their lengths conduct as w0 does among the coarse ones; what
    # opens is as long as it is.
    own = np.ones(len(contact))
    if len(scale):
        known = contact >= 0
        a, b = net.pipe_grain_a[known], net.pipe_grain_b[known]
        own[known] = 0.5 * (scale[a] + scale[b])
    wide = w0 * np.cbrt(own)
    length = own * net.pipe_length
    factor = rock.normal_stiffness / (unit**2 * 12.0 * wet.viscosity * length)
    i, j = net.pipe_from, net.pipe_to
    pipe = np.flatnonzero((side[i] < 0) & (side[j] < 0))
    link = np.flatnonzero((side[i] < 0) != (side[j] < 0))
    inner = np.where(side[i] < 0, i, j)[link]
    ends = np.where(side[i] < 0, side[j], side[i])[link]
    return (
        Conduits(
            i=number[i[pipe]],
            j=number[j[pipe]],
            contact=contact[pipe],
            wide=wide[pipe],
            factor=factor[pipe],
            half_force=half[pipe],
            link=number[inner],
            link_contact=contact[link],
            link_wide=wide[link],
            link_factor=factor[link],
            link_half_force=half[link],
            link_pressure=held[ends] / rock.normal_stiffness,
        ),
        ends,
        length,
        wide,
    )


def _contact_of(skeleton: Skeleton, n: int, a: Array, b: Array) -> Array:
    """The contact between grains a and b (p,), −1 where there is none."""
    known = np.flatnonzero(skeleton.b >= 0)
    keys = skeleton.a[known] * n + skeleton.b[known]
    order = np.argsort(keys, kind="stable")
    wanted = np.where((a >= 0) & (b >= 0), a * n + b, -1)
    at = np.minimum(np.searchsorted(keys[order], wanted), len(keys) - 1)
    return np.where(keys[order][at] == wanted, known[order][at], -1)


def _well_pores(net: Network, pore: Array, wells: tuple[Well, ...]) -> Array:
    """The pore of each well, as an unknown.

    Raises ModelError where two wells share one, or a side keeps its pressure.
    """
    if not wells:
        return np.empty(0, np.int64)
    number = np.full(len(net.x), -1)
    number[pore] = np.arange(len(pore))
    found = number[domains_at(net, np.array([well.at for well in wells]))]
    if found.min() < 0:
        name = wells[int(np.argmin(found))].name
        raise ModelError(
            f"the well {name} lies in a pore whose pressure a side or a hole keeps; move it away"
        )
    if len(np.unique(found)) < len(found):
        raise ModelError("two wells lie in one pore; move them apart, or raise grains.count")
    result: Array = found
    return result
