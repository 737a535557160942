"""Whoever reads what a command says: data go to stdout, messages to stderr.

A terminal may know few characters, or may not be there at all; what is shown is printable.
"""

from __future__ import annotations

import io
import os
import shutil
import sys
import textwrap
from pathlib import Path
from typing import TextIO

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


def show(data: str, *, sentences: bool = False) -> None:
    """Give a user data, on stdout.

    Parameters
    ----------
    data : lines
    sentences : whether a terminal may break them
    """
    text = printable_lines(data)
    print(_broken(text, sys.stdout) if sentences else text)


def say(message: str) -> None:
    """Tell a user something, on stderr."""
    print(_broken(printable_lines(message), sys.stderr), file=sys.stderr, flush=True)


def _broken(text: str, stream: TextIO) -> str:
    """Text whose lines are broken between words where a terminal is narrower; else as it is.

    A line that is indented, as one quoted from a study, stays.
    """
    if not stream.isatty():
        return text
    width = max(shutil.get_terminal_size().columns, 40)
    return "\n".join(
        line
        if len(line) <= width or line[0].isspace()
        else textwrap.fill(
            line, width, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False
        )
        for line in text.split("\n")
    )
