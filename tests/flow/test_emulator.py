"""One small model of a family: what it meets, from which side, and how far off it can be."""

import dataclasses
import functools
import itertools
import math

import numpy as np
import pytest

from demflow.model.controls import Controls, sites
from demflow.model.emulation import emulate, emulator, share_of
from demflow.model.families import Member, alike
from demflow.model.flow.equation.outputs import outputs
from demflow.model.flow.solvers.affine import Share
from demflow.model.flow.solvers.contour import contour, radii
from demflow.model.flow.solvers.emulator import CAUTION, projected, residuals, round_off, transfer
from demflow.model.flow.solvers.registry import pose
from demflow.model.network.apertures import open_pipes
from demflow.model.network.domains import network
from demflow.model.network.fractures.walk import walk
from demflow.model.region import Rectangle
from demflow.model.scene import (
    Fracture,
    LogNormal,
    Matrix,
    Probe,
    RandomSet,
    Trace,
    Well,
    flow_lines,
)
from demflow.model.threads import one_blas_thread
from tests.reservoirs import dense_matrices, exact_response
from tests.rocks import random_graph

pytestmark = pytest.mark.slow

BOX = Rectangle(2.0, 1.4)
PACKING = random_graph(1.3, 500, 3)
NETWORK = network(PACKING, region=BOX)
MATRIX, VISCOSITY, BULK = Matrix(aperture=2e-5), 1e-3, 1e9
TIMES = tuple(np.geomspace(1e-3, 1e2, 26).tolist())
WELL = Well(name="w", at=(0.1, 0.05), radius=0.06, rate=1e-6)
OTHER = Well(name="v", at=(-0.6, 0.3), radius=0.05, rate=-2e-6)
PROBE = Probe(name="p", at=(0.5, -0.3))


def fractures(one: float, two: float) -> tuple[Fracture, ...]:
    """A fracture through the well to the rim, and two that cross it, of two apertures."""
    return (
        Trace(name="a", aperture=one, start=(-0.5, -0.25), end=(1.2, 0.6)),
        Trace(name="b", aperture=two, start=(0.4, -0.5), end=(0.4, 0.65)),
        Trace(name="c", aperture=two, start=(-0.5, 0.5), end=(-0.2, -0.6)),
    )


WALK = walk(NETWORK, region=BOX, lines=flow_lines(fractures(1e-4, 1e-4), BOX))
APERTURES = np.geomspace(3e-5, 5e-4, 6)
MEMBERS = [fractures(w, v) for w in APERTURES for v in APERTURES]
MEMBERS = [MEMBERS[14], *MEMBERS[:14], *MEMBERS[15:]]
LAYOUTS = {
    "well": ((WELL,), ("left", "right"), ()),
    "sealed": ((WELL,), (), ()),
    "two": ((WELL, OTHER), ("left",), (PROBE,)),
    "stores": ((dataclasses.replace(WELL, wellbore_storage=1e-10),), ("right",), (PROBE,)),
}


def asked(layout: str, tolerance: float = 1e-4, flows: bool = False) -> dict:
    wells, sides, probes = LAYOUTS[layout]
    return {
        "bulk_modulus": BULK,
        "wells": sites(wells),
        "sides": sides,
        "active": (False,) * len(sides) + (True,) * len(wells),
        "probes": probes,
        "times": TIMES,
        "tolerance": tolerance,
        "check_flows": flows,
        "decades": (0,) * (len(sides) + len(wells)) if len(wells) > 1 else None,
    }


def given(layout: str, family: list, tolerance: float = 1e-4, flows: bool = False) -> dict:
    return {
        "region": BOX,
        "matrix": MATRIX,
        "viscosity": VISCOSITY,
        "fractures": alike(family[0]),
        "asked": asked(layout, tolerance, flows),
    }


def made(layout: str, family: list = MEMBERS, **told):
    parts = given(layout, family, **told)
    return emulator(NETWORK, WALK, None, None, **parts, members=tuple(family))


def posed(layout: str, member: tuple[Fracture, ...]):
    opened = open_pipes(
        *(NETWORK, WALK, None, None),
        region=BOX,
        matrix=MATRIX,
        fractures=member,
        viscosity=VISCOSITY,
    )
    return opened, pose(NETWORK, opened, region=BOX, **asked(layout)).problem


