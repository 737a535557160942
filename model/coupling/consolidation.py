"""The stage *consolidate*: what a unit of each source does to fluid and frame together."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from demflow.model.coupling.duality import pores_of
from demflow.model.coupling.frame import WALLS, frame_of
from demflow.model.coupling.krylov import Course, Factors, course
from demflow.model.coupling.march import march
from demflow.model.coupling.record import Record, record_of
from demflow.model.coupling.rock import Rock, Source, rock_of
from demflow.model.flow.equation.outputs import map_rows, outputs
from demflow.model.flow.equation.probes import Probes, between_pores
from demflow.model.flow.equation.sites import WellSite, change_times, time_since
from demflow.model.flow.equation.system import System, assemble
from demflow.model.flow.solvers.initial import with_linear_fields
from demflow.model.mechanics.loading.ground import dug_out
from demflow.model.network.domains import faces_of_holes
from demflow.model.outcome import ModelError
from demflow.model.products import Apertures, Array, Network, Packing, Responses
from demflow.model.region import Pierced, Rectangle, Region, bounding_box
from demflow.model.scene import Bonds, JointLine, Probe
from demflow.model.threads import one_blas_thread

# Walls may stand this far off the sides of a region that they enclose, of its size: packings
# end near to the box that they are made for.
OFF_WALLS = 0.05

LOADED = ("right", "top")  # walls that stresses are put on, in the order of the loads

SOLVERS: dict[str, Callable[..., Course]] = {"krylov": course, "implicit": march}


class Consolidation(NamedTuple):
    """Responses of a poroelastic rock: those of the flow, and of walls and stresses beside them.

    Sources are those of the flow, then the loads xx and yy of 1 Pa.
    """

    flow: Responses
    wall: Array  # (sources, l, 4) m, outward ways of left, right, bottom, top
    stress: Array  # (sources, l, 3) Pa, mean effective stress xx, yy, xy, compression positive
    initial_wall: Array  # (fields, l, 4) of unit initial fields
    initial_stress: Array  # (fields, l, 3)


def consolidate(
    packing: Packing,
    network: Network,
    apertures: Apertures,
    *,
    region: Region,
    normal_stiffness: float,
    stiffness_ratio: float,
    friction: float,
    bonds: Bonds | None,
    held: tuple[str, ...],
    load_times: tuple[tuple[float, ...], ...],
    bulk_modulus: float,
    wells: tuple[WellSite, ...],
    sides: tuple[str, ...],
    active: tuple[bool, ...],
    probes: tuple[Probe, ...],
    times: tuple[float, ...],
    method: str,
    tolerance: float,
    record_map: bool,
    initial: str = "uniform",
    joints: tuple[JointLine, ...] = (),
) -> Consolidation:
    """Responses of a bonded, unbroken rock to a unit step of each source.

    While bonds hold and apertures stay, fluid and frame are linear together, so that rates,
    pressures and loads in any schedule are sums of shifted and scaled responses.

    Parameters
    ----------
    packing, network, apertures : grains between walls, and all their pores (`walled`).
    region : what the specimen should fill.
    normal_stiffness : k_n of contacts, N/m per metre of depth.
    stiffness_ratio, friction, bonds : of contacts; moduli of bonds over k_n.
    held : walls that stand besides the left and the bottom one.
    load_times : s, when the stress on the right and on the top wall changes; none where it never
        does.
    bulk_modulus : K_f of the fluid, Pa.
    wells, sides, active, probes, times, method, tolerance, record_map, initial : as for
        `flow.solvers.registry.flow`; `active` has the loads at its end.
    joints : smooth joints, their stiffnesses over k_n.

    Raises `ModelError` where the rock is loose, or the solver cannot answer.
    """
    check_walls(packing, region)
    region, walls = between_walls(packing, region)
    frame = frame_of(
        packing, stiffness_ratio=stiffness_ratio, friction=friction, bonds=bonds, held=held,
        gone=taken(packing, region), joints=joints,
    )  # fmt: skip
    system = assemble(
        network,
        apertures,
        region=region,
        bulk_modulus=bulk_modulus,
        wells=wells,
        sides=sides,
        at_side=held_pores(packing, network, region, sides),
    )
    if initial == "gradient":
        system = with_linear_fields(system, network, apertures, wells)
    points = np.array([p.at for p in probes]).reshape(-1, 2)
    probed = between_pores(network, apertures, region, system, points)
    rock = rock_of(packing, network, frame, system, normal_stiffness)
    record = record_of(rock, packing, outputs(system, probed))
    lag = lags(times, wells, load_times)
    name = "krylov" if method == "auto" else method
    if name not in SOLVERS:
        raise ModelError(f"there is no coupled solver {name}, only {', '.join(SOLVERS)}")
    factors = Factors(rock)
    lengths = (walls.height, walls.width)
    flows = system.fixed_count + len(system.rate_wells)
    acts = np.asarray(active, dtype=bool)
    fields = len(system.initial)
    found: list[Course] = []
    with one_blas_thread():
        for k in range(flows + fields + len(LOADED)):
            given = record.direct[k] if k < flows + fields else np.zeros(len(record.kind))
            if not acts[k]:
                source = Source(np.zeros(len(frame.free)), np.zeros(system.n))
                given = np.zeros(len(record.kind))
            elif k < flows + fields:
                source = rock.unit_pressure(k) if k < system.fixed_count else rock.unit_rate(k)
            else:
                load = k - flows - fields
                source = rock.unit_load(LOADED[load], lengths[load])
            run = SOLVERS[name]
            found.append(run(factors, record, source, given, lag, tolerance, field=record_map))
    responses = found[:flows] + found[flows + fields :]
    starts = [
        _started(one, rock, record, lag, k) for k, one in enumerate(found[flows : flows + fields])
    ]
    return _product(
        system, network, apertures, record, rock, lag, responses, starts, probed, factors,
        name, tolerance, record_map=record_map,
    )  # fmt: skip


def check_walls(packing: Packing, region: Region) -> None:
    """Raise where the walls do not stand at the sides of the region."""
    (west, east, south, north), (left, right, bottom, top) = packing.box, bounding_box(region)
    size, wanted = np.array([east - west, north - south]), np.array([right - left, top - bottom])
    if np.any(np.abs(size - wanted) > OFF_WALLS * wanted):
        raise ModelError(
            f"the specimen between walls is {size[0]:.4g} m by {size[1]:.4g} m, not the region's "
            f"{wanted[0]:.4g} m by {wanted[1]:.4g} m: specimens have a least width of some 50 mean "
            "radii, or rows of a lattice do not fit; raise grains.count, or change the region"
        )


def between_walls(packing: Packing, region: Region) -> tuple[Region, Rectangle]:
    """A region, filled to the walls of the packing; its holes stay. And it without them.

    Parameters
    ----------
    packing : grains between walls
    region : what they should fill
    """
    left, right, bottom, top = packing.box.tolist()
    walls = Rectangle(right - left, top - bottom)
    return Pierced(walls, region.holes) if isinstance(region, Pierced) else walls, walls


def taken(packing: Packing, region: Region) -> Array | None:
    """The grains that its holes take, (n,) bool; None where there are none.

    Parameters
    ----------
    packing : grains between walls
    region : where the case lies, m
    """
    if not isinstance(region, Pierced):
        return None
    return np.any(dug_out(packing, region.holes), axis=0)


def lags(
    times: tuple[float, ...],
    wells: tuple[WellSite, ...],
    load_times: tuple[tuple[float, ...], ...],
) -> Array:
    """Times since a step at which responses are needed, increasing, s.

    Parameters
    ----------
    times : of the outputs, s
    wells : the wells
    load_times : when loads change, s
    """
    of_wells = change_times(wells)
    changes = np.unique(np.concatenate([of_wells, *(np.asarray(t, float) for t in load_times)]))
    wanted = np.concatenate([times, of_wells])
    lag = time_since(changes[None, :], wanted[:, None])
    return np.unique(lag[lag >= 0.0])


def held_pores(packing: Packing, network: Network, region: Region, sides: tuple[str, ...]) -> Array:
    """The side that holds the pressure of each pore, (d,), −1 none: those that reach its wall.

    A hole is a pore by itself, which pushes on the rock around it.

    Parameters
    ----------
    packing : grains at rest under the packing pressure
    network : pores and pipes of the matrix
    region : where the case lies, m
    sides : sides at a fixed pressure
    """
    at_side = np.full(len(network.x), -1)
    walls = pores_of(packing, network).walls
    holes = region.holes if isinstance(region, Pierced) else ()
    for order, name in enumerate(sides):
        if name in WALLS or name == "outer":
            reach = walls.any(axis=1) if name == "outer" else walls[:, WALLS.index(name)]
            at_side[reach & (at_side < 0)] = order
        else:
            gone = dug_out(packing, tuple(hole for hole in holes if hole.name == name))
            at_side[
                faces_of_holes(
                    gone, network.corner_start, network.corner_grain, network.grain_x,
                    network.grain_y,
                )
            ] = order  # fmt: skip
    return at_side


def _started(found: Course, rock: Rock, record: Record, lag: Array, field: int) -> Course:
    """The course of an initial field: what it does by itself, and the field added."""
    pressure = rock.system.initial[field] / rock.modulus
    output = found.output + record.pressure @ pressure
    cumulative = found.cumulative.copy()
    cumulative[:, :-1] += lag[:, None] * (record.inflow @ pressure)
    maps = found.pressure + (rock.system.initial[field] if found.pressure.size else 0.0)
    return found._replace(output=output, cumulative=cumulative, pressure=maps)


def _product(
    system: System,
    network: Network,
    apertures: Apertures,
    record: Record,
    rock: Rock,
    lag: Array,
    responses: list[Course],
    starts: list[Course],
    probed: Probes,
    factors: Factors,
    name: str,
    tolerance: float,
    *,
    record_map: bool,
) -> Consolidation:
    """All courses as one product."""
    o = record.flow_outputs
    nodes = len(network.x) + np.arange(len(apertures.node_x))
    domain = np.append(np.arange(len(network.x)), nodes) if record_map else nodes[:0]

    node, fixed = map_rows(system, domain)

    def maps(courses: list[Course], first: int = 0) -> Array:
        filled = np.zeros((len(courses), len(lag), len(domain)))
        for k, one in enumerate(courses):
            filled[k][:, node >= 0] = one.pressure[:, node[node >= 0]]
            filled[k][:, fixed == first + k] = 1.0
        return filled

    output = _stacked([one.output for one in responses])
    started = _stacked([one.output for one in starts], output.shape[1:])
    every = [*responses, *starts]
    error = max((one.error for one in every), default=0.0)
    used = ", ".join(str(one.vectors) for one in every if one.vectors > 0)
    what = "vectors" if name == "krylov" else "steps"
    mean = system.initial @ rock.storage / max(rock.storage.sum(), 1e-300)
    volume = np.abs(system.initial - mean[:, None]) @ system.storage
    flow = Responses(
        lag=lag,
        output=output[:, :, :o],
        cumulative=_stacked([one.cumulative for one in responses]),
        pressure=maps(responses),
        missing=np.zeros((len(responses), len(lag))),
        least_flow=np.zeros(len(responses)),
        domain=domain,
        reached=np.ones(len(domain), dtype=bool),
        time_error=np.asarray(error),
        tolerance_met=np.asarray(float(error <= tolerance)),
        residual=np.asarray(max((one.residual for one in every), default=0.0)),
        work=np.asarray(factors.made + sum(one.vectors for one in every)),
        probe_reached=np.ones(len(probed.own), dtype=bool),
        probe_place=probed.place,
        isolated=np.asarray(system.isolated),
        initial_output=started[:, :, :o],
        initial_cumulative=_stacked(
            [one.cumulative for one in starts], (len(lag), record.inflow.shape[0] + 1)
        ),
        initial_pressure=maps(starts, first=len(responses)),
        initial_volume=volume,
        initial_missing=np.zeros((len(starts), len(lag))),
        solver=np.asarray(f"coupled {name}"),
        solver_reason=np.asarray(
            f"linear poroelastic rock: {factors.made} factors, {used or 'no'} {what}"
        ),
    )
    return Consolidation(
        flow=flow,
        wall=output[:, :, o : o + 4],
        stress=output[:, :, o + 4 :],
        initial_wall=started[:, :, o : o + 4],
        initial_stress=started[:, :, o + 4 :],
    )


def _stacked(arrays: list[Array], shape: tuple[int, ...] = ()) -> Array:
    return np.array(arrays) if arrays else np.zeros((0, *shape))
