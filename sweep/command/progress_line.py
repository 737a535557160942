"""How far a run is, as a line on a terminal or in a log."""

from __future__ import annotations

import os
import shutil
import sys
import time
from typing import TextIO

from demflow.sweep.execution.progress import Progress

WAITING_SECONDS = 2.0  # s without any worker before that is told
BAR = 20  # characters of the bar
STILL_SECONDS = 25.0  # s without progress before that is told: within half a minute


class ProgressLine:
    """Writes `Progress` to a stream: in place on a terminal with a bar, now and then elsewhere.

    Colours are used on a terminal only, and not where NO_COLOR is set. A line that is wider than
    the terminal would leave pieces of itself behind: the bar goes first, then the end of the text.
    """

    def __init__(self, stream: TextIO | None = None, every: float = 15.0):
        self.stream = sys.stderr if stream is None else stream
        self.in_place = self.stream.isatty()
        self.coloured = self.in_place and not os.environ.get("NO_COLOR")
        self.every = 0.1 if self.in_place else every
        self._last: float | None = None
        self._text = ""
        self._width = 0

    def __call__(self, progress: Progress) -> None:
        """Show the state, unless the last one was shown a moment ago."""
        now = time.monotonic()
        early = self._last is not None and now - self._last < self.every
        text = line(progress)
        if text == self._text or (early and progress.left):
            return
        self._last, self._text = now, text
        if not self.in_place:
            print(text, file=self.stream, flush=True)
            return
        text = self._fitted(progress, text)
        padding = " " * max(self._width - len(text), 0)
        self._width = len(text)
        if self.coloured and progress.failed:
            failed = f"{progress.failed} failed"
            text = text.replace(failed, f"\033[31m{failed}\033[0m")
        print(f"\r{text}{padding}", end="", file=self.stream, flush=True)

    def _fitted(self, progress: Progress, text: str) -> str:
        """The line with its bar, or what of it the terminal has room for."""
        room = shutil.get_terminal_size().columns - 1
        if len(text) + BAR + 1 <= room:
            return f"{bar(progress, getattr(self.stream, 'encoding', None))} {text}"
        return text if len(text) <= room else text[: room - 3] + "..."

    def close(self) -> None:
        """End the line that was written in place."""
        if self.in_place and self._width:
            print(file=self.stream, flush=True)
            self._width = 0


def bar(progress: Progress, encoding: str | None) -> str:
    """How many of the cases have ended, in `BAR` characters that a stream can write."""
    try:
        full, empty = "█░"
        (full + empty).encode(encoding or "ascii")
    except (UnicodeEncodeError, LookupError):
        full, empty = "#-"
    ended = BAR * (progress.cases - progress.left) // max(progress.cases, 1)
    return full * ended + empty * (BAR - ended)


def line(progress: Progress) -> str:
    """Return one line of text: done, failed, left, time to go."""
    told = (
        f"{progress.done} of {progress.cases} cases done, {progress.failed} failed, "
        f"{progress.left} left"
    )
    if not progress.left:
        return told
    if progress.ending:
        told += ", ending with what runs; Ctrl-C again stops at once"
    elif progress.waiting > WAITING_SECONDS:
        told += f", no worker for {duration(progress.waiting)}: waiting"
    elif progress.compiling:
        told += ", compiling: once on this machine"
    elif progress.seconds_left is None:
        told += ", time to go unknown yet"
    else:
        left = progress.seconds_left
        told += f", {'less than a second' if left < 1.0 else duration(left)} to go"
    if progress.still > STILL_SECONDS:
        ended = f", {progress.deaths} have died" if progress.deaths else ""
        told += (
            f" (last progress {duration(progress.still)} ago; workers: {progress.workers}{ended})"
        )
    return told


def duration(seconds: float | None) -> str:
    """Return a time span as people say it: 30 ms, 8.0 s, 3 min, 2 h 05 min."""
    if seconds is None:
        return "unknown time"
    if 0 < seconds < 0.0995:
        return f"{1000 * seconds:.2g} ms"
    if seconds < 9.95:
        return f"{seconds:.1f} s"
    if seconds < 99.5:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60:02d} min"


def size(count: float) -> str:
    """Return a number of bytes as people say it: 3.1 MB."""
    step = sum(count >= 999.5 * 1000**power for power in range(3))
    count /= 1000**step
    whole = step == 0 or count >= 99.5
    return f"{count:.{0 if whole else 1}f} {('B', 'kB', 'MB', 'GB')[step]}"
