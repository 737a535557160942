"""Contacts in small displacements bear what the laws of contact say, and their tangent is true."""

import numpy as np
import pytest
from scipy.sparse import diags_array

from demflow.model.coupling.skeleton import (
    INTACT,
    borne,
    broken,
    forces,
    load_factors,
    skeleton_of,
    stored_energy,
)
from demflow.model.mechanics.contact.bonds import BROKEN_IN_TENSION
from demflow.model.mechanics.contact.contacts import contact_forces
from demflow.model.mechanics.specimen.rock import build_specimen
from demflow.model.mechanics.static.load_carrying import carrying, contacts_of
from tests.coupling.bored import BONDS, KN, joint, packed

CASES = {
    "parallel": (BONDS["parallel"], ()),
    "contact": (BONDS["contact"], ()),
    "unbonded": (None, ()),
    "jointed": (BONDS["parallel"], (joint(0.4),)),
    "cemented": (BONDS["contact"], (joint(0.4, cohesion=1e9, tensile_strength=1e9),)),
}


def specimen(name: str):
    bonds, joints = CASES[name]
    rock = build_specimen(packed(), KN, 2.5, 0.5, bonds, joints)
    carries = carrying(len(rock.grains.x), contacts_of(rock))
    rock.grains.radius[~carries] *= 0.9  # what rattles shall touch nothing
    return rock


def shift(n: int, size: float, seed: int = 3) -> np.ndarray:
    return size * np.random.default_rng(seed).standard_normal(3 * n + 2)


def true_forces(name: str, u: np.ndarray) -> np.ndarray:
    """Forces and torques of the explicit solver's law after a step u."""
    rock = specimen(name)
    grains, box, n = rock.grains, rock.box.copy(), len(rock.grains.x)
    grains.x[:] += u[:-2:3]
    grains.y[:] += u[1:-2:3]
    grains.vx[:], grains.vy[:], grains.spin[:] = u[:-2:3], u[1:-2:3], u[2:-2:3]
    box[1] += u[-2]
    box[3] += u[-1]
    sums = contact_forces(
        grains, rock.pairs, rock.bonds, rock.joints, rock.law, box, 1, 1.0, 0.0, 0.0, None
    )
    found = np.empty(3 * n + 2)
    found[:-2:3], found[1:-2:3], found[2:-2:3] = grains.fx, grains.fy, grains.torque
    found[-2:] = sums.right, sums.top
    return found


@pytest.mark.parametrize("name", [name for name in CASES if name != "unbonded"])
@pytest.mark.parametrize("size", [1e-6, 1e-5])
def test_forces_are_those_of_the_laws_to_second_order(name, size):
    skeleton, hold = skeleton_of(specimen(name))
    n = len(packed().x)
    # what bears no load is left out, and so are its motions
    used = np.zeros(n, bool)
    used[skeleton.a], used[skeleton.b[skeleton.b >= 0]] = True, True
    u = shift(n, size)
    u[:-2] *= np.repeat(used, 3)
    rest = np.zeros(3 * n + 2)
    ours = forces(skeleton, hold, borne(skeleton, hold, u), u)
    start = forces(skeleton, hold, borne(skeleton, hold, rest), rest)
    true = true_forces(name, u)
    every = np.append(np.repeat(used, 3), [True, True])
    assert np.abs(start - true_forces(name, rest))[every].max() < 1e-12
    # forces at hand times the turn of the contacts, and strains of second order
    assert np.abs(ours - true)[every].max() < 30 * size * (size + np.abs(start).max() + 1e-3)
    assert np.abs(ours - start)[every].max() > 0.5 * size


