"""A linear poroelastic rock: Biot's theory without a fitted number, and solvers that agree."""

import math

import numpy as np
import pytest
from scipy import linalg

from demflow.model.analytic.mandel import mandel_pressure, roots, slab
from demflow.model.analytic.terzaghi import consolidation_degree
from demflow.model.coupling.frame import frame_of
from demflow.model.coupling.krylov import Factors, course
from demflow.model.coupling.march import march
from demflow.model.outcome import ModelError
from tests.coupling_rocks import (
    APERTURE,
    CEMENT,
    FLUID,
    VISCOSITY,
    random_packing,
    specimen_of,
    square_packing,
)


def of_load(specimen, wall, length, lag, tolerance=1e-6, solver=course, **more):
    """Course of 1 Pa on a wall."""
    source = specimen.rock.unit_load(wall, length)
    nothing = np.zeros(len(specimen.record.kind))
    factors = Factors(specimen.rock)
    return solver(factors, specimen.record, source, nothing, lag, tolerance, **more)


@pytest.mark.parametrize(
    "packed", [lambda: square_packing(10), lambda: random_packing(3)], ids=["square", "random"]
)
@pytest.mark.parametrize("fluid", [3e7, FLUID, 1e12])
def test_sealed_and_equilibrated_it_has_skemptons_pressure_and_the_undrained_strain(packed, fluid):
    specimen = specimen_of(packed(), fluid=fluid)
    width, height = specimen.width, specimen.height
    # of drained ways of the walls alone: volume given up by 1 Pa on top, and by 1 Pa all around
    top = specimen.drained("top", width)
    all_around = top + specimen.drained("right", height)
    given_up, compliance = (-(w[1] * height + w[3] * width) for w in (top, all_around))
    storage = float(specimen.network.volume.sum()) / fluid
    skempton = given_up / (compliance + storage)
    last = np.array([1e4, 1e5])
    found = of_load(specimen, "top", width, last, 1e-10)
    flow_outputs = specimen.record.flow_outputs
    assert found.output[-1, :flow_outputs] == pytest.approx(skempton, rel=1e-8)
    undrained = top - skempton * all_around
    assert found.output[-1, flow_outputs : flow_outputs + 4] == pytest.approx(undrained, rel=1e-8)
    # what the contacts bear is what the fluid leaves
    stress = found.output[-1, flow_outputs + 4 : flow_outputs + 6]
    assert stress == pytest.approx([-skempton, 1.0 - skempton], rel=1e-7)


@pytest.mark.slow
def test_solvers_agree_with_the_dense_eigen_solution():
    specimen = specimen_of(random_packing(), sides=("top",), held=("right",))
    rock, record = specimen.rock, specimen.record
    source = rock.unit_load("top", specimen.width)
    moves = np.linalg.solve(rock.frame.stiffness.toarray(), rock.squeeze.toarray())
    stores = np.diag(rock.storage) + rock.squeeze.T @ moves
    rate, mode = linalg.eigh(rock.conductance.toarray(), 0.5 * (stores + stores.T))
    lag = np.geomspace(1e-4, 0.1, 16)
    start = mode.T @ rock.jump(source)
    left = np.exp(-np.outer(rate, lag)) * start[:, None]
    pressure, change = (mode @ left).T, (mode @ (-rate[:, None] * left)).T
    exact = pressure @ record.pressure.T + (pressure @ moves.T) @ record.place.T
    exact += (change @ moves.T) @ record.speed.T + record.place @ rock.frame.moved(source.force)
    size = np.abs(exact).max(axis=0)
    size[size == 0.0] = np.inf  # walls that stand

    def error(found):
        return float(np.max(np.abs(found.output - exact).max(axis=0) / size))

    nothing = np.zeros(len(record.kind))
    for tolerance in (1e-4, 1e-7):
        found = course(Factors(rock), record, source, nothing, lag, tolerance, field=True)
        assert found.error <= tolerance
        assert error(found) <= tolerance
        maps = found.pressure / rock.modulus
        assert np.abs(maps - pressure).max() <= 10.0 * tolerance * np.abs(pressure).max()
    # the march is of second order: a local error 30 times smaller, a global one ten times
    errors = [error(march(Factors(rock), record, source, nothing, lag, t)) for t in (3e-4, 1e-5)]
    assert errors[1] < 1e-3
    order = 3.0 * math.log(errors[0] / errors[1]) / math.log(30.0)
    assert 1.6 < order < 2.6


def test_terzaghi_on_a_square_lattice_is_met_to_second_order():
    errors = []
    for rows in (30, 60):
        specimen = specimen_of(square_packing(rows), sides=("top",), held=("right",))
        height, width = specimen.height, specimen.width
        ways = specimen.drained("top", width)
        modulus = -height / ways[3]
        mobility = APERTURE**3 / (24.0 * 0.01) / VISCOSITY
        storage = specimen.storage / (width * height)
        diffusivity = mobility / (storage + 1.0 / modulus)
        T_v = np.array([0.05, 0.1, 0.2, 0.5, 1.0])
        found = of_load(specimen, "top", width, T_v * height**2 / diffusivity)
        way = found.output[:, specimen.record.flow_outputs + 3]
        undrained = ways[3] * (1.0 - 1.0 / (1.0 + storage * modulus))
        degree = (way - undrained) / (ways[3] - undrained)
        errors.append(np.abs(degree / consolidation_degree(T_v) - 1.0).max())
    assert errors[0] < 3e-3
    assert math.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)


