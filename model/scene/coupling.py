"""How fluid and rock are coupled, and what loads the specimen's walls while fluid moves."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import NamedTuple

from demflow.model.parameters import Problems, SceneError, check_fields, parameter
from demflow.model.region import Rectangle, Region
from demflow.model.scene.flow import Fluid, Matrix, Well
from demflow.model.scene.fractures import Fracture
from demflow.model.scene.rock import Bonds, Grains, Stress

__all__ = ["Coupling", "Reckoned", "coupling_problems", "one_way_ratio", "reckoned"]

# Closing over its strain at which flows with apertures as they are are off by 1 %.
ONE_WAY = 0.007

COUPLED = ("krylov", "implicit")  # solvers of coupled transients
Schedule = tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class Coupling:
    """Two-way coupling: pressure moves grains, grains squeeze pores.

    The region is then the specimen between its four walls, of which the left and the bottom one
    stand. The right and the top one keep their stress, but for the changes given here.
    """

    method: str = parameter(
        default="auto",
        choices=("auto", "none", "linear", "apertures", "breaking"),
        help="linear: grains bonded and unbroken, apertures as they are; apertures: these follow "
        "the forces; breaking: bonds and joints break one by one, and what parts opens; none: "
        "fluid moves alone; auto takes apertures where that changes flows by more than some "
        "percent, else linear",
    )
    least_pressure: float | None = parameter(
        "Pa",
        default=None,
        help="pressure at which the liquid turns to vapour, of method breaking; by default never",
    )
    step_error: float = parameter(
        default=1e-2,
        at_least=1e-5,
        below=1,
        help="error in time of the pressures in each step of method breaking, over the largest",
    )
    held: str = parameter(
        default="none",
        choices=("none", "right", "top", "both"),
        help="walls that stand besides the left and the bottom one, whatever presses on them",
    )
    load_xx: float | None = parameter(
        "Pa", default=None, help="stress put on the right wall at time zero, compression positive"
    )
    load_yy: float | None = parameter(
        "Pa", default=None, help="stress put on the top wall at time zero, compression positive"
    )
    schedule_xx: Schedule | None = parameter(
        "s, Pa", default=None, help="stress put on the right wall in time, [[time, stress], …]"
    )
    schedule_yy: Schedule | None = parameter(
        "s, Pa", default=None, help="stress put on the top wall in time, [[time, stress], …]"
    )

    def __post_init__(self) -> None:
        check_fields(self)
        problems = []
        if self.method == "breaking":
            for name in ("load_xx", "load_yy", "schedule_xx", "schedule_yy"):
                if getattr(self, name) is not None:
                    what = "method breaking keeps the stresses of the scene; leave it out"
                    problems.append((name, what))
            if self.held != "none":
                what = "method breaking holds the left and the bottom wall only; leave it out"
                problems.append(("held", what))
        elif self.least_pressure is not None:
            problems.append(("least_pressure", "only method breaking knows vapour; leave it out"))
        for axis, wall in (("xx", "right"), ("yy", "top")):
            load, schedule = getattr(self, f"load_{axis}"), getattr(self, f"schedule_{axis}")
            name = f"load_{axis}" if schedule is None else f"schedule_{axis}"
            if load is not None and schedule is not None:
                problems.append((name, f"give either load_{axis} or schedule_{axis}"))
            if (load is not None or schedule is not None) and wall in self.held_walls:
                what = f"the {wall} wall is held, so that no load moves it; leave one of them out"
                problems.append((name, what))
            problems += _schedule_problems(f"schedule_{axis}", schedule)
        if problems:
            raise SceneError(problems)

    @property
    def held_walls(self) -> tuple[str, ...]:
        """Walls that stand besides the left and the bottom one."""
        return {"none": (), "both": ("right", "top")}.get(self.held, (self.held,))

    @property
    def load_changes(self) -> tuple[Schedule, Schedule]:
        """Times (s) and new stresses (Pa) put on the right and on the top wall."""
        return tuple(  # type: ignore[return-value]
            schedule if schedule is not None else ((0.0, load),) if load else ()
            for load, schedule in (
                (self.load_xx, self.schedule_xx),
                (self.load_yy, self.schedule_yy),
            )
        )


def _schedule_problems(name: str, schedule: Schedule | None) -> Problems:
    if schedule is None:
        return
    starts = [t for t, _ in schedule]
    if not starts:
        yield name, "the schedule is empty"
    elif not all(math.isfinite(v) for entry in schedule for v in entry):
        yield name, "times and stresses must be finite"
    elif starts[0] < 0 or any(b <= a for a, b in itertools.pairwise(starts)):
        yield name, "times must increase, from 0 s on"


class Reckoned(NamedTuple):
    """What is known beforehand of apertures that follow forces."""

    method: str  # linear | apertures
    sensitivity: float  # a = F̄ / (F̄ + F0)
    drawdown: float  # x, the largest change of pressure and load over the mean effective stress
    ratio: float  # of a flow to what it would be with apertures as they are
    reason: str


def one_way_ratio(sensitivity: float, drawdown: float) -> float:
    """Flow with apertures that follow forces over the flow without, about.

    A conductance goes as (1 + a ξ)⁻³ where pressure fell by ξ mean effective stresses, a = F̄ / (F̄ +
    F0). Between full and least pressure, in series, (1/x) ∫₀ˣ (1 + a ξ)⁻³ dξ = (1 − (1 + a x)⁻²) /
    (2 a x). `sensitivity` a in [0, 1), `drawdown` x ≥ 0.
    """
    closed = sensitivity * drawdown
    if closed < 1e-6:
        return 1.0 - 1.5 * closed
    return (1.0 - (1.0 + closed) ** -2) / (2.0 * closed)


def reckoned(
    region: Region,
    grains: Grains,
    matrix: Matrix | None,
    fluid: Fluid | None,
    stress: Stress | None,
    changes: tuple[float, ...],
    wells: tuple[Well, ...],
) -> Reckoned:
    """What coupling: auto takes, and why; before anything is run.

    `changes` are the pressures that are kept less the initial one, and the loads on walls, Pa. A
    well at a rate q draws about q μ ln(L / r_w) / (2π k).

    Parameters
    ----------
    region : where the case lies, m
    grains : how the grains are packed, and how stiff they are
    matrix : pipes of the rock, or None
    fluid : or None
    stress : on the rock, or None
    changes : times of changes, s
    wells : the wells of the scene
    """
    if (
        stress is None
        or matrix is None
        or (matrix.half_force is None and matrix.half_stress is None)
    ):
        reason = "apertures follow no force: there is no stress, or no half_stress or half_force"
        return Reckoned("linear", 0.0, 0.0, 1.0, reason)
    effective = 0.5 * (stress.xx + stress.yy)
    radius = grains.mean_radius or math.sqrt(0.83 * region.area / (math.pi * (grains.count or 1)))
    half = matrix.half_stress or (matrix.half_force or 0.0) / (2.0 * radius)
    sensitivity = effective / (effective + half)
    permeability = matrix.permeability or (matrix.aperture or 0.0) ** 3 / (24.0 * radius)
    permeability *= (1.0 - sensitivity) ** 3
    drawn = max((abs(change) for change in changes), default=0.0)
    for well in wells:
        rate = max((abs(q) for _, q in well.rate_changes), default=0.0)
        if rate > 0.0 and fluid is not None:
            reach = max(math.log(math.sqrt(region.area) / well.effective_radius), 1.0)
            least = 2.0 * math.pi * permeability
            drawn += rate * fluid.viscosity * reach / least if least > 0.0 else math.inf
    drawdown = min(drawn / effective, 1.0)
    ratio = one_way_ratio(sensitivity, drawdown)
    method = "apertures" if sensitivity * drawdown >= ONE_WAY else "linear"
    reason = (
        f"pressures and loads change by {drawdown:.2g} mean effective stresses, of a part "
        f"{sensitivity:.2g} of which contacts close: with apertures as they are flows would be off "
        f"by about {abs(1.0 / ratio - 1.0):.1%}"
    )
    return Reckoned(method, sensitivity, drawdown, ratio, reason)


def coupling_problems(
    region: Region,
    grains: Grains,
    bonds: Bonds | None,
    fractures: tuple[Fracture, ...],
    *,
    breaks: bool = False,
    linear: bool = False,
) -> Problems:
    """What a coupled rock cannot be.

    Parameters
    ----------
    region : where the case lies, m
    grains : how the grains are packed, and how stiff they are
    bonds : cement at the contacts, or None
    fractures : the fractures of the scene
    breaks : whether bonds may break
    linear : whether apertures stay as they are
    """
    if not isinstance(region, Rectangle):
        yield (
            "coupling",
            "a coupled specimen stands between four walls; take region.shape rectangle",
        )
    if grains.packing == "periodic":
        what = "a periodic packing has no walls; a coupled specimen needs them, as packing: random"
        yield "grains.packing", what
    if grains.scatter != "leave":
        yield "grains.scatter", "coupled grains keep their own volumes and pipes; leave it out"
    if grains.contact_stiffness is None:
        yield "grains.modulus", "coupling needs modulus or normal_stiffness"
    if grains.contact_law is not None:
        yield "grains.contact", "coupling takes linear contacts without rolling resistance"
    if bonds is None:
        yield "bonds", "coupled grains are bonded; add bonds"
    for fracture in fractures:
        if breaks:
            if fracture.acts_on_flow:
                yield (
                    f"fractures.{fracture.name}",
                    "where bonds break a fracture is a joint, which conducts as it opens; give "
                    "joint, and neither aperture, permeability nor a barrier",
                )
        elif fracture.joint is not None and not linear:
            yield (
                f"fractures.{fracture.name}.joint",
                "apertures that follow forces know no smooth joints; take coupling: linear, where "
                "a joint is two springs, or breaking, where it slides and opens",
            )
