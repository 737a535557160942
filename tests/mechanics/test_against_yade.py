"""Contact forces against those of an independent code, on the same grains and loads."""

import numpy as np
import pytest

from demflow.model.products import Packing
from tests.peers.grain_forces import CASES, DATA, Forces, difference, forces_of


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_contact_forces_are_those_of_yade(name):
    """Kept by `tests/peers/grain_forces.py`; 0.02 to 0.6 % when it was."""
    with np.load(DATA / "yade.npz") as kept:
        packing = Packing(
            **{key: kept[f"packing_{key}"] for key in Packing._fields if key != "scale"}
        )
        theirs = Forces(*(kept[f"{name}_{key}"] for key in Forces._fields))
    ours = forces_of(CASES[name].load(packing), float(packing.radius.mean()))
    assert len(ours.a) > 1.5 * len(packing.x)
    assert difference(ours, theirs) < 0.01
