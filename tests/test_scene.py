"""Scenes: bounds, contradictions, all of them at once, and what follows from the parts."""

import dataclasses
import math

import numpy as np
import pytest

from demflow.model import scene as parts
from demflow.model.parameters import SceneError
from demflow.model.region import Circle, Polygon, Rectangle
from demflow.model.scene import (
    MEASURED_BY_A_TEST,
    OBSERVABLES,
    OF_BREAKING,
    OF_COUPLING,
    BiWing,
    Bonds,
    Coupling,
    FailureTest,
    Fluid,
    FractureSet,
    Grains,
    Matrix,
    Probe,
    Scene,
    Solver,
    Stress,
    Trace,
    Well,
)
from demflow.model.stages import STAGES, simulate
from demflow.sweep.plan.identity import encode

GOOD = {
    Rectangle: {"width": 2.0, "height": 1.0},
    Circle: {"radius": 1.0},
    Grains: {"count": 100, "porosity": 0.17, "modulus": 2e10},
    Bonds: {"kind": "parallel", "tensile_strength": 1e7, "shear_strength": 1e7},
    Stress: {"xx": 2e7, "yy": 1e7},
    Matrix: {"aperture": 1e-5},
    Fluid: {"viscosity": 1e-3, "bulk_modulus": 1e9},
    BiWing: {"name": "b", "aperture": 1e-4, "at": (0.0, 0.0), "angle": 0.1, "half_length": 0.2},
    FractureSet: {"name": "s", "aperture": 1e-4, "angle": 0.1, "length": 0.2, "spacing": 0.1},
    Trace: {"name": "t", "aperture": 1e-4, "start": (-0.3, 0.0), "end": (0.3, 0.1)},
    Well: {"name": "w", "at": (0.1, 0.1), "radius": 0.05, "rate": 1e-6},
    Solver: {},
}

PERIODIC = Grains(count=9, packing="periodic", porosity=0.17, modulus=1e10)


def good(**changed):
    given = {
        "region": Circle(1.0),
        "grains": Grains(**GOOD[Grains]),
        "matrix": Matrix(aperture=1e-5),
        "fluid": Fluid(1e-3, 1e9),
        "observe": ("well_pressure",),
        "wells": (Well(**GOOD[Well]),),
        "boundaries": (("outer", 1e6),),
        "initial_pressure": 1e6,
        "times": (1.0, 10.0),
    }
    return Scene(**{**given, **changed})


def problems(make):
    with pytest.raises(SceneError) as caught:
        make()
    return dict(caught.value.problems)


def bounded():
    for made in GOOD:
        for declared in dataclasses.fields(made):
            meta = declared.metadata
            for kind in ("above", "at_least", "below", "at_most"):
                if meta and meta[kind] is not None:
                    yield pytest.param(
                        made, declared, kind, id=f"{made.__name__}.{declared.name} {kind}"
                    )


@pytest.mark.parametrize("made", GOOD)
def test_the_good_examples_are_good_and_frozen(made):
    instance = made(**GOOD[made])
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(instance, dataclasses.fields(made)[0].name, 1.0)
    assert instance == made(**GOOD[made])
    assert hash(instance) == hash(made(**GOOD[made]))


@pytest.mark.parametrize(("made", "declared", "kind"), list(bounded()))
def test_every_bound_holds_at_its_edge_and_beyond(made, declared, kind):
    edge = declared.metadata[kind]
    step = 1 if isinstance(edge, int) and "int" in str(declared.type) else 1e-9 * max(abs(edge), 1)
    bad = {"above": edge, "at_least": edge - step, "below": edge, "at_most": edge + step}[kind]
    name = declared.metadata["key"] or declared.name
    assert name in problems(lambda: made(**{**GOOD[made], declared.name: bad}))


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(
    ("made", "name"),
    [
        (made, declared.name)
        for made in GOOD
        for declared in dataclasses.fields(made)
        if declared.metadata and declared.type in ("float", "float | None")
    ],
)
def test_numbers_are_finite(made, name, bad):
    assert problems(lambda: made(**{**GOOD[made], name: bad}))