def together(own: Share) -> Share:
    """One member as several are given."""
    return Share(own.conductance[None], own.storage[None])


def share(model, member: tuple[Fracture, ...]) -> Share:
    found = share_of(
        model.branch_class, posed("well", member)[0].branch_aperture / model.branch_aperture
    )
    assert found is not None
    return found


def dense(layout: str, member: tuple[Fracture, ...]):
    """G, C and the rows of the outputs, (n, n), (n, n) and (n, o)."""
    _, problem = posed(layout, member)
    G, _ = dense_matrices(problem.system)
    return G, np.diag(problem.system.storage), problem.records.rows.toarray().T


@pytest.fixture(autouse=True)
def alone():
    """Dense algebra of this size gains nothing from threads."""
    with one_blas_thread():
        yield


@functools.cache
def model_of(layout: str):
    """The model of a layout."""
    return made(layout)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_member_has_the_terms_of_its_family(layout):
    """Conductances and storage of any member, from shares of two classes."""
    model = model_of(layout)
    assert model.usable
    assert model.branch_class.max() == 2
    member = fractures(7.7e-5, 2.1e-4)
    _, problem = posed(layout, member)
    w = int(model.wells)
    small = projected(model, share(model, member))
    assert len(small.decay) == model.conductance.shape[1] - w
    at_rest = np.tensordot(share(model, member).storage, model.stored, 1)
    first = at_rest[w] ** 2  # of the constants: the pores' volume over the bulk modulus, squared
    base = projected(model, share(model, MEMBERS[0]))
    assert len(base.decay) == len(small.decay)
    total = problem.system.storage[: problem.system.pores].sum()
    own = posed(layout, MEMBERS[0])[1].system.storage[: problem.system.pores].sum()
    assert first == pytest.approx(total**2 / own, rel=1e-10)


