"""How wide each pipe is and what it conducts (the *open* stage)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from demflow.model.network.fractures.closure import closed, normal_stress, on_joint
from demflow.model.outcome import ModelError
from demflow.model.products import Apertures, Network, Permeability, StressState, Walk
from demflow.model.region import Region
from demflow.model.scene import Fracture, Matrix, acting_lines


def stressed_aperture(w0: np.ndarray, force: np.ndarray, half_force: Any) -> np.ndarray:
    """Aperture of pipes under compression, w = w0 F0 / (F + F0).

    Eq. 2 with its sign put right: F0 (`half_force`, N per metre) is the force that halves
    the aperture w0 (m). `force` ≥ 0 is compressive.

    Parameters
    ----------
    w0 : apertures without force, (p,) m
    force : F ≥ 0, compressive, (p,) N per metre of depth
    half_force : F0, (p,) or one, N per metre of depth
    """
    found: np.ndarray = w0 * half_force / (force + half_force)
    return found


def parted_aperture(w0: np.ndarray, gap: np.ndarray, gap_factor: float) -> np.ndarray:
    """Aperture of pipes whose grains have parted, w = w0 + m g (Eq. 3); gap g ≥ 0 in m.

    Parameters
    ----------
    w0 : apertures of grains that touch, (p,) m
    gap : g ≥ 0, (p,) m
    gap_factor : m
    """
    return w0 + gap_factor * gap


def pipe_conductance(aperture: np.ndarray, length: np.ndarray, viscosity: float) -> np.ndarray:
    """Conductance of a pipe between parallel plates, g = w³ / (12 μ L) (Eq. 1), m³/(s Pa).

    Parameters
    ----------
    aperture : w, (p,) m
    length : L, (p,) m
    viscosity : of the fluid, Pa s
    """
    return aperture**3 / (12.0 * viscosity * length)


def transmissivity(aperture: Any, viscosity: float) -> Any:
    """Cubic law of fractures of hydraulic aperture w (m), T = w³ / (12 μ), m³/(s Pa)."""
    return aperture**3 / (12.0 * viscosity)


def uniform(network: Network, aperture: float, viscosity: float) -> Apertures:
    """The network with one aperture everywhere and no fracture.

    Parameters
    ----------
    network : pores and pipes of the matrix
    aperture : m
    viscosity : of the fluid, Pa s
    """
    p = len(network.pipe_from)
    conductance = pipe_conductance(np.full(p, float(aperture)), network.pipe_length, viscosity)
    none, nowhere = np.empty(0, dtype=np.int64), np.empty(0)
    return Apertures(
        aperture=np.full(p, float(aperture)),
        conductance=conductance,
        volume=network.volume,
        on_fracture=np.full(p, -1, dtype=np.int64),
        cut_conductance=conductance[network.cut] / network.cut_fraction,
        trace_start=np.empty((0, 2)),
        trace_end=np.empty((0, 2)),
        trace_fracture=none,
        trace_pipes=none,
        trace_acts=none,
        node_x=nowhere,
        node_y=nowhere,
        node_side=np.empty((0, 2), dtype=np.int64),
        node_volume=nowhere,
        branch_a=none,
        branch_b=none,
        branch_line=none,
        branch_length=nowhere,
        branch_aperture=nowhere,
        branch_conductance=nowhere,
        cross_pipe=none,
        cross_fraction=nowhere,
        cross_node=none,
        cross_resistance=nowhere,
        matrix_aperture=np.asarray(float(aperture)),
    )


def open_pipes(
    network: Network,
    walked: Walk | None,
    stress: StressState | None,
    unit_permeability: Permeability | None,
    *,
    region: Region,
    matrix: Matrix,
    fractures: tuple[Fracture, ...],
    viscosity: float,
) -> Apertures:
    """Open every pipe: matrix, stress, then fractures and barriers.

    Parameters
    ----------
    network : pores and pipes.
    walked : where the lines of the fractures run; None where there is none.
    stress : contact forces and moved grains; None where no stress is modelled.
    unit_permeability : permeability of the network at an aperture of 1 m everywhere
        (permeability is proportional to w³); needed where a permeability is given.
    region, matrix, fractures, viscosity : parts of the scene.

    A fracture given by its permeability has w_f = (k_f / k_1)^(1/3) in the unstressed
    state, and follows stress as the matrix does; the widest has a pipe that several share.
    Branches of traces with a hydraulic aperture carry w³ / (12 μ) over their length. Barriers
    come last: a multiplier holds for whatever crosses it, a resistance per area stands in series
    with each pipe over the length that it cuts, and with each trace over its aperture.
    """
    if matrix.aperture is not None:
        w0 = matrix.aperture
    else:
        w0 = _aperture_for(matrix.permeability, unit_permeability)
    result = uniform(network, w0, viscosity)
    lines = acting_lines(fractures, region) if walked is not None else []
    if walked is None or len(walked.line_start) != len(lines):
        if fractures and acting_lines(fractures, region):
            raise ModelError("the fractures were not walked on this network; run walk with them")
        walked, lines = None, []
    unstressed = result.aperture.copy()
    fracture = np.array([line.fracture for line in lines], dtype=np.int64)
    if walked is not None:
        wide = np.array(
            [
                _aperture_for(f.permeability, unit_permeability) if f.part == "chain" else 0.0
                for f in fractures
            ]
        )[fracture]
        acts, on_fracture = _widened(walked, wide, unstressed)
    aperture = _stressed(network, with_feet(network, stress), unstressed, matrix)
    conductance = pipe_conductance(aperture, network.pipe_length, viscosity)
    result = result._replace(
        aperture=aperture,
        conductance=conductance,
        cut_conductance=conductance[network.cut] / network.cut_fraction,
    )
    if walked is None:
        return result
    result = result._replace(
        on_fracture=on_fracture,
        volume=_volumes(network, walked, fractures, fracture, aperture),
        trace_start=walked.line_start,
        trace_end=walked.line_end,
        trace_fracture=fracture,
        trace_pipes=_per_line(walked, walked.cross_line, walked.chain_line),
        node_x=walked.node_x,
        node_y=walked.node_y,
        node_side=walked.node_side,
        branch_a=walked.branch_a,
        branch_b=walked.branch_b,
        branch_line=walked.branch_line,
        branch_length=walked.branch_length,
    )
    open_lines = np.array([line.aperture or 0.0 for line in lines])
    felt = stress_across(walked, stress, fractures, fracture)
    hydraulic = branch_apertures(walked, felt, fractures, fracture, open_lines)
    result = with_branches(result, walked, hydraulic, viscosity)
    result = _with_barriers(result, network, walked, [fractures[k] for k in fracture], viscosity)
    ends = walked.branch_line[(walked.node_side[walked.branch_a, 0] >= 0)]
    acts = acts + _per_line(walked, walked.cross_line, walked.wall_line, walked.cut_line, ends)
    return result._replace(trace_acts=acts)


def _per_line(walked: Walk, *lines: np.ndarray) -> np.ndarray:
    """How often each line is named, (lines,)."""
    return np.bincount(np.concatenate(lines), minlength=len(walked.line_start))


def _widened(
    walked: Walk, wide: np.ndarray, unstressed: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Give the pipes of chains the aperture of their line, where it is wider (in place).

    Returns the number of pipes that each line widened, and the line that each pipe runs along:
    the widest, of equal ones the last, and any where none is wider than the matrix.
    """
    on_fracture = np.full(len(unstressed), -1, dtype=np.int64)
    order = np.lexsort((walked.chain_line, wide[walked.chain_line]))
    pipe, line = walked.chain_pipe[order], walked.chain_line[order]
    wins = unstressed[pipe] <= wide[line]
    on_fracture[pipe] = line
    np.maximum.at(unstressed, pipe, wide[line])
    return _per_line(walked, line[wins]), on_fracture


