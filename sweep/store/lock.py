"""One run at a time writes a results folder.

The lock is the kernel's (`flock`), so it ends with the process that holds it, however
that process ends: nothing is left for anyone to remove. What the file says is only for
the message to the second run.
"""

from __future__ import annotations

import fcntl
import json
import os
import socket
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType


class LockedError(RuntimeError):
    """Another run holds the results folder; the text says which."""


class FolderLock:
    """Hold `folder/.lock` while a `with` block runs. Raises LockedError if another does."""

    def __init__(self, folder: Path, purpose: str = "run"):
        self.path = Path(folder) / ".lock"
        self.purpose = purpose
        self._file: int | None = None

    def __enter__(self) -> FolderLock:
        while self._file is None:
            self._file = self._acquire()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._file is not None:
            # removed while it is held: whoever waits on this file finds it gone, and looks again
            with suppress(OSError):  # what stays is no lock once it is closed
                self.path.unlink()
            os.close(self._file)
            self._file = None

    def _acquire(self) -> int | None:
        file = os.open(self.path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise LockedError(self._holder()) from None
            if not self._still_there(file):
                os.close(file)
                return None
            with suppress(OSError):  # the lock holds without a name in it
                os.ftruncate(file, 0)
                os.write(file, json.dumps(self._who()).encode())
        except BaseException:
            os.close(file)
            raise
        return file

    def _still_there(self, file: int) -> bool:
        """Whether the file that was locked is the one that the path names now."""
        with suppress(FileNotFoundError):
            return os.path.samestat(os.fstat(file), self.path.stat())
        return False

    def _who(self) -> dict[str, str | int]:
        return {
            "pid": os.getpid(),
            "host": socket.gethostname(),
            "since": datetime.now(UTC).isoformat(timespec="seconds"),
            "purpose": self.purpose,
        }

    def _holder(self) -> str:
        folder = self.path.parent
        try:
            who = json.loads(self.path.read_text())
            return (
                f"{folder} is in use by process {who['pid']} on {who['host']} "
                f"({who['purpose']}, since {who['since']}); wait for it, or end it"
            )
        except (OSError, ValueError, KeyError, TypeError):
            # the other process is between taking the lock and writing its name
            return f"{folder} is in use by another process; wait for it, or end it"
