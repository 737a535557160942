"""The flow equation against OpenPNM, on the same network and conductances."""

import numpy as np
import pytest

from demflow.model.flow.solvers.registry import SOLVERS
from tests.flow.bounds import OFF
from tests.peers.pressures import OPENPNM, ours, taken


@pytest.mark.slow
@pytest.mark.parametrize("method", SOLVERS)
def test_pressures_are_those_of_openpnm(method):
    """Kept by `tests/peers/pressures.py`: steady to 1e-8, transient to its accuracy."""
    with np.load(OPENPNM) as kept:
        network = {name[6:]: kept[name] for name in kept if name.startswith("given_")}
        made = taken(network)
        assert made.pores > 100
        name = "transient" if SOLVERS[method].transient else "steady"
        theirs = np.atleast_2d(kept[name])[:, : made.n]
    found = ours(made, method)
    assert np.ptp(theirs[-1]) > 0.1
    assert np.abs(found - theirs).max() <= OFF[method].peer
