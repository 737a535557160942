"""Studies run once for all the checks that look at them."""

from __future__ import annotations

import atexit
import shutil
import tempfile
from functools import cache
from pathlib import Path
from typing import NamedTuple

import xarray as xr

from demflow import sweep
from demflow.model.scene import Scene
from demflow.sweep.study.cases import case_at
from demflow.sweep.study.load import Study

STUDIES = Path(__file__).parents[2] / "studies"


class Ran(NamedTuple):
    """A study, its dataset and the folder that holds it."""

    study: Study
    dataset: xr.Dataset
    folder: Path

    def scene_of(self, index: dict[str, int]) -> Scene:
        """The scene of the case at a position along each axis."""
        return case_at(self.study, [index[axis.name] for axis in self.study.axes]).scene

    def maps_of(self, index: dict[str, int]) -> xr.Dataset:
        """The maps of that case."""
        values = {axis: self.dataset[axis].values[at].item() for axis, at in index.items()}
        return sweep.open_case(self.folder, **values)


@cache
def results_folder() -> Path:
    """A folder for results that goes when the process ends."""
    folder = Path(tempfile.mkdtemp(prefix="demflow-bench-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


@cache
def ran(name: str) -> Ran:
    """Run studies/NAME.yaml on two workers as a user would."""
    path = STUDIES / f"{name}.yaml"
    study = sweep.load_study(path)
    dataset = sweep.run(path, workers=2, results=results_folder())
    return Ran(study, dataset, results_folder() / study.name)
