"""Results made by hand: datasets and maps with known fields, without running a model."""

from __future__ import annotations

import itertools
from functools import cache

import numpy as np
import xarray as xr
from scipy.spatial import Delaunay

from demflow.model.analytic.linear import linear_pressure
from demflow.model.analytic.radial import radial_dimensionless_pressure
from demflow.model.quantities import CASE
from demflow.model.scene import Scene
from demflow.model.transient import bourdet_derivative
from demflow.sweep.study.cases import case_at, coordinates
from demflow.sweep.study.load import Study, load_study

MD = 9.869233e-16

SWEEP = """
study: angles
title: Angle, aperture, stress and rate
scene:
  region: {shape: circle, radius: 14 m}
  grains: {count: 600, porosity: 0.17, modulus: 20 GPa}
  stress: {xx: 20 MPa, yy: 10 MPa}
  matrix: {permeability: 0.458 mD, half_force: 5 MN/m}
  fluid: {viscosity: 1 Pa s, bulk_modulus: 1 GPa}
  fractures:
    natural: {kind: set, angle: 65 deg, length: 5 m, spacing: 2.5 m, aperture: 100 um}
  wells:
    producer: {at: [0 m, 0 m], radius: 0.964 m, rate: 2e-5 m3/s}
  boundaries: {outer: 7 MPa}
  initial_pressure: 7 MPa
  times: {first: 1 s, last: 24000 s, per_decade: 12}
vary:
  fracture_angle: {parameter: fractures.natural.angle, values: [0 deg, 30 deg, 65 deg]}
  aperture: {parameter: fractures.natural.aperture, from: 20 um, to: 500 um, count: 3, spacing: log}
  stress_yy: {parameter: stress.yy, values: [5 MPa, 20 MPa]}
  rate: {parameter: wells.producer.rate, values: [1e-5 m3/s, 2e-5 m3/s]}
observe: [well_pressure, permeability, pressure_map, grain_map]
"""

LINEAR = """
study: linear
title: Linear flow
scene:
  region: {shape: rectangle, width: 13.5 m, height: 14 m}
  grains: {count: 5000, porosity: 0.17}
  matrix: {permeability: 2667 mD}
  fluid: {viscosity: 1 Pa s, bulk_modulus: 1 GPa}
  boundaries: {left: 5 MPa, right: 0 Pa}
  initial_pressure: 5 MPa
  times: [67 s, 267 s, 667 s, 1467 s, 3067 s, 15067 s]
vary:
  packing: {parameter: grains.seed, values: [1, 2, 3, 4, 5]}
observe: [pressure_map, boundary_flow]
figures: {compare: linear, maps: [267 s, 667 s, 1467 s, 15067 s]}
"""

RADIAL = """
study: radial
title: Radial flow
scene:
  region: {shape: circle, radius: 13.8 m}
  grains: {count: 5000, porosity: 0.17}
  matrix: {permeability: 2442 mD}
  fluid: {viscosity: 1 Pa s, bulk_modulus: 1 GPa}
  wells:
    producer: {at: [0 m, 0 m], radius: 0.964 m, rate: 2e-5 m3/s}
  boundaries: {outer: 7 MPa}
  initial_pressure: 7 MPa
  times: [120 s, 420 s, 1420 s, 2753 s, 24086 s]
vary:
  packing: {parameter: grains.seed, values: [1, 2, 3, 4, 5]}
observe: [well_pressure, pressure_map]
figures: {compare: radial}
"""


def study_of(text: str, folder) -> Study:
    """The study of a text."""
    path = folder / "study.yaml"
    path.write_text(text)
    return load_study(path)