@pytest.mark.parametrize("number", [np.float64, np.float32, np.int64])
def test_bounds_hold_for_numbers_of_numpy_too(number):
    assert problems(lambda: Grains(count=number(0), porosity=0.17))
    assert problems(lambda: Circle(number(-1)))


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_points_are_finite(bad):
    assert problems(lambda: BiWing(**{**GOOD[BiWing], "at": (bad, 0.0)}))
    assert problems(lambda: Trace(**{**GOOD[Trace], "end": (0.0, bad)}))
    assert problems(lambda: good(probes=(Probe("p", (bad, 0.0)),)))
    assert problems(lambda: good(wells=(Well(**{**GOOD[Well], "at": (bad, 0.0)}),)))


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_pressures_and_times_are_finite(bad):
    assert "initial_pressure" in problems(lambda: good(initial_pressure=bad))
    assert "boundaries.outer" in problems(lambda: good(boundaries=(("outer", bad),)))
    assert "times" in problems(lambda: good(times=(1.0, bad)))


def test_choices_are_words_from_a_list():
    assert "packing" in problems(lambda: Grains(count=9, packing="cubic"))
    assert "kind" in problems(lambda: Bonds("glue", 1.0, 1.0))
    assert "method" in problems(lambda: Solver(method="magic"))


@pytest.mark.parametrize(
    ("changed", "path"),
    [
        ({"observe": ()}, "observe"),
        ({"observe": ("colour",)}, "observe"),
        ({"wells": ()}, "observe"),
        ({"observe": ("probe_pressure",)}, "observe"),
        ({"observe": ("boundary_flow",), "boundaries": ()}, "observe"),
        ({"observe": ("pressure_map",), "wells": (), "boundaries": ()}, "wells"),
        ({"wells": (Well(**{**GOOD[Well], "at": (2.0, 0.0)}),)}, "wells.w.at"),
        (
            {"wells": (Well(**GOOD[Well]), Well(**{**GOOD[Well], "name": "v"}))},
            "wells.v.at",
        ),
        ({"wells": (Well(**GOOD[Well]),) * 2}, "wells.w"),
        ({"probes": (Probe("far", (9.0, 0.0)),)}, "probes.far.at"),
        ({"boundaries": (("left", 1.0),)}, "boundaries.left"),
        ({"boundaries": (("outer", 1.0), ("outer", 2.0))}, "boundaries.outer"),
        ({"times": ()}, None),
        ({"times": (0.0, 1.0)}, "times"),
        ({"times": (2.0, 1.0)}, "times"),
        ({"times": (1.0, 1.0)}, "times"),
        ({"times": (), "solver": Solver(method="krylov")}, "times"),
        ({"initial_pressure": None}, "initial_pressure"),
        ({"boundaries": (), "solver": Solver(method="steady")}, "boundaries"),
        (
            {
                "wells": (
                    Well(name="w", at=(0, 0), radius=0.1, schedule=((0.0, 1.0), (1.0, 0.0))),
                ),
                "solver": Solver(method="steady"),
            },
            "wells.w.schedule",
        ),
        ({"stress": Stress(1.0, 1.0), "grains": Grains(count=9, porosity=0.17)}, "grains.modulus"),
        ({"stress": Stress(1.0, 1.0), "grains": PERIODIC}, "stress"),
        ({"test": FailureTest(), "grains": PERIODIC}, "test"),
        ({"bonds": Bonds("contact", 1.0, 1.0)}, "bonds"),
        ({"matrix": Matrix(aperture=1e-5, half_force=1e6)}, "matrix.half_force"),
        (
            {
                "grains": Grains(count=9, packing="square", modulus=1e9),
                "stress": Stress(1.0, 1.0),
            },
            "stress",
        ),
    ],
)
def test_contradictions_are_named_by_their_path(changed, path):
    if path is None:
        assert good(**changed).method == "steady"
    else:
        assert path in problems(lambda: good(**changed))


