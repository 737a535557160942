"""A hydraulic fracture in plane strain against the limits of toughness and of friction in fluid.

A hole in sealed, cemented grains is filled at a constant rate until a fracture runs from it along
a weak plane, whose cement alone breaks. Half-length and pressure over the stress across the plane
are held against the closed forms (`model.analytic.kgd`) with what the same packing has of its own:
Young's modulus and Poisson's ratio for small strains, the fluid's stiffness added to the bulk
modulus (pores are sealed, so that the rock is undrained: K + K_f / φ), and the toughness at which
uniform pressure in a straight crack on its plane breaks the next contact, by √(π ℓ) times that
pressure, in the mean of several lengths.

The toughness of grains is some strength times the root of a grain's size, and confinement adds to
it, so that it is chosen by the strength, far above the stress: what holds is scaled, not the rock
of a textbook. Grains are three times finer along
the plane. Pressure falls and rises by a few tenths with each contact that breaks; both are
means over the outputs of the last half of the growth.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from demflow.model.analytic import kgd
from demflow.model.coupling.balance import Fluid as Step
from demflow.model.coupling.balance import balanced
from demflow.model.coupling.setting import setting
from demflow.model.coupling.skeleton import Hold, load_factors
from demflow.model.region import Rectangle
from demflow.model.scene import (
    BiWing,
    Bonds,
    Fluid,
    Grains,
    Joint,
    Matrix,
    Refinement,
    Scene,
    Stress,
    Well,
)
from demflow.model.scene.coupling import Coupling
from demflow.model.stages import STAGES, run_stages
from tests.benchmarks.result import Result

SEEDS = (1, 2, 3)
COUNT, SIDE, STRESS, STIFF = 1200, 20.0, 4e6, 2e10
FINER, HOLE = 3.0, 0.16
BOUND = 0.10
FROM = 3.0  # s: the outputs that are compared
CRACKS = (2.0, 2.4, 2.8, 3.2, 3.6)  # m: half-lengths for the toughness


class Regime(NamedTuple):
    """What is chosen for one of the limits."""

    viscosity: float  # Pa s
    rate: float  # m²/s
    strength: float  # Pa, of the plane
    aperture: float  # m, of pipes that did not open


REGIMES = {
    "toughness": Regime(1e-6, 2e-3, 40e6, 1e-7),
    "viscosity": Regime(100.0, 4e-3, 10e6, 1e-4),
}


def fractured(seed: int, regime: Regime, count: int = COUNT) -> Scene:
    """A hole on a weak plane in strong, sealed rock."""
    plane = Joint(
        normal_stiffness=2e12,
        shear_stiffness=1e12,
        friction=1.0,
        cohesion=1e9,
        tensile_strength=regime.strength,
    )
    return Scene(
        region=Rectangle(SIDE, SIDE),
        grains=Grains(
            count=count,
            porosity=0.16,
            seed=seed,
            modulus=20e9,
            refine=(Refinement(around="traces", within=0.6, factor=FINER),),
        ),
        bonds=Bonds(
            kind="parallel", tensile_strength=2e9, shear_strength=2e9, installation_gap=0.05
        ),
        stress=Stress(STRESS, STRESS),
        matrix=Matrix(aperture=regime.aperture, gap_factor=1.0),
        fractures=(
            BiWing(name="plane", at=(0.0, 0.0), angle=0.0, half_length=0.35 * SIDE, joint=plane),
        ),
        fluid=Fluid(regime.viscosity, STIFF),
        wells=(Well(name="bore", at=(0.0, 0.0), radius=HOLE, rate=-regime.rate),),
        initial_pressure=0.0,
        coupling=Coupling(method="breaking"),
        times=tuple(np.round(np.geomspace(0.3, 10.0, 25), 4).tolist()),
        observe=("well_pressure", "crack_length", "injected_volume", "elastic_moduli"),
    )


class Plane(NamedTuple):
    """Contacts of the weak plane, and the specimen that they are in."""

    x: np.ndarray  # (k,) m, ascending
    toughness: float  # Pa √m
    modulus: float  # Pa: E′ by the volume of its cracks


def plane_of(scene: Scene, products: dict) -> Plane:
    """The weak plane of a packing: toughness by uniform pressure in cracks of several lengths."""
    stage = next(s for s in STAGES if s.name == "fracture")
    told = stage.given(scene, 0)
    given = setting(products["pack"], None, rock=told["rock"], wet=told["wet"], wells=told["wells"])
    case, s, c = given.case, given.case.skeleton, given.case.conduits
    (weak,) = np.nonzero(s.joint & (s.tensile_strength > 0.0))
    weak = weak[np.argsort(s.x[weak])]
    x = case.unit * s.x[weak]
    d, found, strength = (
        len(case.storage),
        [],
        float(s.tensile_strength[weak].max()) * case.stiffness,
    )
    for half in CRACKS:
        cut = weak[np.abs(x) < half]
        hold = given.hold._replace(mode=given.hold.mode.copy())
        hold.mode[cut] = 1
        beside = np.isin(c.contact, cut)
        held = np.zeros(d, bool)
        held[np.concatenate([c.i[beside], c.j[beside], given.well])] = True

        def pressed(net: float, hold: Hold = hold, held: np.ndarray = held) -> tuple[float, float]:
            """Largest load factor of the plane, and the volume of the pores of the crack, m²."""
            p = np.where(held, (STRESS + net) / case.stiffness, 0.0)
            now = balanced(
                case, hold, given.u, p, case.pull @ given.u, Step(0.0, np.zeros(d), held),
                np.zeros(d, bool),
            )  # fmt: skip
            load = float(load_factors(s, hold, now.found)[0][weak].max())
            return load, float((case.pull @ (now.u - given.u))[held].sum()) * case.unit**2

        length = _half_length(x, x[np.abs(x) < half])
        critical = brentq(
            lambda net, pressed=pressed: pressed(net)[0] - 1.0, 0.1 * strength, 3.0 * strength,
            rtol=0.01,
        )  # fmt: skip
        wider = pressed(critical)[1] - pressed(0.5 * critical)[1]
        found.append((critical * np.sqrt(np.pi * length), np.pi * length**2 * critical / wider))
    toughness, modulus = np.mean(found, axis=0)
    return Plane(x, float(toughness), float(modulus))


def _half_length(x: np.ndarray, broken: np.ndarray) -> float:
    """Half the length of a crack, m: to halfway between its last contact and the next."""
    if not len(broken):
        return 0.0
    low, high = np.searchsorted(x, [broken.min(), broken.max()])
    left = 0.5 * (x[low] + x[max(low - 1, 0)])
    right = 0.5 * (x[high] + x[min(high + 1, len(x) - 1)])
    return float(0.5 * (right - left))


def ratios(seed: int, regime: Regime) -> tuple[float, float, str]:
    """Half-length and pressure over the closed forms of one packing."""
    scene = fractured(seed, regime)
    products = run_stages(scene)
    found, run = products["observe"], products["fracture"]
    weak = plane_of(fractured(seed, REGIMES["toughness"]), products)
    toughness = weak.toughness * _share(regime)
    e, nu = float(found["elastic_youngs_modulus"]), float(found["elastic_poissons_ratio"])
    bulk = e / (2.0 * (1.0 - nu)) + STIFF / float(found["porosity"])
    shear = e / (2.0 * (1.0 + nu))
    plane_modulus = 4.0 * bulk * shear / (bulk + shear)
    times = np.array(run.records.time)
    late = times >= FROM
    own = np.array([_half_length(weak.x, run.events.x[run.events.time <= time]) for time in times])
    net = run.records.well_pressure[:, 0] - STRESS
    told = {"plane_modulus": plane_modulus, "rate": regime.rate}
    strong = kgd.dimensionless_toughness(**told, toughness=toughness, viscosity=regime.viscosity)
    if strong > kgd.TOUGHNESS_ABOVE:
        exact = kgd.toughness_dominated(times, **told, toughness=toughness)
    else:
        exact = kgd.viscosity_dominated(times, **told, viscosity=regime.viscosity)
    length = float(np.mean((own / exact.half_length)[late]))
    pressure = float(np.mean((net / exact.pressure)[late]))
    line = (
        f"K_m {strong:.2f}, E' {plane_modulus / 1e9:.1f} GPa ({weak.modulus / 1e9:.1f} by its "
        f"cracks), K_Ic {toughness / 1e6:.1f} MPa√m; at {times[-1]:g} s half-length "
        f"{own[-1]:.2f} m of {exact.half_length[-1]:.2f}, pressure {net[-1] / 1e6:.1f} MPa of "
        f"{exact.pressure[-1] / 1e6:.1f}; {len(run.events.time)} breaks; {run.state.stopped!s}"
    )
    return length, pressure, line


def _share(regime: Regime) -> float:
    """Toughness over that of the plane that was measured: as their strength over the stress."""
    return (regime.strength + STRESS) / (REGIMES["toughness"].strength + STRESS)


def run(seeds: tuple[int, ...] = SEEDS) -> Result:
    """Both limits, in the mean over packings."""
    lines, means = [], {}
    for name, regime in REGIMES.items():
        found = []
        for seed in seeds:
            length, pressure, line = ratios(seed, regime)
            found.append((length, pressure))
            lines.append(f"{name}, packing {seed}: ℓ {length:.3f}, p {pressure:.3f}; {line}")
        means[name] = np.mean(found, axis=0)
    holds = all(np.all(np.abs(mean - 1.0) <= BOUND) for mean in means.values())
    return Result(
        "; ".join(f"{n}: ℓ {m[0] - 1:+.0%}, p {m[1] - 1:+.0%}" for n, m in means.items())
        + f" in the mean of {len(seeds)} packings",
        f"≤ {BOUND:.0%} each",
        bool(holds),
        "\n".join(lines),
    )
