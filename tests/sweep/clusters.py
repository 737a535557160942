"""A Dask cluster of real processes on the loopback, each in a folder of its own.

They are forked from one that has imported Dask and nothing else: to import it takes a process four
times as long as all the rest that it does before it stands.
"""

from __future__ import annotations

import atexit
import json
import os
import signal
import subprocess
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import NamedTuple

import psutil

from tests.sweep.processes import wait_until

ROOT = Path(__file__).parents[2]
LOCAL = ("--host", "127.0.0.1", "--dashboard-address", "127.0.0.1:0")
PATIENCE = 120.0  # s for all processes to stand
# Dask's own watching, which costs each of the processes a few per cent of a processor
UNWATCHED = {
    "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False",
    "DASK_DISTRIBUTED__ADMIN__TICK__INTERVAL": "1s",
    "DASK_DISTRIBUTED__ADMIN__SYSTEM_MONITOR__INTERVAL": "10s",
}


class Cluster(NamedTuple):
    """A scheduler's address, the processes, and the folder that holds all."""

    address: str
    workers: list[psutil.Process]
    folder: Path
    scheduler: psutil.Process


class Certificate(NamedTuple):
    """Files of a certificate that vouches for itself, and of its key."""

    certificate: Path
    key: Path

    @property
    def options(self) -> tuple[str, ...]:
        """How `dask scheduler` and `dask worker` are told of it."""
        own = ("--tls-cert", str(self.certificate), "--tls-key", str(self.key))
        return ("--protocol", "tls", "--tls-ca-file", str(self.certificate), *own)

    @property
    def configuration(self) -> dict[str, str]:
        """How a client's Dask is told of it."""
        files = {"ca-file": self.certificate, "client.cert": self.certificate}
        files["client.key"] = self.key
        return {f"distributed.comm.tls.{name}": str(file) for name, file in files.items()}

    @property
    def environment(self) -> dict[str, str]:
        """The same, for a client in a process of its own."""
        return {
            "DASK_" + name.upper().replace(".", "__").replace("-", "_"): file
            for name, file in self.configuration.items()
        }


def certificate(folder: Path) -> Certificate:
    """Make a certificate for this machine, valid for a day."""
    made = Certificate(folder / "certificate.pem", folder / "key.pem")
    command = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "1"]
    command += ["-subj", "/CN=demflow", "-addext", "subjectAltName=IP:127.0.0.1"]
    command += ["-out", str(made.certificate), "-keyout", str(made.key)]
    subprocess.run(command, check=True, capture_output=True)
    return made


@contextmanager
def dask_cluster(
    folder: Path,
    workers: int = 2,
    certificate: Certificate | None = None,
    options: tuple[str, ...] = (),
) -> Iterator[Cluster]:
    """Start `dask scheduler` and as many `dask worker`s with some options, and end them all."""
    folder.mkdir()
    contact = folder / "contact.json"
    secured = () if certificate is None else certificate.options
    with ExitStack() as stack:
        scheduler = ("scheduler", *LOCAL, *secured, "--port", "0")
        main = stack.enter_context(
            _process(folder / "scheduler", *scheduler, "--scheduler-file", str(contact))
        )
        worker = ("worker", *LOCAL, *secured, *options, "--nthreads", "1")
        worker += ("--scheduler-file", str(contact))
        started = [
            stack.enter_context(_process(folder / f"worker-{k}", *worker)) for k in range(workers)
        ]
        wait_until(lambda: _written(contact) and all(map(_has_worker, started)), PATIENCE)
        yield Cluster(json.loads(contact.read_text())["address"], started, folder, main)


@contextmanager
def extra_worker(address: str, folder: Path, *options: str) -> Iterator[psutil.Process]:
    """Let one more `dask worker` join a scheduler while a `with` block runs."""
    with _process(folder, "worker", address, *LOCAL, *options) as started:
        wait_until(lambda: "Registered to" in (folder / "log").read_text(), PATIENCE)
        yield started


def _written(contact: Path) -> bool:
    return contact.exists() and contact.read_text().endswith("}")


def _has_worker(nanny: psutil.Process) -> bool:
    return any("spawn_main" in " ".join(child.cmdline()) for child in _children(nanny))


def _children(process: psutil.Process) -> list[psutil.Process]:
    return process.children(recursive=True)


@contextmanager
def _process(folder: Path, *arguments: str) -> Iterator[psutil.Process]:
    """`dask …` in a folder of its own."""
    folder.mkdir()
    (folder / "log").touch()
    server = _server()
    assert server.stdin is not None
    assert server.stdout is not None
    print(json.dumps([str(folder), arguments]), file=server.stdin, flush=True)
    started = psutil.Process(int(server.stdout.readline()))
    try:
        yield started
    finally:
        with suppress(psutil.NoSuchProcess):
            family = _children(started)
            started.terminate()
            try:
                started.wait(10)
            except psutil.TimeoutExpired:
                started.kill()
                started.wait()
            for child in family:
                if child.is_running():
                    child.kill()


@cache
def _server() -> subprocess.Popen[str]:
    """What forks, for as long as the tests run."""
    pipe = subprocess.PIPE
    server = subprocess.Popen(
        [sys.executable, "-c", "from tests.sweep.clusters import serve; serve()"],
        env={**os.environ, **UNWATCHED, "PYTHONPATH": str(ROOT)},
        stdin=pipe,
        stdout=pipe,
        text=True,
    )
    atexit.register(server.communicate)
    return server


def serve() -> None:
    """Fork `dask …` for each line of standard input, its folder and arguments; write its number."""
    from dask import cli
    from distributed.cli import dask_scheduler, dask_worker  # noqa: F401 (which it runs)

    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for them here
    for line in sys.stdin:
        folder, arguments = json.loads(line)
        if process := os.fork():
            print(process, flush=True)
            continue
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        _become(folder, cli.run_cli, arguments)


def _become(folder: str, run: Callable[[], None], arguments: list[str]) -> None:
    """Run Dask's command line in a folder with a log, and end this process."""
    status = 1
    try:
        os.chdir(folder)
        log = os.open("log", os.O_WRONLY)
        null = os.open(os.devnull, os.O_RDONLY)
        for stream, own in enumerate((null, log, log)):
            os.dup2(own, stream)
        sys.argv = ["dask", *arguments]
        run()
        status = 0
    except SystemExit as end:
        status = int(end.code or 0)
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)
