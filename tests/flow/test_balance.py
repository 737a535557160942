"""Steady flow at any contrast: every pressure, flow and pore against rational arithmetic."""

from fractions import Fraction

import numpy as np
import pytest

from demflow.model.flow.equation import balance as balance_module
from demflow.model.flow.equation.balance import steady_flow, transient_misfit
from demflow.model.flow.equation.system import System
from demflow.model.flow.linear.factor import analyse, factorise, solve
from demflow.model.flow.solvers import implicit as implicit_module
from demflow.model.flow.solvers import subspace as subspace_module
from demflow.model.network.apertures import open_pipes
from demflow.model.network.domains import network
from demflow.model.network.fractures.walk import walk
from demflow.model.region import Rectangle
from demflow.model.scene import Matrix, Trace, Well, flow_lines
from tests.flow.test_factor import eliminate, random_graph
from tests.reservoirs import Reservoir
from tests.rocks import random_graph as random_rock

pytestmark = pytest.mark.slow


def system_of(n, i, j, g, node, source, fixed_g) -> System:
    """Pores between two fixed pressures; the last unknown is a well at a rate."""
    none = np.empty(0, dtype=np.int64)
    return System(
        domain=np.arange(n - 1),
        n=n,
        storage=np.append(np.ones(n - 1), 0.0),
        edge_i=i,
        edge_j=j,
        edge_g=g,
        fixed_node=node,
        fixed_source=source,
        fixed_g=fixed_g,
        short_a=none,
        short_b=none,
        short_g=np.empty(0),
        sides=("left", "right"),
        pressure_wells=(),
        rate_wells=(0,),
        well_node=np.array([n - 1]),
        node_of_domain=np.arange(n - 1),
        source_of_domain=np.full(n - 1, -1),
        isolated=0,
        initial=np.empty((0, n)),
    )


def random_system(seed, strong=1e12, n=30) -> System:
    """A connected graph, a part of its edges far stronger than the others."""
    rng = np.random.default_rng(seed)
    i, j = random_graph(rng, n, n)
    g = rng.uniform(0.5, 2, len(i)) * np.where(rng.random(len(i)) < 0.5, strong, 1.0)
    node = rng.choice(n - 1, 6, replace=False)
    return system_of(n, i, j, g, node, np.array([0, 0, 0, 1, 1, 1]), rng.uniform(0.5, 2, 6))


def exact_pressure(system: System, source: int) -> list[Fraction]:
    """All unknowns for a unit of the source, in fractions."""
    n = system.n
    matrix = [[Fraction(0)] * n for _ in range(n)]
    rhs = [Fraction(0)] * n
    for a, b, g in zip(
        system.edge_i.tolist(), system.edge_j.tolist(), system.edge_g.tolist(), strict=True
    ):
        for one, other in ((a, b), (b, a)):
            matrix[one][one] += Fraction(g)
            matrix[one][other] -= Fraction(g)
    for a, k, g in zip(
        system.fixed_node.tolist(),
        system.fixed_source.tolist(),
        system.fixed_g.tolist(),
        strict=True,
    ):
        matrix[a][a] += Fraction(g)
        rhs[a] += Fraction(g) * (k == source)
    if source == 2:
        rhs[n - 1] = Fraction(-1)
    return eliminate(matrix, rhs)


@pytest.mark.parametrize("source", [0, 1, 2])
@pytest.mark.parametrize("strong", [1.0, 1e-12, 1e6, 1e12, 1e15])
def test_every_pressure_and_flow_is_right(strong, source):
    for seed in range(3):
        system = random_system(seed, strong)
        factor = factorise(
            analyse(system.n, system.edge_i, system.edge_j), system.edge_g, system.excess
        )
        found = steady_flow(system, factor, source)
        exact = exact_pressure(system, source)
        pressure = np.array([float(p) for p in exact])
        np.testing.assert_allclose(found.pressure, pressure, rtol=1e-14)
        edge = [
            float(Fraction(g) * (exact[a] - exact[b]))
            for a, b, g in zip(
                system.edge_i.tolist(), system.edge_j.tolist(), system.edge_g.tolist(), strict=True
            )
        ]
        inflow = np.zeros(2)
        for a, k, g in zip(
            system.fixed_node.tolist(),
            system.fixed_source.tolist(),
            system.fixed_g.tolist(),
            strict=True,
        ):
            inflow[k] += float(Fraction(g) * ((k == source) - exact[a]))
        whole = np.abs(inflow).max()
        np.testing.assert_allclose(found.edge, edge, rtol=1e-11, atol=1e-15 * whole)
        np.testing.assert_allclose(found.inflow(system, source), inflow, rtol=1e-13)
        assert found.imbalance < 1e-12


def test_like_conductances_need_no_refinement():
    system = random_system(1, strong=1.0)
    factor = factorise(
        analyse(system.n, system.edge_i, system.edge_j), system.edge_g, system.excess
    )
    assert steady_flow(system, factor, 0).refinements == 0


def test_a_pressure_without_a_sink_moves_nothing():
    """One fixed pressure alone: the pores take it, and nothing flows."""
    system = random_system(2)._replace(fixed_source=np.zeros(6, dtype=np.int64))
    factor = factorise(
        analyse(system.n, system.edge_i, system.edge_j), system.edge_g, system.excess
    )
    found = steady_flow(system, factor, 0)
    np.testing.assert_allclose(found.pressure, 1.0, rtol=1e-15)
    assert abs(found.inflow(system, 0)[0]) < 1e-15
    assert found.imbalance < 1e-9


