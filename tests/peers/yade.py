"""Run a script of this folder in Yade, which has a Python of its own."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np


class PeerMissingError(RuntimeError):
    """A program to compare with is not installed."""


def run_in_yade(script: str, **case: object) -> dict[str, np.ndarray]:
    """Hand arrays to a script, single-threaded, and return the arrays that it leaves.

    Raises PeerMissingError without Yade, RuntimeError where the script fails.
    """
    if shutil.which("yade") is None:
        raise PeerMissingError("Yade is not installed: apt-get install yade")
    with tempfile.TemporaryDirectory() as folder:
        given, result = Path(folder, "case.npz"), Path(folder, "result.npz")
        np.savez(given, **case)
        # Yade must not see this environment
        env = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "VIRTUAL"))}
        env |= {"CASE": str(given), "RESULT": str(result), "OMP_NUM_THREADS": "1"}
        command = ["yade", "-n", "-x", "-j1", str(Path(__file__).with_name(script))]
        done = subprocess.run(command, env=env, capture_output=True, text=True)
        if not result.exists():
            raise RuntimeError(f"Yade ended without a result: {done.stdout}{done.stderr}"[-2000:])
        with np.load(result) as found:
            return dict(found)
