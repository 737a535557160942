"""How large the sums are from which errors of responses are told apart."""

import numpy as np
import pytest

from demflow.model.flow.solvers.share import pulse

RISES = {
    "closed rock": lambda t: t,
    "a side far away": lambda t: np.exp(-3.0 / np.maximum(t, 1e-9)),
    "what settles": lambda t: 1.0 - np.exp(-t),
    "what goes on": lambda t: np.log1p(t),
}


@pytest.mark.parametrize("rise", RISES)
@pytest.mark.parametrize("shortest", [1e-2, 0.3, 5.0, 1e3])
def test_a_pulse_is_told_no_larger_than_it_is_and_not_much_smaller(rise, shortest):
    """Against all pulses on a fine grid, for lags off it."""
    response = RISES[rise]
    lag = np.geomspace(1.7e-3, 1e4, 61)
    fine = np.geomspace(1e-4, 1e4, 4001)
    right = np.abs(response(fine) - response(np.maximum(fine - shortest, 0.0))).max()
    found = pulse(lag, response(lag)[:, None], 2, shortest)[0]
    assert 0.3 * right <= found <= right * (1.0 + 1e-9)


def test_a_source_of_one_step_moves_all_that_it_does():
    response = np.array([[0.0, 1.0], [-3.0, 1.5], [2.0, 2.0]])
    assert pulse(np.array([0.0, 1.0, 2.0]), response, 1, np.inf).tolist() == [3.0, 2.0]