def test_snapshots_are_met_in_value_and_slope():
    """At a pole of a snapshot: the transfer, its slope in s and in each transmissivity."""
    model = model_of("two")
    lag = np.array(TIMES)
    first = int(model.branch_class[WALK.branch_line == 0][0])  # the class of fracture a
    for chosen in (0, len(model.snapshot_storage) // 2):
        at = Share(model.snapshot_conductance[chosen], model.snapshot_storage[chosen])
        member = next(
            m for m in MEMBERS if np.allclose(share(model, m).storage, at.storage, rtol=1e-9)
        )
        for pole in (model.poles[chosen][model.poles[chosen] > 0.0]).tolist()[:2]:
            assert 0.05 / lag[-1] < pole < 200.0 / lag[0]
            G, C, rows = dense("two", member)
            x = np.linalg.solve(G + pole * C, rows)
            counted = np.ix_(model.counted, model.counted)
            true, found = (rows.T @ x)[counted], transfer(model, at, np.array([pole]))[0][counted]
            np.testing.assert_allclose(found, true, rtol=1e-7, atol=1e-9 * np.abs(true).max())
            step = 1e-4 * pole
            ends = transfer(model, at, np.array([pole - step, pole + step]))
            slope = ((ends[1] - ends[0]) / (2 * step))[counted]
            true = -(x.T @ C @ x)[counted]
            np.testing.assert_allclose(slope, true, rtol=1e-4, atol=1e-6 * np.abs(true).max())
            small = projected(model, at)
            inner = small.vectors @ (
                (small.vectors.T @ small.ports) / (small.decay[:, None] + pole)
            )
            wells = small.follow @ inner + small.inverse @ small.at_wells
            field = np.concatenate([wells, inner])
            for k in (1, 2):  # what the projection makes of −xᵀ L x
                slope = -(field.T @ (at.conductance[k] * model.conductance[k]) @ field)[counted]
                L = dense("two", fractures(*_wider(member, k == first)))[0] - G
                true = -(x.T @ L @ x)[counted]
                np.testing.assert_allclose(slope, true, rtol=1e-4, atol=1e-4 * np.abs(true).max())


def _wider(member: tuple[Fracture, ...], the_first: bool) -> tuple[float, float]:
    """Apertures of a member one of whose transmissivities is doubled."""
    one, two = member[0].aperture, member[1].aperture
    cube = 2.0 ** (1.0 / 3.0)
    return (one * cube, two) if the_first else (one, two * cube)


HELD_OUT = [
    fractures(w, v)
    for w, v in np.exp(np.random.default_rng(5).uniform(np.log(3e-5), np.log(5e-4), (12, 2)))
]


@pytest.mark.parametrize("layout", LAYOUTS)
def test_real_frequencies_lie_between_the_bounds(layout):
    """The small model is below, and no farther than r'(G' + s C')⁻¹ r of a smaller reference."""
    model = model_of(layout)
    frequency = contour(np.array(TIMES)).frequency
    ports = np.flatnonzero(model.counted)
    for member in HELD_OUT[:5]:
        own = share(model, member)
        G, C, rows = dense(layout, member)
        small = projected(model, own)
        size = residuals(model, together(own), projected(model, together(own)), frequency)[0]
        for k, s in list(enumerate(radii(np.array(TIMES))))[::2]:
            true = np.einsum("no,no->o", rows, np.linalg.solve(G + s * C, rows))[ports]
            found = np.einsum("oo->o", transfer(model, own, np.array([s]))[0]).real[ports]
            noise = round_off(small, TIMES[-1]) * np.abs(true)
            assert np.all(found <= true + noise)
            assert np.all(true - found <= CAUTION * size[k, 0] + noise)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_complex_frequencies_too(layout):
    """|e| ≤ |r_o| |r_p| / cos(½ arg s) for every pair of outputs on the contour."""
    model = model_of(layout)
    around = contour(np.array(TIMES))
    ports = np.flatnonzero(model.counted)
    for member in HELD_OUT[:2]:
        own = share(model, member)
        G, C, rows = dense(layout, member)
        small = projected(model, own)
        size = residuals(model, together(own), projected(model, together(own)), around.frequency)[0]
        noise = round_off(small, TIMES[-1])
        for k, a in itertools.product(range(0, len(around.radius), 3), range(4)):
            s = around.frequency[k, a]
            true = (rows.T @ np.linalg.solve(G + s * C, rows))[np.ix_(ports, ports)]
            off = np.abs(true - transfer(model, own, np.array([s]))[0][np.ix_(ports, ports)])
            root = np.sqrt(CAUTION * size[k, a])
            bound = np.outer(root, root) / math.cos(0.5 * np.angle(s))
            assert np.all(off <= bound + noise * np.abs(true).max())


def test_the_contour_bounds_what_it_is_given():
    """Of E = c/(λ + s)², whose step response is known, at every decay rate."""
    lag = np.geomspace(1.0, 1e4, 30)
    around = contour(lag)
    for decay in np.geomspace(1e-6, 1e2, 17):
        error = 1.0 / np.abs(decay + around.frequency) ** 2
        z = decay * lag
        true = np.where(z < 1e-4, 0.5 * lag**2, (-np.expm1(-z) - z * np.exp(-z)) / decay**2)
        bound = around.in_time(error)
        assert np.all(bound >= 0.9 * true)
        assert np.all(bound <= 20.0 * np.maximum(true, 0.0) + 5.0 * error.max() * (z > 30.0))


def member_of(layout: str, family: tuple[Fracture, ...]) -> Member:
    wells, sides, _ = LAYOUTS[layout]
    return Member(family, Controls(0.0, 0.0, (0.0,) * len(sides), wells, TIMES, True))


def seen(layout: str, model, members: list, **told) -> dict[str, np.ndarray]:
    return emulate(
        *(PACKING, None, NETWORK, WALK, None, model),
        **given(layout, members, **told),
        wanted=("well_pressure", "probe_pressure", "boundary_flow"),
        members=tuple(member_of(layout, one) for one in members),
    )


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("tolerance", [1e-3, 1e-5])
def test_held_out_members_keep_their_bound_at_all_times(layout, tolerance):
    """Against dense eigenvectors: within the stated bound, and that within the tolerance."""
    model = made(layout, tolerance=tolerance)
    found = seen(layout, model, HELD_OUT, tolerance=tolerance)
    by_model = found["solver_used"] == "emulated"
    assert np.count_nonzero(by_model) >= len(HELD_OUT) - 3
    assert np.all(found["estimated_error"] <= tolerance)
    assert np.all(found["mass_balance_error"] < 1e-9)
    assert np.all(found["emulator_snapshots"][by_model] == model.snapshots)
    wells = LAYOUTS[layout][0]
    for k, member in enumerate(HELD_OUT):
        _, problem = posed(layout, member)
        first = problem.system.fixed_count
        change = sum(
            well.rate * exact_response(problem.system, first + number, np.array(TIMES))
            for number, well in enumerate(wells)
        )
        true = change[:, problem.system.well_node].T
        off = np.abs(found["well_pressure"][k] - true) / np.maximum.accumulate(np.abs(true), axis=1)
        assert np.all(off <= found["estimated_error"][k] + 1e-9)


def test_flows_that_are_asked_for_are_held_to_the_tolerance():
    model = made("well", flows=True)
    found = seen("well", model, HELD_OUT, flows=True)
    assert set(found["solver_used"]) == {"emulated"}
    for k, member in enumerate(HELD_OUT):
        _, problem = posed("well", member)
        field = exact_response(problem.system, problem.system.fixed_count, np.array(TIMES))
        true = WELL.rate * (outputs(problem.system, np.empty(0, int)).rows @ field.T)[1:3]
        off = np.abs(found["boundary_flow"][k] - true).max(axis=1) / np.abs(true).max(axis=1)
        assert np.all(off <= found["estimated_error"][k] + 1e-8)


def test_what_is_no_family_is_solved_case_by_case():
    """Apertures drawn anew for every trace go each its own way; the result says so."""
    drawn = [
        (
            RandomSet(
                name="r",
                aperture=LogNormal(deviation=d, median=1e-4),
                intensity=3.0,
                length=0.6,
                angle=0.7,
            ),
        )
        for d in (0.2, 0.4, 0.6)
    ]
    lines = walk(NETWORK, region=BOX, lines=flow_lines(drawn[0], BOX))
    parts = given("well", drawn)
    model = emulator(NETWORK, lines, None, None, **parts, members=tuple(drawn))
    assert not model.usable
    assert "ways" in str(model.reason)
    found = emulate(
        *(PACKING, None, NETWORK, lines, None, model),
        **parts,
        wanted=("well_pressure",),
        members=tuple(member_of("well", one) for one in drawn),
    )
    assert "emulated" not in set(found["solver_used"])
    assert all("not emulated: its apertures go" in why for why in found["solver_reason"])
    assert np.isfinite(found["well_pressure"]).all()


def test_medians_of_one_law_are_one_family():
    """Fractures of many apertures that widen alike, far apart as they are, have two terms."""
    drawn = [
        (
            RandomSet(
                name="r",
                aperture=LogNormal(deviation=0.5, median=m),
                intensity=3.0,
                length=0.6,
                angle=0.7,
            ),
        )
        for m in np.geomspace(5e-5, 2e-4, 7)
    ]
    lines = walk(NETWORK, region=BOX, lines=flow_lines(drawn[0], BOX))
    parts = given("well", drawn)
    model = emulator(NETWORK, lines, None, None, **parts, members=tuple(drawn))
    assert model.usable
    assert len(model.conductance) == 2
    assert model.largest_error <= 0.5e-4


def test_a_member_beyond_the_family_is_solved_by_itself():
    """Wider than all that the model was made of: its bound tells, and the case is right."""
    narrow = [fractures(w, w) for w in np.geomspace(3e-5, 4e-5, 4)]
    model = made("well", narrow)
    far = fractures(3e-3, 3e-3)
    found = seen("well", model, [narrow[1], far])
    assert found["solver_used"][0] == "emulated"
    assert found["solver_used"][1] != "emulated"
    assert "not emulated: the bound of its error is" in found["solver_reason"][1]
    _, problem = posed("well", far)
    true = WELL.rate * exact_response(problem.system, problem.system.fixed_count, np.array(TIMES))
    well = true[:, problem.system.well_node[0]]
    np.testing.assert_allclose(found["well_pressure"][1, 0], well, rtol=2e-4)


def test_same_model_same_bits():
    again = made("well")
    for name, value in again._asdict().items():
        np.testing.assert_array_equal(value, getattr(model_of("well"), name), err_msg=name)
