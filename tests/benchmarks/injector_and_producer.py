"""An injector and a producer: reciprocity, turning the flow round, and images in the rim."""

from __future__ import annotations

import numpy as np

from demflow.model.analytic.wells import doublet_pressure_fall
from demflow.model.region import Circle
from tests.benchmarks.ran import ran
from tests.benchmarks.result import Result

PAIR, TURNED, WEST, EAST = range(4)  # the study's four settings of the rates


def run() -> Result:
    """Reciprocity and reversal to the tolerance; the mean fall between the wells to the formula."""
    study = ran("injector_producer")
    data = study.dataset
    scene = study.scene_of({"seed": 0, "rates": PAIR})
    assert isinstance(scene.region, Circle)
    assert scene.uniform_pressure is not None
    assert scene.matrix.permeability is not None
    change = data["well_pressure"].values - scene.uniform_pressure  # seed, rates, well, time
    scale = np.abs(change).max()
    reciprocity = np.abs(change[:, WEST, 1] - change[:, EAST, 0]).max() / scale
    turned = np.abs(change[:, PAIR] + change[:, TURNED]).max() / scale
    summed = np.abs(change[:, PAIR] + change[:, WEST] - change[:, EAST]).max() / scale
    east = scene.wells[1]
    assert east.rate is not None
    expected = doublet_pressure_fall(
        east.rate,
        scene.fluid.viscosity,
        scene.matrix.permeability,
        offset=east.at[0],
        radius=east.radius,
        outer_radius=scene.region.radius,
    )
    between = 0.5 * (change[:, PAIR, 0, -1] - change[:, PAIR, 1, -1])
    middle = data["probe_pressure"].isel(rates=PAIR, elapsed_time=-1).values
    middle = np.abs(middle.mean(axis=0) - scene.uniform_pressure).mean() / expected
    off = between.mean() / expected - 1
    details = "\n".join(
        [
            f"what west does to east, and east to west: apart by {reciprocity:.1e} of the largest",
            f"both rates turned round: {turned:.1e}; one well and the other: {summed:.1e}",
            "half the fall between the wells over the formula: "
            + " ".join(f"{100 * (b / expected - 1):+.1f}" for b in between)
            + f" %, mean {100 * off:+.1f} %",
            f"pressure on the line between them off that of the rim by {100 * middle:.1f} % of it",
        ]
    )
    return Result(
        f"reciprocity {reciprocity:.1e}, reversal {turned:.1e}, superposition {summed:.1e}; fall "
        f"{100 * off:+.1f} % against the formula; midline {100 * middle:.1f} %",
        "≤ 2e-6 each; ≤ 4 %; ≤ 4 %",
        bool(max(reciprocity, turned, summed) <= 2e-6 and abs(off) <= 0.04 and middle <= 0.04),
        details,
    )