def cut_rock(kind: str, contrast: float) -> Reservoir:
    """Random pores with a fracture or a barrier across them."""
    region = Rectangle(2.0, 2.0)
    line = {"name": kind, "start": (-0.7, -0.4), "end": (0.6, 0.7)}
    if kind == "fracture":
        fracture = Trace(**line, aperture=1e-5 * contrast ** (1 / 3))
    else:
        fracture = Trace(**line, transmissibility_multiplier=1 / contrast)
    packing = random_rock(1.1, 900, 4)
    net = network(packing, region=region)
    walked = walk(net, region=region, lines=flow_lines((fracture,), region))
    opened = open_pipes(
        net,
        walked,
        None,
        None,
        region=region,
        matrix=Matrix(aperture=1e-5),
        fractures=(fracture,),
        viscosity=1e-3,
    )
    return Reservoir(region, net, opened, 1e9)


CUT = {
    (kind, contrast): cut_rock(kind, contrast)
    for kind in ("fracture", "barrier")
    for contrast in (1e9, 1e12, 1e14)
}
WELL = (Well(name="well", at=(0.0, 0.02), radius=0.1, rate=1e-6),)
SIDES = (("left", 2e6), ("right", 1e6), ("top", 1.5e6))


@pytest.mark.parametrize("rock", CUT.values(), ids=map(str, CUT))
def test_a_rock_balances_at_any_contrast(rock):
    """As a user sees it: flows of the boundaries and of the well, balance and residual."""
    seen = rock.observed(WELL, SIDES, method="steady")
    assert seen["mass_balance_error"] < 1e-14
    assert seen["residual"] < 1e-12


@pytest.mark.parametrize("rock", CUT.values(), ids=map(str, CUT))
@pytest.mark.parametrize("method", ["krylov", "implicit"])
def test_a_transient_balances_at_any_contrast(rock, method):
    """In every pore, though pressures along the fracture agree in all of their digits."""
    times = tuple(np.geomspace(1.0, 1e8, 9))
    seen = rock.observed(WELL, SIDES, 1e6, times, method=method, tolerance=1e-5)
    assert seen["mass_balance_error"] < 1e-13
    at_rest = rock.observed(WELL, SIDES, method="steady")["boundary_flow"]
    np.testing.assert_allclose(seen["boundary_flow"][:, -1], at_rest, rtol=1e-8)
    assert seen["residual"] < (1e-7 if method == "krylov" else 1e-13)


def noisy(share: float):
    """A substitution whose every result is off by about this share."""
    rng = np.random.default_rng(1)

    def substitute(factor, rhs):
        x = solve(factor, rhs)
        return x * (1.0 + share * rng.standard_normal(x.shape))

    return substitute


def nothing(factor, rhs):
    return np.zeros_like(rhs)


@pytest.mark.parametrize("broken", [nothing, noisy(0.3), noisy(1.0)])
def test_a_broken_factor_shows_in_the_residual_of_a_steady_state(broken, monkeypatch):
    """What is drained along the tree balances, whatever the pressures are."""
    rock = CUT["fracture", 1e12]
    good = rock.observed(WELL, SIDES, method="steady")
    monkeypatch.setattr(balance_module, "solve", broken)
    seen = rock.observed(WELL, SIDES, method="steady")
    assert abs(seen["well_pressure"][0] / good["well_pressure"][0] - 1.0) > 1e-3
    assert seen["residual"] > 0.1


@pytest.mark.parametrize(("method", "share"), [("krylov", 0.3), ("implicit", 1e-5)])
def test_a_noisy_factor_shows_in_the_residual_of_a_transient(method, share, monkeypatch):
    """Though the volume balances: each solution is brought back to it."""
    for module in (balance_module, subspace_module):
        monkeypatch.setattr(module, "solve", noisy(share))
    exact, rng = implicit_module.Ladder.factor, np.random.default_rng(2)

    def off(ladder, rung):  # otherwise at every step
        factor = exact(ladder, rung)
        noise = 1.0 + share * rng.standard_normal(factor.pivot.shape)
        return factor._replace(pivot=factor.pivot * noise)

    monkeypatch.setattr(implicit_module.Ladder, "factor", off)
    times = (1.0, 10.0, 100.0)
    seen = CUT["fracture", 1e12].observed(WELL, (), 1e6, times, method=method, tolerance=1e-2)
    assert seen["mass_balance_error"] < 1e-12
    assert seen["residual"] > share


def test_the_misfit_of_a_transient_is_that_of_its_pressure():
    """Relative, whatever the contrast; and none where the pressure is right."""
    system = random_system(3, strong=1e12)
    shift = 0.1
    symbolic = analyse(system.n, system.edge_i, system.edge_j)
    factor = factorise(symbolic, system.edge_g, system.excess + shift * system.storage)
    rng = np.random.default_rng(0)
    pressure = solve(factor, system.source(2))  # (G + s C) p = f: the rate is s p
    assert transient_misfit(system, factor, shift, 2, pressure, shift * pressure) < 1e-14
    for off in (1e-3, 1e-9):
        moved = pressure * (1.0 + off * rng.uniform(-1.0, 1.0, system.n))
        found = transient_misfit(system, factor, shift, 2, moved, shift * pressure)
        assert 0.1 * off < found < 10 * off
    gone = transient_misfit(system, factor, shift, 2, 0.0 * pressure, shift * pressure)
    assert gone > 0.1
