"""Apertures: the force and gap laws, calibration by a cube root, who wins a shared pipe."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from demflow.model.network.apertures import (
    open_pipes,
    parted_aperture,
    pipe_conductance,
    stressed_aperture,
    transmissivity,
    uniform,
)
from demflow.model.network.domains import network
from demflow.model.network.fractures.walk import walk
from demflow.model.outcome import ModelError
from demflow.model.permeability import permeability, unit_permeability
from demflow.model.products import Permeability, StressState
from demflow.model.region import Circle
from demflow.model.scene import FractureSet, Matrix, Trace, flow_lines
from tests.rocks import random_graph

REGION = Circle(0.8)
PACKING = random_graph(1.0, 300, 1)
NETWORK = network(PACKING, region=REGION)
UNIT = Permeability(unit_permeability(NETWORK))
VISCOSITY = 1e-3
positive = st.floats(1e-9, 1e9)


CRACKS = [name for name in StressState._fields if name.startswith("crack_")]


def opened(*fractures, matrix=None, stress=None, unit=UNIT):
    lines = flow_lines(fractures, REGION)
    return open_pipes(
        NETWORK,
        walk(NETWORK, region=REGION, lines=lines) if lines else None,
        stress,
        unit,
        region=REGION,
        matrix=matrix or Matrix(aperture=1e-5),
        fractures=fractures,
        viscosity=VISCOSITY,
    )


def state(force, x=None, y=None, kept=slice(None), joint_gap=None):
    """Contact forces (and moved grains) on the packing's contacts."""
    a, b = PACKING.contact_a[kept], PACKING.contact_b[kept]
    return StressState(
        x=PACKING.x if x is None else x,
        y=PACKING.y if y is None else y,
        contact_a=a,
        contact_b=b,
        normal_force=np.broadcast_to(force, len(PACKING.contact_a))[kept].astype(float),
        shear_force=np.zeros(len(a)),
        bonded=np.zeros(len(a), dtype=bool),
        joint_gap=np.full(len(a), np.nan) if joint_gap is None else joint_gap,
        **dict.fromkeys(CRACKS, np.empty(0)),
        idle_joints=np.asarray(0),
        box=PACKING.box,
        stress=np.zeros(3),
        wall_stress=np.zeros(4),
        unbalanced_ratio=np.asarray(0.0),
        broken_bonds=np.asarray(0),
        largest_overlap=np.asarray(0.0),
        static=np.asarray(0),
        steps=np.asarray(0),
    )


@given(w0=positive, f0=positive, force=st.floats(0, 1e9))
def test_force_law(w0, f0, force):
    """w0 without force, half of it at F0, falling, never below zero."""
    assert stressed_aperture(w0, 0.0, f0) == pytest.approx(w0)
    assert stressed_aperture(w0, f0, f0) == pytest.approx(0.5 * w0)
    assert 0 < stressed_aperture(w0, force, f0) <= w0 * (1 + 1e-15)
    assert stressed_aperture(w0, 2 * force, f0) <= stressed_aperture(w0, force, f0)


@given(w0=positive, gap=st.floats(0, 1), m=st.floats(0, 1))
def test_gap_law_meets_the_force_law_at_contact(w0, gap, m):
    assert parted_aperture(w0, 0.0, m) == pytest.approx(stressed_aperture(w0, 0.0, 1.0))
    assert parted_aperture(w0, gap, m) - w0 == pytest.approx(m * gap, abs=1e-15 * w0 + 1e-12)


def test_plates_by_hand():
    assert pipe_conductance(np.array([2e-4]), np.array([0.5]), 1e-3)[0] == pytest.approx(
        8e-12 / (12 * 1e-3 * 0.5)
    )
    assert transmissivity(2e-4, 1e-3) == pytest.approx(8e-12 / 0.012)


def test_a_wanted_permeability_is_met_by_a_cube_root():
    matrix = Matrix(permeability=3e-15)
    found = opened(matrix=matrix)
    assert 0.5 * np.trace(permeability(NETWORK, found, viscosity=VISCOSITY)) == pytest.approx(
        3e-15, rel=1e-12
    )
    assert np.all(found.aperture == found.matrix_aperture)


def test_a_permeability_needs_the_network_s_own():
    with pytest.raises(ModelError, match="not computed"):
        opened(matrix=Matrix(permeability=1e-15), unit=None)


