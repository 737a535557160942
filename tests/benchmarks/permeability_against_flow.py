"""Permeabilities of fractured rock under stress are those of its flow, each by its own name.

The twelve states of the quickstart (angles, apertures, stresses) in SEEDS packings, in a square of
the area of its circle. `permeability` is held against the flow under a pressure p = −x or p = −y
along the whole rim, whose Σ q p is the dissipation. That pressure goes in steps, much shorter than
a pore, for a step moves where a fracture leaves: at 45° and 150 µm by 5, 2 and 1 % of its flow in
80, 160 and 320 steps a side.
`bar_permeability` is held against `boundary_flow` of the same rock between two sides whose others
are sealed. How far the first lies above the second, where fractures meet the rim, is told. GRAINS
(of the environment) makes the packings smaller, SEEDS and STEPS choose others and other steps.
"""

from __future__ import annotations

import math
import os
import warnings

import numpy as np
import xarray as xr
import yaml

from demflow import sweep
from tests.benchmarks.ran import STUDIES, results_folder
from tests.benchmarks.result import Result

GRAINS = int(os.environ.get("GRAINS", "2500"))
SEEDS = tuple(int(s) for s in os.environ.get("SEEDS", "1 2 3").split())
SIZE = math.sqrt(math.pi) * 14.0  # m, of the square
STEPS = int(os.environ.get("STEPS", "640"))  # of the pressure along each side
VISCOSITY = 1e-3  # Pa s
AT_RIM, OF_BAR = 0.01, 0.03
BARS = {"x": ("left", "right"), "y": ("bottom", "top")}  # sides where it enters and leaves


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
    return {axis: dict(enumerate((-middle[:, k]).tolist())) for k, axis in enumerate("xy")}


def flows(name: str, region: dict, rims: dict[str, dict[str, str]], observed: str) -> xr.Dataset:
    """The quickstart in a square, steady, with each of these pressures on its rim."""
    study = yaml.safe_load((STUDIES / "quickstart.yaml").read_text())
    scene, vary = study["scene"], study["vary"]
    for key in ("wells", "times", "initial_pressure", "boundaries"):
        scene.pop(key)
    scene["region"] = region
    scene["grains"]["count"] = GRAINS
    vary.pop("rate")
    vary["seed"] = {"parameter": "grains.seed", "values": list(SEEDS)}
    variants = {axis: {"boundaries": rim} for axis, rim in rims.items()}
    scene["boundaries"] = dict(next(iter(rims.values())))
    vary["rim"] = {"variants": variants}
    written = {
        "study": name,
        "scene": scene,
        "vary": vary,
        "observe": ["permeability", observed, "boundary_flow"],
        "solver": {"method": "steady"},
    }
    written["observe"] = list(dict.fromkeys(written["observe"]))
    path = results_folder() / f"{name}.yaml"
    path.write_text(yaml.safe_dump(written, sort_keys=False))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return sweep.run(path, workers=1, results=results_folder())


def run() -> Result:
    """Compare each permeability with its flow, of each state and packing, along x and y."""
    begin, rim = corners(), rims()
    stepped = flows(
        "permeability_against_flow",
        {"shape": "polygon", "vertices": begin.tolist()},
        {
            axis: {f"side[{k}]": f"{p!r} Pa" for k, p in pressures.items()}
            for axis, pressures in rim.items()
        },
        "permeability",
    )
    bars = flows(
        "bar_permeability_against_flow",
        {"shape": "rectangle", "width": SIZE, "height": SIZE},
        {axis: {one: "1 MPa", other: "0 Pa"} for axis, (one, other) in BARS.items()},
        "bar_permeability",
    )
    at_rim, of_bar, above, lines = [], [], [], []
    states = ("fracture_angle", "aperture", "stress_yy", "seed")
    done = stepped["permeability"].notnull().all(("row", "column", "rim"))
    for case in done.stack(case=states)["case"].values:
        where = dict(zip(states, case, strict=True))
        for k, axis in enumerate("xy"):
            linear, bar = (one.sel(where | {"rim": axis}) for one in (stepped, bars))
            tensor = float(linear["permeability"][k, k])
            q = linear["boundary_flow"].sel(boundary=[f"side[{j}]" for j in rim[axis]]).values
            dissipated = VISCOSITY * float(q.ravel() @ np.array(list(rim[axis].values()))) / SIZE**2
            off = tensor / dissipated - 1.0
            at_rim.append(off)
            flow = float(bar["boundary_flow"].sel(boundary=BARS[axis][0]).values.ravel()[0])
            of_bar.append(float(bar["bar_permeability"][k]) / (VISCOSITY * flow / 1e6) - 1.0)
            above.append(float(bar["permeability"][k, k] / bar["bar_permeability"][k]) - 1.0)
            lines.append(
                f"{case}, k_{axis}{axis} {tensor:.4g} m²: against Σ q p {off:+.2%}; of the bar "
                f"against its flow {of_bar[-1]:+.2e}, tensor over bar {above[-1]:+.2%}"
            )
    rim_most, bar_most = (float(np.abs(one).max()) for one in (at_rim, of_bar))
    lines.append(
        f"{GRAINS} grains, {int(done.sum())} states; mean {np.mean(at_rim):+.2%}; the tensor lies "
        f"{min(above):+.2%} to {max(above):+.2%} above the bar"
    )
    return Result(
        f"dissipation within {rim_most:.2%}, sealed bar within {bar_most:.2%}",
        f"{AT_RIM:.0%}, {OF_BAR:.0%}",
        rim_most <= AT_RIM and bar_most <= OF_BAR and len(above) == 2 * 12 * len(SEEDS),
        "\n".join(lines),
    )
