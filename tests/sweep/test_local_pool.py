"""Worker processes of this machine, without a run."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys

import psutil
import pytest
from distributed.core import rpc
from distributed.security import Security

from demflow.sweep.errors import RunError
from demflow.sweep.execution import certificate, local
from demflow.sweep.execution.local import LocalPool
from demflow.sweep.execution.pool import silent_loops

pytestmark = pytest.mark.slow


def starting(known: set[int]) -> list[psutil.Process]:
    """Worker processes that were not there before."""
    found = []
    for process in psutil.Process().children(recursive=True):
        try:
            if process.pid not in known and "spawn_main" in " ".join(process.cmdline()):
                found.append(process)
        except psutil.Error:
            continue
    return found


async def storm(kills: int) -> int:
    """Kill so many workers as they start; how many stand in the end."""
    killed: set[int] = set()
    async with LocalPool(2) as pool:
        pool.ask_for(2)
        async with asyncio.timeout(60.0):
            while len(await pool.look()) < 2 or len(killed) < kills:
                if len(killed) < kills:
                    for process in starting(killed)[:1]:
                        process.kill()
                        killed.add(process.pid)
                await asyncio.sleep(0.02)
        return len(await pool.look())


def test_workers_killed_while_they_start_are_replaced_each_time(monkeypatch):
    """However often: only of those that end by themselves a few say that none can be had."""
    monkeypatch.setattr(local, "START_ATTEMPTS", 1)
    monkeypatch.setattr(local, "START_SECONDS", 0.0)
    with silent_loops():
        assert asyncio.run(storm(3)) == 2


def test_workers_that_something_kills_as_they_start_end_the_run_with_a_word(monkeypatch):
    monkeypatch.setattr(local, "KILLED_SECONDS", 0.0)
    with silent_loops(), pytest.raises(RunError, match="were killed as they started, by signal 9"):
        asyncio.run(storm(3))


async def hung(known: set[int]) -> psutil.Process:
    """A worker that stands still as it starts."""
    async with asyncio.timeout(60.0):
        while not (found := starting(known)):
            await asyncio.sleep(0.02)
    found[0].suspend()
    return found[0]


def test_another_takes_the_place_of_a_worker_that_hangs_as_it_starts(monkeypatch):
    async def numbers(known: set[int]) -> tuple[bool, int]:
        async with LocalPool(1) as pool:
            first = await hung(known)
            monkeypatch.setattr(local, "HUNG_SECONDS", 0.0)
            async with asyncio.timeout(60.0):
                while first.is_running():  # it is found before its nanny knows its number
                    await pool.look()
                    await asyncio.sleep(0.02)
            monkeypatch.undo()
            async with asyncio.timeout(60.0):
                while not (found := await pool.look()):
                    await asyncio.sleep(0.02)
            return first.is_running(), len(found)

    with silent_loops():
        assert asyncio.run(numbers({p.pid for p in starting(set())})) == (False, 1)


def test_a_worker_that_hangs_as_it_starts_does_not_outlive_its_run():
    async def left(known: set[int]) -> psutil.Process:
        async with LocalPool(1):
            return await hung(known)

    with silent_loops():
        assert not asyncio.run(left({p.pid for p in starting(set())})).is_running()


def test_no_more_workers_stand_than_have_something_to_do():
    async def numbers() -> list[int]:
        async with LocalPool(2) as pool:
            found = []
            for asked, stand in ((0, 1), (5, 2), (1, 2)):
                pool.ask_for(asked)
                async with asyncio.timeout(60.0):
                    while len(await pool.look()) < stand:
                        await asyncio.sleep(0.05)
                found.append(len(pool.cluster.worker_spec))
            return found

    with silent_loops():
        assert asyncio.run(numbers()) == [1, 2, 2]


def test_the_environment_of_whoever_runs_stays_as_it_was(monkeypatch):
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    before = dict(os.environ)

    async def start() -> None:
        async with LocalPool(1) as pool, asyncio.timeout(60.0):
            while not await pool.look():
                await asyncio.sleep(0.05)
            assert os.environ["OMP_NUM_THREADS"] == "1"

    with silent_loops():
        asyncio.run(start())
    names = local.ENVIRONMENT
    assert {n: os.environ.get(n) for n in names} == {n: before.get(n) for n in names}


def test_every_run_has_another_certificate_and_loads_nothing_to_make_it():
    code = (
        "import sys; from demflow.sweep.execution.certificate import made; a, b = made(), made()\n"
        "assert not set(a) & set(b) and 'cryptography' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_what_its_process_is_warned_of_is_no_part_of_a_certificate(monkeypatch):
    monkeypatch.setenv("PYTHONPROFILEIMPORTTIME", "1")  # tells on the stream of errors
    for part in certificate.made():
        assert part.startswith("-----BEGIN ")
        assert part.endswith("-----\n")


def test_no_process_stays_that_nobody_asks_for_its_certificate():
    before = set(psutil.Process().children())
    certificate.begin()
    assert len(set(psutil.Process().children()) - before) == 1
    certificate.forget()
    certificate.forget()
    assert set(psutil.Process().children()) == before


@pytest.mark.parametrize(("program", "status"), [("exit 3", 3), ("exec sleep 60", -9)])
def test_where_no_certificate_can_be_made_the_run_ends_with_a_word(
    tmp_path, monkeypatch, program, status
):
    maker = tmp_path / "maker"
    maker.write_text(f"#!/bin/sh\n{program}\n")
    maker.chmod(0o755)
    monkeypatch.setattr(certificate, "get_executable", lambda: str(maker))
    monkeypatch.setattr(certificate, "MAKING_SECONDS", 1.0)
    with pytest.raises(RunError, match=f"could be made .* ended with status {status}"):
        asyncio.run(LocalPool(1).__aenter__())


@pytest.mark.parametrize("scheme", ["tcp", "tls"])
def test_whoever_has_not_the_key_of_the_run_is_let_in_nowhere(scheme):
    """Neither plainly nor with a certificate of their own: to the scheduler, nannies, workers."""
    own = Security.temporary() if scheme == "tls" else Security()
    arguments = own.get_connection_args("client")

    async def reach(address: str) -> None:
        asked = rpc(address.replace("tls", scheme), connection_args=arguments, timeout=1)
        async with asked as there:
            await there.identity()

    async def attempts() -> None:
        async with LocalPool(1) as pool:
            async with asyncio.timeout(60.0):
                while not (workers := await pool.look()):
                    await asyncio.sleep(0.05)
            nannies = [nanny.address for nanny in pool.cluster.workers.values()]
            for address in (pool.cluster.scheduler_address, *workers, *nannies):
                with pytest.raises(
                    OSError, match=r"[Tt]imed out|closed|handshake|certificate|established"
                ):
                    await reach(address)
            assert await pool.call(next(iter(workers)), abs, -1) == 1

    with silent_loops():
        asyncio.run(attempts())