def test_a_fracture_of_given_permeability_is_as_wide_as_a_medium_of_it():
    """The paper's meaning: w_f = w_m (k_f / k_m)^(1/3), and only along the trace."""
    fracture = Trace(name="f", permeability=27e-15, start=(-0.5, -0.1), end=(0.5, 0.2))
    found = opened(fracture, matrix=Matrix(permeability=1e-15))
    on = found.on_fracture == 0
    assert 5 < on.sum() == found.trace_pipes[0]
    np.testing.assert_allclose(found.aperture[on], 3 * found.matrix_aperture, rtol=1e-12)
    np.testing.assert_array_equal(found.aperture[~on], found.matrix_aperture)
    np.testing.assert_allclose(
        found.conductance, pipe_conductance(found.aperture, NETWORK.pipe_length, VISCOSITY)
    )
    assert len(found.node_x) == 0


def test_forces_of_f0_everywhere_halve_apertures_and_leave_an_eighth():
    matrix = Matrix(aperture=1e-5, half_force=2e6)
    loaded = opened(matrix=matrix, stress=state(2e6))
    free = opened(matrix=matrix)
    np.testing.assert_allclose(loaded.aperture, 0.5 * free.aperture)
    np.testing.assert_allclose(loaded.conductance, free.conductance / 8)
    np.testing.assert_allclose(loaded.cut_conductance, free.cut_conductance / 8)
    assert loaded.matrix_aperture == free.matrix_aperture == 1e-5


def test_each_pipe_has_the_force_of_its_own_contact():
    force = 1e6 * (1 + np.arange(len(PACKING.contact_a)))
    found = opened(matrix=Matrix(aperture=1e-5, half_force=3e6), stress=state(force))
    by_pair = {
        pair: f
        for *pair, f in zip(
            PACKING.contact_a.tolist(), PACKING.contact_b.tolist(), force, strict=True
        )
        for pair in [tuple(pair)]
    }
    pairs = zip(NETWORK.pipe_grain_a.tolist(), NETWORK.pipe_grain_b.tolist(), strict=True)
    expected = [1e-5 * 3e6 / (by_pair[pair] + 3e6) for pair in pairs]
    np.testing.assert_allclose(found.aperture, expected, rtol=1e-12)


def test_pipes_outlive_their_contacts_and_widen_with_the_gap():
    """Grains moved apart by a tenth; every second contact is gone."""
    x, y = 1.1 * PACKING.x, 1.1 * PACKING.y
    matrix = Matrix(aperture=1e-5, half_force=3e6, gap_factor=0.25)
    found = opened(matrix=matrix, stress=state(0.0, x, y, slice(None, None, 2)))
    a, b = NETWORK.pipe_grain_a, NETWORK.pipe_grain_b
    gap = np.hypot(x[a] - x[b], y[a] - y[b]) - NETWORK.pipe_length
    np.testing.assert_allclose(found.aperture, 1e-5 + 0.25 * np.maximum(gap, 0), rtol=1e-12)


def test_fractures_of_given_permeability_close_under_force_as_the_matrix_does():
    fracture = Trace(name="f", permeability=27e-15, start=(-0.5, -0.1), end=(0.5, 0.2))
    matrix = Matrix(permeability=1e-15, half_force=2e6)
    loaded = opened(fracture, matrix=matrix, stress=state(6e6))
    free = opened(fracture, matrix=matrix)
    np.testing.assert_allclose(loaded.aperture, free.aperture / 4)


def test_a_hydraulic_aperture_is_the_one_in_place():
    """It carries w³/(12 μ) whatever the forces, and leaves the matrix's pipes as they are."""
    fracture = Trace(name="f", aperture=1e-4, start=(-0.5, -0.1), end=(0.5, 0.2))
    matrix = Matrix(aperture=1e-5, half_force=2e6)
    loaded = opened(fracture, matrix=matrix, stress=state(6e6))
    free = opened(fracture, matrix=matrix)
    assert len(free.branch_line) > 5
    np.testing.assert_array_equal(loaded.branch_conductance, free.branch_conductance)
    np.testing.assert_array_equal(loaded.branch_aperture, 1e-4)
    length = np.hypot(0.1 + 0.9, 0.3)
    assert free.branch_length.sum() == pytest.approx(length, rel=1e-12)
    np.testing.assert_allclose(
        free.branch_conductance * free.branch_length, transmissivity(1e-4, VISCOSITY)
    )
    np.testing.assert_array_equal(free.conductance, opened(matrix=matrix).conductance)