class Felt(NamedTuple):
    """What the branches of traces feel of a stress."""

    across: np.ndarray  # (e,) Pa, compression positive
    opening: np.ndarray  # (e,) m, of joints that slid and dilate, or that nothing presses


def stress_across(
    walked: Walk, stress: StressState | None, fractures: tuple[Fracture, ...], of_line: np.ndarray
) -> Felt | None:
    """Stress across each branch; None where no law makes apertures feel it.

    That of the rock around, but of a joint what its own contacts bear. `of_line` (lines,) is the
    fracture that each line is of.

    Parameters
    ----------
    walked : where traces lie in the network
    stress : the stress on the rock, or None
    fractures : the fractures of the scene
    of_line : fracture of each line
    """
    closing = [f.closure is not None and f.closure.closes for f in fractures]
    if stress is None or not any(closing) or not len(walked.branch_line):
        return None
    across = normal_stress(stress, walked)
    opening = np.zeros(len(across))
    for line, number in enumerate(of_line.tolist()):
        joint = fractures[number].joint
        if joint is None or not closing[number]:
            continue
        ours = walked.branch_line == line
        ends = np.stack([walked.branch_a[ours], walked.branch_b[ours]])
        start, end = walked.line_start[line], walked.line_end[line]
        middle = np.column_stack([walked.node_x[ends].mean(0), walked.node_y[ends].mean(0)])
        at = (middle - start) @ (end - start) / np.hypot(*(end - start))
        found = on_joint(stress, start, end, at, float(np.tan(joint.dilation_angle)))
        if found is not None:
            across[ours], opening[ours] = found.normal, found.opening
    return Felt(across, opening)


