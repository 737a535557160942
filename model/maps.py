"""Fields of one case: pores, pipes, grains, and what a test to failure recorded."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from demflow.model.controls import controls_of
from demflow.model.history import superposed_map, until
from demflow.model.products import Apertures, Network, Packing, StressState
from demflow.model.quantities import MAPS, TESTS
from demflow.model.scene import Scene


def case_maps(
    scene: Scene, products: Mapping[str, Any], *, ends: bool = True
) -> dict[str, np.ndarray]:
    """Fields of one case under their names in `model.quantities.MAPS`, with its polygons.

    `products` are those of `run_stages`. Domains are those inside the region, pipes those
    with an end among them. `mesh_node_x`, `mesh_node_y` are the corners of the domains'
    polygons and `mesh_face_nodes` (domain, most corners) their indices, −1 where a domain
    has fewer. A test to failure adds its curves and cracks, `model.quantities.TESTS`. Without
    `ends` the domains that pipes join are left out: pictures need none, and to find those of
    traces takes kernels, which take longer to load than a picture to draw.
    """
    tested = {name: getattr(products["strength"], name) for name in TESTS} if scene.tests else {}
    return tested | _pore_maps(scene, products, ends) if scene.porous else tested


def _pore_maps(scene: Scene, products: Mapping[str, Any], with_ends: bool) -> dict[str, np.ndarray]:
    """Pores, pipes and grains of a case."""
    fractured = products.get("fracture")
    net: Network = products["network"] if fractured is None else fractured.network
    opened: Apertures = products["open"]
    if fractured is not None:  # wells are holes, and pipes stand as they do at the end
        opened = opened_at_end(net, fractured.aperture, scene)
    domain = np.flatnonzero(net.inside)
    number = np.full(len(net.x), -1)
    number[domain] = np.arange(len(domain))
    pipe = np.flatnonzero(net.inside[net.pipe_from] | net.inside[net.pipe_to])
    trace = opened.on_fracture[pipe]
    fracture = np.full(len(pipe), -1)
    fracture[trace >= 0] = opened.trace_fracture[trace[trace >= 0]]
    at = np.column_stack([opened.node_x, opened.node_y])
    maps = {
        "x": net.x[domain],
        "y": net.y[domain],
        "volume": opened.volume[domain],
        # a branch of a trace is a pipe between the pores in which its ends lie
        "aperture": np.append(opened.aperture[pipe], opened.branch_aperture),
        "conductance": np.append(opened.conductance[pipe], opened.branch_conductance),
        "on_fracture": np.append(fracture, opened.trace_fracture[opened.branch_line]),
        **_throats(net, opened, pipe),
        **_mesh(net, domain),
        **_sources(scene),
        **_traces(scene, opened),
    }
    if with_ends:
        maps |= _ends(net, opened, pipe, number)
    if len(at):
        maps |= {
            "fracture_node_x": opened.node_x,
            "fracture_node_y": opened.node_y,
            "branch_from": opened.branch_a,
            "branch_to": opened.branch_b,
            "branch_fracture": opened.trace_fracture[opened.branch_line],
            "branch_aperture": opened.branch_aperture,
        }
    if "pressure_map" in scene.observe:
        controls = controls_of(scene)
        if fractured is not None:
            pressure = until(fractured.records.pressure, len(controls.times))
        elif (followed := products.get("follow")) is not None:
            pressure = until(followed.records.pressure, len(controls.times))
        else:
            coupled = products.get("consolidate")
            responses = products["flow"] if coupled is None else coupled.flow
            pressure = superposed_map(responses, controls, scene.loads)
            pressure = pressure if controls.transient else pressure[0]
        maps["pressure"] = pressure[..., : len(domain)]
        if len(at):
            at_node = pressure[..., len(domain) :]
            maps |= {"fracture_node_pressure": at_node, "trace_flow": _trace_flow(opened, at_node)}
    if "grain_map" in scene.observe:
        state: StressState | None = products.get("stress")
        packing: Packing = products["pack"]
        held = state if state is not None else packing
        stiffness = 1.0 if state is not None else (scene.grains.contact_stiffness or np.nan)
        maps |= {
            "grain_x": held.x,
            "grain_y": held.y,
            "radius": packing.radius,
            "normal_force": held.normal_force * stiffness,
            "shear_force": held.shear_force * stiffness,
            "grain_a": held.contact_a,
            "grain_b": held.contact_b,
        }
        if state is not None:
            maps |= {name: getattr(state, name) for name in MAPS if name.startswith("crack_")}
    return maps


def opened_at_end(net: Network, aperture: np.ndarray, scene: Scene) -> Apertures:
    """The pipes of a network at given apertures (p,) m.

    Parameters
    ----------
    net : pores and pipes
    aperture : of the pipes, m
    scene : the case
    """
    from demflow.model.network.apertures import pipe_conductance, uniform  # with SciPy's trees

    viscosity = scene.fluid.viscosity if scene.fluid is not None else 1.0
    plain = uniform(net, float(aperture.min(initial=np.inf)), viscosity)
    conductance = pipe_conductance(aperture, net.pipe_length, viscosity)
    return plain._replace(aperture=aperture, conductance=conductance)


def _ends(
    net: Network, opened: Apertures, pipe: np.ndarray, number: np.ndarray
) -> dict[str, np.ndarray]:
    """The domains that some pipes and the branches of traces join, as `number` counts them."""
    from demflow.model.network.domains import domains_at  # with kernels

    swap = ~net.inside[net.pipe_from[pipe]]
    start = np.where(swap, net.pipe_to[pipe], net.pipe_from[pipe])
    end = np.where(swap, net.pipe_from[pipe], net.pipe_to[pipe])
    at = np.column_stack([opened.node_x, opened.node_y])
    pore = number[domains_at(net, at)] if len(at) else np.empty(0, dtype=np.int64)
    return {
        "from_domain": np.append(number[start], pore[opened.branch_a]),
        "to_domain": np.append(number[end], pore[opened.branch_b]),
    }


def _throats(net: Network, opened: Apertures, pipe: np.ndarray) -> dict[str, np.ndarray]:
    """Where some pipes are narrowest: between the rims of their two grains; middles of branches."""
    a, b = net.pipe_grain_a[pipe], net.pipe_grain_b[pipe]
    share = net.grain_radius[a] / (net.grain_radius[a] + net.grain_radius[b])
    return {
        f"pipe_{axis}": np.append(
            centre[a] + share * (centre[b] - centre[a]),
            0.5 * (node[opened.branch_a] + node[opened.branch_b]),
        )
        for axis, centre, node in (
            ("x", net.grain_x, opened.node_x),
            ("y", net.grain_y, opened.node_y),
        )
    }


def _sources(scene: Scene) -> dict[str, np.ndarray]:
    """The wells, where there are some."""
    if not scene.wells:
        return {}
    return {
        "well": np.array([well.name for well in scene.wells]),
        "well_x": np.array([well.at[0] for well in scene.wells]),
        "well_y": np.array([well.at[1] for well in scene.wells]),
        "well_radius": np.array([well.radius for well in scene.wells]),
    }


def _traces(scene: Scene, opened: Apertures) -> dict[str, np.ndarray]:
    """The fractures, and the straight pieces that they draw in the region, if there are any."""
    if not scene.fractures:
        return {}
    names = {"fracture": np.array([fracture.name for fracture in scene.fractures])}
    if not len(opened.trace_start):
        return names
    return names | {
        "trace_from_x": opened.trace_start[:, 0],
        "trace_from_y": opened.trace_start[:, 1],
        "trace_to_x": opened.trace_end[:, 0],
        "trace_to_y": opened.trace_end[:, 1],
        "trace_fracture": opened.trace_fracture,
    }


def _trace_flow(opened: Apertures, pressure: np.ndarray) -> np.ndarray:
    """The largest flow along each trace, from its begin to its end positive, (…, traces) m³/s.

    From differences of the nodes' pressures (…, nodes): where a trace conducts so much more than
    the rock that these differ in their last digits only, no more of it than those is known.
    """
    a, b, line = opened.branch_a, opened.branch_b, opened.branch_line
    step = np.stack([opened.node_x[b] - opened.node_x[a], opened.node_y[b] - opened.node_y[a]])
    along = (opened.trace_end - opened.trace_start)[line].T
    sense = np.sign((step * along).sum(axis=0))
    fall = np.nan_to_num(pressure[..., a] - pressure[..., b])  # what no source reaches is at rest
    flow = sense * opened.branch_conductance * fall
    most = np.zeros((len(opened.trace_start), *pressure.shape[:-1]))
    least = most.copy()
    np.maximum.at(most, line, np.moveaxis(flow, -1, 0))
    np.minimum.at(least, line, np.moveaxis(flow, -1, 0))
    return np.moveaxis(np.where(most >= -least, most, least), 0, -1)


def _mesh(net: Network, domain: np.ndarray) -> dict[str, np.ndarray]:
    """The polygons of some domains: their corners, and the corners of each, padded with −1."""
    corners = np.diff(net.corner_start)[domain]
    faces = np.full((len(domain), corners.max()), -1)
    filled = np.arange(faces.shape[1]) < corners[:, None]
    first = np.repeat(net.corner_start[:-1][domain], corners)
    within = np.arange(corners.sum()) - np.repeat(np.cumsum(corners) - corners, corners)
    grains, nodes = np.unique(net.corner_grain[first + within], return_inverse=True)
    faces[filled] = nodes
    return {
        "mesh_node_x": net.grain_x[grains],
        "mesh_node_y": net.grain_y[grains],
        "mesh_face_nodes": faces,
    }
