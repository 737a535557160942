"""BLAS on one thread within the solvers, and as before outside."""

from threadpoolctl import threadpool_info, threadpool_limits

from demflow.model.threads import one_blas_thread


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
