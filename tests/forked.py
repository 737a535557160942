"""Code in processes of its own that cost little: forked from one that holds the libraries.

To start Python and import Numba takes ten times what most of such code does. The process that is
forked holds nothing of ours, so that each finds the package anew where it is told to look.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

SERVE = "from tests.forked import serve; serve()"


class Forks(NamedTuple):
    """What forks one process after another."""

    server: subprocess.Popen[str]

    def answer(self, code: str, folder: Path, environment: Mapping[str, str]) -> str:
        """What some code prints that runs in a folder, whose modules come before all others."""
        assert self.server.stdin is not None
        assert self.server.stdout is not None
        print(
            json.dumps([code, str(folder), dict(environment)]), file=self.server.stdin, flush=True
        )
        status, printed = json.loads(self.server.stdout.readline())
        assert status == 0, printed
        return str(printed)


@contextmanager
def forks() -> Iterator[Forks]:
    """Hold Numba ready while a `with` block runs."""
    pipe = subprocess.PIPE
    with subprocess.Popen(
        [sys.executable, "-c", SERVE],
        cwd=Path(__file__).parents[1],
        stdin=pipe,
        stdout=pipe,
        text=True,
    ) as server:
        yield Forks(server)
        server.communicate()


def serve() -> None:
    """Fork a process for each line of standard input, and write what it printed."""
    import numba

    numba.njit(lambda x: x + 1)(1)  # which has Numba set up all that it wants for compiling
    assert not [name for name in sys.modules if name.startswith("demflow")]
    for line in sys.stdin:
        told, tell = os.pipe()
        process = os.fork()
        if not process:
            os.dup2(tell, 1)
            os.dup2(tell, 2)
            _run(*json.loads(line))
        os.close(tell)
        with os.fdopen(told) as pipe:
            printed = pipe.read()
        _, status = os.waitpid(process, 0)
        print(json.dumps([status, printed]), flush=True)


def _run(code: str, folder: str, environment: dict[str, str]) -> None:
    """Run some code, and end this process."""
    from numba.core import config

    status = 1
    try:
        os.environ.clear()
        os.environ.update(environment)
        config.reload_config()
        os.chdir(folder)
        sys.path.insert(0, folder)
        sys.dont_write_bytecode = bool(environment.get("PYTHONDONTWRITEBYTECODE"))
        exec(compile(code, "<code>", "exec"), {"__name__": "__main__"})
        status = 0
    except BaseException:
        sys.excepthook(*sys.exc_info())
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)