def test_the_wider_of_two_chains_has_a_shared_pipe_in_any_order():
    narrow = Trace(name="narrow", permeability=1e-13, start=(-0.5, 0.1), end=(0.5, 0.1))
    wide = Trace(name="wide", permeability=3e-13, start=(-0.5, 0.101), end=(0.5, 0.101))
    wet = Trace(name="wet", permeability=1e-10, start=(-0.4, -0.5), end=(0.3, 0.5))
    one, other = opened(narrow, wide, wet), opened(wet, wide, narrow)
    np.testing.assert_allclose(one.conductance, other.conductance, rtol=1e-12)
    np.testing.assert_array_equal(one.aperture, other.aperture)
    np.testing.assert_allclose(
        one.conductance, np.max([opened(f).conductance for f in (narrow, wide, wet)], axis=0)
    )


def test_traces_in_one_pore_all_carry():
    """Two parallel traces a thousandth of a pore apart conduct the sum, in any order."""
    ends = [((-1.0, y), (1.0, y)) for y in (0.1, 0.1 + 1e-4)]
    traces = [
        Trace(name=f"f{k}", aperture=w, start=a, end=b)
        for k, ((a, b), w) in enumerate(zip(ends, (1e-4, 2e-4), strict=True))
    ]
    sealed = Matrix(aperture=0.0)
    tensors = [
        permeability(NETWORK, opened(*fs, matrix=sealed), viscosity=VISCOSITY)[0, 0]
        for fs in (traces, traces[::-1], traces[:1], traces[1:])
    ]
    assert tensors[0] == pytest.approx(tensors[2] + tensors[3], rel=1e-9)
    assert tensors[1] == pytest.approx(tensors[0], rel=1e-9)


def test_a_fracture_tighter_than_the_matrix_changes_nothing():
    tight = Trace(name="tight", permeability=1e-22, start=(-0.5, 0.1), end=(0.5, 0.1))
    np.testing.assert_array_equal(opened(tight).conductance, opened().conductance)


def test_barriers_multiply_what_crosses_them_twice_where_two_do():
    walls = [
        Trace(name=n, transmissibility_multiplier=m, start=(0.0, -0.5), end=(0.01, 0.5))
        for n, m in (("one", 0.5), ("two", 0.2))
    ]
    ratio = opened(*walls).conductance / opened().conductance
    assert sorted(set(np.round(ratio, 12))) == [0.1, 1.0]


def test_fractures_are_told_apart():
    pieces = FractureSet(name="set", aperture=1e-4, angle=0.3, length=0.4, spacing=0.4)
    lone = Trace(name="lone", aperture=1e-4, start=(-0.5, 0.1), end=(0.5, 0.1))
    found = opened(pieces, lone)
    assert set(found.trace_fracture.tolist()) == {0, 1}
    assert found.trace_fracture.tolist() == sorted(found.trace_fracture.tolist())
    assert len(found.trace_start) == len(found.trace_end) == len(found.trace_pipes)
    assert set(found.branch_line.tolist()) == set(range(len(found.trace_pipes)))
    assert np.all(found.on_fracture == -1)


def test_uniform_is_open_pipes_without_anything():
    for field, value in uniform(NETWORK, 1e-5, VISCOSITY)._asdict().items():
        np.testing.assert_array_equal(value, getattr(opened(), field), err_msg=field)


def test_inputs_are_left_as_they_were():
    before = {name: np.copy(value) for name, value in NETWORK._asdict().items()}
    opened(
        Trace(name="f", aperture=1e-4, start=(-0.5, -0.1), end=(0.5, 0.2)),
        Trace(name="b", transmissibility_multiplier=0.0, start=(0.0, -0.5), end=(0.01, 0.5)),
    )
    for name, value in before.items():
        np.testing.assert_array_equal(value, getattr(NETWORK, name), err_msg=name)


def test_across_a_joint_the_gap_is_the_joints_own():
    """Grains that slid past each other along a joint part without opening their pipe."""
    matrix = Matrix(aperture=1e-5, half_force=1.0, gap_factor=0.5)
    count = len(PACKING.contact_a)
    stretched = {"x": 1.1 * PACKING.x, "y": 1.1 * PACKING.y}
    closed = opened(matrix=matrix, stress=state(0.0, **stretched, joint_gap=np.zeros(count)))
    np.testing.assert_allclose(closed.aperture, 1e-5)
    gap = np.full(count, 2e-3)
    wide = opened(matrix=matrix, stress=state(0.0, **stretched, joint_gap=gap))
    np.testing.assert_allclose(wide.aperture, 1e-5 + 0.5 * 2e-3)
