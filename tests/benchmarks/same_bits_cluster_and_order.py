"""A cluster without a shared folder, and another order of submission, give the same bits.

The study is small and runs all kinds of stages. The cluster is `dask scheduler` and two
`dask worker`s in folders of their own; the other order is every axis turned round.
"""

from __future__ import annotations

from demflow import sweep
from tests.benchmarks.ran import results_folder
from tests.benchmarks.result import Result
from tests.benchmarks.same_bits_any_workers import MEASURED, differing
from tests.benchmarks.sweeps import FOUR_AXES
from tests.sweep.clusters import dask_cluster

AXES = {
    "angle": ("fractures.natural.angle", ["0 deg", "30 deg", "65 deg"]),
    "stress_yy": ("stress.yy", ["10 MPa", "20 MPa"]),
    "rate": ("wells.producer.rate", [1e-5, 2e-5]),
    "seed": ("grains.seed", [1, 2]),
}


def study(name: str, *, turned: bool) -> str:
    """The text of the study, its axes as they stand or turned round."""
    head = FOUR_AXES.format(name=name, grains=500, angles=1, apertures=1, stresses=1, rates=[1])
    step = -1 if turned else 1
    lines = [
        f"  {axis}: {{parameter: {path}, values: [{', '.join(map(str, values[::step]))}]}}"
        for axis, (path, values) in AXES.items()
    ]
    observe = "observe: [well_pressure, permeability]\n"
    return "\n".join([head.partition("vary:")[0] + "vary:", *lines, observe])


def run() -> Result:
    """Compare one worker, two, a cluster and the turned study, variable by variable."""
    folder = results_folder() / "order"
    folder.mkdir()
    plain, turned = folder / "order.yaml", folder / "turned.yaml"
    plain.write_text(study("order", turned=False))
    turned.write_text(study("order", turned=True))
    one = sweep.run(plain, workers=1, results=folder / "one")
    two = sweep.run(plain, workers=2, results=folder / "two")
    back = sweep.run(turned, workers=2, results=folder / "turned")
    with dask_cluster(folder / "cluster") as cluster:
        there = sweep.run(plain, scheduler=cluster.address, results=folder / "there")
    as_plain = back.sel({axis: one[axis] for axis in AXES})
    pairs = {"2 workers": two, "cluster": there, "turned round": as_plain}
    found = {name: differing(one, dataset) for name, dataset in pairs.items()}
    lines = [f"{name}: {', '.join(names) or 'identical'}" for name, names in found.items()]
    count = sum(map(len, found.values()))
    good = int((one.status == 0).sum())
    lines.append(f"{good} of {one.status.size} cases good")
    return Result(
        f"{count} of {len(set(one.variables) - set(MEASURED))} variables differ",
        "0",
        count == 0 and good == one.status.size,
        "\n".join(lines),
    )
