"""Tensors of a family: to the bit what each member gives by itself."""

import dataclasses
import itertools

import numpy as np
import pytest

from demflow.model.outcome import ModelError, OutOfMemory
from demflow.model.permeability import LinearRim
from demflow.model.quantities import FAILURE
from demflow.model.region import Rectangle
from demflow.model.scene import (
    Bonds,
    Closure,
    Fluid,
    FractureSet,
    Grains,
    LogNormal,
    Matrix,
    RandomSet,
    Scene,
    Stress,
    Trace,
)
from demflow.model.stages import STAGES, run_stages
from demflow.model.tensors import CONDITIONS

pytestmark = pytest.mark.usefixtures("packed_once")

STAGE = {stage.name: stage for stage in STAGES}
EVERY = ("bar_permeability", "periodic_permeability", "permeability")


def traces(one: float, two: float) -> tuple:
    """A trace from rim to rim and a set that crosses it, of two apertures."""
    return (
        Trace(name="a", aperture=one, start=(-0.9, -0.25), end=(1.2, 0.4)),
        FractureSet(name="b", angle=1.2, length=0.8, spacing=0.4, aperture=two),
    )


def barred(one: float, two: float) -> tuple:
    """The same, crossed by a barrier and by a line that lets a tenth through."""
    return (
        *traces(one, two),
        Trace(name="wall", start=(-0.6, -0.9), end=(-0.4, 0.4), thickness=0.02, permeability=1e-19),
        Trace(name="part", start=(0.1, -0.6), end=(0.3, 0.6), transmissibility_multiplier=0.1),
    )


def drawn(one: float, two: float) -> tuple:
    """Traces whose apertures are drawn, and a chain."""
    wide = LogNormal(deviation=0.5, median=one)
    return (
        RandomSet(name="r", aperture=wide, intensity=3.0, length=0.6, angle=0.3),
        Trace(name="b", aperture=two, start=(0.4, -0.6), end=(-0.3, 0.65)),
        Trace(name="c", permeability=1e-11, start=(-0.7, 0.3), end=(0.7, 0.1)),
    )


def closing(one: float, two: float) -> tuple:
    """Traces that the stress on the rock closes."""
    law = Closure(stiffness=2e11, largest_closure=1e-5)
    return tuple(dataclasses.replace(f, closure=law) for f in traces(one, two))


STRESSED = {
    "grains": Grains(
        count=220, porosity=0.17, seed=3, modulus=20e9, stiffness_ratio=2.5, friction=0.5
    ),
    "bonds": Bonds("contact", 5e8, 5e8),
    "stress": Stress(xx=20e6, yy=8e6),
}
ROCKS = {
    "plain": (traces, {}),
    "barred": (barred, {}),
    "drawn": (drawn, {}),
    "closing": (closing, STRESSED),
}


def scene(fractures: tuple, **changed) -> Scene:
    told = {
        "region": Rectangle(1.6, 1.2),
        "grains": Grains(count=220, porosity=0.17, seed=3),
        "matrix": Matrix(permeability=1e-15),
        "fluid": Fluid(1e-3, 1e9),
        "fractures": fractures,
        "observe": EVERY,
    }
    return Scene(**{**told, **changed})


def together(scenes: list[Scene]) -> dict[str, np.ndarray]:
    """What the stage gives, by products of the first scene's own stages."""
    stage, products = STAGE["tensors"], {}
    for name in ("pack", "unit_loads", *stage.parents[1:]):
        row = STAGE[name]
        if row.wanted(scenes[0]):
            parents = [products.get(parent) for parent in row.parents]
            products[name] = row.run(*parents, **row.given(scenes[0]))
    members = tuple(one.fractures for one in scenes)
    parents = [products.get(name) for name in stage.parents]
    return stage.run(*parents, **stage.given(scenes[0]), members=members)


@pytest.mark.parametrize("kind", ROCKS)
def test_each_member_has_what_it_has_alone(kind):
    fractures, changed = ROCKS[kind]
    widths = itertools.product((2e-5, 1.3e-4, 6e-4), (3e-5, 2e-4))
    scenes = [scene(fractures(*at), **changed) for at in widths]
    found = together([*scenes, scenes[1]])
    assert not any(found[FAILURE])
    alone = [run_stages(one)["observe"] for one in [*scenes, scenes[1]]]
    assert found.keys() == {FAILURE, *alone[0]}
    for name in alone[0]:
        np.testing.assert_array_equal(found[name], [one[name] for one in alone], err_msg=name)
    assert len(np.unique(found["permeability"], axis=0)) == len(scenes)


def test_a_member_without_a_result_takes_none_from_the_others(monkeypatch):
    class Narrow(LinearRim):
        def measured(self, apertures, *, viscosity):
            if apertures.branch_aperture.max() > 3e-4:
                raise ModelError("too wide")
            return super().measured(apertures, viscosity=viscosity)

    rim = lambda rock, opened: Narrow(rock.network, opened)  # noqa: E731 (a row)
    scenes = [scene(traces(w, 1e-4), observe=("permeability",)) for w in (1e-4, 4e-4, 2e-4)]
    whole = together(scenes)["permeability"]
    monkeypatch.setitem(CONDITIONS, "permeability", rim)
    found = together(scenes)
    assert found[FAILURE].tolist() == ["", "too wide", ""]
    assert np.all(np.isnan(found["permeability"][1]))
    np.testing.assert_array_equal(found["permeability"][::2], whole[::2])


def test_what_does_not_fit_ends_the_run_and_is_no_answer_of_a_member(monkeypatch):
    """An answer stays; a run that lacked memory is made again once there is more."""

    def short(*_):
        raise OutOfMemory("a factor would not fit")

    monkeypatch.setitem(CONDITIONS, "permeability", short)
    with pytest.raises(OutOfMemory, match="a factor would not fit"):
        together([scene(traces(1e-4, 1e-4)), scene(traces(2e-4, 1e-4))])


def test_members_of_another_family_are_refused():
    one, other = scene(traces(1e-4, 1e-4)), scene(barred(1e-4, 1e-4))
    with pytest.raises(ValueError, match="members of a family differ in more"):
        together([one, other])
