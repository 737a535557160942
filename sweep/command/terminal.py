"""Whoever reads what a command says: data go to stdout, messages to stderr.

A terminal may know few characters, or may not be there at all; what is shown is printable.
"""

from __future__ import annotations

import io
import os
import sys
from pathlib import Path

from demflow.sweep.printable import printable_lines


def ready() -> None:
    r"""Make the standard streams take any text.

    A character that a stream's encoding lacks is written as its escape. A stream that was closed
    before the command began leads nowhere; its number must not go to the next file that is opened.
    """
    if None in (sys.stdin, sys.stdout, sys.stderr):
        while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
            pass
        os.close(number)
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_WRONLY), "w", encoding="utf-8"))
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def settle() -> None:
    """Write out what stdout holds; what cannot be written must not be tried when Python ends."""
    try:
        sys.stdout.flush()
    except OSError:
        with Path(os.devnull).open("w", encoding="utf-8") as nowhere:
            os.dup2(nowhere.fileno(), sys.stdout.fileno())


def show(data: str) -> None:
    """Give a user data, on stdout."""
    print(printable_lines(data))


def say(message: str) -> None:
    """Tell a user something, on stderr."""
    print(printable_lines(message), file=sys.stderr, flush=True)