def test_mandels_pressure_rises_before_it_falls():
    columns = 60
    specimen = specimen_of(square_packing(6, columns), sides=("left", "right"))
    width, height = specimen.width, specimen.height
    mobility = APERTURE**3 / (24.0 * 0.01) / VISCOSITY
    rock = slab(specimen.moduli(), specimen.storage / (width * height), mobility)
    half = 0.5 * width
    t_D = np.array([0.02, 0.05, 0.1, 0.3, 1.0])
    found = of_load(specimen, "top", width, t_D * half**2 / rock.diffusivity)
    probe = specimen.record.flow_outputs - 1
    middle = found.output[:, probe] / rock.pressure
    # the probe lies in a pore beside or in the middle
    exact = mandel_pressure(0.0, t_D, rock.ratio)
    assert middle == pytest.approx(exact, rel=2e-3)
    assert middle.max() > 1.02


def test_mandels_roots_and_start():
    for ratio in (1.01, 2.0, 50.0):
        alpha = roots(ratio, 20)
        assert np.all(np.diff(alpha) > 0.0)
        assert np.tan(alpha) == pytest.approx(ratio * alpha, rel=1e-6)
    assert mandel_pressure([0.0, 0.5, 0.9], 1e-5, 3.0) == pytest.approx(1.0, abs=0.02)
    # of an isotropic rock: 1 + s/r = (1 − ν)/(ν_u − ν), p0/σ = B (1 + ν_u)/3, plane strain
    shear, poisson, undrained = 1.0, 0.2, 0.4
    lame = 2.0 * shear * poisson / (1.0 - 2.0 * poisson)
    moduli = [[lame + 2.0 * shear, lame], [lame, lame + 2.0 * shear]]
    bulk = lame + 2.0 * shear / 3.0
    bulk_u = 2.0 * shear * (1.0 + undrained) / (3.0 * (1.0 - 2.0 * undrained))
    found = slab(moduli, 1.0 / (bulk_u - bulk), 1.0)  # with Biot's coefficient 1
    assert found.ratio == pytest.approx((1.0 - poisson) / (undrained - poisson), rel=1e-12)
    skempton = 1.0 - bulk / bulk_u
    assert found.pressure == pytest.approx(skempton * (1.0 + undrained) / 3.0, rel=1e-12)


@pytest.mark.slow
def test_volumes_balance_to_round_off_and_come_out_of_the_settlement():
    specimen = specimen_of(random_packing(), sides=("top", "left"), held=("right",))
    lag = np.geomspace(1e-4, 1e2, 13)
    found = of_load(specimen, "top", specimen.width, lag, 1e-4)
    let_in, stored = found.cumulative[:, :2].sum(axis=1), found.cumulative[:, 2]
    assert np.abs(let_in - stored).max() <= 1e-12 * np.abs(stored).max()
    way = found.output[-1, specimen.record.flow_outputs + 3]
    assert stored[-1] == pytest.approx(way * specimen.width, rel=1e-8)
    unit = specimen.rock.unit_pressure(0)
    own = Factors(specimen.rock)
    given = course(own, specimen.record, unit, specimen.record.direct[0], lag, 1e-4)
    let_in, stored = given.cumulative[:, :2].sum(axis=1), given.cumulative[:, 2]
    moved = np.abs(given.cumulative).max()
    assert np.abs(let_in - stored).max() <= 1e-12 * moved


@pytest.mark.slow
def test_pressure_and_settlement_are_reciprocal():
    """∫ p dt of the drained side's flow by a load is the work of its pressure on the wall."""
    specimen = specimen_of(random_packing(2), sides=("top",), held=("right",))
    lag = np.geomspace(1e-4, 1e1, 9)
    by_load = of_load(specimen, "top", specimen.width, lag, 1e-9)
    nothing = specimen.record.direct[0]
    unit = specimen.rock.unit_pressure(0)
    by_pressure = course(Factors(specimen.rock), specimen.record, unit, nothing, lag, 1e-9)
    way = by_pressure.output[:, specimen.record.flow_outputs + 3]
    # Maxwell and Betti: 1 Pa at the side lifts the wall as much as 1 Pa on the wall lets out
    assert way * specimen.width == pytest.approx(-by_load.cumulative[:, 0], rel=1e-6)


def test_nothing_moves_where_nothing_acts_and_loose_rocks_are_refused():
    specimen = specimen_of(square_packing(6), held=("right", "top"))
    lag = np.array([1.0, 2.0])
    for solver in (course, march):
        found = of_load(specimen, "top", specimen.width, lag, solver=solver)
        assert not found.output.any()
        assert not found.cumulative.any()
    packing = square_packing(6)
    far = packing._replace(box=packing.box + np.array([-1.0, 1.0, -1.0, 1.0]))
    with pytest.raises(ModelError, match="no grain bears load"):
        frame_of(far, stiffness_ratio=2.5, friction=0.5, bonds=CEMENT)
