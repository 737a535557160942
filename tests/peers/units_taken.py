"""Give a dataset its units by pint-xarray and cf-xarray; run by a Python that has them."""

from __future__ import annotations

import json
import sys
import warnings

warnings.filterwarnings("ignore")  # coordinates that are indexes are numbers again


def main(path: str) -> dict[str, list[str]]:
    """Variables whose unit is not taken, or is another one after a way there and back."""
    import cf_xarray.units
    import pint_xarray  # noqa: F401 (gives datasets their door)
    import xarray as xr

    registry = cf_xarray.units.units
    dataset = xr.open_dataset(path, decode_times=False)
    wanted = {k: v.attrs["units"] for k, v in dataset.data_vars.items() if v.attrs.get("units")}
    numbers = {k: unit for k, unit in wanted.items() if dataset[k].dtype.kind == "f"}
    taken = dataset[[*numbers]].pint.quantify(unit_registry=registry)
    wrong = [k for k, unit in numbers.items() if taken[k].pint.units != registry.Unit(unit)]
    back = taken.pint.dequantify(format="cf")
    changed = [
        k
        for k, unit in numbers.items()
        if registry.Unit(back[k].attrs["units"]) != registry.Unit(unit)
    ]
    return {"tried": [*numbers], "wrong": wrong, "changed": changed}


if __name__ == "__main__":
    print(json.dumps(main(sys.argv[1])))