def test_a_hydraulic_conductivity_is_that_of_the_fluid():
    """Darcy's law by heads: q = K h / L is k (ρ g h) / (μ L)."""
    viscosity, density, conductivity = 1.3e-3, 1025.0, 2.4e-7
    made = good(
        matrix=Matrix(hydraulic_conductivity=conductivity),
        fluid=Fluid(viscosity, 1e9, density),
    )
    head, length = 3.0, 7.0
    assert made.pipes is not None
    by_pressure = made.pipes.permeability / viscosity * (density * 9.80665 * head) / length
    assert by_pressure == pytest.approx(conductivity * head / length, rel=1e-14)
    same = good(matrix=Matrix(made.pipes.permeability), fluid=Fluid(viscosity, 1e9))
    for stage in STAGES:  # both share what is computed
        for read in stage.reads.values():
            assert encode(read(made)) == encode(read(same))
    lacking = {"matrix": Matrix(hydraulic_conductivity=1e-7)}
    assert "fluid.density" in problems(lambda: good(**lacking))
    assert "fluid.density" in problems(lambda: good(**lacking, fluid=None))


def test_a_compressibility_is_a_bulk_modulus():
    one, other = (
        good(fluid=fluid) for fluid in (Fluid(1e-3, 2.0**31), Fluid(1e-3, None, None, 2.0**-31))
    )
    assert one.fluid.modulus == other.fluid.modulus
    for stage in STAGES:  # both share what is computed
        for read in (*stage.reads.values(), *stage.options.values()):
            assert encode(read(one)) == encode(read(other))


def test_a_specific_storage_is_what_closed_rock_gives():
    """A well draws q = S_s A dh/dt at last, whatever the porosity; heads are p / (ρ g)."""
    density, storage, rate, grains = 1025.0, 3e-6, 1e-6, Grains(count=300, porosity=0.17)
    times = (1e9, 1.5e9)
    made = good(
        region=Rectangle(10.0, 8.0), grains=grains, stress=None, bonds=None, fractures=(),
        matrix=Matrix(1e-15, specific_storage=storage), fluid=Fluid(1e-3, density=density),
        wells=(Well(name="w", at=(0.3, 0.2), radius=0.1, rate=rate),), boundaries=(), probes=(),
        initial_pressure=1e7, times=times, observe=("well_pressure",),
    )  # fmt: skip
    seen = simulate(made)
    fall = -np.diff(seen["well_pressure"][0])[0] / (density * 9.80665)
    assert rate * (times[1] - times[0]) == pytest.approx(storage * 80.0 * fall, rel=1e-2)
    held = {"matrix": Matrix(1e-15, specific_storage=1e-6), "fluid": Fluid(1e-3, None, 1000.0)}
    assert good(**held).stores(0.2) == pytest.approx(1e-6 / 9806.65, rel=1e-14)
    for fluid, path in (
        (Fluid(1e-3, 1e9, 1000.0), "matrix.specific_storage"),
        (Fluid(1e-3), "fluid.density"),
    ):
        assert path in problems(lambda fluid=fluid: good(**{**held, "fluid": fluid}))
    assert "fluid.bulk_modulus" in problems(lambda: good(fluid=Fluid(1e-3)))
    assert "compressibility" in problems(lambda: Fluid(1e-3, 1e9, compressibility=1e-9))
    coupled = {**held, "coupling": Coupling()}
    assert "matrix.specific_storage" in problems(lambda: good(**coupled))


def test_all_contradictions_are_told_at_once():
    found = problems(
        lambda: good(
            observe=("colour",),
            times=(3.0, 2.0),
            probes=(Probe("far", (9.0, 0.0)),),
            boundaries=(("left", 1.0),),
            bonds=Bonds("contact", 1.0, 1.0),
        )
    )
    assert set(found) >= {"observe", "times", "probes.far.at", "boundaries.left", "bonds"}


