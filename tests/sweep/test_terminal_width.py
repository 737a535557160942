"""What a terminal shows fits its width; what a pipe gets stays one line."""

import io
import sys

import numpy as np
import pytest

from demflow.sweep.command.terminal import say, show


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.parametrize("columns", [80, 200])
def test_sentences_break_between_words(monkeypatch, columns):
    monkeypatch.setenv("COLUMNS", str(columns))
    rng = np.random.default_rng(columns)
    words = ["x" * int(n) for n in rng.integers(1, 20, 200)]
    quoted = "    " + "y" * 300
    for stream, tell in (("stdout", lambda t: show(t, sentences=True)), ("stderr", say)):
        for terminal in (Terminal(), io.StringIO()):
            monkeypatch.setattr(sys, stream, terminal)
            tell(f"{' '.join(words)}\n{quoted}")
            *lines, last = terminal.getvalue().rstrip("\n").split("\n")
            assert last == quoted
            assert " ".join(lines).split() == words
            if terminal.isatty():
                assert max(map(len, lines)) <= columns
                assert all(line.startswith("  ") for line in lines[1:])
            else:
                assert len(lines) == 1
