"""Families of cases that differ in how wide their fractures are (stages *emulator*, *emulate*).

*emulator* makes one small model from some members of a family, *emulate* answers a block of them
with it and observes each; one that the model is not proven good for is solved by itself.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from demflow.model.controls import Controls
from demflow.model.families import Member
from demflow.model.flow.solvers.affine import Share, terms_of
from demflow.model.flow.solvers.contour import contour
from demflow.model.flow.solvers.emulator import Emulated, build, emulated
from demflow.model.flow.solvers.initial import none_at_all
from demflow.model.flow.solvers.registry import Choice, Posed, flow, pose, responses_of
from demflow.model.history import superposed
from demflow.model.members import Rock, check, stacked
from demflow.model.network.apertures import with_branches
from demflow.model.observe import flowed, observe, smallest_pore
from demflow.model.outcome import ModelError, OutOfMemory
from demflow.model.products import (
    Apertures,
    Emulator,
    Network,
    Packing,
    Permeability,
    Responses,
    StressState,
    Walk,
)
from demflow.model.quantities import FAILURE, checked
from demflow.model.region import Region
from demflow.model.scene import Fracture, Matrix, acting_lines
from demflow.model.threads import one_blas_thread

# Classes of branches that widen alike, each with terms of its own.
MOST_CLASSES = 6

# Part of an aperture by which branches of one class may differ: round-off.
ROUND_OFF = 1e-12

EMULATED = "emulated"  # the solver's name in results


def emulator(
    network: Network,
    walked: Walk,
    stress: StressState | None,
    calibrated: Permeability | None,
    *,
    region: Region,
    matrix: Matrix,
    viscosity: float,
    fractures: tuple[Any, ...],
    asked: dict[str, Any],
    members: tuple[tuple[Fracture, ...], ...],
) -> Emulator:
    """The small model of a family (the *emulator* stage).

    Parameters
    ----------
    network, walked, stress, calibrated : products that all of the family share.
    region, matrix, viscosity : parts of the scene.
    fractures : what the family's fractures have in common, see `model.families.alike`.
    asked : what of the flow is wanted, see `model.families.asked`.
    members : the fractures of those cases that the model is made of, the base first.

    Where the family has no such model, the product says why: apertures that are no few factors of
    one another, barriers whose worth goes with the aperture that they cut, too many outputs.
    """
    check(fractures, members)
    rock = Rock(network, walked, stress, calibrated, region, matrix, viscosity)
    try:
        widths = np.array(list(rock.widths(list(members))))
        number, shares = _classes(rock, members[0], widths)
        base = rock.opened(members[0])
        problem = _pose(rock, base, asked).problem
        terms = terms_of(
            problem,
            lambda k: _pose(rock, _doubled(base, number == k), asked).problem,
            int(number.max(initial=0)),
        )
        if terms is None:
            raise ModelError("its flow equations are no sums of the same few terms")
        with one_blas_thread():
            model = build(terms, problem, shares, asked["tolerance"])
    except (ModelError, OutOfMemory) as error:
        return _none(str(error))
    return model._replace(branch_class=number, branch_aperture=widths[0])


def emulate(
    packing: Packing,
    stress: StressState | None,
    network: Network,
    walked: Walk,
    calibrated: Permeability | None,
    model: Emulator,
    *,
    region: Region,
    matrix: Matrix,
    viscosity: float,
    fractures: tuple[Any, ...],
    asked: dict[str, Any],
    wanted: tuple[str, ...],
    members: tuple[Member, ...],
) -> dict[str, np.ndarray]:
    """What is observed of each of some members of a family, (members, …) (the *emulate* stage).

    Parameters are those of `emulator`, and `wanted`, what is observed. Under the names of
    `model.quantities.CASE`; beside them `failure`, words for those that have no result.

    Parameters
    ----------
    packing : grains at rest under the packing pressure
    stress : the stress on the rock, or None
    network : pores and pipes of the matrix
    walked : where traces lie in the network
    calibrated : permeability of the unstressed network, or None
    model : reduced model of a family of cases
    region : where the case lies, m
    matrix : pipes of the rock, or None
    viscosity : of the fluid, Pa s
    fractures : the fractures of the scene
    asked : what the flow stage is asked for
    wanted : names of what is observed
    members : cases of the family
    """
    every = [one.fractures for one in members]
    check(fractures, tuple(every))
    rock = Rock(network, walked, stress, calibrated, region, matrix, viscosity)
    family = _Family(rock, model, every[0], asked)
    state = observe(
        *(packing, stress, None, network, family.base, None, None, None, None),
        region=region,
        controls=members[0].controls,
        wanted=wanted,
    )
    found: list[dict[str, np.ndarray]] = [{} for _ in members]
    with one_blas_thread():
        for numbers, answer in family.answers(every):
            for k in numbers:
                found[k] = _seen(answer, members[k].controls, network, model, wanted)
    return stacked(
        [one if FAILURE in one else {**state, **one, FAILURE: np.asarray("")} for one in found]
    )


class _Answer(NamedTuple):
    """What answers some members."""

    apertures: Apertures
    responses: Responses


def _seen(
    answer: _Answer | Exception,
    controls: Controls,
    network: Network,
    model: Emulator,
    wanted: tuple[str, ...],
) -> dict[str, np.ndarray]:
    """What is observed of a member's flow, or words where it has none."""
    if isinstance(answer, Exception):
        return {FAILURE: np.asarray(str(answer))}
    seen = {"smallest_pore": smallest_pore(answer.apertures, network.inside)}
    if str(answer.responses.solver) == EMULATED:
        seen["emulator_snapshots"] = model.snapshots
    try:
        seen |= flowed(superposed(answer.responses, controls), None, controls, wanted)
        checked(seen)
    except (ModelError, OutOfMemory) as error:
        return {FAILURE: np.asarray(str(error))}
    return {name: np.asarray(value) for name, value in seen.items()}