def branch_apertures(
    walked: Walk,
    felt: Felt | None,
    fractures: tuple[Fracture, ...],
    of_line: np.ndarray,
    aperture: np.ndarray,
) -> np.ndarray:
    """Hydraulic apertures of the branches, (e,) m, under the stress that they feel.

    `of_line` (lines,) is the fracture that each line is of, `aperture` (lines,) m what it has
    without stress.

    Parameters
    ----------
    walked : where traces lie in the network
    felt : stress across branches, or None
    fractures : the fractures of the scene
    of_line : fracture of each line
    aperture : of the lines, m
    """
    result = aperture[walked.branch_line]
    if felt is None:
        found: np.ndarray = result
        return found
    for law in {f.closure for f in fractures if f.closure is not None and f.closure.closes}:
        ours = np.array([f.closure == law for f in fractures])[of_line][walked.branch_line]
        result[ours] = closed(result[ours], felt.across[ours], law) + felt.opening[ours]
    found = result
    return found


def with_branches(
    result: Apertures, walked: Walk, aperture: np.ndarray, viscosity: float
) -> Apertures:
    """The traces' branches at hydraulic apertures (e,) m, and what their nodes store.

    Parameters
    ----------
    result : apertures without them
    walked : where traces lie in the network
    aperture : of the branches, m
    viscosity : of the fluid, Pa s
    """
    half = 0.5 * aperture * walked.branch_length
    m = len(walked.node_x)
    volume = np.bincount(walked.branch_a, weights=half, minlength=m)
    volume += np.bincount(walked.branch_b, weights=half, minlength=m)
    return result._replace(
        branch_aperture=aperture,
        branch_conductance=transmissivity(aperture, viscosity) / walked.branch_length,
        node_volume=volume,
    )


