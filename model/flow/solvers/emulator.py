"""Transients of a family of flow equations by one small model, each with a proven error.

A Galerkin projection on solutions (G + s C)⁻¹ b, at some real s and of some members of the family,
meets the response there, its slope in s and that in every transmissivity. With the same loads on
either side, what it lacks at any frequency is bᵀe = r̄ᵀ (G + s C)⁻¹ r, r the residual; for real s
that is positive, so that the projection is a lower bound. In modulus it is at most

    ‖r‖² / cos(½ arg s),   ‖r‖² = r̄ᵀ (G' + |s| C')⁻¹ r,

for any member whose G' ≤ G and C' ≤ C, since the real part of (G + s C) e^(−½ i arg s) is
G + |s| C times that cosine. A contour takes this to a bound at every time (`contour.py`). The norm
is the mean of |zᵀr|² over N samples z of a normal law with the covariance (G' + |s| C')⁻¹, one
solve each (Balabanov & Nouy 2019, Adv. Comput. Math. 45, 2969–3019), taken c = `CAUTION` times
larger. The samples by which members are judged are drawn once the space is complete, so that they
know nothing of it. For a residual that knows nothing of them the mean is too small only where a χ²
of N degrees of freedom, of the real or of the imaginary part, is below N / c. By Chernoff's bound
that happens with a probability of at most 2 (e^(1 − 1/c) / c)^(N/2), 4e-16 here, so that among
100,000 members, at all frequencies and outputs of each, some bound fails by chance with one of less
than 1e-7.

Snapshots are taken where the bound is largest until it is within the tolerance (greedy; Veroy &
Patera 2005, Int. J. Numer. Meth. Fluids 47, 773–788).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import eigh
from scipy.sparse import csr_array

from demflow.model.flow.equation.problem import Answer, Problem, empty_answer
from demflow.model.flow.equation.system import System
from demflow.model.flow.linear.factor import Factor, analyse, factorise, solve
from demflow.model.flow.solvers.affine import Share, Terms
from demflow.model.flow.solvers.contour import Contour, contour
from demflow.model.flow.solvers.krylov import balanced
from demflow.model.flow.solvers.share import Rough, shared_out, told
from demflow.model.flow.solvers.subspace import Basis, Modes
from demflow.model.memory import foresee
from demflow.model.outcome import ModelError
from demflow.model.products import Emulator

# Samples that make up a norm, and how much larger it is taken; a few tell where a snapshot is due.
SAMPLES = 32
CAUTION = 25.0
SAMPLES_BEFORE = 8

# Radii of the contour that share the samples of the least one, whose norm is the largest.
SHARED = 2
SEED = 20

# Poles of snapshots: from below the inverse of the last time, each so many times the one before,
# to beyond that of the first; and images taken at each.
SLOWEST, LADDER, FASTEST = 0.1, 30.0, 10.0
IMAGES = 2

MOST_VECTORS = 240
MOST_SNAPSHOTS = 60
MOST_PORTS = 6  # outputs held to the tolerance; each adds its own vectors
MARGIN = 0.5  # of the tolerance that members which were looked at are brought to

# Part of what a bound may be of the largest share of any pole, for that pole to be worth a solve.
WORTH = 0.1
NOTHING = 1e-9  # part of a vector that is round-off once the known part is taken away

# A member that has so little of the reference's matrix gets a reference of its own.
FAR = 1e-2
MOST_REFERENCES = 4

A_FEW = 3  # members that are looked at in one go to find the worst
AT_ONCE = 16  # members that are answered at once: more would not stay in a cache


class Emulated(NamedTuple):
    """What the small model answers for one member."""

    answer: Answer
    error: float  # bound of the relative error of all that is held to the tolerance
    noise: float  # what of it is round-off
    worst: np.ndarray  # (r,) of the contour's radii, what each has in that; (0,) unless asked for


class Projected(NamedTuple):
    """The flow equation of members (…) on the small space; wells that store nothing eliminated."""

    decay: np.ndarray  # (…, m) 1/s
    vectors: np.ndarray  # (…, m, m) modes
    follow: np.ndarray  # (…, w, m) how such wells follow the space
    inverse: np.ndarray  # (…, w, w)
    ports: np.ndarray  # (…, m, o) rows of the outputs
    at_wells: np.ndarray  # (…, w, o) the same at these wells


def projected(model: Emulator, share: Share) -> Projected:
    """Project the flow equation of one member, or of several whose shares are (…, terms).

    Parameters
    ----------
    model : small model of a family of cases
    share : how wide the fractures of each are
    """
    w = int(model.wells)
    G = np.tensordot(share.conductance, model.conductance, 1)
    C = np.tensordot(share.storage, model.storage, 1)
    inverse = np.linalg.inv(G[..., :w, :w])
    follow = -inverse @ G[..., :w, w:]
    held = G[..., w:, w:] + G[..., w:, :w] @ follow
    decay, vectors = np.empty(held.shape[:-1]), np.empty(held.shape)
    for at in np.ndindex(held.shape[:-2]):
        decay[at], vectors[at] = eigh(held[at], C[at][w:, w:], check_finite=False)
    ports = np.tensordot(share.conductance, model.ports, 1)
    if model.sealed:
        decay[..., 0] = 0.0  # of the constants, but for round-off
    return Projected(
        np.maximum(decay, 0.0),
        vectors,
        follow,
        inverse,
        ports[..., w:, :] + follow.mT @ ports[..., :w, :],
        ports[..., :w, :],
    )


def round_off(small: Projected, last: float) -> np.ndarray:
    """Relative round-off of the slowest mode that decays at all, up to the time `last` (s), (…)."""
    decays = np.where(small.decay > 0.0, small.decay, np.inf).min(axis=-1, initial=np.inf)
    slowest = np.maximum(decays, 1.0 / last)
    return np.asarray(np.finfo(float).eps * small.decay[..., -1] / slowest)


def transfer(model: Emulator, share: Share, frequency: np.ndarray) -> np.ndarray:
    """The response of each output to a load at each, at frequencies (f,) 1/s, (…, f, o, o).

    Parameters
    ----------
    model : small model of a family of cases
    share : how wide the fractures of one member are, or of several (…, terms)
    frequency : Laplace variable, (f,) 1/s
    """
    return _transfer(projected(model, share), frequency)


def _transfer(small: Projected, frequency: np.ndarray) -> np.ndarray:
    loads = small.vectors.mT @ small.ports
    inner = loads[..., None, :, :] / (small.decay[..., None, :, None] + frequency[:, None, None])
    wells = small.at_wells.mT @ small.inverse @ small.at_wells
    return np.asarray(loads.mT[..., None, :, :] @ inner + wells[..., None, :, :])


def residuals(model: Emulator, share: Share, small: Projected, frequency: np.ndarray) -> np.ndarray:
    """Squared norm of the residual of each port that counts, (b, r, a, p), without caution.

    At frequencies (r, a) 1/s of which each row has one modulus, that of a radius of the contour.

    Parameters
    ----------
    model : reduced model of a family of cases
    share : how wide the fractures of b members are, (b, terms)
    small : their projected problems
    frequency : Laplace variable, (r, a) 1/s
    """
    counted = np.flatnonzero(model.counted)
    radii = len(frequency)
    frequency = np.concatenate([frequency, frequency[-1:].repeat(-radii % SHARED, axis=0)])
    frequency = frequency.reshape(-1, SHARED * frequency.shape[1])
    rows, angles = frequency.shape
    members, m = small.decay.shape
    loads = small.vectors.mT @ small.ports[..., counted]
    modal = loads[..., None] / (small.decay[:, :, None, None] + frequency.ravel())
    modal = modal.reshape(members, m, -1)
    parts = np.concatenate([modal.real, modal.imag], axis=2)  # (b, m, 2 p r a)
    inner = small.vectors @ parts
    wells = small.follow @ inner
    half = wells.shape[2] // 2
    own = small.inverse @ small.at_wells[..., counted]
    wells[:, :, :half] += np.repeat(own, rows * angles, axis=2)
    found = np.concatenate([wells, inner], axis=1)
    found = found.reshape(members, -1, 2, len(counted), rows, angles)
    real, imaginary = found.transpose(2, 0, 4, 1, 3, 5)  # (b, r, q, p, a) each
    moved = frequency[:, None, None, :]
    both = np.stack([real, imaginary], axis=4)
    rates = np.stack(
        [
            moved.real * real - moved.imag * imaginary,
            moved.real * imaginary + moved.imag * real,
        ],
        axis=4,
    )
    flat = (members, rows, both.shape[2], -1)
    both, rates = both.reshape(flat), rates.reshape(flat)
    size = np.empty((members, rows, angles, len(counted)))
    best, reach = _reference(model, share)
    for k in np.unique(best):
        ours = np.flatnonzero(best == k)
        conductance, storage = share.conductance[ours], share.storage[ours]
        seen = np.tensordot(conductance, model.seen_ports[k][..., counted], 1)
        left = np.tensordot(conductance, model.seen_conductance[k], 1) @ both[ours]
        left += np.tensordot(storage, model.seen_storage[k], 1) @ rates[ours]
        left = left.reshape(*left.shape[:3], len(counted), 2, angles)
        left[..., 0, :] -= seen[..., None]
        squares = np.mean(left**2, axis=2).sum(axis=3)
        size[ours] = squares.swapaxes(2, 3) / reach[ours, None, None, None]
    return size.reshape(members, rows * SHARED, -1, len(counted))[:, :radii]


def _reference(model: Emulator, share: Share) -> tuple[np.ndarray, np.ndarray]:
    """The reference whose matrix bounds that of each member (b,) best, and what part does."""
    reach = np.minimum(
        (share.conductance[:, None] / model.reference_conductance).min(axis=2),
        (share.storage[:, None] / model.reference_storage).min(axis=2),
    )
    best = np.minimum(reach, 1.0).argmax(axis=1)
    return best, np.minimum(1.0, reach[np.arange(len(best)), best])


def _reach(model: Emulator, share: Share) -> float:
    """What part of its own matrix the best reference is sure to have of one member."""
    found = _reference(model, Share(share.conductance[None], share.storage[None]))
    return float(found[1][0])


def emulated(
    model: Emulator,
    problem: Problem,
    shares: Sequence[Share],
    around: Contour,
    *,
    by_radius: bool = False,
) -> Iterator[Emulated]:
    """The responses of some members of the family whose base poses `problem`, and their errors.

    `around` is the contour of its lags.

    Parameters
    ----------
    model : reduced model of a family of cases
    problem : what is solved
    shares : how wide the fractures of each member are
    around : contour of the inverse transform
    by_radius : whether to tell what each radius has in the error
    """
    for first in range(0, len(shares), AT_ONCE):
        some = shares[first : first + AT_ONCE]
        share = Share(*map(np.array, zip(*some, strict=True)))
        yield from _at_once(model, problem, share, around, by_radius)


def _at_once(
    model: Emulator, problem: Problem, share: Share, around: Contour, by_radius: bool
) -> list[Emulated]:
    """The same of members whose shares are (b, terms)."""
    small = projected(model, share)
    records, lag = problem.records, problem.lag
    w, wells, members = int(model.wells), records.well_rows, len(share.storage)
    flows = slice(wells, wells + records.flow_rows)
    direct = np.tensordot(share.conductance, model.direct, 1)  # (b, sources, o)
    stored = share.storage @ model.stored
    held = stored[:, w:] + (small.follow.mT @ stored[:, :w, None])[..., 0]
    answers = [empty_answer(problem) for _ in range(members)]
    for k in problem.active_sources:
        well = k - problem.system.fixed_count  # its load is what its row reads, the other sign
        load, at_wells = -small.ports[..., well, None], -small.at_wells[..., well, None]
        loads = (small.vectors.mT @ load)[..., 0]
        modes = Modes(small.decay, small.vectors, loads, np.zeros_like(loads))
        basis = Basis(model.highest[None, w:], modes, small.ports.mT, held)
        own = (small.at_wells.mT @ (small.inverse @ at_wells))[..., 0]
        alone = own + direct[:, k]
        given = -1.0 + own[:, flows].sum(axis=1)
        let_in = basis.rows[:, flows].sum(axis=1)
        pressure, integral, volume, missing = balanced(
            problem.system, basis, lag, let_in, given[:, None]
        )
        output = pressure @ small.ports + alone[:, None]
        through = integral @ small.ports[..., flows] + lag[:, None] * alone[:, None, flows]
        for one, *found in zip(answers, output, through, volume, missing, strict=True):
            one.output[k], one.cumulative[k, :, :-1], one.cumulative[k, :, -1] = found[:3]
            one.missing[k] = found[3]
    size = residuals(model, share, small, around.frequency)
    noise = round_off(small, lag[-1])
    slow = np.abs(np.log(around.radius * lag[-1])).argmin()
    at_rest = np.abs(np.einsum("bfoo->bo", _transfer(small, around.radius[[slow]])))
    left = np.sqrt(size[:, slow, 0] / at_rest[:, model.counted]).max(axis=1)
    errors = _in_time(model, problem, answers, size, around, by_radius)
    return [
        Emulated(answer._replace(time_error=error + off, residual=rest), error + off, off, worst)
        for answer, (error, worst), off, rest in zip(
            answers, errors, noise.tolist(), left.tolist(), strict=True
        )
    ]


def _in_time(
    model: Emulator,
    problem: Problem,
    answers: list[Answer],
    size: np.ndarray,
    around: Contour,
    by_radius: bool,
) -> list[tuple[float, np.ndarray]]:
    """Largest relative error of all that is held to the tolerance; what each radius has in it."""
    later = problem.lag > 0.0
    counted = np.flatnonzero(model.counted).tolist()
    shared = [shared_out(problem, partial(_given, answer)) for answer in answers]
    largest = np.zeros(len(answers))
    worst = np.zeros((len(answers), len(around.radius) if by_radius else 0))
    for k in problem.active_sources:
        own = counted.index(k - problem.system.fixed_count)
        pairs = zip(shared, answers, strict=True)
        scale = np.array([one.scale(k, answer.output[k][later]) for one, answer in pairs])
        for place, port in enumerate(counted):
            product = CAUTION * np.sqrt(size[..., own] * size[..., place]) / around.leaning
            counts = scale[:, :, port] > 0.0
            over = np.where(counts, 1.0 / np.where(counts, scale[:, :, port], 1.0), 0.0)
            largest = np.maximum(largest, (around.in_time(product) * over).max(axis=1))
            if by_radius:
                shares = around.shares(product) * over[..., None]
                worst = np.maximum(worst, shares.max(axis=1))
    return list(zip(largest.tolist(), worst, strict=True))


def _given(answer: Answer, problem: Problem) -> Rough:
    sources = problem.active_sources
    return Rough(answer.output, {k: answer.pressure[k, told(problem, k)] for k in sources})


def counted_outputs(problem: Problem) -> np.ndarray:
    """Which outputs are held to the tolerance, (o,) bool: wells at a rate, flows, probes."""
    counted = np.ones(problem.records.rows.shape[0], dtype=bool)
    flows = slice(problem.records.well_rows, problem.records.well_rows + problem.records.flow_rows)
    counted[flows] = problem.flows_count
    return counted


def build(terms: Terms, problem: Problem, members: list[Share], tolerance: float) -> Emulator:
    """The small model of a family, good for the members that are given within the tolerance.

    Raises `ModelError` where that takes too many vectors, `OutOfMemory`.

    Parameters
    ----------
    terms : parts of the family’s matrix
    problem : what is solved
    members : shares of the members
    tolerance : relative error
    """
    if np.count_nonzero(counted_outputs(problem)) > MOST_PORTS:
        raise ModelError(f"more than {MOST_PORTS} outputs are held to the tolerance")
    lag = problem.lag[problem.lag > 0.0]
    around = contour(lag)
    space = _Space(terms, problem, around)
    space.refer(members[0])
    steps = np.log(FASTEST / lag.min() * lag.max() / SLOWEST) / np.log(LADDER)
    poles = SLOWEST / lag.max() * LADDER ** np.arange(np.ceil(steps) + 1)
    near = np.abs(np.log(around.radius[:, None] / poles)) <= 0.5 * np.log(LADDER)
    space.add(members[0], poles, IMAGES)
    looks = _Looks(problem, members, around, tolerance)
    while True:
        model, enough = space.model(), (1.0 if space.judged else MARGIN) * tolerance
        at = looks.worst(model, enough)
        full = space.count > MOST_VECTORS or len(space.snapshots) > MOST_SNAPSHOTS
        if looks.error[at] <= enough or full:
            if space.judged:
                return model._replace(largest_error=np.asarray(looks.error[at]))
            space.judge()
        elif _reach(model, members[at]) < FAR and len(space.references) < MOST_REFERENCES:
            space.refer(members[at])
        else:
            needs = (near * looks.shares[at][:, None]).max(axis=0)
            space.add(members[at], poles[needs > WORTH * needs.max()], IMAGES)


# what flows and is stored by some vectors: at which unknowns, and how much (rows, k)
_Moved = tuple[tuple[Any, np.ndarray], tuple[Any, np.ndarray]]


class _Looks:
    """Errors of some members, looked at no oftener than the choice of the worst asks for.

    A space that grows makes errors smaller as a rule: a member whose error was less than that of
    another when it was last looked at needs no look, but before all are said to be good.
    """

    def __init__(
        self, problem: Problem, members: list[Share], around: Contour, tolerance: float
    ) -> None:
        self.problem, self.members, self.around = problem, members, around
        self.noise = 0.5 * MARGIN * tolerance  # an error that no vector helps
        self.error = np.full(len(members), np.inf)  # when each was last looked at
        self.shares = np.empty((len(members), len(around.radius)))  # of each radius in that

    def worst(self, model: Emulator, enough: float) -> int:
        """The member of the largest error; all were looked at where that is `enough`."""
        looked = np.zeros(len(self.members), dtype=bool)
        while True:
            at = int(np.argmax(self.error))
            if looked[at] and (self.error[at] > enough or looked.all()):
                return at
            order = np.argsort(np.where(looked, -1.0, self.error))[::-1]
            order = order[: np.count_nonzero(~looked)]
            some = order if looked[at] or np.isinf(self.error[at]) else order[:A_FEW]
            shares = [self.members[k] for k in some]
            found = emulated(model, self.problem, shares, self.around, by_radius=True)
            for k, one in zip(some, found, strict=True):
                self.error[k] = 0.0 if one.noise > self.noise else one.error
                self.shares[k] = one.worst
            looked[some] = True


class _Reference(NamedTuple):
    """Samples of a normal law at each radius of the contour, and what they see of the space."""

    share: Share
    samples: list[np.ndarray]  # (n, samples) each
    conductance: list[np.ndarray]  # (terms, radii, samples, vectors) of what was added each time
    storage: list[np.ndarray]
    ports: np.ndarray  # (terms, radii, samples, o)


class _Space:
    """A space that grows by snapshots; its first vectors are the wells that store nothing."""

    def __init__(self, terms: Terms, problem: Problem, around: Contour) -> None:
        system = terms.system
        self.terms, self.problem, self.around = terms, problem, around
        self.symbolic = analyse(system.n, system.edge_i, system.edge_j)
        ones, edge = np.ones(len(system.edge_i)), np.arange(len(system.edge_i))
        ends = (np.append(system.edge_i, system.edge_j), np.append(edge, edge))
        self.incidence = csr_array((np.append(ones, -ones), ends), shape=(system.n, len(edge)))
        count = len(terms.edge_g)
        self.acts = [np.flatnonzero(g) for g in terms.edge_g]
        self.nets = [self.incidence[:, on] for on in self.acts]
        pairs = zip(terms.edge_g, terms.fixed_g, strict=True)
        self.where = [_rows(edge, fixed, system) for edge, fixed in pairs]
        self.stores = [_most(c != 0.0) for c in terms.storage]
        self.wells = system.n - system.pores
        self.weight = system.storage  # of the inner product
        self.vectors = np.eye(system.n, self.wells, -system.pores)
        self.conductance = np.zeros((count, 0, 0))
        self.storage = np.zeros((count, 0, 0))
        self.references: list[_Reference] = []
        self.snapshots: list[tuple[Share, np.ndarray]] = []
        self.images: dict[tuple[bytes, float], int] = {}  # taken so far of a member at a pole
        self.judged = False  # whether samples were drawn after the last vector
        self.samples = SAMPLES_BEFORE  # that make up a norm so far
        self._draws = 0
        self._enter(self.vectors[:, :0])
        ones_on_pores = np.append(np.ones(system.pores), np.zeros(self.wells))
        self._append(ones_on_pores[:, None])

    @property
    def count(self) -> int:
        """Vectors so far."""
        found: int = self.vectors.shape[1]
        return found

    def factor(self, share: Share, shift: float) -> Factor:
        """The factor of G + s C of one member."""
        system = self.terms.at(share)
        return factorise(self.symbolic, system.edge_g, system.excess + shift * system.storage)

    def add(self, share: Share, poles: np.ndarray, images: int) -> None:
        """Take snapshots of one member; where it was there before, further images at the pole."""
        self.judged = False
        storage = share.storage @ self.terms.storage
        ports = np.tensordot(share.conductance, self.terms.ports, 1)
        ports = ports[:, counted_outputs(self.problem)]
        found = []
        for pole in poles.tolist():
            key = (share.conductance.tobytes(), pole)
            before = self.images.get(key, 0)
            self.images[key] = before + (images if before == 0 else 1)
            factor, image = self.factor(share, pole), ports
            for number in range(self.images[key]):
                image = solve(factor, image)
                if number >= before:
                    found.append(image)
                image = storage[:, None] * image
        self.snapshots.append((share, poles))
        self._append(np.concatenate(found, axis=1))

    def _append(self, found: np.ndarray) -> None:
        """Orthonormalise pressures (n, k) in the storage of the base, and take them in."""
        pores, first = self.terms.system.pores, self.count
        room = self.vectors
        foresee("the vectors of an emulator", 8.0 * len(found) * (first + found.shape[1]))
        for column in found.T:
            vector = np.append(column[:pores], np.zeros(self.wells))
            vector /= np.sqrt(vector @ (self.weight * vector))
            for _ in range(2):
                known = room[:, self.wells :]
                vector = vector - known @ (known.T @ (self.weight * vector))
            left = np.sqrt(vector @ (self.weight * vector))
            if left > NOTHING:
                room = np.column_stack([room, vector / left])
        fresh = room[:, first:]
        self.vectors = room
        self._enter(fresh)

    def _enter(self, fresh: np.ndarray) -> None:
        """Bring projections and what samples see up to date with the last vectors (n, k)."""
        first, every = self.count - fresh.shape[1], self.vectors
        sizes = (len(self.terms.edge_g), self.count, self.count)
        old_g, old_c = self.conductance, self.storage
        self.conductance, self.storage = np.zeros(sizes), np.zeros(sizes)
        known = old_g.shape[1]
        self.conductance[:, :known, :known], self.storage[:, :known, :known] = old_g, old_c
        fresh = every[:, known:] if known < first else fresh
        moved = [self._moved(term, fresh) for term in range(len(self.acts))]
        for t, parts in enumerate(moved):
            for whole, (rows, moves) in zip(
                (self.conductance[t], self.storage[t]), parts, strict=True
            ):
                part = every[rows].T @ moves
                whole[:, known:], whole[known:, :] = part, part.T
        for reference in self.references:
            self._see(reference, moved)

    def _see(self, reference: _Reference, moved: list[_Moved]) -> None:
        """What the samples of a reference see of what flows and is stored by some vectors."""
        seen: tuple[list[Any], list[Any]] = ([], [])
        for parts in moved:
            for into, (rows, moves) in zip(seen, parts, strict=True):
                into.append([z[rows].T @ moves for z in reference.samples])
        reference.conductance.append(np.array(seen[0]))
        reference.storage.append(np.array(seen[1]))

    def _moved(self, term: int, vectors: np.ndarray) -> _Moved:
        """What a term lets flow out of each unknown (m³/s) and has it store, at pressures (n, k).

        Each with the unknowns that it acts on.
        """
        on, system, rows = self.acts[term], self.terms.system, self.where[term]
        g = self.terms.edge_g[term][on, None]
        flow = self.nets[term] @ (g * (vectors[system.edge_i[on]] - vectors[system.edge_j[on]]))
        links = self.terms.fixed_g[term][:, None] * vectors[system.fixed_node]
        np.add.at(flow, system.fixed_node, links)
        holds = self.stores[term]
        return (rows, flow[rows]), (holds, self.terms.storage[term][holds, None] * vectors[holds])

    def refer(self, share: Share) -> None:
        """Draw samples by which residuals are measured, of the matrices of one member."""
        system = self.terms.at(share)
        size = 8.0 * system.n * self.samples * np.ceil(len(self.around.radius) / SHARED)
        foresee("the samples of an emulator", size)
        rng = np.random.default_rng(SEED + self._draws)
        self._draws += 1
        links = csr_array(
            (np.ones(len(system.fixed_node)), (system.fixed_node, np.arange(len(system.fixed_g)))),
            shape=(system.n, len(system.fixed_g)),
        )
        edges = rng.standard_normal((len(system.edge_g), self.samples))
        outer = rng.standard_normal((len(system.fixed_g), self.samples))
        stores = rng.standard_normal((system.n, self.samples)) * np.sqrt(system.storage)[:, None]
        flows = self.incidence @ (np.sqrt(system.edge_g)[:, None] * edges)
        flows += links @ (np.sqrt(system.fixed_g)[:, None] * outer)
        # samples of one radius need not be independent of those of another
        samples = [
            solve(self.factor(share, radius), flows + np.sqrt(radius) * stores)
            for radius in self.around.radius[::SHARED].tolist()
        ]
        ports = np.array([[z.T @ rows for z in samples] for rows in self.terms.ports])
        reference = _Reference(share, samples, [], [], ports)
        self.references.append(reference)
        every = range(len(self.acts))
        self._see(reference, [self._moved(term, self.vectors) for term in every])

    def judge(self) -> None:
        """Draw all samples anew, of which the space knows nothing."""
        drawn = [one.share for one in self.references]
        self.references.clear()
        self.samples = SAMPLES
        for share in drawn:
            self.refer(share)
        self.judged = True

    def model(self) -> Emulator:
        """The small model of the space as it is."""
        terms, referred = self.terms, self.references
        members = [share for share, _ in self.snapshots]
        return Emulator(
            wells=np.asarray(self.wells),
            conductance=self.conductance,
            storage=self.storage,
            stored=terms.storage @ self.vectors,
            sealed=np.asarray(float(len(terms.system.fixed_node) == 0)),
            highest=np.abs(self.vectors).max(axis=0),
            ports=np.array([self.vectors.T @ rows for rows in terms.ports]),
            direct=terms.direct,
            counted=counted_outputs(self.problem),
            reference_conductance=np.array([one.share.conductance for one in referred]),
            reference_storage=np.array([one.share.storage for one in referred]),
            seen_conductance=np.array([np.concatenate(r.conductance, 3) for r in referred]),
            seen_storage=np.array([np.concatenate(r.storage, 3) for r in referred]),
            seen_ports=np.array([one.ports for one in referred]),
            snapshot_conductance=np.array([share.conductance for share in members]),
            snapshot_storage=np.array([share.storage for share in members]),
            poles=_ragged([poles for _, poles in self.snapshots]),
            snapshots=np.asarray(len({share.conductance.tobytes() for share in members})),
            branch_class=np.empty(0, dtype=np.int64),
            branch_aperture=np.empty(0),
            usable=np.asarray(1.0),
            reason=np.asarray(""),
            largest_error=np.asarray(np.inf),
        )


def _rows(edge_g: np.ndarray, fixed_g: np.ndarray, system: System) -> np.ndarray | slice:
    """The unknowns between which a term lets something flow; all of them where they are many."""
    on = edge_g != 0.0
    ends = (system.edge_i[on], system.edge_j[on], system.fixed_node[fixed_g != 0.0])
    touched = np.zeros(system.n, dtype=bool)
    touched[np.concatenate(ends)] = True
    return _most(touched)


def _most(acts: np.ndarray) -> np.ndarray | slice:
    """Which of the unknowns (n,) bool; a slice of all where most of them are."""
    rows = np.flatnonzero(acts)
    return rows if len(rows) < 0.5 * len(acts) else slice(None)


def _ragged(rows: list[np.ndarray]) -> np.ndarray:
    """Rows of different lengths side by side, filled up with zeros."""
    width = max((len(row) for row in rows), default=0)
    return np.array([np.append(row, np.zeros(width - len(row))) for row in rows])
