"""The energy ledger: input = stored + lost, whatever takes the energy."""

import numpy as np
import pytest

from demflow.model.mechanics.contact.bonds import INTACT
from demflow.model.mechanics.contact.grains import at_rest
from demflow.model.mechanics.contact.joints import Trace
from demflow.model.mechanics.contact.law import Linear
from demflow.model.mechanics.loading.stress import straight_path
from demflow.model.mechanics.motion.equilibrium import FIRE, NEVER, OUT_OF_STEPS, Specimen
from demflow.model.mechanics.motion.servo import STANDING
from demflow.model.mechanics.packing.compaction import hydrostatic
from demflow.model.mechanics.specimen.rock import build_specimen
from demflow.model.scene import Bonds, Joint, JointLine
from tests.mechanics.rocks import packed

KN = 40e9
WEAK = Joint(
    normal_stiffness=KN, shear_stiffness=KN, friction=0.3, cohesion=1e5, dilation_angle=0.1
)


def loaded(bonds=None, joints=()):
    """The balance of a rock that is led from its packed state to 2:1."""
    rock = packed(specimen=True)
    specimen = build_specimen(rock, KN, 2.5, 0.5, bonds, joints, 1)
    specimen.relax(hydrostatic(2e-4), NEVER, damping=0.5, steps=2000)  # joints are soft
    specimen.open_ledger()
    path = straight_path(2e-4, 5e-4, 2.5e-4)
    assert specimen.relax(path, NEVER, damping=0.3, steps=1500) == OUT_OF_STEPS
    return specimen, specimen.energies()


@pytest.mark.slow
@pytest.mark.parametrize(
    "rock",
    [
        {},
        {"bonds": Bonds(kind="contact", tensile_strength=2e5, shear_strength=5e5)},
        {"bonds": Bonds(kind="parallel", tensile_strength=5e5, shear_strength=1e6)},
        {"joints": (JointLine((-3.0, -2.0), (3.0, 2.0), WEAK),)},
    ],
    ids=["friction", "contact bonds", "parallel bonds", "joint"],
)
def test_the_balance_closes(rock) -> None:
    specimen, found = loaded(**rock)
    assert found.walls > 0.0
    assert found.elastic > 0.0
    assert found.slip > 0.0
    assert found.damping > 0.0
    broken = np.count_nonzero(specimen.bonds.state != INTACT)
    assert "joints" in rock or (found.breakage > 0.0) == (broken > 0)
    assert abs(found.jerks) <= 1e-4 * abs(found.input)  # of a joint that slips
    assert abs(found.error) <= 1e-6 * abs(found.input)


def test_a_collision_closes_the_better_the_smaller_the_steps() -> None:
    def error(dt: float) -> float:
        grains = at_rest(np.array([-1.0, 1.0]), np.array([-0.3, 0.3]), np.ones(2), np.ones(2))
        grains.vx[:], grains.spin[:] = [0.02, -0.01], [0.01, 0.02]
        grains.x[:] = [-0.955, 0.955]
        box = 1e3 * np.array([-1.0, 1.0, -1.0, 1.0])
        specimen = Specimen(grains, box, Linear(1.0, 0.4, 0.2), dt=dt)
        specimen.open_ledger()
        specimen.relax(STANDING, NEVER, damping=0.0, steps=round(8.0 / dt))
        assert specimen.energies().slip > 0.0
        return abs(specimen.energies().error)

    coarse, fine = error(0.04), error(0.01)
    energy = 0.5 * (0.02**2 + 0.01**2 + 0.01**2 + 0.02**2)
    assert coarse < 1e-4 * energy
    assert fine < 0.5 * coarse


def test_loads_and_led_grains_do_work() -> None:
    """A disc falls on a box's floor and is pushed by another that is led at constant speed."""
    grains = at_rest(np.array([-2.1, 0.0]), np.array([0.0, 0.1]), np.ones(2), np.array([np.inf, 1]))
    grains.vx[0] = 1e-3
    grains.load_y[1] = -1e-4
    specimen = Specimen(grains, np.array([-9.0, 9.0, -1.0, 9.0]), Linear(1.0, 0.4, 0.4), dt=0.02)
    specimen.open_ledger()
    specimen.relax(STANDING, NEVER, damping=0.2, steps=20000)
    found = specimen.energies()
    assert found.loads > 0.0
    assert found.kinetic > 0.0
    assert abs(found.error) <= 1e-4 * found.input


def test_grains_that_slide_past_each_other_along_a_joint_lose_what_it_stored() -> None:
    """Led along under a constant overlap u: friction μ k_n u on the way, k_n u² / 2 at its end."""
    led = np.full(2, np.inf)
    grains = at_rest(np.zeros(2), np.array([-0.95, 0.95]), np.ones(2), led)
    grains.vx[1] = 1e-3
    trace = Trace(
        start=(-3.0, 0.0), end=(3.0, 0.0), normal_stiffness=0.5, shear_stiffness=0.5, friction=0.3,
        tensile_strength=0.0, cohesion=0.0, dilation=0.0,
    )  # fmt: skip
    box = 1e3 * np.array([-1.0, 1.0, -1.0, 1.0])
    specimen = Specimen(grains, box, Linear(1.0, 0.4, 0.3), dt=1.0, traces=[trace])
    specimen.open_ledger()
    specimen.relax(STANDING, NEVER, damping=0.0, steps=2100)
    found = specimen.energies()
    assert found.elastic == pytest.approx(-0.5 * 0.1**2, rel=1e-6)
    assert found.slip > 0.3 * 0.1 * 1.9 + 0.5 * 0.1**2
    assert abs(found.error) <= 1e-6 * found.input


def test_fire_keeps_no_ledger() -> None:
    grains = at_rest(np.zeros(1), np.zeros(1), np.ones(1), np.ones(1))
    specimen = Specimen(grains, np.array([-2.0, 2.0, -2.0, 2.0]), Linear(1.0, 0.4, 0.4))
    specimen.open_ledger()
    with pytest.raises(ValueError, match="local damping"):
        specimen.relax(STANDING, NEVER, damping=FIRE, steps=1)
