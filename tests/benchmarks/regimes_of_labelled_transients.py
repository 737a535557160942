"""Flow regimes of labelled transients: of reservoir models with noise, and of networks."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from demflow.model.stages import simulate
from demflow.model.transient import bourdet_derivative
from demflow.sweep.analysis.regimes import SURE, Regime, detect_regimes
from demflow.sweep.analysis.reservoirs import MODELS, unit_response
from demflow.sweep.study.cases import case_at
from demflow.sweep.study.load import load_study
from demflow.sweep.study.reservoir import PARAMETERS, Rock, parameters_of
from tests.benchmarks.result import Result

EACH = 6  # transients of each kind
NOISE = 0.001  # of the pressure change
SMOOTHING = 0.3
ROCK = Rock(porosity=0.2, viscosity=1e-3, compressibility=1e-9, well_radius=0.1, thickness=10.0)


class Kind(NamedTuple):
    """A kind of transient: its model, where its parameters are drawn from, and its regimes."""

    model: str
    drawn: dict[str, tuple[float, float]]
    times: tuple[float, float]  # s
    regimes: tuple[str, ...]
    besides: tuple[str, ...] = ()  # regimes that may be there or not


K = {"permeability": (5e-14, 2e-13)}  # 0.25 to 1 m²/s
KINDS = {
    "storage and skin": Kind(
        "homogeneous",
        K | {"wellbore_storage": (3e-9, 3e-8), "skin_factor": (0.5, 6.0)},
        (1e-2, 1e6),
        ("wellbore storage", "radial"),
    ),
    "open fracture": Kind(
        "infinite_conductivity_fracture",
        K | {"half_length": (20.0, 60.0)},
        (1e-1, 1e6),
        ("linear", "radial"),
    ),
    "resisting fracture": Kind(
        "finite_conductivity_fracture",
        K | {"half_length": (30.0, 60.0), "fracture_conductivity": (3e-12, 1e-11)},
        (1e-1, 1e6),
        ("bilinear", "radial"),
        ("linear",),
    ),
    "one fault": Kind("fault", K | {"distance": (15.0, 60.0)}, (1.0, 1e6), ("radial", "one fault")),
    "corner": Kind(
        "corner",
        K | {"distance": (15.0, 40.0), "ratio": (1.0, 1.5)},
        (1.0, 1e6),
        ("radial", "corner"),
        ("one fault",),
    ),
    "channel": Kind(
        "channel",
        K | {"width": (40.0, 120.0), "offset": (0.4, 0.5)},
        (1.0, 1e6),
        ("radial", "channel"),
    ),
    "closed": Kind(
        "closed_circle", K | {"radius": (40.0, 150.0)}, (1.0, 2e6), ("radial", "pseudo-steady")
    ),
    "constant pressure": Kind(
        "constant_pressure_circle", K | {"radius": (40.0, 150.0)}, (1.0, 1e6), ("radial", "steady")
    ),
}
NETWORKS = {
    "network, sealed rim": ("boundaries: {}", ("radial", "pseudo-steady")),
    "network, rim at constant pressure": ("boundaries: {outer: 7 MPa}", ("radial", "steady")),
}
SCENE = """study: network
scene:
  region: {{shape: circle, radius: 50 m}}
  grains: {{count: 3000, porosity: 0.16, seed: {seed}}}
  matrix: {{permeability: 5 mD}}
  fluid: {{viscosity: 1 cP, bulk_modulus: 1 GPa}}
  wells: {{p: {{at: [0 m, 0 m], radius: 0.1 m, rate: 1e-6 m3/s}}}}
  {rim}
  initial_pressure: 7 MPa
  times: {{first: 1000 s, last: 1e7 s, per_decade: 20}}
observe: [well_pressure]
"""


def of_model(kind: Kind, rng: np.random.Generator) -> list[Regime]:
    """Regimes of one transient of a reservoir model, with noise."""
    values = {n: PARAMETERS[n].default for n in parameters_of(kind.model)}
    values |= {n: low * (high / low) ** rng.uniform() for n, (low, high) in kind.drawn.items()}
    values["initial_pressure"] = 0.0
    begin, end = kind.times
    times = np.geomspace(begin, end, int(20 * np.log10(end / begin)))
    change = unit_response(MODELS[kind.model], ROCK, values, times)
    change *= 1.0 + NOISE * rng.normal(size=len(times))
    return detect_regimes(times, change, bourdet_derivative(times, change, smoothing=SMOOTHING))


def of_network(rim: str, seed: int, rng: np.random.Generator) -> list[Regime]:
    """Regimes of the well of a network, with noise."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "study.yaml"
        path.write_text(SCENE.format(seed=seed, rim=rim))
        scene = case_at(load_study(path), ()).scene
    times = np.array(scene.times)
    change = 7e6 - simulate(scene)["well_pressure"][0]
    change = change * (1.0 + NOISE * rng.normal(size=len(times)))
    return detect_regimes(times, change, bourdet_derivative(times, change, smoothing=SMOOTHING))


def judged(
    found: list[Regime], expected: tuple[str, ...], besides: tuple[str, ...]
) -> tuple[bool, bool, str]:
    """Whether the regimes are those expected, in their order; whether one is surely wrong."""
    own = [one for one in found if one.name not in besides]
    right = tuple(one.name for one in own) == expected
    wrong = any(one.confidence >= SURE and one.name not in expected for one in own)
    told = ", ".join(f"{one.name} ({one.confidence:.2f})" for one in found)
    return right, wrong, told


def run() -> Result:
    """How many transients are read right, and how many surely wrong."""
    rng = np.random.default_rng(4)
    total = right = wrong = 0
    lines = []
    cases: list[tuple[str, tuple[str, ...], tuple[str, ...], list[Regime]]] = []
    for name, kind in KINDS.items():
        cases += [(name, kind.regimes, kind.besides, of_model(kind, rng)) for _ in range(EACH)]
    for name, (rim, expected) in NETWORKS.items():
        cases += [(name, expected, (), of_network(rim, 1 + k, rng)) for k in range(EACH)]
    for name, expected, besides, found in cases:
        good, bad, told = judged(found, expected, besides)
        total, right, wrong = total + 1, right + good, wrong + bad
        if not good:
            lines.append(f"{name}: {told or 'nothing'}{', surely wrong' if bad else ''}")
    return Result(
        f"{right} of {total} right, {wrong} surely wrong",
        "≥ 57 of 60 right, none surely wrong",
        bool(right >= 57 and total == 60 and wrong == 0),
        "\n".join(lines),
    )