class _Family:
    """Answers members of a family, by the small model where that is proven good."""

    def __init__(
        self, rock: Rock, model: Emulator, fractures: tuple[Fracture, ...], asked: dict[str, Any]
    ) -> None:
        self.rock, self.model, self.asked = rock, model, asked
        self.base = rock.opened(fractures)
        self.posed = _pose(rock, self.base, asked)
        self.start = none_at_all(self.posed.problem)

    def answers(
        self, members: list[tuple[Fracture, ...]]
    ) -> Iterator[tuple[list[int], _Answer | Exception]]:
        """What answers members whose branches are equally wide, and which these are."""
        widths = list(self.rock.widths(members))
        alike: dict[bytes, list[int]] = {}
        for k, width in enumerate(widths):
            alike.setdefault(width.tobytes(), []).append(k)
        shares = [self._share(widths[numbers[0]]) for numbers in alike.values()]
        lag = self.posed.problem.lag
        by_model = emulated(
            self.model,
            self.posed.problem,
            [share for share in shares if share is not None],
            contour(lag[lag > 0.0]),
        )
        for numbers, share in zip(alike.values(), shares, strict=True):
            found = None if share is None else next(by_model)
            try:
                first = numbers[0]
                yield numbers, self._answer(members[first], widths[first], found)
            except (ModelError, OutOfMemory) as error:
                yield numbers, error

    def _share(self, width: np.ndarray) -> Share | None:
        """Shares of a member whose branches have apertures (e,) m; None where it has none."""
        if not self.model.usable:
            return None
        return share_of(self.model.branch_class, width / self.model.branch_aperture)

    def _answer(
        self, fractures: tuple[Fracture, ...], width: np.ndarray, found: Emulated | None
    ) -> _Answer:
        """By the small model; by itself where the error of that is beyond the tolerance."""
        if found is None:
            reason = str(self.model.reason) or "its apertures are no factors of the family's"
            return self._alone(fractures, reason)
        if not found.error <= self.asked["tolerance"]:
            return self._alone(fractures, f"the bound of its error is {found.error:.2g}")
        vectors = self.model.conductance.shape[1]
        reason = (
            f"one model of {vectors} vectors from {int(self.model.snapshots)} cases answers the "
            f"family, each with an error of proven bound"
        )
        choice = Choice(EMULATED, reason, self.posed.problem)
        opened = with_branches(self.base, self.rock.walked, width, self.rock.viscosity)
        return _Answer(opened, responses_of(self.posed, found.answer, self.start, 1.0, choice))

    def _alone(self, fractures: tuple[Fracture, ...], why: str) -> _Answer:
        """By itself, as if there were no family."""
        opened = self.rock.opened(fractures)
        alone = flow(
            self.rock.network,
            opened,
            region=self.rock.region,
            method="auto",
            safety_factor=1.0,
            record_map=False,
            **self.asked,
        )
        reason = f"{alone.solver_reason}; not emulated: {why}"
        return _Answer(opened, alone._replace(solver_reason=np.asarray(reason)))


