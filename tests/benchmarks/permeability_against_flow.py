"""The permeability of fractured rock under stress is that of its flow, up to the rim.

The twelve states of the quickstart (angles, apertures, stresses) in SEEDS packings, in a square of
the area of its circle. Two flows of the same rock are held against the tensor: that of a pressure
p = −x or p = −y along the whole rim, in steps of a pore, whose Σ q p is the dissipation, where
fractures leave through sides on which that is exact (elsewhere a step moves what they carry by
some percent); and that of a sealed bar, between two sides at fixed pressures, against the flow of
a homogeneous square that has the tensor. GRAINS (of the environment) makes the packings smaller,
SEEDS and STEPS choose others and other steps.
"""

from __future__ import annotations

import math
import os
import warnings
from functools import cache

import numpy as np
import xarray as xr
import yaml

from demflow import sweep
from tests.benchmarks.ran import STUDIES, results_folder
from tests.benchmarks.result import Result

GRAINS = int(os.environ.get("GRAINS", "2500"))
SEEDS = tuple(int(s) for s in os.environ.get("SEEDS", "1 2 3").split())
SIZE = math.sqrt(math.pi) * 14.0  # m, of the square
STEPS = int(os.environ.get("STEPS", "80"))  # of the pressure along each side
VISCOSITY = 1e-3  # Pa s
AT_RIM, OF_BAR = 0.01, 0.03
EXACT = ((0.0, "x"), (90.0, "y"))  # angles and axes at which fractures end on sides of one pressure
BARS = {"x": (3, 1), "y": (0, 2)}  # number of the sides where it enters and leaves


def corners() -> np.ndarray:
    """Corners of the steps along the rim, (4 STEPS, 2) m, counterclockwise from the lower left."""
    turn = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0), (0.0, 0.0)]
    rim = [
        np.linspace(a, b, STEPS, endpoint=False)
        for a, b in zip(np.array(turn[:-1]), np.array(turn[1:]), strict=True)
    ]
    return SIZE * (np.concatenate(rim) - 0.5)


def rims() -> dict[str, dict[int, float]]:
    """Pressure of each step of the rim by its number, for each flow."""
    begin = corners()
    middle = 0.5 * (begin + np.roll(begin, -1, axis=0))
    found = {
        f"linear_{axis}": dict(enumerate((-middle[:, k]).tolist())) for k, axis in enumerate("xy")
    }
    for axis, (enters, leaves) in BARS.items():
        inlet, outlet = (range(side * STEPS, (side + 1) * STEPS) for side in (enters, leaves))
        found[f"bar_{axis}"] = dict.fromkeys(inlet, SIZE) | dict.fromkeys(outlet, 0.0)
    return found


@cache
def flows() -> xr.Dataset:
    """The quickstart in the square, steady, with each of these rims."""
    study = yaml.safe_load((STUDIES / "quickstart.yaml").read_text())
    scene, vary = study["scene"], study["vary"]
    for key in ("wells", "times", "initial_pressure", "boundaries"):
        scene.pop(key)
    scene["region"] = {"shape": "polygon", "vertices": corners().tolist()}
    scene["grains"]["count"] = GRAINS
    vary.pop("rate")
    vary["seed"] = {"parameter": "grains.seed", "values": list(SEEDS)}
    variants = {
        name: {"boundaries": {f"side[{k}]": f"{p!r} Pa" for k, p in rim.items()}}
        for name, rim in rims().items()
    }
    scene["boundaries"] = dict(variants["linear_x"]["boundaries"])
    vary["rim"] = {"variants": variants}
    written = {
        "study": "permeability_against_flow",
        "scene": scene,
        "vary": vary,
        "observe": ["permeability", "boundary_flow"],
        "solver": {"method": "steady"},
    }
    path = results_folder() / "permeability_against_flow.yaml"
    path.write_text(yaml.safe_dump(written, sort_keys=False))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return sweep.run(path, workers=1, results=results_folder())


def of_square(tensor: np.ndarray, cells: int = 40) -> float:
    """Flow along x over the gradient of a homogeneous unit square with sealed sides.

    Bilinear elements; k_xx where the tensor is diagonal, less where the flow would turn.

    Parameters
    ----------
    tensor : of permeability, (2, 2)
    cells : elements along each side
    """
    from scipy.sparse import coo_array
    from scipy.sparse.linalg import spsolve

    at = np.array([0.5 - 0.5 / math.sqrt(3.0), 0.5 + 0.5 / math.sqrt(3.0)])
    local = np.zeros((4, 4))
    for s in at:
        for t in at:
            slope = np.array([[t - 1, 1 - t, -t, t], [s - 1, -s, 1 - s, s]])
            local += 0.25 * slope.T @ tensor @ slope
    number = np.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)  # y, x
    element = np.stack([number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]], -1)
    element = element.reshape(-1, 4)
    matrix = coo_array(
        (
            np.tile(local.ravel(), len(element)),
            (np.repeat(element, 4, axis=1).ravel(), np.tile(element, 4).ravel()),
        )
    ).tocsr()
    p = np.zeros(number.size)
    p[number[:, 0]] = 1.0
    free = number[:, 1:-1].ravel()
    p[free] = spsolve(matrix[free][:, free].tocsc(), -(matrix[free] @ p))
    return float(p @ (matrix @ p))


def run() -> Result:
    """Compare both flows of each state and packing, along x and y."""
    found = flows()
    good = found["permeability"].notnull().all(("row", "column", "rim"))
    begin = corners()
    rim = rims()
    at_rim, of_bar, lines = [], [], []
    states = ("fracture_angle", "aperture", "stress_yy", "seed")
    cases = found.stack(case=states)
    for case in cases["case"].values:
        one = cases.sel(case=case)
        for k, axis in enumerate("xy"):
            linear, bar = one.sel(rim=f"linear_{axis}"), one.sel(rim=f"bar_{axis}")
            tensor = linear["permeability"].values
            q = linear["boundary_flow"].values.reshape(len(begin), -1)[:, -1]
            imposed = np.array([rim[f"linear_{axis}"][j] for j in range(len(begin))])
            dissipated = VISCOSITY * float(q @ imposed) / SIZE**2
            turned = tensor if axis == "x" else tensor[::-1, ::-1]
            through = bar["boundary_flow"].values.reshape(len(begin), -1)[:, -1]
            inlet = [j for j, p in rim[f"bar_{axis}"].items() if p > 0.0]
            measured = VISCOSITY * float(through[inlet].sum()) / SIZE
            off = tensor[k, k] / dissipated - 1.0
            if (case[0], axis) in EXACT:
                at_rim.append(off)
            of_bar.append(of_square(turned) / measured - 1.0)
            lines.append(
                f"{case}, k_{axis}{axis} {tensor[k, k]:.4g} m²: against Σ q p {off:+.2%}, "
                f"against the sealed bar {of_bar[-1]:+.2%}"
            )
    rim_most, bar_most = (float(np.abs(one).max()) for one in (at_rim, of_bar))
    lines.append(
        f"{GRAINS} grains, {int(good.sum())} states; mean {np.mean(at_rim):+.2%}, "
        f"{np.mean(of_bar):+.2%}"
    )
    return Result(
        f"dissipation within {rim_most:.2%}, sealed bar within {bar_most:.2%}",
        f"{AT_RIM:.0%}, {OF_BAR:.0%}",
        rim_most <= AT_RIM and bar_most <= OF_BAR,
        "\n".join(lines),
    )
