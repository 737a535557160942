"""Time LAMMPS on given discs; `make peers` installs it into .peers."""

from __future__ import annotations

import os
import re
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from tests.peers.yade import PeerMissingError

FOLDER = Path(__file__).resolve().parent
ENVIRONMENT = FOLDER.parents[1] / ".peers"


def lammps_steps(
    x: np.ndarray,
    y: np.ndarray,
    radius: np.ndarray,
    size: np.ndarray,
    *,
    friction: float,
    steps: int,
    repeats: int,
) -> tuple[list[float], float]:
    """Processor time of each run of `steps` steps on discs in a periodic box, contacts per disc.

    Raises PeerMissingError where LAMMPS is not installed.
    """
    program = Path(os.environ.get("LAMMPS", ENVIRONMENT / "bin" / "lmp"))
    if not program.exists():
        raise PeerMissingError("LAMMPS is not installed: make peers")
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder, "discs.data")
        lines = [
            "discs", "", f"{len(x)} atoms", "1 atom types",
            f"0 {float(size[0])!r} xlo xhi", f"0 {float(size[1])!r} ylo yhi", "-0.5 0.5 zlo zhi",
            "", "Atoms", "",
        ]  # fmt: skip
        lines += [
            f"{k + 1} 1 {2 * r!r} 1.0 {px!r} {py!r} 0"
            for k, (px, py, r) in enumerate(
                zip(x.tolist(), y.tolist(), radius.tolist(), strict=True)
            )
        ]
        data.write_text("\n".join(lines) + "\n")
        told = {"data": data, "friction": friction, "steps": steps, "repeats": repeats}
        command = [str(program), "-in", str(FOLDER / "lammps_steps.in"), "-log", "none"]
        for name, value in told.items():
            command += ["-var", name, str(value)]
        env = os.environ | {
            "LD_LIBRARY_PATH": str(program.resolve().parent.parent / "lib"),
            "OMP_NUM_THREADS": "1",
        }
        done = subprocess.run(command, env=env, capture_output=True, text=True, cwd=folder)
    loops = zip(
        re.findall(r"Loop time of (\S+)", done.stdout),
        re.findall(r"(\S+)% CPU use", done.stdout),
        strict=True,
    )
    seconds = [float(loop) * float(use) / 100.0 for loop, use in loops][1:]
    if len(seconds) != repeats:
        raise RuntimeError(f"LAMMPS ended early: {done.stdout}{done.stderr}"[-2000:])
    touching = re.findall(r"^\s+\d+\s+(\d\S*)\s*$", done.stdout, re.MULTILINE)
    return seconds, 0.5 * float(touching[-1])