@pytest.mark.parametrize(
    "make",
    [
        lambda: Grains(porosity=0.17),
        lambda: Grains(count=9, mean_radius=1.0, porosity=0.17),
        lambda: Grains(count=9),
        lambda: Grains(count=9, packing="square", porosity=0.17),
        lambda: Grains(count=9, porosity=0.17, modulus=1.0, normal_stiffness=1.0),
        lambda: Grains(count=9, porosity=0.5),
        lambda: Grains(
            count=9, porosity=0.17, packing_stress=1e6, packing_friction=0.1, modulus=1e10
        ),
        lambda: Grains(count=9, packing_stress=1e6, modulus=1e10),
        lambda: Grains(count=9, porosity=0.17, packing_stress=1e6),
        lambda: Grains(count=9, porosity=0.17, packing_stress=1e9, modulus=1e10),
        lambda: Grains(count=9, packing="square", packing_friction=0.1),
        lambda: Grains(count=9, packing="periodic"),
        lambda: Matrix(),
        lambda: Matrix(permeability=1e-15, aperture=1e-5),
        lambda: Matrix(permeability=1e-15, hydraulic_conductivity=1e-8),
        lambda: Trace(name="t", start=(0, 0), end=(1, 1)),
        lambda: Trace(name="t", aperture=1e-4, permeability=1e-12, start=(0, 0), end=(1, 1)),
        lambda: Trace(name="t", aperture=1e-4, start=(0.5, 0.5), end=(0.5, 0.5)),
        lambda: Trace(name="t", aperture=1e-4, at=(0.0, 0.0), length=1.0),
        lambda: Trace(name="t", aperture=1e-4, at=(0.0, 0.0), angle=0.0, length=0.0),
        lambda: Trace(
            name="t", aperture=1e-4, at=(0.0, 0.0), angle=0.0, length=1.0, end=(1.0, 1.0)
        ),
        lambda: Well(name="w", at=(0, 0), radius=1.0),
        lambda: Well(name="w", at=(0, 0), radius=1.0, rate=1.0, pressure=1.0),
        lambda: Well(name="w", at=(0, 0), radius=1.0, schedule=()),
        lambda: Well(name="w", at=(0, 0), radius=1.0, schedule=((1.0, 1.0), (1.0, 2.0))),
        lambda: Well(name="w", at=(0, 0), radius=1.0, schedule=((-1.0, 1.0),)),
        lambda: Well(name="w", at=(0, 0), radius=1.0, schedule=((0.0, math.nan),)),
    ],
)
def test_parts_that_contradict_themselves(make):
    assert problems(make)


@pytest.mark.parametrize("angle", [0.0, 0.6, -2.0])
def test_a_trace_by_its_centre_is_the_line_between_its_ends(angle):
    by_centre = Trace(name="t", aperture=1e-4, at=(0.3, -0.2), angle=angle, length=3.0)
    (x0, y0), (x1, y1) = by_centre.points
    assert math.hypot(x1 - x0, y1 - y0) == pytest.approx(3.0, rel=1e-15)
    assert math.atan2(y1 - y0, x1 - x0) == pytest.approx(angle, abs=1e-15)
    assert (0.5 * (x0 + x1), 0.5 * (y0 + y1)) == pytest.approx((0.3, -0.2), rel=1e-15)
    wings = BiWing(name="t", aperture=1e-4, at=(0.3, -0.2), angle=angle, half_length=1.5)
    assert by_centre.points == wings.points
    between = Trace(name="t", aperture=1e-4, start=(x0, y0), end=(x1, y1))
    assert between.points == by_centre.points


def test_auto_is_decided_by_the_times():
    assert good().method == "auto"
    assert good(times=()).method == "steady"
    assert good(solver=Solver(method="explicit")).method == "explicit"


STIFF = Grains(count=9, porosity=0.17, modulus=1e10)


def test_only_flow_outputs_need_flow():
    assert good().flows
    for name in set(OBSERVABLES) - {*OF_COUPLING, *OF_BREAKING}:
        made = good(
            region=Rectangle(2.0, 2.0), observe=(name,), probes=(Probe("p", (0.0, 0.0)),),
            grains=STIFF, test=FailureTest(),
            bonds=Bonds(kind="contact", tensile_strength=1e7, shear_strength=1e7),
            stress=Stress(1e7, 1e7),
        )  # fmt: skip
        without = (
            "permeability",
            "bar_permeability",
            "periodic_permeability",
            "grain_map",
            "fracture_network",
            *MEASURED_BY_A_TEST,
        )
        without += ("elastic_moduli", "force_chains")
        assert made.flows == (name not in without)
    assert not good(observe=("permeability",), times=(), wells=(), boundaries=()).flows


