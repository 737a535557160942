"""Figures of walls and joints that move: the curves are the data."""

import numpy as np
import xarray as xr

from demflow.model.outcome import Status
from demflow.sweep.figures import movement
from demflow.sweep.figures.style import house_style

TIMES = np.array([1.0, 10.0, 100.0])


def _dataset(status):
    rng = np.random.default_rng(5)
    walls = rng.uniform(-1e-3, 1e-3, (3, 2, 3))
    walls[:, 0] = 0.0
    start = rng.uniform(1.0, 2.0, (3, 2, 2))
    growth = rng.uniform(1.0, 3.0, (3, 3))
    return xr.Dataset(
        {
            "status": ("rate", status),
            "wall_displacement": (("rate", "wall", "elapsed_time"), walls),
            "well_pressure": (
                ("rate", "well", "elapsed_time"), rng.uniform(1e6, 9e6, (3, 1, 3))
            ),
            "joint_slip": (("rate", "elapsed_time"), rng.uniform(1e-5, 9e-5, (3, 3))),
            "permeability_at_start": (("rate", "row", "column"), start),
            "permeability_in_time": (
                ("rate", "elapsed_time", "row", "column"), growth[..., None, None] * start[:, None]
            ),
        },
        {
            "rate": [1.0, 2.0, 3.0], "wall": ["left", "top"], "elapsed_time": TIMES,
            "well": ["injector"], "row": ["x", "y"], "column": ["x", "y"],
        },
    ), growth  # fmt: skip


def _drawn(draw, dataset, tmp_path, monkeypatch):
    kept = []
    monkeypatch.setattr(movement, "save", lambda figure, *_: kept.append(figure))
    with house_style():
        draw(dataset, tmp_path / "one.png")
    return kept[0].axes if kept else None


def test_settlement_is_the_way_inwards_of_the_walls_that_move(tmp_path, monkeypatch):
    dataset, _ = _dataset([Status.DONE, Status.FAILED, Status.DONE])
    (panel,) = _drawn(movement.draw_settlement, dataset, tmp_path, monkeypatch)
    assert panel.get_title() == "top wall"
    assert "m)" in panel.get_ylabel()
    wanted = -dataset["wall_displacement"].sel(wall="top").values[[0, 2]]
    found = np.array([line.get_ydata() for line in panel.lines])
    factor = found[0, 0] / wanted[0, 0]
    assert any(np.isclose(factor, one) for one in (1.0, 1e3, 1e6))
    np.testing.assert_allclose(found, factor * wanted)
    still = dataset.assign(wall_displacement=0.0 * dataset["wall_displacement"])
    assert _drawn(movement.draw_settlement, still, tmp_path, monkeypatch) is None


def test_slip_and_permeability_follow_the_pressure_of_the_well(tmp_path, monkeypatch):
    dataset, growth = _dataset([Status.DONE, Status.STOPPED, Status.FAILED])
    slip, permeability = _drawn(movement.draw_slip, dataset, tmp_path, monkeypatch)
    for k in (0, 1):
        pressure = dataset["well_pressure"].values[k, 0] / 1e6
        np.testing.assert_allclose(slip.lines[k].get_xdata(), pressure)
        np.testing.assert_allclose(permeability.lines[k].get_xdata(), pressure)
        np.testing.assert_allclose(permeability.lines[k].get_ydata(), growth[k])
        np.testing.assert_allclose(slip.lines[k].get_ydata(), 1e6 * dataset["joint_slip"].values[k])
    assert len(slip.lines) == 2
    unobserved = dataset.drop_vars(["joint_slip", "permeability_in_time"])
    assert _drawn(movement.draw_slip, unobserved, tmp_path, monkeypatch) is None
