"""Hypothesis draws the same examples on every run, so that a red test stays red.

What runs cost is noted in a cache of the tests' own.
"""

import atexit
import os
import shutil
import tempfile
from pathlib import Path

import pytest
from hypothesis import settings

from tests import cache

settings.register_profile("reproducible", derandomize=True, deadline=None, database=None)
settings.load_profile("reproducible")

_notes = Path(tempfile.mkdtemp(prefix="demflow-tests-"))
atexit.register(shutil.rmtree, _notes, ignore_errors=True)
os.environ.update(cache.variables(_notes))


@pytest.fixture(scope="module")
def one_worker():
    """All runs of a module go to one worker process that stands for as long as the tests do."""
    from tests import standing  # with all of Dask

    with standing.one_worker():
        yield
