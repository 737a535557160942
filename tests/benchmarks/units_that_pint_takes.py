"""Units of every quantity are taken by pint-xarray with the registry of cf-xarray."""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import xarray as xr

from demflow.model import quantities
from tests.benchmarks.result import Result
from tests.peers.lammps import ENVIRONMENT
from tests.peers.yade import PeerMissingError

TABLES = ("CASE", "PRINCIPAL", "ENSEMBLE", "SWEEP", "RAGGED", "MAPS", "TESTS")


def run() -> Result:
    """Write a dataset with a number for each quantity, and read it as those packages do."""
    python = Path(os.environ.get("PEERS_PYTHON", ENVIRONMENT / "bin" / "python"))
    if not python.exists():
        raise PeerMissingError("pint-xarray and cf-xarray are not installed: make peers")
    named = {
        f"{table}_{name}": quantity.unit
        for table in TABLES
        for name, quantity in getattr(quantities, table).items()
        if quantity.unit
    }
    dataset = xr.Dataset(
        {name: ((), np.float64(2.0), {"units": unit}) for name, unit in named.items()}
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "units.nc")
        dataset.to_netcdf(path)
        reader = Path(__file__).parents[1] / "peers" / "units_taken.py"
        told = subprocess.run([python, reader, path], capture_output=True, text=True, check=True)
    found = json.loads(told.stdout)
    off = sorted({*found["wrong"], *found["changed"]})
    units = ", ".join(sorted(set(named.values())))
    return Result(
        f"{len(found['tried']) - len(off)} of {len(named)} quantities, {len(set(named.values()))} "
        "units",
        "all of them",
        not off and len(found["tried"]) == len(named),
        f"units: {units}" + (f"; not taken: {', '.join(off)}" if off else ""),
    )