def _with_barriers(
    result: Apertures,
    network: Network,
    walked: Walk,
    fractures: list[Fracture],
    viscosity: float,
) -> Apertures:
    """What barriers leave of pipes and branches; `fractures` (lines,) that of each line."""
    given = [f.transmissibility_multiplier for f in fractures]
    multiplier = np.array([1.0 if m is None else m for m in given])
    resistance = np.array([f.resistance_at(viscosity) or 0.0 for f in fractures])
    keeps = np.ones(len(network.pipe_from))
    np.multiply.at(keeps, walked.wall_pipe, multiplier[walked.wall_line])
    branch = result.branch_conductance.copy()
    np.multiply.at(branch, walked.cut_branch, multiplier[walked.cut_line])
    across = np.bincount(
        walked.cut_branch,
        weights=resistance[walked.cut_line] / result.branch_aperture[walked.cut_branch],
        minlength=len(branch),
    )
    stands = resistance[walked.wall_line] > 0.0
    pipe = np.concatenate([walked.cross_pipe, walked.wall_pipe[stands]])
    fraction = np.concatenate([walked.cross_fraction, walked.wall_fraction[stands]])
    added = (resistance[walked.wall_line] / walked.wall_length)[stands]
    order = np.lexsort((fraction, pipe))
    return result._replace(
        conductance=result.conductance * keeps,
        cut_conductance=result.cut_conductance * keeps[network.cut],
        branch_conductance=branch / (1.0 + branch * across),
        cross_pipe=pipe[order],
        cross_fraction=fraction[order],
        cross_node=np.append(walked.cross_node, np.full(len(added), -1))[order],
        cross_resistance=np.append(np.zeros(len(walked.cross_pipe)), added)[order],
    )


def _aperture_for(permeability: float | None, unit_permeability: Permeability | None) -> float:
    """Aperture at which a uniform network has the permeability: a cube root, k ∝ w³."""
    if permeability is None or unit_permeability is None:
        raise ModelError("a permeability is asked for, but the network's own was not computed")
    return float(np.cbrt(permeability / (0.5 * np.trace(unit_permeability.tensor))))


def _stressed(
    network: Network, stress: StressState | None, unstressed: np.ndarray, matrix: Matrix
) -> np.ndarray:
    """Apertures under the contact forces; unchanged where no force law is given."""
    if stress is None or (matrix.half_force is None and matrix.half_stress is None):
        return unstressed
    half: Any = matrix.half_force
    if matrix.half_stress is not None:
        one, other = (
            network.grain_radius[grain] for grain in (network.pipe_grain_a, network.pipe_grain_b)
        )
        # a wall presses on a grain as its mirror image would
        half = matrix.half_stress * np.where(other == 0.0, 2.0 * one, one + other)
    contact = pipe_contacts(network, stress)
    force = np.where(contact >= 0, stress.normal_force[contact], 0.0)
    gap = np.maximum(pipe_gaps(network, stress, contact), 0.0)
    return np.where(
        force > 0.0,
        stressed_aperture(unstressed, np.maximum(force, 0.0), half),
        parted_aperture(unstressed, gap, matrix.gap_factor),
    )


def with_feet(network: Network, stress: StressState | None) -> StressState | None:
    """The loaded grains with what walls press on their feet, where the network has such.

    A wall presses a grain by what its contacts leave unbalanced across the wall.
    """
    if stress is None or len(network.grain_x) == len(stress.x):
        return stress
    n, a, b = len(stress.x), stress.contact_a, stress.contact_b
    normal = np.array([stress.x[b] - stress.x[a], stress.y[b] - stress.y[a]])
    normal /= np.hypot(*normal)
    force = stress.normal_force * normal + stress.shear_force * np.array([-normal[1], normal[0]])
    net = np.array([np.bincount(b, f, n) - np.bincount(a, f, n) for f in force])
    low = (network.grain_x.min(), network.grain_y.min())
    high = (network.grain_x.max(), network.grain_y.max())
    stands = network.pipe_grain_b >= n
    grain, foot = network.pipe_grain_a[stands], network.pipe_grain_b[stands]
    place = np.array([network.grain_x, network.grain_y])
    moved = place.copy()
    moved[:, :n] = stress.x, stress.y
    press = np.zeros(len(foot))
    for axis in (0, 1):
        for side, sense in ((low[axis], -1.0), (high[axis], 1.0)):
            on = place[axis, foot] == side
            press[on] = sense * net[axis, grain[on]]
            moved[axis, foot[on]] = stress.box[2 * axis + (sense > 0.0)]
            moved[1 - axis, foot[on]] = moved[1 - axis, grain[on]]
    one, other = np.append(a, grain), np.append(b, foot)
    order = np.lexsort((other, one))
    none = np.zeros(len(foot))
    return stress._replace(
        x=moved[0],
        y=moved[1],
        contact_a=one[order],
        contact_b=other[order],
        normal_force=np.append(stress.normal_force, press)[order],
        shear_force=np.append(stress.shear_force, none)[order],
        bonded=np.append(stress.bonded, none > 0.0)[order],
        joint_gap=np.append(stress.joint_gap, none + np.nan)[order],
    )


