"""States of stress of a family: to the bit what each member gives by itself."""

import numpy as np
import pytest

from demflow.model import states
from demflow.model.outcome import ModelError, OutOfMemory
from demflow.model.quantities import FAILURE
from demflow.model.region import Rectangle
from demflow.model.scene import Bonds, Closure, Fluid, Grains, Matrix, Scene, Stress, Trace
from demflow.model.stages import STAGES, run_stages

STAGE = {stage.name: stage for stage in STAGES}
EVERY = ("bar_permeability", "periodic_permeability", "permeability")
CEMENTS = {
    "contact": Bonds("contact", 5e8, 5e8, installation_gap=0.01),
    "parallel": Bonds("parallel", 5e8, 5e8),
}


def scene(xx: float, yy: float, angle: float = 0.0, **changed) -> Scene:
    told = {
        "region": Rectangle(1.6, 1.2),
        "grains": Grains(
            count=220, porosity=0.17, seed=5, modulus=20e9, stiffness_ratio=2.5, friction=0.5
        ),
        "bonds": CEMENTS["contact"],
        "stress": Stress(xx=xx, yy=yy, angle=angle, method="static"),
        "matrix": Matrix(permeability=1e-15, half_stress=8e6),
        "fluid": Fluid(1e-3, 1e9),
        "observe": EVERY,
    }
    return Scene(**{**told, **changed})


def together(scenes: list[Scene]) -> dict[str, np.ndarray]:
    """What the stage gives, by products of the first scene's own stages."""
    stage, products = STAGE["states"], {}
    for name in stage.parents:
        row = STAGE[name]
        if row.wanted(scenes[0]):
            parents = [products.get(parent) for parent in row.parents]
            products[name] = row.run(*parents, **row.given(scenes[0]))
    assert stage.brings is not None
    members = tuple(map(stage.brings, scenes))
    parents = [products.get(name) for name in stage.parents]
    return stage.run(*parents, **stage.given(scenes[0]), members=members)


@pytest.mark.parametrize("traced", [False, True], ids=["plain", "traced"])
@pytest.mark.parametrize("cement", CEMENTS)
def test_each_member_has_what_it_has_alone(cement, traced):
    changed = {"bonds": CEMENTS[cement]}
    if traced:
        law = Closure(half_stress=9e6)
        trace = Trace(name="a", aperture=1e-4, start=(-0.9, -0.25), end=(1.2, 0.4), closure=law)
        changed["fractures"] = (trace,)
    rng = np.random.default_rng(7)
    loads = [(*rng.uniform(8e6, 20e6, 2), rng.uniform(0.0, 1.5)) for _ in range(5)]
    scenes = [scene(*load, **changed) for load in loads]
    found = together([*scenes, scenes[1]])
    assert not any(found[FAILURE])
    alone = [run_stages(one)["observe"] for one in [*scenes, scenes[1]]]
    assert found.keys() == {FAILURE, *alone[0]}
    for name in alone[0]:
        np.testing.assert_array_equal(found[name], [one[name] for one in alone], err_msg=name)
    assert len(np.unique(found["permeability"], axis=0)) == len(scenes)


def test_a_member_beyond_its_strength_says_why_and_takes_nothing_from_the_others():
    """To the word what the stage *stress* says of it alone."""
    weak = {"bonds": Bonds("contact", 2e7, 2e7, installation_gap=0.01)}
    scenes = [scene(*load, **weak) for load in ((1e7, 1e7), (3e8, 1e7), (1.2e7, 9e6))]
    with pytest.raises(ModelError) as error:
        run_stages(scenes[1])
    found = together(scenes)
    assert found[FAILURE].tolist() == ["", str(error.value), ""]
    assert np.all(np.isnan(found["permeability"][1]))
    whole = together(scenes[::2])
    for name in whole:
        np.testing.assert_array_equal(found[name][::2], whole[name], err_msg=name)


def test_what_does_not_fit_ends_the_run_and_is_no_answer_of_a_member(monkeypatch):
    """An answer stays; a run that lacked memory is made again once there is more."""

    def short(*_, **__):
        raise OutOfMemory("a factor would not fit")

    monkeypatch.setattr(states, "load", short)
    with pytest.raises(OutOfMemory, match="a factor would not fit"):
        together([scene(1e7, 1e7), scene(1.2e7, 9e6)])


def test_who_may_take_long_or_asks_for_more_is_loaded_alone():
    """What is left to `auto` may have to go along a path, and flow has products of its own."""
    family = STAGE["states"].family
    assert family is not None
    one = scene(1e7, 8e6)
    assert family(one)
    assert not family(scene(1e7, 8e6, stress=Stress(xx=1e7, yy=8e6)))
    assert not family(scene(1e7, 8e6, observe=("permeability", "force_chains")))
    assert not family(scene(1e7, 8e6, stress=None, bonds=None, matrix=Matrix(permeability=1e-15)))
