"""demflow beside modules of a user's own that bear the names of its folders."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
STUDY = """
study: beside
scene:
  region: {shape: rectangle, width: 2 m, height: 2 m}
  grains: {count: 60, porosity: 0.17, seed: 1}
  matrix: {permeability: 1 mD}
  fluid: {viscosity: 1 cP, bulk_modulus: 2.2 GPa}
  boundaries: {left: 2 MPa, right: 1 MPa}
observe: [permeability]
"""
OWN = "whose = 'the user'\n"
SCRIPT = """
import json
import model, sweep
import demflow

if __name__ == "__main__":
    dataset = demflow.run("study.yaml", workers=1)
    own = [module.whose for module in (model, sweep)]
    print(json.dumps([own, dataset["status"].item(), demflow.Scene.__module__]))
"""


@pytest.fixture
def folder(tmp_path):
    for name, text in {"model.py": OWN, "sweep.py": OWN, "study.yaml": STUDY}.items():
        (tmp_path / name).write_text(text)
    (tmp_path / "script.py").write_text(SCRIPT)
    return tmp_path


def python(folder, *arguments):
    own = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(
        [sys.executable, *arguments], cwd=folder, env=own, capture_output=True, text=True
    )


@pytest.mark.slow
def test_a_study_runs_from_a_folder_with_modules_of_the_same_names(folder):
    """From a script that imports them, whose workers import that script; then by the command."""
    done = python(folder, "script.py")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == [["the user"] * 2, 0, "demflow.model.scene.case"]
    again = python(folder, "-m", "demflow", "run", "study.yaml", "--json")
    assert again.returncode == 0, again.stderr
    assert json.loads(again.stdout)["computed"] == 0
