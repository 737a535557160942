"""The stage *fracture*: a march through breaking bonds, leg by leg, and what it records.

A leg ends at a change of some rate, or after some outputs. Each sets the case up anew and goes on
from the state in which the one before left it, so that it is a run of its own: resumed, limited
and shared like any other.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from demflow.model.coupling import breaking
from demflow.model.coupling.balance import flow, openings
from demflow.model.coupling.breaking import March, State, Wells
from demflow.model.coupling.setting import Setting, setting
from demflow.model.coupling.skeleton import FIRM, SLID, borne
from demflow.model.coupling.told import BreakingFluid, BreakingRock, Leg
from demflow.model.mechanics.contact.grains import Array
from demflow.model.network.apertures import pipe_conductance, uniform
from demflow.model.network.domains import domains_at
from demflow.model.permeability import permeability
from demflow.model.products import Network, Packing, Permeability
from demflow.model.scene import Probe, Well


class Records(NamedTuple):
    """What was recorded at t times, in SI for unit depth."""

    time: Array  # (t,) s
    well_pressure: Array  # (t, w) Pa
    well_rate: Array  # (t, w) m³/s, positive for production
    side_flow: Array  # (t, b) m³/s, positive into the region
    probe_pressure: Array  # (t, q) Pa
    stored: Array  # (t,) m³ that the pores gained
    injected: Array  # (t,) m³ by wells at a rate
    let_in: Array  # (t, k) m³ by the sides and wells that keep a pressure
    leaked: Array  # (t,) m³ injected that is in no well and beside no broken contact
    crack_length: Array  # (t,) m
    lowest: Array  # (t,) Pa, of any pore
    energies: Array  # (t, 6) J/m: put in, by the fluid's friction, slip, breaks, astray, jerks
    slip: Array  # (t, 3) of joint contacts since time zero: mean, largest (m), part that slid
    permeability: Array  # (t, 2, 2) m² of the network as it stands, or (t, 0, 0)
    pressure: Array  # (t, domains or 0) Pa


class Events(NamedTuple):
    """What broke or began to slide, in order."""

    time: Array  # (e,) s
    x: Array  # (e,) m
    y: Array
    mode: Array  # (e,) broken: 1 in tension, 2 in shear; 3 a joint's contact began to slide
    energy: Array  # (e,) J/m
    pore: Array  # (e,) domain beside it of the higher pressure, −1 none
    contact: Array  # (e,)
    length: Array  # (e,) m of the crack: between the pores that it joins


class Fracturing(NamedTuple):
    """Where a march stands and what it recorded."""

    state: State  # in the units of its case
    origin: Array  # (m,) displacements at time zero
    mass: Array  # (d,) fluid of the pores then
    records: Records
    at_changes: Array  # (c, w) Pa: pressures of the wells just before their rates change
    change_time: Array  # (c,) s
    events: Events
    network: Network  # without the grains in wells
    aperture: Array  # (p,) m: of its pipes at the end
    unbalanced: Array  # () largest volume out of balance in a pore, over the volume moved
    off: Array  # () largest force out of balance over the mean contact force
    factored: Array  # () factorisations so far
    solved: Array  # () and solves with them
    steps: Array  # () balances that were found
    probe_place: Array  # (q, 2) m: of the pores whose pressures probes have
    highest: Array  # (w,) Pa: pressure of each well after any step, between outputs too
    loose: Array  # () grains that came free and are held where they were
    permeability: Array  # (2, 2) m² of the network at time zero, or (0, 0)


def fracture(
    packing: Packing,
    unit_permeability: Permeability | None,
    before: Fracturing | None,
    *,
    rock: BreakingRock,
    wet: BreakingFluid,
    wells: tuple[Well, ...],
    probes: tuple[Probe, ...],
    tolerance: float,
    record_map: bool,
    record_permeability: bool = False,
    leg: Leg,
) -> Fracturing:
    """March on by one leg.

    Parameters
    ----------
    packing : the grains.
    unit_permeability : of their network at an aperture of 1 m, where a permeability is given.
    before : what the leg before left; None at first.
    rock, wet : parts of the scene.
    wells : where they are; what they do says the leg.
    probes : places of which the pore's pressure is recorded.
    tolerance : error in time of a step's pressures, over the largest.
    record_map : whether the pressures of all pores are kept.
    record_permeability : whether that of the network is measured at the outputs.
    leg : what to do.

    Raises ModelError where the rock does not bear its stresses; whatever else ends a march early
    is `state.stopped`.
    """
    if before is not None and str(before.state.stopped):
        return before
    goes_on = None if before is None else (before.state.u, before.state.hold)
    given = setting(packing, unit_permeability, rock=rock, wet=wet, wells=wells, start=goes_on)
    keepers = len(wet.sides) + sum(rate is None for rate in leg.rates)
    if before is None:
        march = March(given, given.u, keepers, tolerance)
        state = march.drained(breaking.start(given, keepers))
        march.origin, mass = state.u, state.mass
    else:
        march = March(given, before.origin, keepers, tolerance)
        state = before.state._replace(stopped="")
        mass = before.mass
    recorder = _Recorder(
        march, wells, leg.rates, wet, mass, before, probes, record_map, record_permeability
    )
    at_start = recorder.permeability(state) if before is None else before.permeability
    acts = _wells(given, wells, leg.rates, wet)
    for time in leg.times:
        state = march.to(state, time, acts)
        if state.stopped:
            break
        recorder.record(state)
    if not state.stopped and state.time < leg.end:
        state = march.to(state, leg.end, acts)
    return recorder.product(state, leg, at_start)


def _wells(
    given: Setting, wells: tuple[Well, ...], rates: tuple[float | None, ...], wet: BreakingFluid
) -> Wells:
    """What wells do in a leg, in the units of the case."""
    case, d = given.case, len(given.case.storage)
    inflow, held, pressure = np.zeros(d), np.zeros(d, bool), np.zeros(d)
    keepers = []
    for pore, well, rate in zip(given.well, wells, rates, strict=True):
        if rate is None:
            assert well.pressure is not None
            held[pore] = True
            pressure[pore] = (well.pressure - wet.initial) / case.stiffness
            keepers.append(pore)
        else:
            inflow[pore] -= rate / case.unit**2
    return Wells(inflow, held, pressure, np.array(keepers, dtype=np.int64))


class _Recorder:
    """Keeps what a march does, after what it did in its legs before."""

    def __init__(
        self,
        march: March,
        wells: tuple[Well, ...],
        rates: tuple[float | None, ...],
        wet: BreakingFluid,
        mass: Array,
        before: Fracturing | None,
        probes: tuple[Probe, ...],
        record_map: bool,
        record_permeability: bool,
    ):
        self.march, self.given, self.case = march, march.given, march.case
        self.wells, self.rates, self.wet, self.mass = wells, rates, wet, mass
        self.before, self.record_map = before, record_map
        self.record_permeability = record_permeability
        net, sides = self.given.network, len(wet.sides)
        self.probes = domains_at(net, np.array([p.at for p in probes]).reshape(-1, 2))
        self.sides = sides
        self.rows: list[tuple[Array, ...]] = []

    def record(self, state: State) -> None:
        """Keep what there is to say at the time of a state."""
        case, given, book = self.case, self.given, state.ledger
        area, energy = case.unit**2, case.unit**2 * case.stiffness
        pressure = self._pressure(state.p)
        found = borne(case.skeleton, state.hold, state.u)
        moved = flow(case, state.hold, found, state.p)
        rate = [
            -self.march.given_rate[pore] * area if rate is None else rate
            for pore, rate in zip(given.well, self.rates, strict=True)
        ]
        gained = state.mass - self.mass
        contact = np.array([e.contact for e in self.march.events if e.mode != SLID], dtype=np.int64)
        if self.before is not None:
            old = self.before.events
            contact = np.append(old.contact[old.mode != SLID], contact)
        here = np.zeros(len(gained), bool)
        here[given.well] = True
        c = case.conduits
        beside = np.isin(c.contact, contact)
        here[c.i[beside]] = here[c.j[beside]] = True
        put_in = book.injected + float(book.let_in[self.sides :].sum())
        self.rows.append(
            (
                np.asarray(state.time),
                pressure[given.pore[given.well]],
                np.array(rate, dtype=float),
                -area * np.bincount(given.link_side, moved.link, self.sides),
                pressure[self.probes],
                np.asarray(area * gained.sum()),
                np.asarray(area * book.injected),
                area * book.let_in,
                np.asarray(area * (put_in - gained[here].sum())),
                np.asarray(self._lengths(contact).sum()),
                np.asarray(pressure.min()),
                energy
                * np.array(
                    [
                        *(book.work, book.viscous, book.slip, book.released),
                        *(book.astray, book.jerks),
                    ]
                ),
                self._slip(state),
                self.permeability(state),
                pressure if self.record_map else pressure[:0],
            )
        )

    def _slip(self, state: State) -> Array:
        """Slip of the joints: by length the mean, and the part that slid; the largest."""
        s = self.case.skeleton
        slip, length = self.case.unit * state.hold.slip[s.joint], s.half_width[s.joint]
        slid = (state.hold.mode[s.joint] == SLID) | (slip > 0.0)
        whole = max(float(length.sum()), 1e-300)
        return np.array([slip @ length / whole, slip.max(initial=0.0), slid @ length / whole])

    def permeability(self, state: State) -> Array:
        """That of the network as it stands, (2, 2) m²; (0, 0) where it is not asked for."""
        if not self.record_permeability:
            return np.empty((0, 0))
        net, viscosity = self.given.network, self.wet.viscosity
        apertures = uniform(net, 1.0, viscosity)._replace(
            conductance=pipe_conductance(self._apertures(state), self.given.pipe_length, viscosity)
        )
        return permeability(net, apertures, viscosity=viscosity)

    def _apertures(self, state: State) -> Array:
        """Of all pipes of the network, m; those on the sides are as wide as unstressed ones."""
        case, given = self.case, self.given
        net, side = given.network, given.side
        found = borne(case.skeleton, state.hold, state.u)
        aperture = given.unopened.copy()
        within = (side[net.pipe_from] < 0) & (side[net.pipe_to] < 0)
        aperture[within] = openings(case, state.hold, found)[0].wide
        return aperture

    def product(self, state: State, leg: Leg, at_start: Array) -> Fracturing:
        """All that was recorded, and where the march stands."""
        case, before, given = self.case, self.before, self.given
        if self.rows:
            records = Records(*(np.array(column) for column in zip(*self.rows, strict=True)))
        else:
            self.record(state)
            records = Records(*(np.array(column)[:0] for column in zip(*self.rows, strict=True)))
        changes = self._pressure(state.p)[given.pore[given.well]][None]
        ended = leg.changes and not state.stopped
        changes, at = changes[: int(ended)], np.array([leg.end])[: int(ended)]
        events, march = self._events(), self.march
        factored, solved, steps = case.matrix.factored, case.matrix.solved, march.solves
        highest = self.wet.initial + case.stiffness * march.highest
        if before is not None:
            highest = np.maximum(highest, before.highest)
            records = _after(before.records, records)
            events = _after(before.events, events)
            changes = np.concatenate([before.at_changes, changes])
            at = np.concatenate([before.change_time, at])
            factored, solved = factored + int(before.factored), solved + int(before.solved)
            steps += int(before.steps)
        moved = max(float(np.abs(state.ledger.let_in).sum()) + abs(state.ledger.injected), 1e-300)
        return Fracturing(
            state=state,
            origin=march.origin,
            mass=self.mass,
            records=records,
            at_changes=changes,
            change_time=at,
            events=events,
            network=given.network,
            aperture=self._apertures(state),
            unbalanced=np.asarray(state.ledger.unbalanced / moved),
            off=np.asarray(state.ledger.off),
            factored=np.asarray(factored),
            solved=np.asarray(solved),
            steps=np.asarray(steps),
            probe_place=np.column_stack(
                [given.network.x[self.probes], given.network.y[self.probes]]
            ),
            highest=highest,
            permeability=at_start,
            loose=np.asarray(np.count_nonzero(state.hold.grip[:-2:3] >= FIRM)),
        )

    def _pressure(self, p: Array) -> Array:
        """Of all domains, Pa."""
        given = self.given
        held = np.array([pressure for _, pressure in self.wet.sides])
        found = np.full(len(given.side), self.wet.initial)
        found[given.side >= 0] = held[given.side[given.side >= 0]]
        found[given.pore] += self.case.stiffness * p
        return found

    def _lengths(self, contact: Array) -> Array:
        """Length of the crack through each contact, m: from pore to pore, or of its bond."""
        case, given, net = self.case, self.given, self.given.network
        c, s = case.conduits, case.skeleton
        pipe = np.full(len(s.a), -1)
        pipe[c.contact[c.contact >= 0]] = np.flatnonzero(c.contact >= 0)
        of = pipe[contact]
        i, j = given.pore[c.i[of]], given.pore[c.j[of]]
        between = np.hypot(net.x[i] - net.x[j], net.y[i] - net.y[j])
        found: Array = np.where(of >= 0, between, 2.0 * case.unit * s.half_width[contact])
        return found

    def _events(self) -> Events:
        case, given, events = self.case, self.given, self.march.events
        contact = np.array([e.contact for e in events], dtype=np.int64)
        pore = np.array([e.pore for e in events], dtype=np.int64)
        s, unit = case.skeleton, case.unit
        box = given.box
        middle = 0.5 * np.array([box[0] + box[1], box[2] + box[3]])
        return Events(
            time=np.array([e.time for e in events], dtype=float),
            x=middle[0] + unit * s.x[contact],
            y=middle[1] + unit * s.y[contact],
            mode=np.array([e.mode for e in events], dtype=np.int8),
            energy=unit**2 * case.stiffness * np.array([e.energy for e in events], dtype=float),
            pore=np.where(pore >= 0, given.pore[pore], -1),
            contact=contact,
            length=self._lengths(contact),
        )


def _after(first: Any, then: Any) -> Any:
    """Records or events, one after the other."""
    pairs = zip(first, then, strict=True)
    return type(first)(*(np.concatenate([a, b]) for a, b in pairs))
