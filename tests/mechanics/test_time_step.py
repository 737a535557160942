"""The time step is stable whatever the ratios of stiffnesses, by the spectrum of K and M."""

import numpy as np
import pytest
from scipy.sparse import diags_array
from scipy.sparse.linalg import eigsh

from demflow.model.mechanics.loading.stress import load
from demflow.model.mechanics.motion.equilibrium import Specimen
from demflow.model.mechanics.specimen.rock import build_specimen
from demflow.model.mechanics.static.load_carrying import contacts_of
from demflow.model.mechanics.static.stiffness import matrix
from demflow.model.scene import Bonds, Stress
from tests.mechanics.rocks import packed

KN = 40e9
RATIOS = [0.1, 0.2, 0.5, 1.0, 2.5, 10.0]


def cement(kind: str | None, **more) -> Bonds | None:
    if kind is None:
        return None
    return Bonds(kind=kind, tensile_strength=1e12, shear_strength=1e12, **more)


def over_critical(specimen: Specimen) -> float:
    """The time step over 2 / ω, beyond which leapfrog is unstable, while contacts hold."""
    grains, n = specimen.grains, len(specimen.grains.x)
    stiffness = matrix(grains, contacts_of(specimen), specimen.bonds, specimen.law)
    weight = np.sqrt(grains.inverse_mass)
    scale = diags_array(np.column_stack((weight, weight, weight / grains.radius)).ravel())
    modes = scale @ stiffness[: 3 * n, : 3 * n] @ scale  # walls stand
    largest = eigsh(modes, k=1, which="LA", return_eigenvectors=False, tol=1e-4)[0]
    return 0.5 * specimen.dt * float(np.sqrt(largest))


@pytest.mark.slow
@pytest.mark.parametrize("ratio", RATIOS)
@pytest.mark.parametrize(
    ("porosity", "kind", "sizes"),
    [(0.165, "random", 1.66), (0.165, "random", 10.0), (None, "hexagonal", 1.0)],
)
def test_the_step_lies_below_the_critical_one(
    porosity: float | None, kind: str, sizes: float, ratio: float
) -> None:
    rock = packed(porosity, count=150, kind=kind, ratio=sizes)
    parallel = [
        cement("parallel", modulus=modulus, stiffness_ratio=of_bonds)
        for modulus in (0.1 * KN, None, 10.0 * KN)
        for of_bonds in (None, 0.1, 10.0)
    ]
    kinds = [cement(None), cement("contact"), *parallel]
    for bonds in kinds:
        found = over_critical(build_specimen(rock, KN, ratio, 0.5, bonds))
        assert 0.2 < found < 0.95, bonds


@pytest.mark.slow
@pytest.mark.parametrize("ratio", RATIOS)
@pytest.mark.parametrize("kind", [None, "contact", "parallel"])
def test_grains_come_to_rest_at_any_stiffness_ratio(ratio: float, kind: str | None) -> None:
    """1.2:1 lies far within the strength."""
    state = load(
        packed(count=150),
        normal_stiffness=KN,
        stiffness_ratio=ratio,
        friction=0.5,
        bonds=cement(kind),
        stress=Stress(xx=12e6, yy=10e6, method="explicit"),
    )
    np.testing.assert_allclose(state.wall_stress, np.array([12, 12, 10, 10]) * 1e6, rtol=1e-3)
    assert float(state.unbalanced_ratio) <= 1e-3
    assert int(state.steps) < 10_000