def test_stiffness_of_a_contact_is_the_modulus_or_as_given():
    assert Grains(count=9, porosity=0.17, modulus=1e10).contact_stiffness == 1e10
    assert Grains(count=9, porosity=0.17, normal_stiffness=7.0).contact_stiffness == 7.0
    assert Grains(count=9, porosity=0.17).contact_stiffness is None


def test_scenes_are_values():
    assert good() == good()
    assert hash(good()) == hash(good())
    assert good() != good(times=(1.0, 11.0))


def test_every_parameter_says_what_it_is():
    for made in GOOD:
        for declared in dataclasses.fields(made):
            if declared.name != "name":
                assert declared.metadata["help"], (made, declared.name)
    assert set(parts.__all__) >= {made.__name__ for made in GOOD}


@pytest.mark.parametrize(
    ("changed", "path"),
    [
        ({"wells": (Well(name="w", at=(0.0, 0.0), radius=30.0, rate=1.0),)}, "wells.w.radius"),
        ({"wells": (Well(name="w", at=(0.9, 0.0), radius=0.2, rate=1.0),)}, "wells.w.radius"),
        (
            {"fractures": (Trace(name="t", aperture=1e-4, start=(5.0, 5.0), end=(9.0, 5.0)),)},
            "fractures.t.from",
        ),
        (
            {
                "fractures": (
                    BiWing(name="b", aperture=1e-4, at=(9, 9), angle=0.0, half_length=1.0),
                )
            },
            "fractures.b.at",
        ),
        (
            {
                "fractures": (
                    FractureSet(name="s", aperture=1e-4, angle=0.3, length=1.0, spacing=1e-6),
                )
            },
            "fractures.s.spacing",
        ),
        ({"solver": Solver(method="steady")}, "times"),
    ],
)
def test_what_cannot_act_is_refused(changed, path):
    assert path in problems(lambda: good(**changed))


@pytest.mark.parametrize("angle", [0.1, 2.0])
def test_joints_under_a_stress_off_the_walls_are_refused_before_anything_runs(angle):
    """Only the static solver loads rock at an angle, and it knows no joints."""
    joint = parts.Joint(normal_stiffness=1e11, shear_stiffness=1e11, friction=0.5)
    jointed = {
        "grains": Grains(**GOOD[Grains]),
        "bonds": Bonds(**GOOD[Bonds]),
        "fractures": (Trace(**{**GOOD[Trace], "joint": joint}),),
    }
    along = Stress(2e7, 1e7, angle=0.5 * math.pi)
    assert good(**jointed, stress=along).stress is along
    assert "stress.angle" in problems(lambda: good(**jointed, stress=Stress(2e7, 1e7, angle)))
    assert good(**{**jointed, "fractures": ()}, stress=Stress(2e7, 1e7, angle)).stress


@pytest.mark.parametrize(
    "region",
    [
        Rectangle(2.0, 2.0),
        Polygon(((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0))),
    ],
)
def test_a_fracture_along_the_rim_is_refused_on_every_side(region):
    for start, end in (
        ((-1, 1), (1, 1)),
        ((1, -1), (-1, -1)),
        ((-1, 0), (-1, 1)),
        ((1, 0), (1, 1)),
    ):
        along = Trace(name="t", aperture=1e-4, start=start, end=end)
        found = problems(
            lambda along=along: good(region=region, wells=(), observe=(), fractures=(along,))
        )
        assert "fractures.t.from" in found
    slanted = Trace(name="t", aperture=1e-4, start=(-1, -1), end=(1, 0.999))
    found = problems(lambda: good(region=region, wells=(), observe=(), fractures=(slanted,)))
    assert not any(path.startswith("fractures") for path in found)
