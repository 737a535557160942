"""Flow equations that differ in how wide fractures are: each a sum of the same few terms.

A trace has nodes and branches of its own, so that the graph does not know how wide it is. With
T = w³ / (12 μ) along it and w times its length stored in it, the matrices of all such cases are

    G(T) = G₀ + Σ T_f L_f,    C(w) = C₀ + Σ w_f D_f,

L_f and D_f positive and of the nodes of traces alone; so are the links to what keeps its pressure.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from demflow.model.flow.equation.problem import Problem
from demflow.model.flow.equation.system import System

# Part of a number that is round-off where terms are told apart and put together again.
ROUND_OFF = 1e-10


class Share(NamedTuple):
    """How wide fractures are, beside those that terms were told by; 1 in front for the rock."""

    conductance: np.ndarray  # (terms,) of L_f, w³ over the same of the base
    storage: np.ndarray  # (terms,) of D_f, w over that of the base


class Terms(NamedTuple):
    """The terms of a family of flow equations on one graph; the rock's stands first."""

    system: System  # the base: all shares are one
    edge_g: np.ndarray  # (terms, e) m³/(s Pa)
    storage: np.ndarray  # (terms, n) m³/Pa
    fixed_g: np.ndarray  # (terms, f) m³/(s Pa)
    ports: np.ndarray  # (terms, n, o) the rows of the recorded outputs
    direct: np.ndarray  # (terms, sources, o) what a unit source adds to outputs by itself

    def at(self, share: Share) -> System:
        """The flow equation of one case."""
        return self.system._replace(
            edge_g=share.conductance @ self.edge_g,
            storage=share.storage @ self.storage,
            fixed_g=share.conductance @ self.fixed_g,
        )


def terms_of(base: Problem, changed: Callable[[int], Problem], count: int) -> Terms | None:
    """The terms of a family, from what the equation becomes as one class after the other grows.

    `changed(k)` is the problem in which the fractures of class k, from 1 to `count`, conduct and
    store twice as much. None where what is left of the rock is negative, or the graph another one:
    then the family is none.

    Parameters
    ----------
    base : problem of the first member
    changed : problem of another by its number
    count : members
    """
    one = [changed(k) for k in range(1, count + 1)]
    if not all(_alike(base, other) for other in one):
        return None
    found = []
    for part in (_edges, _storage, _fixed, _ports, _direct):
        whole = part(base)
        grown = [part(other) - whole for other in one]
        rock = whole - sum(grown)
        noise = ROUND_OFF * np.abs(whole)
        found.append(np.array([np.where(np.abs(rock) > noise, rock, 0.0), *grown]))
    if any(np.any(positive < 0.0) for positive in found[:3]):
        return None
    return Terms(base.system, *found)


def _edges(problem: Problem) -> np.ndarray:
    return problem.system.edge_g


def _storage(problem: Problem) -> np.ndarray:
    return problem.system.storage


def _fixed(problem: Problem) -> np.ndarray:
    return problem.system.fixed_g


def _ports(problem: Problem) -> np.ndarray:
    return np.asarray(problem.records.rows.toarray().T)


def _direct(problem: Problem) -> np.ndarray:
    return problem.records.direct


def _alike(one: Problem, other: Problem) -> bool:
    """Whether two problems have one graph, and the same sources and outputs."""
    a, b = one.system, other.system
    same = a.n == b.n and a.pores == b.pores
    names = ("edge_i", "edge_j", "fixed_node", "fixed_source", "well_node", "node_of_domain")
    return same and all(np.array_equal(getattr(a, name), getattr(b, name)) for name in names)