def pipe_contacts(network: Network, stress: StressState) -> np.ndarray:
    """The contact of the loaded grains at each pipe, (p,), −1 where they carry nothing."""
    n = np.int64(len(stress.x))
    key = network.pipe_grain_a * n + network.pipe_grain_b
    known = stress.contact_a * n + stress.contact_b
    if len(known) == 0:
        return np.full(len(key), -1)
    found = np.minimum(np.searchsorted(known, key), len(known) - 1)
    return np.where(known[found] == key, found, -1)


def pipe_gaps(network: Network, stress: StressState, contact: np.ndarray) -> np.ndarray:
    """Gap between the grains at each pipe, (p,) in m, negative where they overlap.

    Across a smooth joint it is the joint's own: grains that slide past each other along it
    part without opening it. Beside a grain that was taken away there is none. `contact` (p,) is
    that of each pipe, as `pipe_contacts` gives it.
    """
    a, b = network.pipe_grain_a, network.pipe_grain_b
    distance = np.hypot(stress.x[a] - stress.x[b], stress.y[a] - stress.y[b])
    taken = np.isnan(distance)
    opening = np.where(contact >= 0, stress.joint_gap[contact], np.nan)
    touching = (
        network.grain_radius[network.pipe_grain_a] + network.grain_radius[network.pipe_grain_b]
    )
    gap = np.where(np.isnan(opening), distance - touching, opening)
    gap[taken] = 0.0
    return gap


def _volumes(
    network: Network,
    walked: Walk,
    fractures: tuple[Fracture, ...],
    fracture: np.ndarray,
    aperture: np.ndarray,
) -> np.ndarray:
    """Pore volumes after the pores along a chain gave theirs to the matrix, where it owns them.

    A pore keeps the volume of its stretch of fracture, the rest goes in equal parts to those of
    its neighbours that lie on no such line; without any it keeps its own.
    """
    volume = network.volume.copy()
    gives_up = np.array([f.pore_storage == "matrix" and f.part == "chain" for f in fractures])
    on = gives_up[fracture[walked.chain_domain_line]]
    if not on.any():
        return volume
    pipes = np.bincount(walked.chain_line, minlength=len(fracture))
    summed = np.bincount(walked.chain_line, aperture[walked.chain_pipe], len(fracture))
    width = summed / np.maximum(pipes, 1)
    own = np.full(len(volume), np.nan)
    domain, line = walked.chain_domain[on], walked.chain_domain_line[on]
    own[domain] = 0.0
    np.add.at(own, domain, width[line] * walked.chain_storage[on])
    own = np.minimum(own, network.volume)
    on_trace = ~np.isnan(own)
    i = np.concatenate([network.pipe_from, network.pipe_to])
    j = np.concatenate([network.pipe_to, network.pipe_from])
    gives = on_trace[i] & ~on_trace[j] & network.inside[j]
    receivers = np.bincount(i[gives], minlength=len(volume))
    parts = np.divide(
        network.volume - own, receivers, where=receivers > 0, out=np.zeros(len(volume))
    )
    giving = on_trace & (receivers > 0)
    volume[giving] = own[giving]
    np.add.at(volume, j[gives], parts[i[gives]])
    # a stretch of zero length would leave a pore without storage
    found: np.ndarray = np.maximum(volume, 1e-6 * network.volume.mean())
    return found
