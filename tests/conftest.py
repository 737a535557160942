"""Hypothesis draws the same examples on every run, so that a red test stays red.

What runs cost is noted in a cache of the tests' own. Processes of tests take all cores:
threads of their libraries would wait for one another, which took most of the time of dense solves.
"""

import atexit
import gc
import os
import shutil
import sys
import tempfile
from pathlib import Path

import pytest
from hypothesis import settings

from tests import cache

settings.register_profile("reproducible", derandomize=True, deadline=None, database=None)
settings.load_profile("reproducible")

for library in ("OMP", "OPENBLAS", "MKL", "VECLIB_MAXIMUM"):  # read when NumPy is imported
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

# Processes are many, and each would compile all sources anew where none may keep them compiled.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

gc.disable()  # until all is imported, little of which is garbage

_notes = Path(tempfile.mkdtemp(prefix="demflow-tests-"))
atexit.register(shutil.rmtree, _notes, ignore_errors=True)
cache.share_sources(_notes)
os.environ.update(cache.variables(_notes))


def pytest_collection_modifyitems(items):
    """First what starts workers of its own and waits for them: other processes compute meanwhile.

    Where several of them came to such tests together, at the end, all would wait.
    """
    items.sort(key=lambda item: "forked_workers" not in item.fixturenames)


def pytest_collection_finish():
    """What is imported by now stays: each run that looks for garbage need not go through it.

    Figures leave much that refers to itself; to look for it seldom costs less.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 50)
    gc.enable()


@pytest.fixture(scope="module")
def packed_once():
    """Grains with which several tests begin are packed once; not for tests of packings."""
    from tests import packed  # with the kernels of mechanics

    with packed.once():
        yield


@pytest.fixture(scope="module")
def forked_workers():
    """The workers of a module are forked, which costs less than to start them."""
    from tests import standing  # with all of Dask

    with standing.forked_workers():
        yield


@pytest.fixture
def spawned_workers():
    """The workers of one test are started as a user's are."""
    from tests import standing  # with all of Dask

    with standing.spawned_workers():
        yield


@pytest.fixture(scope="session")
def standing_worker():
    """A worker process that stands for as long as the tests do."""
    from tests import standing  # with all of Dask

    with standing.standing_worker() as scheduler:
        yield scheduler


@pytest.fixture(scope="module")
def one_worker(standing_worker):
    """All runs of a module go to one worker that stands."""
    from tests import standing  # with all of Dask

    with standing.runs_on(standing_worker):
        yield
