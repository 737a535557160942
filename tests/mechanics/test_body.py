"""A specimen put away and taken out again goes on as if nothing had happened."""

from __future__ import annotations

import numpy as np
import pytest

from demflow.model.mechanics.loading.stress import straight_path
from demflow.model.mechanics.motion.equilibrium import FIRE, NEVER, Specimen
from demflow.model.mechanics.specimen.body import Body, body_of, specimen_of
from demflow.model.mechanics.specimen.rock import build_specimen, elasticity
from demflow.model.products import build, named
from demflow.model.scene import Bonds, Contact, Joint, JointLine
from demflow.sweep.store.products import pack, unpack
from tests.mechanics.rocks import packed

STRENGTH = {"tensile_strength": 2e7, "shear_strength": 2e7}  # some of the bonds break
BONDS = {kind: Bonds(kind=kind, **STRENGTH) for kind in ("contact", "parallel")}
LINES = (
    JointLine(
        (-0.6, -0.4), (0.5, 0.6), Joint(normal_stiffness=1e11, shear_stiffness=4e10, friction=0.4)
    ),
    JointLine(
        (5.0, 5.0), (6.0, 5.0), Joint(normal_stiffness=1e11, shear_stiffness=4e10, friction=0.4)
    ),
)
KINDS = {
    "unbonded": (None, (), 0.7),
    "hertz": (None, (), 0.7),
    "rolling": (None, (), 0.7),
    "contact": (BONDS["contact"], (), 0.7),
    "parallel": (BONDS["parallel"], (), FIRE),
    "jointed": (BONDS["parallel"], LINES, 0.7),
}
CONTACTS = {
    "hertz": Contact(law="hertz", poissons_ratio=0.25),
    "rolling": Contact(law="rolling", rolling_friction=0.3),
}
STEPS = 400


def made(kind: str) -> Specimen:
    bonds, joints, _ = KINDS[kind]
    packing, elastic = packed(0.17, count=200, specimen=True), None
    if kind in CONTACTS:
        elastic = elasticity(CONTACTS[kind], 2e10, 2.5, 0.5, 1e7)
    return build_specimen(packing, 2e10, 2.5, 0.5, bonds, joints, seed=3, elastic=elastic)


def moved(specimen: Specimen, kind: str, servo) -> Specimen:
    specimen.relax(servo, NEVER, damping=KINDS[kind][2], steps=STEPS)
    return specimen


def through_the_store(body: Body) -> Body:
    return build(Body, unpack(pack(named(body), {})).arrays)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_it_goes_on_with_the_same_bits(kind):
    """Twice as many steps, and the same with the specimen stored and built anew in between."""
    servo = straight_path(1e-3, 4e-3, 2e-3)._replace(pace=np.inf)
    whole = moved(moved(made(kind), kind, servo), kind, servo)
    half = moved(made(kind), kind, servo)
    again = moved(specimen_of(through_the_store(body_of(half)), half.law), kind, servo)
    expected, found = named(body_of(whole)), named(body_of(again))
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        assert type(found[name]) is type(value), name
        np.testing.assert_array_equal(found[name], value, err_msg=name)
        assert np.asarray(found[name]).dtype == np.asarray(value).dtype, name
    assert again.idle_traces == whole.idle_traces == (1 if kind == "jointed" else 0)
    assert (whole.rebuilds > 0) == (kind != "parallel")  # which FIRE keeps near its place
    if kind == "rolling":
        assert np.abs(whole.pairs.moment).max() > 0.0
    if KINDS[kind][0] is not None:
        assert np.count_nonzero(whole.bonds.state) > 0
    if kind == "jointed":
        assert np.abs(whole.joints.slipped).max() > 0.0


def test_what_becomes_of_one_touches_not_the_other():
    servo = straight_path(1e-3, 4e-3, 2e-3)._replace(pace=np.inf)
    specimen = moved(made("jointed"), "jointed", servo)
    body = body_of(specimen)
    before = {name: np.copy(value) for name, value in named(body).items()}
    moved(specimen, "jointed", servo)
    moved(specimen_of(body, specimen.law), "jointed", servo)
    for name, value in named(body).items():
        np.testing.assert_array_equal(value, before[name], err_msg=name)


def test_a_ledger_of_energies_is_kept_on():
    servo = straight_path(1e-3, 4e-3, 2e-3)._replace(pace=np.inf)
    whole = made("parallel")
    whole.open_ledger()
    whole.relax(servo, NEVER, damping=0.7, steps=STEPS)
    again = specimen_of(through_the_store(body_of(whole)), whole.law)
    for specimen in (whole, again):
        specimen.relax(servo, NEVER, damping=0.7, steps=STEPS)
    assert again.energies() == whole.energies()
