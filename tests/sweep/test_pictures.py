"""Figures on axes of the caller's: each shows the numbers that it was given."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Wedge
from PIL import Image

import demflow.sweep.accessor  # noqa: F401 -- registers `dataset.demflow`
from demflow.sweep.errors import ResultsError
from demflow.sweep.figures.style import Form, house_style
from demflow.sweep.figures.traces import draw_traces_of
from demflow.sweep.figures.two_axes import draw_drawdown, draw_two_axes
from demflow.sweep.study.units import parse_unit

RNG = np.random.default_rng(7)
MD = float(parse_unit("mD").factor)


@pytest.fixture
def panel():
    figure, axes = plt.subplots()
    yield axes
    plt.close(figure)


def study(angles=4, seeds=3):
    """Tensors turned by an angle, larger from seed to seed; the last case failed."""
    angle = np.linspace(0.0, 67.5, angles)
    tensor = np.empty((angles, seeds, 2, 2))
    for i, a in enumerate(np.radians(angle)):
        turn = np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
        for j in range(seeds):
            tensor[i, j] = (1 + j) * MD * turn @ np.diag([4.0, 1.0]) @ turn.T
    status = np.zeros((angles, seeds), dtype=int)
    status[-1, -1], tensor[-1, -1] = 1, np.nan
    counts = RNG.integers(1, 40, (3, angles, seeds))
    names = ("network_nodes_i", "network_nodes_y", "network_nodes_x")
    return xr.Dataset(
        {
            "status": (("angle", "seed"), status),
            "permeability": (("angle", "seed", "row", "column"), tensor, {"units": "m2"}),
        }
        | {n: (("angle", "seed"), c) for n, c in zip(names, counts, strict=True)},
        {"angle": ("angle", angle, {"units": "degree"}), "seed": np.arange(seeds)},
    )


def traces(angle, length):
    a = np.radians(angle)
    begin = RNG.normal(size=(len(angle), 2))
    end = begin + (length * np.stack([np.cos(a), np.sin(a)])).T
    names = ("trace_from_x", "trace_from_y", "trace_to_x", "trace_to_y")
    places = (*begin.T, *end.T)
    return xr.Dataset({n: ("trace", v) for n, v in zip(names, places, strict=True)})


def test_a_line_is_the_mean_and_the_band_all_values(panel):
    dataset = study()
    k = dataset.permeability.isel(row=0, column=0)
    assert dataset.demflow.plot_along(k, "angle", panel) is panel
    mean = np.exp(np.log(k / MD).mean("seed"))
    np.testing.assert_allclose(panel.lines[-1].get_ydata(), mean, rtol=1e-12)
    np.testing.assert_allclose(panel.lines[-1].get_xdata(), dataset.angle)
    assert panel.get_ylabel() == "permeability (mD)"


def test_colours_over_two_axes_are_the_values(panel):
    dataset = study()
    k = dataset.permeability.isel(row=1, column=1)
    dataset.demflow.plot_over(k, "seed", "angle", panel)
    shown = panel.images[0].get_array()
    np.testing.assert_allclose(shown.filled(np.nan), k / MD, rtol=1e-12)
    with pytest.raises(ResultsError, match="two of the axes"):
        dataset.demflow.plot_over(k, "angle", "angle", panel)
    with pytest.raises(ResultsError, match="along row, column"):
        dataset.demflow.plot_over("permeability", "seed", "angle", panel)


@pytest.mark.parametrize(("spread", "by_decades"), [(9.0, False), (11.0, True)])
def test_colours_go_by_decades_where_values_do(panel, spread, by_decades):
    dataset = study()
    k = dataset.permeability.isel(row=1, column=1)
    level = k.copy(data=np.geomspace(1.0, spread, k.size).reshape(k.shape))
    dataset.demflow.plot_over(level, "seed", "angle", panel)
    assert isinstance(panel.images[0].norm, LogNorm) == by_decades


def test_a_label_of_many_words_is_broken(panel):
    dataset = study()
    k = dataset.permeability.isel(row=1, column=1).assign_attrs(long_name="words and " * 12)
    dataset.demflow.plot_over(k, "seed", "angle", panel)
    assert max(map(len, panel.images[0].get_label().split("\n"))) <= 40


def test_ellipses_are_the_tensors(panel):
    dataset = study()
    dataset.demflow.plot_ellipses("seed", "angle", panel)
    (found,) = (one for one in panel.collections if isinstance(one, EllipseCollection))
    column, row = found.get_offsets().T.astype(int)
    assert len(set(zip(column, row, strict=True))) == 11  # one case failed
    np.testing.assert_allclose(found.get_angles(), dataset.angle[row], atol=1e-9)
    np.testing.assert_allclose(found.get_widths() / found.get_heights(), 4.0)
    np.testing.assert_allclose(found.get_widths(), 0.9 * (1 + column) / 3)


@pytest.mark.parametrize("shape", [(6.0, 6.0), (9.0, 3.0), (3.0, 9.0)])
def test_ellipses_do_not_overlap_whatever_the_shape_of_the_panel(shape):
    figure = Figure(shape, layout="none")
    panel = figure.subplots()
    study().demflow.plot_ellipses("seed", "angle", panel)
    figure.draw_without_rendering()
    (found,) = (one for one in panel.collections if isinstance(one, EllipseCollection))
    by = found.get_offset_transform().transform(np.eye(2)) - panel.transData.transform((0, 0))
    pixels = by[0, 0] if found._units == "x" else by[1, 1]
    assert found.get_widths().max() * pixels <= 0.9001 * min(by[0, 0], by[1, 1])


def test_a_drawdown_over_two_axes_needs_more_than_lines_can_tell(tmp_path):
    dataset = study()
    change = np.arange(24.0).reshape(4, 3, 1, 2)
    dataset["pressure_change"] = (("angle", "seed", "well", "elapsed_time"), change)
    dataset = dataset.assign_coords(well=["w"], elapsed_time=[1.0, 2.0])
    with house_style():
        path = draw_drawdown(dataset, "w", tmp_path / "w.png")
        few = draw_drawdown(dataset.isel(seed=[0, 1]), "w", tmp_path / "few.png")
    assert path is not None
    with Image.open(path) as image:
        assert "pressure at w within a flow period over angle and seed" in image.info["Description"]
    assert few is None


def test_names_of_tied_values_are_told_apart_along_an_axis(panel):
    """Also where they begin alike."""
    rates = {"west_rate": [1e-5, 1e-5, -1e-5], "east_rate": [-1e-5, 0.0, 1e-5]}
    tied = {name: ("rates", values, {"units": "m3 s-1"}) for name, values in rates.items()}
    dataset = study().drop_vars("seed").rename(seed="rates").assign_coords(tied)
    dataset.demflow.plot_over(dataset.permeability[..., 0, 0], "angle", "rates", panel)
    shown = [text.get_text() for text in panel.get_yticklabels()]
    assert len(set(shown)) == 3, shown


def test_a_rose_reaches_as_far_as_the_rock_is_permeable(panel):
    dataset = study(seeds=1)
    dataset.demflow.plot_permeability_rose(panel)
    assert len(panel.lines) == 3  # one case failed
    for line, angle in zip(panel.lines, np.radians(dataset.angle.values), strict=False):
        x, y = line.get_data()
        direction = np.arctan2(y, x)
        expected = 4.0 * np.cos(direction - angle) ** 2 + np.sin(direction - angle) ** 2
        np.testing.assert_allclose(np.hypot(x, y), expected, rtol=1e-9)
    with pytest.raises(ResultsError, match="0 cases are done"):
        dataset.isel(angle=[-1]).demflow.plot_permeability_rose(panel)


def test_areas_of_a_rose_are_parts_of_the_length(panel):
    angle, length = RNG.uniform(-360.0, 360.0, 500), RNG.uniform(1.0, 9.0, 500)
    traces(angle, length).demflow.plot_rose(panel)
    sectors = [one for one in panel.patches if isinstance(one, Wedge)]
    area = np.array([np.pi * one.r**2 * (one.theta2 - one.theta1) / 360 for one in sectors])
    for one, part in zip(sectors, area / area.sum(), strict=True):
        inside = (angle - one.theta1) % 180.0 < one.theta2 - one.theta1
        assert part == pytest.approx(length[inside].sum() / length.sum() / 2, rel=1e-9)


def test_as_many_traces_are_as_long_as_is_shown(panel):
    length = RNG.pareto(1.5, 200) + 1.0
    traces(RNG.uniform(0, 180, 200), length).demflow.plot_lengths(panel)
    x, y = panel.lines[0].get_data()
    np.testing.assert_array_equal(y, [np.sum(length >= one * (1 - 1e-9)) for one in x])
    with pytest.raises(ResultsError, match="no traces"):
        xr.Dataset().demflow.plot_rose(panel)


def test_a_trace_with_bends_is_one(panel):
    bends = np.cumsum(RNG.normal(size=(40, 7, 2)), axis=1)  # 40 traces of 6 pieces
    begin, end = (part.reshape(-1, 2) for part in (bends[:, :-1], bends[:, 1:]))
    ends = zip("xy", begin.T, end.T, strict=True)
    pieces = {f"trace_{way}_{a}": v for a, b, e in ends for way, v in (("from", b), ("to", e))}
    dataset = xr.Dataset({name: ("trace", values) for name, values in pieces.items()})
    dataset.demflow.plot_lengths(panel)
    along = np.linalg.norm(np.diff(bends, axis=1), axis=2).sum(axis=1)
    np.testing.assert_allclose(panel.lines[0].get_xdata(), np.sort(along)[::-1], rtol=1e-12)
    panel.clear()
    dataset.demflow.plot_rose(panel)
    assert panel.get_title().startswith("40 traces")


def test_nodes_lie_at_their_parts_of_the_triangle(panel):
    dataset = study()
    dataset.demflow.plot_topology(panel)
    x, y = panel.lines[-1].get_data()
    good = dataset.status.values == 0
    i, _, cross = (dataset[f"network_nodes_{n}"].values[good] for n in "iyx")
    total = sum(dataset[f"network_nodes_{n}"].values[good] for n in "iyx")
    np.testing.assert_allclose(y, 0.75**0.5 * i / total)
    np.testing.assert_allclose(x, cross / total + 0.5 * i / total)


def test_chains_lie_between_grains_and_are_as_wide_as_their_force(panel):
    force = np.array([1.0, 3.0, -2.0])
    maps = xr.Dataset(
        {
            "grain_x": ("grain", [0.0, 1.0, 3.0]), "grain_y": ("grain", [0.0, 2.0, 0.5]),
            "grain_a": ("contact", [0, 1, 0]), "grain_b": ("contact", [1, 2, 2]),
            "normal_force": ("contact", force),
        }
    )  # fmt: skip
    maps.demflow.plot_forces(panel)
    pressed, pulled = (c for c in panel.collections if isinstance(c, LineCollection))
    np.testing.assert_array_equal(pressed.get_segments()[1], [[1.0, 2.0], [3.0, 0.5]])
    widths = np.array([*pressed.get_linewidths(), *pulled.get_linewidths()])
    np.testing.assert_allclose(widths / widths[0], [1.0, 3.0, 2.0])
    assert len(pulled.get_segments()) == 1


@pytest.mark.slow
@pytest.mark.parametrize("form", [Form(), Form("svg", "column"), Form("pdf", "page")])
def test_same_data_give_the_same_bytes(tmp_path, form):
    dataset, maps = study(), traces(RNG.uniform(0, 180, 30), RNG.uniform(1, 5, 30))
    contents = []
    for k in range(2):
        with house_style(form):
            drawn = (
                draw_two_axes(dataset, tmp_path / f"{k}_k.png"),
                draw_traces_of(dataset, maps, "a title", tmp_path / f"{k}_t.png"),
            )
        contents.append([path.read_bytes() for path in drawn])
    assert contents[0] == contents[1]


def falling(cases):
    """Pressures of a well that fall by (1 + case) ln(1 + t) kPa; the last case failed."""
    time = np.geomspace(1.0, 1e4, 9)
    pressure = 20e6 - 1e3 * np.outer(np.arange(1, cases + 1), np.log1p(time))[:, None, :]
    status = np.zeros(cases, dtype=int)
    status[-1], pressure[-1] = 1, np.nan
    return xr.Dataset(
        {
            "status": ("seed", status),
            "well_pressure": (("seed", "well", "elapsed_time"), pressure, {"units": "Pa"}),
        },
        {"seed": np.arange(cases), "well": ["w"], "elapsed_time": time},
    )


def test_a_record_lies_beside_what_is_computed(panel):
    dataset = falling(3)
    time = np.sort(np.append(dataset.elapsed_time.values, RNG.uniform(1.0, 1e4, 40)))
    pressure = 20e6 - 1e3 * np.log1p(time) - 250.0  # off the first case by as much
    assert dataset.demflow.plot_measured("w", time, pressure, panel) is panel
    record, *computed = panel.lines
    hour, mega = 3600.0, 1e6
    np.testing.assert_allclose(record.get_xdata() * hour, time)
    np.testing.assert_allclose(record.get_ydata() * mega, pressure)
    assert (panel.get_xlabel(), panel.get_ylabel()) == ("time (h)", "pressure of w (MPa)")
    for line, own in zip(computed, dataset.well_pressure.values[:2, 0], strict=True):
        np.testing.assert_allclose(line.get_ydata() * mega, own)
    assert str(computed[0].get_label()).endswith("rms 250 Pa")
    second = np.sqrt(np.mean((1e3 * np.log1p(dataset.elapsed_time.values) - 250.0) ** 2))
    assert f"rms {second / 1e3:.3g} kPa" in str(computed[1].get_label())


def test_a_record_beside_many_cases_has_their_median_and_band(panel):
    dataset = falling(16)
    time = np.array([2.0, 5.0, 9.0])
    dataset.demflow.plot_measured("w", time, np.full(3, 19.9e6), panel)
    _, median = panel.lines
    own = dataset.well_pressure.values[:15, 0]
    np.testing.assert_allclose(median.get_ydata() * 1e6, np.median(own, axis=0))
    (band,) = panel.collections
    y = band.get_paths()[0].vertices[:, 1] * 1e6
    np.testing.assert_allclose((y.min(), y.max()), (own.min(), own.max()))


@pytest.mark.parametrize(
    ("well", "time", "pressure", "why"),
    [
        ("v", [1.0, 2.0], [1e6, 1e6], "no well v; there are w"),
        ("w", [2.0, 1.0], [1e6, 1e6], "must increase"),
        ("w", [1.0, 2.0], [1e6, np.nan], "finite"),
        ("w", [1.0, 2.0], [1e6], "as many"),
    ],
)
def test_what_is_no_record_is_refused(panel, well, time, pressure, why):
    with pytest.raises(ResultsError, match=why):
        falling(3).demflow.plot_measured(well, time, pressure, panel)
