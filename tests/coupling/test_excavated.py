"""Holes in coupled rock: what pushes on their rims, and the weight of what lies in a fluid."""

import dataclasses
from functools import cache

import numpy as np
import pytest

from demflow.model.coupling.consolidation import held_pores, taken
from demflow.model.coupling.duality import place_of, pore_volumes, pores_of, volume_gradient
from demflow.model.coupling.frame import frame_of
from demflow.model.coupling.rock import rock_of
from demflow.model.flow.equation.system import assemble
from demflow.model.mechanics.packing.packing import pack
from demflow.model.mechanics.static.moduli import elastic_moduli
from demflow.model.network.apertures import uniform
from demflow.model.network.domains import network
from demflow.model.permeability import permeability
from demflow.model.region import Circle, Hole, Pierced, Rectangle
from demflow.model.scene import (
    Bonds,
    CircularHole,
    Coupling,
    Fluid,
    Grains,
    Matrix,
    RectangularHole,
    Scene,
    SceneError,
    Solver,
    Stress,
)
from demflow.model.stages import run_stages, simulate
from tests.coupling_rocks import APERTURE, CEMENT, FLUID, STIFFNESS, VISCOSITY

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("packed_once")]

SCENE = Scene(
    region=Rectangle(2.4, 1.6),
    grains=Grains(count=500, porosity=0.17, seed=3, modulus=2e10),
    matrix=Matrix(aperture=2e-5),
    fluid=Fluid(1e-3, 2.2e9, density=1000.0),
    bonds=Bonds(kind="parallel", tensile_strength=1e9, shear_strength=1e9),
    stress=Stress(2e7, 2e7),
    excavate=(CircularHole(at=(0.2, 0.1), radius=0.25, side="drift"),),
    boundaries=(("drift", 0.0), ("top", 5e6)),
    initial_pressure=5e6,
    coupling=Coupling(method="linear"),
    times=(1e-3, 1.0, 1e5),
    observe=("boundary_flow", "wall_displacement", "effective_stress", "pressure_map"),
)


def changed(**fields):
    return dataclasses.replace(SCENE, **fields)


@cache
def pierced(count=700, radius=0.2):
    """Grains around a hole, the region that they fill, their network."""
    packing = pack(
        region=Rectangle(2.0, 2.0), count=count, mean_radius=None, packing="random",
        radius_ratio=1.66, porosity=0.17, seed=4, specimen=True,
    )  # fmt: skip
    left, right, bottom, top = packing.box
    hole = Hole("hole", (0.1, -0.2), Circle(radius))
    region = Pierced(Rectangle(float(right - left), float(top - bottom)), (hole,))
    return packing, region, network(packing, region=region, walled=True)


def test_the_hole_is_a_pore_whose_push_is_the_gradient_of_its_volume():
    packing, region, net = pierced()
    gone = taken(packing, region)
    assert gone.sum() > 3
    at_side = held_pores(packing, net, region, ("hole",))
    (pore,) = np.flatnonzero(at_side == 0)
    assert not net.inside[pore]
    pores, place = pores_of(packing, net), place_of(packing.x, packing.y, packing.box)
    assert 1.0 < net.area[pore] / (np.pi * 0.2**2) < 1.25  # some pores around are open to it
    gradient = volume_gradient(pores, place)
    force = gradient @ np.ones(len(net.x))
    assert np.abs(force[:-4]).max() < 1e-12 * packing.radius.mean()
    rng, h = np.random.default_rng(2), 2e-4 * packing.radius.mean()
    way = rng.standard_normal(len(place))
    steps = [pore_volumes(pores, place + k * h * way) for k in (1, -1, 2, -2)]
    found = (8.0 * (steps[0] - steps[1]) - (steps[2] - steps[3])) / (12.0 * h)
    wanted = gradient.T @ way
    assert np.abs(found - wanted).max() < 1e-8 * np.abs(wanted).max()
    assert np.abs(wanted[pore]) > np.median(np.abs(wanted))
    assert gradient[np.flatnonzero(np.repeat(gone, 3))].nnz == 0


def test_the_rock_around_it_is_as_permeable_as_without_it():
    packing, region, net = pierced()
    whole = network(packing, region=region.outer, walled=True)
    one, other = (
        permeability(n, uniform(n, APERTURE, VISCOSITY), viscosity=VISCOSITY) for n in (whole, net)
    )
    assert np.trace(other) == pytest.approx(np.trace(one), rel=0.03)
    assert net.porosity == pytest.approx(whole.porosity, rel=0.03)