@pytest.mark.parametrize("name", CASES)
def test_the_tangent_is_that_of_the_forces(name):
    skeleton, hold = skeleton_of(specimen(name))
    n = len(packed().x)
    u, way = shift(n, 2e-4), shift(n, 1.0, 5)
    found = borne(skeleton, hold, u)
    b, s, m = skeleton.parting, skeleton.sliding, skeleton.bending
    tangent = (
        b.T @ diags_array(found.kn) @ b
        + s.T @ diags_array(found.ks) @ s
        + m.T @ diags_array(found.km) @ m
        - s.T @ diags_array(found.cross) @ b
    )
    h = 1e-9
    change = [
        forces(skeleton, hold, borne(skeleton, hold, u + k * h * way), u + k * h * way)
        for k in (-1, 1)
    ]
    slope = (change[1] - change[0]) / (2 * h)
    np.testing.assert_allclose(-(tangent @ way), slope, atol=1e-5 * np.abs(slope).max())
    if name in ("unbonded", "jointed"):
        assert found.slips.any()


@pytest.mark.parametrize("name", ["parallel", "contact"])
def test_energy_is_what_forces_give_back(name):
    skeleton, hold = skeleton_of(specimen(name))
    n = len(packed().x)
    hold = hold._replace(shear=0.0 * hold.shear)
    skeleton = skeleton._replace(friction=np.full(len(skeleton.a), 1e9))
    u, way, h = shift(n, 1e-5), shift(n, 1.0, 5), 1e-8

    def energy(at):
        return stored_energy(skeleton, hold, borne(skeleton, hold, at), at)

    gain = (energy(u + h * way) - energy(u - h * way)) / (2 * h)
    given = -forces(skeleton, hold, borne(skeleton, hold, u), u) @ way
    assert gain == pytest.approx(given, rel=1e-5)


@pytest.mark.parametrize("name", ["parallel", "contact"])
def test_cement_is_at_its_strength_where_the_laws_break_it(name):
    """Bonds of the explicit law break for one per mille more, and hold for one less."""
    skeleton, hold = skeleton_of(specimen(name))
    n = len(packed().x)
    u = shift(n, 1e-4)
    used = np.zeros(n, bool)
    used[skeleton.a], used[skeleton.b[skeleton.b >= 0]] = True, True
    u[:-2] *= np.repeat(used, 3)
    worst = max(f.max() for f in load_factors(skeleton, hold, borne(skeleton, hold, u)))
    for factor, breaks in ((0.99, False), (1.01, True)):
        rock = specimen(name)
        step = 1e-3 * u  # so small that its geometry does not matter
        rock.bonds.tensile_strength[:] *= 1e-3 * worst / factor
        rock.bonds.shear_strength[:] *= 1e-3 * worst / factor
        ours, memory = skeleton_of(rock)
        tension, shear = load_factors(ours, memory, borne(ours, memory, step))
        top = max(tension.max(), shear.max())
        assert (top > 1.0) == (factor * top > factor)
        grains = rock.grains
        grains.x[:] += step[:-2:3]
        grains.y[:] += step[1:-2:3]
        grains.vx[:], grains.vy[:], grains.spin[:] = step[:-2:3], step[1:-2:3], step[2:-2:3]
        rock.bonds.tensile_strength[:] *= top / factor
        rock.bonds.shear_strength[:] *= top / factor
        contact_forces(
            grains, rock.pairs, rock.bonds, rock.joints, rock.law, rock.box, 1, 1.0, 0.0, 0.0, None
        )
        assert np.any(rock.bonds.state != INTACT) == breaks


def test_broken_cement_bears_nothing_and_grains_go_on():
    skeleton, hold = skeleton_of(specimen("contact"))
    u = shift(len(packed().x), 2e-5)
    found = borne(skeleton, hold, u)
    k = int(np.flatnonzero((hold.mode == INTACT) & (found.cement_n > 0))[0])
    after = borne(skeleton, broken(skeleton, hold, found, u, k, BROKEN_IN_TENSION), u)
    assert after.cement_n[k] == after.cement_s[k] == 0.0
    assert after.normal[k] == pytest.approx(found.cement_n[k], rel=1e-12)
    assert abs(after.shear[k]) <= 0.5 * after.normal[k] * (1 + 1e-12)
    others = np.arange(len(skeleton.a)) != k
    np.testing.assert_array_equal(after.force[others], found.force[others])