def _pose(rock: Rock, apertures: Apertures, asked: dict[str, Any]) -> Posed:
    return pose(rock.network, apertures, region=rock.region, **asked)


def _classes(
    rock: Rock, fractures: tuple[Fracture, ...], widths: np.ndarray
) -> tuple[np.ndarray, list[Share]]:
    """Class of each branch, (e,) 0 of those that stay, and the shares of each member.

    Branches whose apertures (members, e) m are those of the first member times the same factors
    are one class. Raises ModelError where they are too many, or a barrier's worth goes with them.
    """
    walked = rock.walked
    resists = np.array(
        [
            (fractures[k].resistance_at(rock.viscosity) or 0.0) > 0.0
            for k in _of_line(rock, fractures)
        ]
    )
    if np.any(resists[walked.cut_line]):
        raise ModelError("barriers across its fractures are worth what the aperture makes of them")
    factor = widths / widths[0]
    digits = np.round(np.log(factor), 10)
    _, first, number = np.unique(digits, axis=1, return_index=True, return_inverse=True)
    stays = np.all(digits[:, first] == 0.0, axis=0)
    rank = np.cumsum(~stays) * ~stays
    if rank.max(initial=0) > MOST_CLASSES:
        raise ModelError(
            f"its apertures go {rank.max()} ways, more than {MOST_CLASSES}: as if drawn anew"
        )
    number = rank[number.ravel()]
    found = [share_of(number, one) for one in factor]
    shares = [one for one in found if one is not None]
    if len(shares) < len(found) or not shares:
        raise ModelError("its apertures are no few factors of one another")
    return number, shares


def _of_line(rock: Rock, fractures: tuple[Fracture, ...]) -> list[int]:
    return [line.fracture for line in acting_lines(fractures, rock.region)]


def share_of(number: np.ndarray, factor: np.ndarray) -> Share | None:
    """Shares from the class of each branch and its aperture over the base's, (e,).

    None where branches of one class differ in it.
    """
    each = np.ones(int(number.max(initial=0)) + 1)
    each[number] = factor
    each[0] = 1.0
    if np.any(np.abs(factor - each[number]) > ROUND_OFF * each.max()):
        return None
    return Share(each**3, each)


def _doubled(base: Apertures, grows: np.ndarray) -> Apertures:
    """The base with twice the conductance and storage in some branches, (e,) bool."""
    half = np.where(grows, 0.5 * base.branch_aperture * base.branch_length, 0.0)
    nodes = len(base.node_x)
    added = np.bincount(base.branch_a, half, nodes) + np.bincount(base.branch_b, half, nodes)
    return base._replace(
        branch_conductance=np.where(grows, 2.0, 1.0) * base.branch_conductance,
        node_volume=base.node_volume + added,
    )


def _none(why: str) -> Emulator:
    """No model, and why."""
    empty = {name: np.zeros(0) for name in Emulator._fields}
    return Emulator(
        **{
            **empty,
            "usable": np.asarray(0.0),
            "reason": np.asarray(why),
            "snapshots": np.asarray(0),
            "largest_error": np.asarray(np.inf),
        }
    )