def rock(region_radius: float, spacing: float, seed: int, square: bool = False) -> xr.Dataset:
    """Maps without pressure: triangles between grains at jittered points, with a UGRID mesh."""
    rng = np.random.default_rng(seed)
    k = np.arange(-region_radius * 1.2, region_radius * 1.2, spacing)
    x, y = (g.ravel() for g in np.meshgrid(k, k))
    x = x + spacing * rng.uniform(-0.3, 0.3, x.size)
    y = y + spacing * rng.uniform(-0.3, 0.3, y.size)
    mesh = Delaunay(np.stack([x, y], axis=1))
    cx, cy = x[mesh.simplices].mean(axis=1), y[mesh.simplices].mean(axis=1)
    size = np.maximum(abs(cx), abs(cy)) if square else np.hypot(cx, cy)
    inside = np.flatnonzero(size < region_radius)
    number = np.full(len(cx), -1)
    number[inside] = np.arange(len(inside))
    start = np.repeat(inside, 3)
    end = mesh.neighbors[inside].ravel()
    keep = (end >= 0) & ((start < end) | (number[end] < 0))
    pairs = np.stack([number[start[keep]], number[end[keep]]])
    on_row = abs(cy[start[keep]] - 0.4 * cx[start[keep]]) < 0.5 * spacing
    return xr.Dataset(
        {
            "volume": ("domain", np.full(len(inside), 0.2 * spacing**2 / 2)),
            "from_domain": ("pipe", pairs[0]),
            "to_domain": ("pipe", pairs[1]),
            "on_fracture": ("pipe", np.where(on_row & (pairs[1] >= 0), 0, -1)),
            "radius": ("grain", np.full(x.size, 0.4 * spacing)),
            "mesh": (
                (),
                0,
                {
                    "cf_role": "mesh_topology",
                    "topology_dimension": 2,
                    "node_coordinates": "mesh_node_x mesh_node_y",
                    "face_node_connectivity": "mesh_face_nodes",
                },
            ),
            "mesh_face_nodes": (("domain", "corner"), mesh.simplices[inside], {"start_index": 0}),
        },
        {
            "x": ("domain", cx[inside]),
            "y": ("domain", cy[inside]),
            "mesh_node_x": ("node", x),
            "mesh_node_y": ("node", y),
            "grain_x": ("grain", x),
            "grain_y": ("grain", y),
        },
    )


def invented_maps(study: Study, index: tuple[int, ...], spacing: float = 1.2) -> xr.Dataset:
    """Maps of a case: the formula's pressure, a little off for each packing."""
    return _maps_of(case_at(study, index).scene, 1 + sum(index), spacing).copy(deep=True)


@cache
def _maps_of(scene: Scene, seed: int, spacing: float) -> xr.Dataset:
    """The same of a scene, made once."""
    times = np.array(scene.times)
    noise = 1.0 + 0.01 * np.random.default_rng(seed).normal()
    if dict(scene.boundaries).keys() == {"left", "right"}:
        maps = rock(6.75, spacing, seed, square=True)
        pressure = linear_pressure(
            maps["x"].values + 6.75,
            times[:, None],
            length=13.5,
            diffusivity=noise * 2667 * MD * 1e9 / 0.17,
            initial=5e6,
            first=5e6,
            second=0.0,
        )
    else:
        maps = rock(scene.region.radius, spacing, seed)
        k = scene.matrix.permeability * (2000 if scene.fractures else 1)
        r_w, R_De = 0.964, scene.region.radius / 0.964
        R_D = np.hypot(maps["x"].values, maps["y"].values) / r_w
        t_D = noise * k * 1e9 * times / (0.17 * r_w**2)
        P_D = radial_dimensionless_pressure(np.clip(R_D, 1, R_De), t_D[:, None], R_De)
        fall = scene.wells[0].rate * np.log(R_De) / (2 * np.pi * k)
        pressure = 7e6 - fall * P_D
    maps["pressure"] = (("elapsed_time", "domain"), pressure)
    return maps.assign_coords(elapsed_time=times)


