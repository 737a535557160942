"""When a result is not good, and BLAS on one thread."""

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from demflow.model.quantities import CASE
from demflow.model.threads import one_blas_thread
from demflow.model.verdict import BOUNDS, verdict

SOUND = {name: np.asarray(0.5 * bound.most) for name, bound in BOUNDS.items()}


def test_every_measure_that_is_judged_is_recorded():
    assert set(BOUNDS) <= set(CASE)


def test_a_sound_case_is_good_with_and_without_an_estimate():
    assert verdict(SOUND) == ()
    assert verdict(SOUND | {"tolerance_met": np.asarray(1.0)}) == ()
    assert verdict(SOUND | {"tolerance_met": np.asarray(np.nan)}) == ()
    assert verdict({}) == ()


@pytest.mark.parametrize("name", BOUNDS)
@pytest.mark.parametrize("value", [268.0, np.nan, np.inf])
def test_a_measure_beyond_its_bound_is_named(name, value):
    (told,) = verdict(SOUND | {name: np.asarray(value)})
    assert name in told
    assert BOUNDS[name].says in told


def test_a_tolerance_that_was_missed_is_told():
    missed = {"tolerance_met": np.asarray(0.0), "estimated_error": np.asarray(0.02)}
    (told,) = verdict(SOUND | missed)
    assert "0.02" in told


def blas_threads():
    return [
        library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"
    ]


def test_blas_uses_one_thread_within_and_as_many_as_before_after():
    with one_blas_thread():
        pass  # the libraries are known now
    with threadpool_limits(limits=2, user_api="blas"):
        before = blas_threads()
        with one_blas_thread():
            assert set(blas_threads()) == {1}
        assert blas_threads() == before
