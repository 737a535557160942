"""One writer at a time, and no lock outlives its process."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest

from demflow.sweep.store.lock import FolderLock, LockedError

HOLD = (
    "import sys, time, pathlib\n"
    "from sweep.store.lock import FolderLock\n"
    "with FolderLock(pathlib.Path(sys.argv[1]), 'demflow run other'):\n"
    "    print('held', flush=True)\n"
    "    time.sleep(600)\n"
)


@pytest.fixture
def holder(tmp_path):
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.communicate()


def test_the_second_is_told_who_holds_it(tmp_path, holder):
    with pytest.raises(LockedError, match=f"process {holder.pid} .*demflow run other"):
        FolderLock(tmp_path).__enter__()


def test_the_lock_of_a_killed_process_is_taken_over(tmp_path, holder):
    holder.send_signal(signal.SIGKILL)
    holder.wait()
    assert (tmp_path / ".lock").exists()
    with FolderLock(tmp_path):
        pass
    assert list(tmp_path.iterdir()) == []


def test_it_is_released_also_after_an_error(tmp_path):
    def fail_inside() -> None:
        with FolderLock(tmp_path):
            with pytest.raises(LockedError, match=f"process {os.getpid()} "):
                FolderLock(tmp_path).__enter__()
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail_inside()
    with FolderLock(tmp_path):
        pass
