"""How far a run is: bars on a terminal, lines in a log."""

from __future__ import annotations

import os
import sys
import time
from typing import TYPE_CHECKING, Any, TextIO

from demflow.sweep.execution.progress import Progress

if TYPE_CHECKING:
    from rich.live import Live
    from rich.table import Table

WAITING_SECONDS = 2.0  # s without any worker before that is told
BAR = 20  # characters of a bar
NARROW = 60  # characters of a terminal below which there are no bars
STILL_SECONDS = 25.0  # s without progress before that is told: within half a minute


class ProgressLine:
    """Writes `Progress` to a stream: in place on a terminal with bars, now and then elsewhere.

    On a terminal each stage that has something to run has a bar, too, which the end takes away.
    Colours are used on a terminal only, and not where NO_COLOR is set.
    """

    def __init__(self, stream: TextIO | None = None, every: float = 15.0):
        self.stream = sys.stderr if stream is None else stream
        self.in_place = self.stream.isatty() and os.environ.get("TERM") != "dumb"
        self.every = 0.1 if self.in_place else every
        self._last: float | None = None
        self._told: object = None
        self._stored: dict[str, int] | None = None  # runs of stages before this run
        self._live: Live | None = None

    def __call__(self, progress: Progress) -> None:
        """Show the state, unless the last one was shown a moment ago."""
        now = time.monotonic()
        early = self._last is not None and now - self._last < self.every
        text = line(progress)
        told = (text, progress.stages if self.in_place else ())
        if told == self._told or (early and progress.left):
            return
        self._last, self._told = now, told
        if not self.in_place:
            print(text, file=self.stream, flush=True)
            return
        if self._stored is None:
            self._stored = {one.stage: one.done for one in progress.stages}
        if self._live is None:
            self._live = _live(self.stream)
        self._live.update(self._shown(progress), refresh=True)

    def _shown(self, progress: Progress) -> Table:
        """The cases, and below them the stages of which some runs were missing at first."""
        from rich.progress_bar import ProgressBar
        from rich.table import Table
        from rich.text import Text

        assert self._live is not None
        wide = self._live.console.width >= NARROW
        rows = Table.grid(padding=(0, 1))
        one_line: dict[str, Any] = {"no_wrap": True, "overflow": "ellipsis"}
        if wide:
            rows.add_column(width=BAR)
        rows.add_column()

        def add(done: int, count: int, text: Text) -> None:
            full = ProgressBar(
                max(count, 1), done, BAR, complete_style="blue", finished_style="green"
            )
            rows.add_row(*([full] if wide else []), text)

        told = Text(line(progress), **one_line)
        if progress.failed:
            told.highlight_words([f"{progress.failed} failed"], "red")
        add(progress.cases - progress.left, progress.cases, told)
        for name, done, runs in progress.stages if progress.left else ():
            if (self._stored or {}).get(name, 0) < runs:
                add(done, runs, Text(f"{name}: {done} of {runs}", "dim", **one_line))
        return rows

    def close(self) -> None:
        """End what was written in place."""
        if self._live is not None:
            self._live.stop()
            self._live = None


def _live(stream: TextIO) -> Live:
    """Lines of a terminal that are written anew where they stand."""
    from rich.console import Console  # imported only where somebody looks
    from rich.live import Live

    live = Live(
        console=Console(file=stream, force_jupyter=False, highlight=False),
        auto_refresh=False,
        redirect_stdout=False,
        redirect_stderr=False,
        vertical_overflow="crop",
    )
    live.start()
    return live


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
