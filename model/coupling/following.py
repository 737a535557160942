"""Apertures that follow the forces on them while fluid moves: a march through the nonlinear rock.

Bonds hold and the frame stays linear, K u = A p + f, but the conductances G(u) are those of the
contact forces at the time. A step of TR-BDF2 (`march`) takes them at its middle, to which u is
extrapolated from the step before: as accurate as iterating, and of second order. What they turn
out to be in the middle belongs to the error of the step; where it counts, the step is taken once
more with that.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from demflow.model.coupling.consolidation import (
    between_walls,
    check_walls,
    held_pores,
    taken,
)
from demflow.model.coupling.frame import frame_of
from demflow.model.coupling.march import ERROR, GAMMA, LADDER, SAFETY, Stepper, between
from demflow.model.coupling.record import Record, record_of
from demflow.model.coupling.rock import Rock, conductances, rock_of
from demflow.model.coupling.told import Stretch
from demflow.model.flow.equation.outputs import outputs
from demflow.model.flow.equation.probes import between_pores
from demflow.model.flow.equation.sites import WellSite
from demflow.model.flow.equation.system import System, assemble
from demflow.model.network.apertures import open_pipes
from demflow.model.outcome import ModelError
from demflow.model.products import (
    Apertures,
    Array,
    Network,
    Packing,
    Permeability,
    StressState,
    Walk,
)
from demflow.model.region import Region
from demflow.model.scene import Bonds, Fracture, Matrix, Probe
from demflow.model.threads import one_blas_thread

FIRST_STEP = 1e-3  # of the time to the first output or change
MOST_STEPS = 5_000
MOST_TRIES = 30  # of one step
AGAIN = 2  # times that a step is taken with the conductances that it led to


class Standing(NamedTuple):
    """Where a march stands, in the units of its rock."""

    time: float  # s
    step: float  # s: the next one, where nothing changes; 0: not known
    p: Array  # (n,)
    u: Array  # (m,) K⁻¹ A p
    force: Array  # (m,) f
    by_force: Array  # (m,) K⁻¹ f
    into: Array  # (fixed,) m³ through pipes since the start
    produced: float  # m³ by wells at a rate
    throughput: float  # m³: the same without signs
    rate: Array  # (m,) du/dt of the last step
    largest: float  # pressure so far
    error: float  # largest estimated error of a step, over that
    steps: int
    factors: int
    conducts: float  # sum of the conductances of pipes at the start
    stopped: str  # why it came to an early end, "" where it did not


class Records(NamedTuple):
    """What was recorded at t times; fields as in `History`, but by time first."""

    well_pressure: Array  # (t, w) Pa
    well_rate: Array  # (t, w) m³/s
    boundary_flow: Array  # (t, b) m³/s
    probe_pressure: Array  # (t, p) Pa
    stored: Array  # (t,) m³
    let_in: Array  # (t, k) m³
    produced: Array  # (t,) m³
    moved: Array  # (t,) m³
    wall: Array  # (t, 4) m
    stress: Array  # (t, 3) Pa, change of the mean effective stress
    kept_conductance: Array  # (t,) mean of the conductances of pipes over those at the start
    pressure: Array  # (t, m) Pa, of pores and nodes of traces; m = 0 where no map is asked for


class Followed(NamedTuple):
    """What a rock did whose apertures followed its forces, and where its march stands."""

    standing: Standing
    records: Records
    change_time: Array  # (c,) s, at which rates change
    at_changes: Array  # (c, w) Pa: pressures of the wells just before
    probe_place: Array  # (p, 2) m
    aperture: Array  # (p,) m, of the pipes where the march stands
    residual: Array  # () of the volumes that the last pressures store, u by K's own factor


class Moving:
    """The rock about a displacement: its apertures by the forces there, and its flow equation."""

    def __init__(
        self,
        rock: Rock,
        base: StressState,
        opened: Callable[[StressState], Apertures],
        assembled: Callable[[Apertures], System],
    ) -> None:
        self.rock, self.base, self.opened, self.assembled = rock, base, opened, assembled
        frame, n = rock.frame, len(base.x)
        known = base.contact_a * n + base.contact_b
        key = frame.contacts.a * n + frame.contacts.b
        place = np.minimum(np.searchsorted(known, key), len(known) - 1)
        ours = known[place] == key
        self._contact, self._a, self._b = (
            place[ours],
            frame.contacts.a[ours],
            frame.contacts.b[ours],
        )
        self._normal, self._shear = (k[ours] * rock.modulus for k in frame.springs)
        self._radius = frame.radius

    def stress(self, moved: Array) -> StressState:
        """The grains and their forces after displacements (m,) in units of the rock."""
        base, frame = self.base, self.rock.frame
        place = np.zeros(3 * frame.grain_count + 4)
        place[frame.free] = frame.unit * moved
        x, y, turn = place[:-4:3], place[1:-4:3], place[2:-4:3] / frame.unit
        a, b = self._a, self._b
        normal = np.array([base.x[b] - base.x[a], base.y[b] - base.y[a]])
        distance = np.hypot(*normal)
        normal /= distance
        step = np.array([x[b] - x[a], y[b] - y[a]])
        part = np.sum(step * normal, axis=0)
        radius = self._radius
        middle = 0.5 * (radius[a] + radius[b] - distance)
        slid = normal[0] * step[1] - normal[1] * step[0]
        slid -= turn[a] * (radius[a] - middle) + turn[b] * (radius[b] - middle)
        force, shear = base.normal_force.copy(), base.shear_force.copy()
        force[self._contact] -= self._normal * part
        shear[self._contact] -= self._shear * slid
        return base._replace(
            x=base.x + x, y=base.y + y, box=base.box + place[-4:], normal_force=force,
            shear_force=shear,
        )  # fmt: skip

    def at(self, moved: Array) -> tuple[Rock, Apertures]:
        """The rock with the conductances about a displacement."""
        apertures = self.opened(self.stress(moved))
        system = self.assembled(apertures)
        flow = conductances(system, self.rock.modulus / self.rock.size)
        return self.rock._replace(system=system, conductance=flow), apertures


def follow(
    packing: Packing,
    network: Network,
    walked: Walk | None,
    stress: StressState,
    unit_permeability: Permeability | None,
    before: Followed | None = None,
    *,
    region: Region,
    matrix: Matrix,
    fractures: tuple[Fracture, ...],
    viscosity: float,
    normal_stiffness: float,
    stiffness_ratio: float,
    friction: float,
    bonds: Bonds | None,
    held: tuple[str, ...],
    bulk_modulus: float,
    wells: tuple[WellSite, ...],
    sides: tuple[str, ...],
    initial: float,
    kept: tuple[float, ...],
    probes: tuple[Probe, ...],
    tolerance: float,
    record_map: bool,
    leg: Stretch,
) -> Followed:
    """March on by one leg a rock whose apertures follow its forces (the stage *follow*).

    Parameters
    ----------
    packing, network : grains between walls, and all their pores.
    walked, stress, unit_permeability, region, matrix, fractures, viscosity : as for
        `network.apertures.open_pipes`; forces count from the stress.
    before : what the leg before left; None at first.
    normal_stiffness, stiffness_ratio, friction, bonds, held : as for `consolidate`.
    bulk_modulus : K_f of the fluid, Pa.
    wells, sides : where they are.
    initial : pressure at the start, at which the stress is effective, Pa.
    kept : pressures of the sides, then of the wells that keep one, Pa.
    probes, record_map : what is recorded.
    tolerance : of the error of a step, over the largest change of pressure so far.
    leg : what to do.

    Raises `ModelError` where the rock is loose; a step that cannot be found ends the march, which
    its `standing` tells.
    """
    if before is not None and before.standing.stopped:
        return before
    check_walls(packing, region)
    filled, walls = between_walls(packing, region)
    frame = frame_of(
        packing, stiffness_ratio=stiffness_ratio, friction=friction, bonds=bonds, held=held,
        gone=taken(packing, region),
    )  # fmt: skip
    at_side = held_pores(packing, network, filled, sides)

    def opened(state: StressState) -> Apertures:
        return open_pipes(
            network, walked, state, unit_permeability, region=region, matrix=matrix,
            fractures=fractures, viscosity=viscosity,
        )  # fmt: skip

    def assembled(apertures: Apertures) -> System:
        return assemble(
            network, apertures, region=filled, bulk_modulus=bulk_modulus, wells=wells, sides=sides,
            at_side=at_side,
        )  # fmt: skip

    start = opened(stress)
    system = assembled(start)
    points = np.array([p.at for p in probes]).reshape(-1, 2)
    probed = between_pores(network, start, filled, system, points)
    rock = rock_of(packing, network, frame, system, normal_stiffness)
    record = record_of(rock, packing, outputs(system, probed))
    pressures = np.array(kept, dtype=float) - initial
    moving = Moving(rock, stress, opened, assembled)
    with one_blas_thread():
        found = _Run(
            moving, record, pressures, leg, (walls.height, walls.width), tolerance,
            None if before is None else before.standing, record_map=record_map,
        )  # fmt: skip
        found.go()
    fixed, at_rate, count = system.fixed_count, len(system.rate_wells), found.at
    own, held_ones = list(system.rate_wells), list(system.pressure_wells)
    output, flow = found.output[:count], found.flow[:count]

    def at_wells(times: int, by_rate: Array, by_pressure: Array) -> Array:
        """What is known of wells at a rate and of those at a pressure, (t, w) together."""
        whole = np.empty((times, len(wells)))
        whole[:, own], whole[:, held_ones] = by_rate, by_pressure
        return whole

    theirs = np.array(kept[len(sides) :])
    nodes = np.append(np.arange(len(network.x)), len(network.x) + np.arange(len(start.node_x)))
    maps = np.full((count, len(nodes) if record_map else 0), initial)
    if record_map:
        node, source = system.node_of_domain[nodes], system.source_of_domain[nodes]
        maps[:, node >= 0] += found.pressure[:count, node[node >= 0]]
        maps[:, source >= 0] += pressures[source[source >= 0]]
    o, span = record.flow_outputs, np.array(leg.times[:count]) - leg.start
    standing = found.standing()
    begun = found.begun
    let_in, stored = found.let_in[:count], found.stored[:count]
    put_through = begun.throughput + np.abs(leg.rates).sum() * span
    records = Records(
        well_pressure=at_wells(count, initial + output[:, :at_rate], theirs),
        well_rate=at_wells(count, np.array(leg.rates, dtype=float), -flow[:, len(sides) :]),
        boundary_flow=flow[:, : len(sides)],
        probe_pressure=initial + output[:, at_rate + fixed : o],
        stored=stored,
        let_in=let_in,
        produced=begun.produced + sum(leg.rates) * span,
        moved=np.abs(let_in).sum(axis=1) + np.abs(stored) + put_through,
        wall=output[:, o : o + 4],
        stress=output[:, o + 4 :],
        kept_conductance=found.kept[:count],
        pressure=maps,
    )
    changed = leg.changes and not standing.stopped
    last = (record.pressure @ found.p + record.place @ (found.u + found.by_force))[:at_rate]
    at_changes = at_wells(1, initial + last[None], theirs)[: int(changed)]
    change_time = np.array([leg.end])[: int(changed)]
    if before is not None:
        pairs = zip(before.records, records, strict=True)
        records = Records(*(np.concatenate([one, other]) for one, other in pairs))
        at_changes = np.concatenate([before.at_changes, at_changes])
        change_time = np.append(before.change_time, change_time)
    return Followed(
        standing=standing,
        records=records,
        change_time=change_time,
        at_changes=at_changes,
        probe_place=probed.place,
        aperture=moving.at(found.u + found.by_force)[1].aperture,
        residual=np.asarray(found.residual()),
    )


class _Taken(NamedTuple):
    p: Array  # (3, n) at the start, the middle and the end of a step
    u: Array  # (3, m)
    lost: Array  # (n,) local error in stored volume


class _Run:
    """A leg of a march: where it stands, and what was recorded of it at its times."""

    def __init__(
        self,
        moving: Moving,
        record: Record,
        kept: Array,
        leg: Stretch,
        lengths: tuple[float, float],
        tolerance: float,
        before: Standing | None,
        *,
        record_map: bool,
    ) -> None:
        """`kept` (fixed,) are pressures over the initial one, Pa."""
        self.moving, self.record, self.kept_pressure = moving, record, kept
        self.leg, self.times, self.lengths, self.tolerance = leg, leg.times, lengths, tolerance
        rock = moving.rock
        n, m, fixed = rock.system.n, len(rock.frame.free), rock.system.fixed_count
        count = len(self.times)
        self.output = np.zeros((count, record.pressure.shape[0]))
        self.flow, self.let_in = np.zeros((count, fixed)), np.zeros((count, fixed))
        self.stored, self.kept = np.zeros(count), np.ones(count)
        self.pressure = np.zeros((count, n if record_map else 0))
        self.at, self.stopped = 0, ""
        if before is None:
            conducts = float(moving.at(np.zeros(m))[1].conductance.sum())
            rest = np.zeros(m)
            before = Standing(
                0.0, 0.0, np.zeros(n), rest, rest, rest, np.zeros(fixed), 0.0, 0.0, rest, 0.0, 0.0,
                0, 0, conducts, "",
            )  # fmt: skip
        self.begun, self.time, self.step = before, before.time, before.step
        self.p, self.u, self.rate = before.p, before.u, before.rate
        self.force, self.by_force, self.into = before.force, before.by_force, before.into
        self.largest, self.error, self.steps = before.largest, before.error, before.steps
        self.rock = rock
        self.drawn = np.array(leg.rates, dtype=float) / rock.size
        self.stepper = Stepper(rock)

    def go(self) -> None:
        """To the end of the leg."""
        begin, end = self.leg.start, self.leg.end
        self._change()
        if self.step == 0.0:
            self.step = FIRST_STEP * (min((*self.times, end)) - begin)
        try:
            while self.time < end:
                asked = min(self.step, end - self.time)
                found, step, wish = self._find(self.time, asked)
                self._keep(found, self.time, step)
                ends = self.time + step >= end * (1.0 - 1e-12)
                self.time = end if ends else self.time + step
                # one that the end of the leg cut short says nothing of the next
                self.step = max(step * wish, self.step if step == asked else 0.0)
        except ModelError as lost:
            self.stopped = str(lost)

    def standing(self) -> Standing:
        """Where it stands."""
        rates, span = np.array(self.leg.rates, dtype=float), self.time - self.leg.start
        begun = self.begun
        return Standing(
            time=self.time,
            step=0.0 if self.leg.changes else self.step,
            p=self.p,
            u=self.u,
            force=self.force,
            by_force=self.by_force,
            into=self.into,
            produced=begun.produced + float(rates.sum()) * span,
            throughput=begun.throughput + float(np.abs(rates).sum()) * span,
            rate=self.rate,
            largest=self.largest,
            error=self.error,
            steps=self.steps,
            factors=begun.factors + self.stepper.made,
            conducts=begun.conducts,
            stopped=self.stopped,
        )

    def residual(self) -> float:
        """How far u is from K⁻¹ A p at the end, as volumes stored, relative."""
        rock = self.rock
        exact = rock.stored(self.p, rock.frame.moved(rock.squeeze @ self.p))
        size = float(np.linalg.norm(exact))
        off = float(np.linalg.norm(rock.stored(self.p, self.u) - exact))
        return off / size if size > 0.0 else 0.0

    def _change(self) -> None:
        """Put on what acts from now on; the fluid bears at once what the frame does not."""
        rock, frame = self.moving.rock, self.moving.rock.frame
        wanted = rock.held @ self.kept_pressure / rock.modulus
        for load, wall, length in zip(self.leg.loads, ("right", "top"), self.lengths, strict=True):
            wanted = wanted + load * rock.unit_load(wall, length).force
        if np.any(wanted != self.force):
            jump = frame.moved(wanted - self.force)
            pushed = -(rock.squeeze.T @ jump)
            dp, du = rock.solve_both(rock.factor(math.inf), math.inf, pushed)
            self.p, self.u = self.p + dp, self.u + du
            self.by_force, self.force = self.by_force + jump, wanted
            self.largest = max(self.largest, float(np.abs(self.p).max()))
            self.step = 0.0
        if self.step == 0.0:
            self.rate = np.zeros(len(self.u))

    def _source(self, system: System) -> Array:
        """What flows in where pressures are zero, (n,)."""
        kept = self.kept_pressure[system.fixed_source] / self.moving.rock.size
        flows = np.bincount(system.fixed_node, system.fixed_g * kept, system.n)
        flows[system.well_node] -= self.drawn
        return np.asarray(flows)

    def _find(self, time: float, step: float) -> tuple[_Taken, float, float]:
        """The next step, its length that keeps the tolerance, and how much longer the next is."""
        ahead = True
        for tries in range(MOST_TRIES):
            if ahead:
                guess = self.u + self.by_force + 0.5 * step * self.rate
                self.rock = self.moving.at(guess)[0]
            self.stepper.take(self.rock)
            source = self._source(self.rock.system)
            taken = _step(self.stepper, self.rock, source, self.p, self.u, step)
            actual = self.moving.at(self.by_force + 0.5 * (self.u + taken.u[2]))[0]
            mean = 0.5 * (self.p + taken.p[2])
            off = self._source(actual.system) - actual.conductance @ mean
            off -= source - self.rock.conductance @ mean
            whole, by_flow = (
                float(np.abs(self.stepper.solve(step, lost)[0]).max())
                for lost in (taken.lost + step * off, step * off)
            )
            size = max(self.largest, float(np.abs(taken.p[2]).max()))
            error = whole / size if size > 0.0 else 0.0
            self.steps += 1
            if not math.isfinite(error) or self.steps > MOST_STEPS:
                raise ModelError(
                    f"the march with apertures that follow forces came to {time:.3g} s in "
                    f"{self.steps} steps; raise solver.tolerance, or look at half_force"
                )
            if error <= self.tolerance:
                self.error, self.largest = max(self.error, error), size
                wish = SAFETY * (self.tolerance / max(error, 1e-300)) ** (1.0 / 3.0)
                return taken, step, LADDER if wish >= LADDER else 1.0
            ahead = by_flow < 0.5 * whole or tries % (AGAIN + 1) == AGAIN
            if ahead:
                step /= LADDER
            else:
                self.rock = actual
        raise ModelError(
            f"no step was found at {time:.3g} s that keeps an error of {self.tolerance:g}; raise "
            "solver.tolerance"
        )

    def _keep(self, taken: _Taken, time: float, step: float) -> None:
        """Record the times within a step, and stand at its end."""
        rock, record, kept = self.rock, self.record, self.kept_pressure
        by_pressure, by_place = record.volume
        held = rock.size * rock.held
        let = np.array([_let_in(rock.system, kept, q * rock.modulus) for q in taken.p])
        half = 0.5 * GAMMA * step
        then = [self.into, self.into + half * (let[0] + let[1])]
        then.append(self.into + step * (let[0] + let[1]) / (2.0 * (2.0 - GAMMA)) + half * let[2])
        while self.at < len(self.times) and self.times[self.at] <= (time + step) * (1.0 + 1e-12):
            k = self.at
            part, slope = between((self.times[k] - time) / step)
            here, place = part @ taken.p, part @ taken.u + self.by_force
            self.output[k] = record.pressure @ here + record.place @ place
            at_time, apertures = self.moving.at(place)
            self.flow[k] = _let_in(at_time.system, kept, here * rock.modulus)
            self.flow[k] += held.T @ (slope @ taken.u) / step
            self.let_in[k] = part @ np.array(then) + held.T @ place
            self.stored[k] = by_pressure @ here + by_place @ place
            self.kept[k] = apertures.conductance.sum() / self.begun.conducts
            if self.pressure.size:
                self.pressure[k] = rock.modulus * here
            self.at += 1
        self.rate = (taken.u[2] - self.u) / step
        self.p, self.u, self.into = taken.p[2], taken.u[2], then[2]


def _step(stepper: Stepper, rock: Rock, source: Array, p: Array, u: Array, step: float) -> _Taken:
    """One step of TR-BDF2 with the conductances of the rock."""
    half = 0.5 * GAMMA * step
    stored = rock.stored(p, u)
    flow = source - rock.conductance @ p
    middle, middle_u = stepper.solve(step, stored + half * (flow + source))
    middle_flow = source - rock.conductance @ middle
    mixed = rock.stored(middle, middle_u) - (1.0 - GAMMA) ** 2 * stored
    after, after_u = stepper.solve(step, mixed / (GAMMA * (2.0 - GAMMA)) + half * source)
    after_flow = source - rock.conductance @ after
    lost = 2.0 * ERROR * step * (
        flow / GAMMA - middle_flow / (GAMMA * (1.0 - GAMMA)) + after_flow / (1.0 - GAMMA)
    )  # fmt: skip
    return _Taken(np.array([p, middle, after]), np.array([u, middle_u, after_u]), lost)


def _let_in(system: System, kept: Array, pressure: Array) -> Array:
    """Flow through pipes from each fixed pressure, (fixed,) m³/s, at pressures (n,) Pa."""
    fixed, source = system.fixed_count, system.fixed_source
    flow = system.fixed_g * (kept[source] - pressure[system.fixed_node])
    found = np.bincount(source, flow, fixed)
    across = system.short_g * (kept[system.short_a] - kept[system.short_b])
    np.add.at(found, system.short_a, across)
    np.subtract.at(found, system.short_b, across)
    return np.asarray(found)
