"""Runs in processes of their own: started, killed, and looked for afterwards."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import psutil

ROOT = Path(__file__).parents[2]
MARK = "DEMFLOW_TEST_RUN"  # in the environment of a run, which all its processes inherit


class Run(NamedTuple):
    """A command that runs, and the mark that all processes of it bear."""

    process: subprocess.Popen[str]
    mark: str

    def all(self) -> list[psutil.Process]:
        """Every living process of the run, also those that have lost their parent."""
        found = []
        for process in psutil.process_iter():
            try:
                if (
                    process.environ().get(MARK) == self.mark
                    and process.status() != psutil.STATUS_ZOMBIE
                ):
                    found.append(process)
            except psutil.Error:
                continue
        return found

    def workers(self) -> list[psutil.Process]:
        """The worker processes, those that have just been started too."""
        return [p for p in self.all() if "spawn_main" in _command(p)]

    def left_after(self, seconds: float) -> list[psutil.Process]:
        """What of it still lives when all has had some time to end."""
        end = time.monotonic() + seconds
        while (living := self.all()) and time.monotonic() < end:
            time.sleep(0.02)
        return living

    def finish(self, seconds: float = 600.0) -> tuple[int, str, str]:
        """Wait for it: exit status, stdout and stderr."""
        out, err = self.process.communicate(timeout=seconds)
        return self.process.returncode, out, err


def wait_until(condition: Callable[[], object], seconds: float = 60.0) -> None:
    """Wait until something holds. Raises AssertionError where it does not come to that."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.02)


def start(study: Path, results: Path, *options: str, **environment: str) -> Run:
    """Start `demflow run` on the toy stages."""
    command = [sys.executable, "-m", "tests.sweep.toys", "run", str(study)]
    mark = uuid.uuid4().hex
    process = subprocess.Popen(
        [*command, "--results", str(results), *options],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT), MARK: mark, **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=_hear_interrupts,
    )
    return Run(process, mark)


def _hear_interrupts() -> None:
    """A run hears Ctrl-C also where the tests themselves run in the background, which do not."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def products(results: Path) -> dict[str, tuple[int, int]]:
    """Every stored product: its file's inode and time, which a second writing changes."""
    found = {}
    for path in results.glob("store/*/*.product"):
        stat = path.stat()
        found[path.name] = (stat.st_ino, stat.st_mtime_ns)
    return found


class Watch:
    """Products as they were first seen, and those that were written again after that."""

    def __init__(self, results: Path):
        self.results = results
        self.first: dict[str, tuple[int, int]] = {}
        self.again: set[str] = set()

    def look(self, *_: object) -> None:
        """See what is stored now; serves as the `progress` of a run."""
        for name, found in products(self.results).items():
            if self.first.setdefault(name, found) != found:
                self.again.add(name)


def leftovers(results: Path) -> list[Path]:
    """Half files, and the lock."""
    return [*results.rglob("*.partial"), *results.rglob(".lock")]


def _command(process: psutil.Process) -> str:
    try:
        return " ".join(process.cmdline())
    except psutil.Error:
        return ""