def invented_dataset(study: Study) -> xr.Dataset:
    """A dataset with a value for every case, smooth in the axes."""
    if study.text not in _datasets:
        _datasets[study.text] = _dataset_of(study)
    return _datasets[study.text].copy(deep=True)


_datasets: dict[str, xr.Dataset] = {}  # by the text of their study, each made once


def _dataset_of(study: Study) -> xr.Dataset:
    names = [axis.name for axis in study.axes]
    scene = case_at(study, [0] * len(names)).scene
    times = np.array(scene.times)
    shape = study.shape
    rng = np.random.default_rng(5)
    data: dict[str, tuple] = {
        "status": (names, np.zeros(shape, dtype=np.int8)),
        "message": (names, np.full(shape, "", dtype=object)),
        "porosity": (names, rng.normal(0.17, 0.001, shape)),
        "mass_balance_error": (names, 1e-14 * rng.uniform(size=shape)),
        "residual": (names, 1e-13 * rng.uniform(size=shape)),
        "time_error": (names, 1e-5 * rng.uniform(size=shape)),
        "compute_time": (names, rng.uniform(1, 2, shape)),
    }
    coords = {"elapsed_time": ("elapsed_time", times, {"units": "s"})}
    for axis in study.axes:
        for c in coordinates(axis):
            coords[c.name] = (axis.name, c.values, {"units": c.unit, "long_name": c.long_name})
    if scene.wells:
        coords["well"] = [w.name for w in scene.wells]
        fields = {
            name: np.full((*shape, 1, len(times)), np.nan)
            for name in ("well_pressure", "well_rate", "pressure_change", "pressure_derivative")
        }
        for index in itertools.product(*map(range, shape)):
            scene = case_at(study, index).scene
            k = scene.matrix.permeability * (
                2000 * 2.0 ** (index[0] + 2 * sum(index[1:-1])) if len(index) > 1 else 1
            )
            R_De, r_w, rate = scene.region.radius / 0.964, 0.964, scene.wells[0].rate
            noise = 1 + 0.01 * rng.normal()
            t_D = noise * k * 1e9 * times / (float(data["porosity"][1][index]) * r_w**2)
            fall = rate * np.log(R_De) / (2 * np.pi * k)
            change = fall * radial_dimensionless_pressure(1.0, t_D, R_De)
            fields["well_pressure"][index] = 7e6 - change
            fields["well_rate"][index] = rate
            fields["pressure_change"][index] = change
            fields["pressure_derivative"][index] = bourdet_derivative(times, change)
        data |= {n: ((*names, "well", "elapsed_time"), v) for n, v in fields.items()}
    if "permeability" in scene.observe:
        steps = sum(
            (i + 1) * np.arange(n).reshape([-1 if j == i else 1 for j in range(len(shape))])
            for i, n in enumerate(shape[:-1])
        ) + np.zeros(shape)
        tensor = np.zeros((*shape, 2, 2))
        tensor[..., 0, 0] = 0.458 * MD * 2.0**steps
        tensor[..., 1, 1] = 0.458 * MD * 1.4**steps
        data["permeability"] = ((*names, "row", "column"), tensor)
        coords |= {"row": ["x", "y"], "column": ["x", "y"]}
    if "boundary_flow" in scene.observe:
        flow = rng.normal(1.365e-5, 1e-7, (*shape, 1, 1)) * np.ones((2, len(times)))
        data["boundary_flow"] = ((*names, "boundary", "elapsed_time"), flow)
        coords["boundary"] = ["left", "right"]
    dataset = xr.Dataset(data, coords)
    for name, quantity in CASE.items():
        if name in dataset:
            dataset[name].attrs = {"units": quantity.unit, "long_name": quantity.long_name}
    dataset.attrs = {
        "title": study.title,
        "study_text": study.text,
        "study_sha256": study.sha256,
        "demflow_version": "0.1.0",
        "numpy_version": np.__version__,
        "history": "made by hand",
    }
    return dataset