def test_fluid_that_presses_on_a_rim_widens_the_hole_as_a_pressuremeter_does():
    """ΔV / V = p / G of a round hole in an endless elastic rock (Lamé).

    Walls that stand around it hinder it, walls that are free to move do not bear what lies beyond.
    """
    packing, region, net = pierced(2500, 0.16)
    at_side = held_pores(packing, net, region, ("hole",))
    system = assemble(
        net, uniform(net, APERTURE, VISCOSITY), region=region, bulk_modulus=FLUID, wells=(),
        sides=("hole",), at_side=at_side,
    )  # fmt: skip
    moduli = elastic_moduli(
        packing, normal_stiffness=1.0, stiffness_ratio=2.5, friction=0.5, bonds=CEMENT
    )
    endless = net.area[at_side == 0][0] / (STIFFNESS * moduli.stiffness[2, 2])
    ratio = []
    for held in (("right", "top"), ()):
        frame = frame_of(
            packing, stiffness_ratio=2.5, friction=0.5, bonds=CEMENT, held=held,
            gone=taken(packing, region),
        )  # fmt: skip
        rock = rock_of(packing, net, frame, system, STIFFNESS)
        moved = frame.moved(rock.unit_pressure(0).force)
        ratio.append(rock.size * float(rock.held.toarray()[:, 0] @ moved) / endless)
    assert 0.92 < ratio[0] < 1.0 < ratio[1] < 1.08


def test_the_same_pressure_everywhere_moves_nothing_but_grains_that_it_compresses():
    """A drift at the rock's pressure is no source at all; its rim bears what its pores bear."""
    scene = changed(boundaries=(("drift", 5e6), ("top", 5e6)), observe=("boundary_flow",))
    found = simulate(scene)
    assert np.abs(found["boundary_flow"]).max() <= 1e-12


def test_a_drained_drift_takes_in_as_much_as_enters_and_pulls_the_walls_in():
    found = simulate(SCENE)
    drift, top = found["boundary_flow"][:, -1]
    assert drift < 0.0 < top
    assert drift + top == pytest.approx(0.0, abs=1e-9 * top)
    assert found["mass_balance_error"] <= 1e-12
    _, right, _, upper = found["wall_displacement"][:, -1]
    assert right < 0.0
    assert upper < 0.0
    rigid = changed(coupling=None, observe=("boundary_flow",), initial_pressure=None, times=())
    assert simulate(rigid)["boundary_flow"][1] == pytest.approx(top, rel=0.15)


def test_apertures_follow_the_same_and_hold_their_volumes():
    stiff = Matrix(aperture=2e-5, half_stress=1e14)
    given = {"times": (1e-1, 1e5), "observe": ("boundary_flow", "wall_displacement")}
    linear = simulate(changed(matrix=stiff, **given))
    loose = {**given, "coupling": Coupling(method="apertures"), "solver": Solver(tolerance=1e-3)}
    follow = simulate(changed(matrix=stiff, **loose))
    assert follow["mass_balance_error"] <= 1e-9
    for name in ("boundary_flow", "wall_displacement"):
        size = np.abs(linear[name][..., 1:]).max()
        assert np.abs(follow[name] - linear[name])[..., 1:].max() <= 3e-3 * size, name
    soft = simulate(changed(matrix=Matrix(aperture=2e-5, half_stress=2e7), **loose))
    assert soft["boundary_flow"][1, -1] < linear["boundary_flow"][1, -1]


def test_a_hole_without_a_pressure_is_lined():
    hole = RectangularHole(at=(-0.3, 0.1), width=0.4, height=0.3)
    scene = changed(excavate=(hole,), boundaries=(("left", 0.0), ("right", 5e6)))
    products = run_stages(scene)
    found, net = products["observe"], products["network"]
    left, right = found["boundary_flow"][:, -1]
    assert left + right == pytest.approx(0.0, abs=1e-9 * right)
    assert len(net.cut) > 5
    whole = simulate(changed(excavate=(), boundaries=(("left", 0.0), ("right", 5e6))))
    assert 0.75 * whole["boundary_flow"][1, -1] < right < whole["boundary_flow"][1, -1]


def test_grains_weigh_less_by_the_fluid_they_displace():
    plain = changed(excavate=(), boundaries=(("top", 0.0),), gravity=9.81)
    assert plain.ground.unit_weight == pytest.approx((plain.grains.density - 1000.0) * 9.81)
    state = run_stages(plain)["stress"]
    dry = dataclasses.replace(plain, coupling=None, times=(), initial_pressure=None,
                              observe=("boundary_flow",))  # fmt: skip
    assert dry.ground.unit_weight == pytest.approx(plain.grains.density * 9.81)

    def heavier(state):
        """Vertical force through the lower over that through the upper half of the rock."""
        a, b = state.contact_a, state.contact_b
        y = 0.5 * (state.y[a] + state.y[b])
        length = np.hypot(state.x[b] - state.x[a], state.y[b] - state.y[a])
        share = state.normal_force * (state.y[b] - state.y[a]) ** 2 / length
        return share[y < 0.0].sum() - share[y >= 0.0].sum()

    assert heavier(state) > 0.0
    with pytest.raises(SceneError, match="grains weigh less by the fluid"):
        changed(gravity=9.81, fluid=Fluid(1e-3, 2.2e9))
    with pytest.raises(SceneError, match="would float"):
        changed(gravity=9.81, fluid=Fluid(1e-3, 2.2e9, density=4000.0))
