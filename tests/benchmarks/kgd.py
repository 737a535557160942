"""A hydraulic fracture in plane strain against the limits of toughness and of friction in fluid.

The study *kgd*: a hole in sealed, cemented grains is filled at a constant rate until a fracture
runs from it along a weak plane, whose cement alone breaks. Half-length and pressure over the stress
across the plane are held against the closed forms (`model.analytic.kgd`) with what the same packing
has of its own:

- *E'*: of the packing for small strains, its pores sealed, free of walls: the rim follows a strain.
- *K_Ic*: p √(π ℓ) of a crack under one pressure that is let grow without haste along the same
  plane, bond by bond, in the mean over the volume that it takes. Bonds of random grains lie now
  dense, now wide apart: where they are dense the crack waits, and the pressure rises by a half.
- *Viscosity*: the fluid goes through the crack's pipes one after the other, each as long as the
  two grains beside it: χ times the way along the plane, and χ μ stands for μ.
- *Rate*: what pores and hole hold by being pressed is not in the crack; injected less that, over
  time.

A crack's half-length is half of what its broken bonds take of the plane, each up to halfway to the
next. Both measures are means over the outputs of the last half of the growth.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import block_array, coo_array, csc_array, diags_array
from scipy.sparse.csgraph import connected_components

from demflow.model.analytic import kgd
from demflow.model.coupling.fracture import Fracturing
from demflow.model.coupling.setting import Setting, setting
from demflow.model.coupling.skeleton import borne
from demflow.model.mechanics.contact.bonds import INTACT
from demflow.model.mechanics.static.stiffness import ANCHOR, Quasidefinite, factorise, solve
from demflow.model.products import Packing
from demflow.model.scene import Scene
from demflow.model.stages import STAGES, run_stages
from demflow.sweep.study.load import load_study
from demflow.sweep.study.scenes import SceneBuilder
from tests.benchmarks.result import Result

BOUND = 0.10
GROWN = 1.0, 3.3  # m: half-lengths between which the toughness is measured
RIM = 8.0  # mean radii from the walls in which grains follow the strain: two coarse grains
STILL = 1e12  # stiffness of pores whose pressure is given, over that of others


class Plane(NamedTuple):
    """The cemented contacts of the weak plane, from left to right."""

    contact: np.ndarray  # (k,)
    x: np.ndarray  # (k,) m
    share: np.ndarray  # (k,) m: what each takes of the plane

    def half_length(self, broken: np.ndarray) -> float:
        """Half the length of the crack through some contacts, m."""
        return 0.5 * float(self.share[np.isin(self.contact, broken)].sum())


def plane_of(given: Setting) -> Plane:
    """The weak plane of a loaded specimen."""
    s = given.case.skeleton
    (weak,) = np.nonzero(s.joint & (given.hold.mode == INTACT))
    weak = weak[np.argsort(s.x[weak])]
    x = given.case.unit * s.x[weak]
    edges = np.concatenate([x[:1], 0.5 * (x[1:] + x[:-1]), x[-1:]])
    return Plane(weak, x, np.diff(edges))


def given_of(scene: Scene, packing: Packing) -> Setting:
    """What the march of a scene starts from."""
    stage = next(s for s in STAGES if s.name == "fracture")
    told = stage.given(scene, 0)
    return setting(packing, None, rock=told["rock"], wet=told["wet"], wells=told["wells"])


def toughness(
    given: Setting, plane: Plane, stress: float, grown: tuple[float, float] = GROWN
) -> float:
    """K_Ic, Pa √m, of a crack that grows slowly under one pressure from the well along its plane.

    Bond by bond: the pressure at which the next one reaches its strength, and the fluid that the
    crack takes until then; what a break leaves room for the pressure falls by. In between all is
    linear, for cement holds all grains but those of the crack.
    """
    case, s, c = given.case, given.case.skeleton, given.case.conduits
    m, d = case.push.shape
    now = borne(s, given.hold, given.u)
    along = np.where(now.slips, 0.0, now.ks)
    broken: list[int] = []
    taken, steps = 0.0, []
    while (half := plane.half_length(np.array(broken, int))) < grown[1]:
        joined = np.isin(c.contact, broken)
        graph = coo_array((np.ones(joined.sum()), (c.i[joined], c.j[joined])), shape=(d, d))
        _, part = connected_components(graph, directed=False)
        inside = part == part[given.well[0]]
        holds = np.ones(len(s.a))
        holds[broken] = 0.0
        stiffness = diags_array(np.full(m, ANCHOR)).tocsc()
        for strain, stiff in ((s.parting, now.kn), (s.sliding, along), (s.bending, now.km)):
            stiffness = stiffness + (strain.T @ diags_array(holds * stiff) @ strain).tocsc()
        stored = np.where(inside, STILL, 1.0) * case.storage
        whole = csc_array(
            block_array([[stiffness, -case.push], [-case.push.T, -diags_array(stored)]])
        )
        factor = Quasidefinite(whole)
        let_go = -s.parting.T @ ((1.0 - holds) * now.force)
        let_go -= s.sliding.T @ ((1.0 - holds) * (now.shear + now.cement_s))
        loads = let_go, case.push @ inside.astype(float)
        still, unit = (factor.solve(np.append(load, np.zeros(d)))[:m] for load in loads)
        across = 2.0 * s.half_width[plane.contact]
        at_rest = (s.cn * (s.parting @ still) - now.cement_n)[plane.contact] / across
        by_pressure = (s.cn * (s.parting @ unit))[plane.contact] / across
        room = s.tensile_strength[plane.contact] - at_rest
        opens = (by_pressure > 0.0) & ~np.isin(plane.contact, broken)
        critical = np.full(len(room), np.inf)
        critical[opens] = room[opens] / by_pressure[opens]
        k = int(np.argmin(critical))
        assert np.isfinite(critical[k]), "the crack ends before it is long enough"
        rest = float((case.pull @ still)[inside].sum())
        gives = float((case.pull @ unit + case.storage)[inside].sum())
        begins = (taken - rest) / gives
        if begins < critical[k]:
            more = rest + gives * critical[k] - taken
            steps.append((half, 0.5 * (begins + critical[k]) * case.stiffness - stress, more))
            taken += more
        broken.append(int(plane.contact[k]))
    half_length, net, volume = np.array(steps).T
    late = half_length >= grown[0]
    return float(np.average((net * np.sqrt(np.pi * half_length))[late], weights=volume[late]))


def plane_modulus(given: Setting, packing: Packing) -> float:
    """E', Pa, of the packing with sealed pores: the rim follows a strain, the rest settles."""
    case, s = given.case, given.case.skeleton
    n, box, net = len(packing.x), packing.box / case.unit, given.network

    def within(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        left, right, bottom, top = box
        level = (y > bottom + RIM) & (y < top - RIM)
        found: np.ndarray = (x > left + RIM) & (x < right - RIM) & level
        return found

    x, y = packing.x / case.unit, packing.y / case.unit
    inside = within(x, y)
    free = np.append(np.repeat(inside, 3), [False, False])
    now, between = borne(s, given.hold, given.u), s.b >= 0
    strains = (s.parting, now.kn), (s.sliding, now.ks), (s.bending, now.km)
    moduli = [(strain, np.where(between, stiff, 0.0)) for strain, stiff in strains]
    moduli.append((case.pull, 1.0 / case.storage))
    whole = diags_array(np.full(3 * n + 2, ANCHOR)).tocsc()
    for strain, stiff in moduli:
        whole = whole + (strain.T @ diags_array(stiff) @ strain).tocsc()
    factor, held = factorise(csc_array(whole[free][:, free])), whole[free][:, ~free]
    moved = np.zeros((3 * n + 2, 2))
    for k, place in enumerate((x, y)):
        moved[k : 3 * n : 3, k] = place
        moved[free, k] = solve(factor, -(held @ moved[~free, k]))
    share = 0.5 * (inside[s.a].astype(float) + inside[np.maximum(s.b, 0)])
    pores = within(net.x[given.pore] / case.unit, net.y[given.pore] / case.unit).astype(float)
    energy = np.zeros((2, 2))
    for (strain, stiff), part in zip(moduli, [share, share, share, pores], strict=True):
        strained = strain @ moved
        energy += strained.T @ ((stiff * part)[:, None] * strained)
    area = np.pi * float(np.sum((packing.radius[inside] / case.unit) ** 2))
    area /= 1.0 - float(packing.porosity)
    along, across = 0.5 * np.trace(energy), 0.5 * (energy[0, 1] + energy[1, 0])
    return float((along - across**2 / along) / area * case.stiffness)


def way(given: Setting, plane: Plane, viscosity: float, broken: np.ndarray) -> float:
    """Length of the pipes of a crack over its own."""
    case, c = given.case, given.case.conduits
    pipes = np.isin(c.contact, broken) & np.isin(c.contact, plane.contact)
    length = case.stiffness / (case.unit**2 * 12.0 * viscosity * c.factor[pipes])
    return float(length.sum() / (2.0 * plane.half_length(broken)))


def broken_by(run: Fracturing, time: float = np.inf) -> np.ndarray:
    """The contacts whose cement broke by a time."""
    broken: np.ndarray = run.events.contact[(run.events.time <= time) & (run.events.mode < 3)]
    return broken


class Growth(NamedTuple):
    """A fracture at the outputs."""

    time: np.ndarray  # (t,) s
    half_length: np.ndarray  # (t,) m
    pressure: np.ndarray  # (t,) Pa over the stress across the plane
    rate: np.ndarray  # (t,) m²/s: what is in it, over time


def growth(scene: Scene, run: Fracturing, given: Setting, plane: Plane) -> Growth:
    """What a march recorded of its fracture."""
    assert scene.fluid is not None
    assert scene.stress is not None
    c, records = given.case.conduits, run.records
    half, pressed = [], []
    for time, pressure in zip(records.time, records.pressure[:, given.pore], strict=True):
        broken = broken_by(run, time)
        beside = np.isin(c.contact, broken)
        inside = np.zeros(len(given.pore), bool)
        inside[np.concatenate([c.i[beside], c.j[beside], given.well])] = True
        held = run.network.volume[given.pore] / scene.fluid.modulus * pressure
        half.append(plane.half_length(broken))
        pressed.append(float(held[inside].sum()))
    net = records.well_pressure[:, 0] - scene.stress.yy
    rate = (records.injected - np.array(pressed)) / records.time
    return Growth(records.time, np.array(half), net, rate)


def ratios(scene: Scene) -> tuple[float, float, str]:
    """Half-length and pressure over the closed forms of one packing, and a line about it."""
    assert scene.fluid is not None
    assert scene.stress is not None
    products = run_stages(scene)
    run = products["fracture"]
    given = given_of(scene, products["pack"])
    plane = plane_of(given)
    tough = toughness(given, plane, scene.stress.yy)
    modulus = plane_modulus(given, products["pack"])
    longer = way(given, plane, scene.fluid.viscosity, broken_by(run))
    viscosity = longer * scene.fluid.viscosity
    grown = growth(scene, run, given, plane)
    strong = kgd.dimensionless_toughness(
        plane_modulus=modulus, toughness=tough, viscosity=viscosity, rate=float(grown.rate[-1])
    )
    exact = np.array(
        [
            (
                kgd.toughness_dominated(time, plane_modulus=modulus, toughness=tough, rate=rate)
                if strong > kgd.TOUGHNESS_ABOVE
                else kgd.viscosity_dominated(
                    time, plane_modulus=modulus, viscosity=viscosity, rate=rate
                )
            )
            for time, rate in zip(grown.time, grown.rate, strict=True)
        ]
    )
    late = exact[:, 0] >= 0.5 * exact[-1, 0]
    length = float(np.mean((grown.half_length / exact[:, 0])[late]))
    pressure = float(np.mean((grown.pressure / exact[:, 2])[late]))
    line = (
        f"K_m {strong:.2f}, E' {modulus / 1e9:.1f} GPa, K_Ic {tough / 1e6:.1f} MPa√m, χ "
        f"{longer:.2f}; at {grown.time[-1]:g} s half-length {grown.half_length[-1]:.2f} m of "
        f"{exact[-1, 0]:.2f}, pressure {grown.pressure[-1] / 1e6:.1f} MPa of "
        f"{exact[-1, 2] / 1e6:.1f}; {np.count_nonzero(run.events.mode < 3)} breaks; "
        f"{run.state.stopped!s}"
    )
    return length, pressure, line


def run() -> Result:
    """Both limits, in the mean over the study's packings."""
    study = load_study("studies/kgd.yaml")
    built = SceneBuilder(study.values, study.axes)
    lines, means = [], {}
    for regime, name in enumerate(("toughness", "viscosity")):
        found = []
        for seed in range(study.shape[1]):
            length, pressure, line = ratios(built.scene((regime, seed)))
            found.append((length, pressure))
            lines.append(f"{name}, packing {seed + 1}: ℓ {length:.3f}, p {pressure:.3f}; {line}")
        means[name] = np.mean(found, axis=0)
    holds = all(np.all(np.abs(mean - 1.0) <= BOUND) for mean in means.values())
    return Result(
        "; ".join(f"{n}: ℓ {m[0] - 1:+.1%}, p {m[1] - 1:+.1%}" for n, m in means.items())
        + f" in the mean of {study.shape[1]} packings",
        f"≤ {BOUND:.0%} each",
        bool(holds),
        "\n".join(lines),
    )
