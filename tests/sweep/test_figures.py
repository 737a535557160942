"""Pictures: what is drawn is what the data say, whatever the shape of the study."""

import dataclasses
import re
from itertools import pairwise

import matplotlib
import numpy as np
import pytest
import xarray as xr
from matplotlib import colormaps
from matplotlib.collections import PathCollection
from matplotlib.colors import Normalize
from PIL import Image

import demflow.sweep.figures as figures
from demflow.model.region import contains
from demflow.sweep.accessor import Results
from demflow.sweep.analysis.cases import case_title, with_unit
from demflow.sweep.errors import ResultsError
from demflow.sweep.figures import animation, representative_cases, write_figures
from demflow.sweep.figures import maps as map_figures
from demflow.sweep.figures.permeability import draw_permeability
from demflow.sweep.figures.style import WIDTHS, Form, house_style, is_log_spaced, label, pick
from demflow.sweep.figures.wells import draw_well
from demflow.sweep.study.cases import case_at
from tests.sweep.invented import LINEAR, RADIAL, SWEEP, invented_dataset, invented_maps, study_of

pytestmark = pytest.mark.slow

SMALL = SWEEP.replace("per_decade: 12", "per_decade: 5")
# few cases, and maps of one time each: what is asked is not how many panels there are
BRIEF = SMALL.replace("observe:", "figures: {maps: [100 s]}\nobserve:").replace(
    "count: 3", "count: 2"
)
BRIEF = BRIEF.replace("[0 deg, 30 deg, 65 deg]", "[0 deg, 65 deg]")
COMPARED = [
    LINEAR.replace("maps: [267 s, 667 s, 1467 s, 15067 s]", "maps: [667 s]"),
    RADIAL.replace("compare: radial", "compare: radial, maps: [120 s]"),
]
STEADY = """
study: steady
scene:
  region: {shape: circle, radius: 14 m}
  grains: {count: 600, porosity: 0.17}
  matrix: {permeability: 1 mD}
  fluid: {viscosity: 1 Pa s, bulk_modulus: 1 GPa}
  wells: {producer: {at: [0 m, 0 m], radius: 0.964 m, rate: 2e-5 m3/s}}
  boundaries: {outer: 7 MPa}
observe: [pressure_map]
"""


@pytest.fixture
def results(tmp_path, monkeypatch):
    """A study of a text with its dataset, its maps to be had from `open_case`."""

    def make(text):
        study = study_of(text, tmp_path)
        dataset = invented_dataset(study)

        def case_of(folder, at, **_):
            index = [
                int(np.flatnonzero(dataset[a.name].values == at[a.name])[0]) for a in study.axes
            ]
            assert folder == tmp_path
            return invented_maps(study, tuple(index), spacing=2.4)

        monkeypatch.setattr(figures, "case_of", case_of)
        monkeypatch.setattr(map_figures, "pixels", lambda: 320)  # a journal's cost most
        return study, dataset, tmp_path

    return make


def names(paths):
    return [p.name for p in paths]


def caption(path):
    with Image.open(path) as image:
        assert min(image.size) > 300
        return image.info["Description"]


def test_a_sweep_gets_its_pictures(results):
    study, dataset, folder = results(SMALL)
    paths = write_figures(dataset, folder, study).paths
    assert names(paths) == [
        "well_pressure_producer.png",
        "drawdown_over_producer.png",
        *(f"pressure_map_{k}.png" for k in range(2)),
        "permeability.png",
    ]
    assert all(p.parent == folder / "figures" for p in paths)
    assert "36 cases" in caption(paths[0])
    assert "L = 0.1" in caption(paths[0])
    assert "fracture angle 65°" in caption(paths[3])
    assert "does not change with rate" in caption(paths[-1])


def test_same_data_give_the_same_bytes_and_leave_no_trace(results):
    study, dataset, folder = results(RADIAL)
    from matplotlib import pyplot

    before, open_before = dict(matplotlib.rcParams), pyplot.get_fignums()
    first = [p.read_bytes() for p in write_figures(dataset, folder, study).paths]
    again = write_figures(dataset, folder, study).paths
    assert [p.read_bytes() for p in again] == first
    assert dict(matplotlib.rcParams) == before
    assert pyplot.get_fignums() == open_before


@pytest.mark.parametrize(("text", "formula"), [(LINEAR, "Eq. 24"), (RADIAL, "Eq. 29")])
def test_comparisons_have_their_tables_beside_them(results, text, formula):
    study, dataset, folder = results(text)
    first = write_figures(dataset, folder, study).paths[0]
    kind = study.figures.compare
    assert first.name == f"compare_{kind}.png"
    assert formula in caption(first)
    tables = sorted((folder / "figures").glob("*.csv"))
    assert names(tables) == [f"compare_{kind}_by_case.csv", f"compare_{kind}_by_time.csv"]
    lines = tables[1].read_text().splitlines()
    times = case_at(study, [0]).scene.times
    assert [float(line.split(",")[0]) for line in lines[1 : len(times) + 1]] == list(times)


@pytest.mark.parametrize("text", COMPARED)
@pytest.mark.parametrize("form", [Form("pdf", "column"), Form("svg")])
def test_comparisons_are_drawn_for_a_journal(results, text, form):
    study, dataset, folder = results(text)
    drawn = write_figures(dataset, folder, study, form).paths
    assert {path.suffix for path in drawn} == {f".{form.format}"}
    assert drawn[0].stem == f"compare_{study.figures.compare}"


def test_a_comparison_that_cannot_be_is_refused(results):
    study, dataset, folder = results(
        SMALL.replace("observe:", "figures: {compare: radial}\nobserve:")
    )
    drawn = write_figures(dataset, folder, study)
    assert [("no fractures" in message) for message in drawn.messages] == [True]
    assert "permeability.png" in names(drawn.paths)


def test_what_is_gone_is_told_and_the_rest_is_drawn(results, monkeypatch):
    study, dataset, folder = results(SMALL)

    def gone(*_, **__):
        raise ResultsError("the case has no flow: it was not run")

    monkeypatch.setattr(figures, "case_of", gone)
    drawn = write_figures(dataset, folder, study)
    assert drawn.messages == [
        f"pressure_map_{k} was not drawn: the case has no flow: it was not run" for k in range(2)
    ]
    assert names(drawn.paths) == [
        "well_pressure_producer.png",
        "drawdown_over_producer.png",
        "permeability.png",
    ]


def test_nothing_done_draws_nothing(results):
    study, dataset, folder = results(SMALL)
    dataset["status"][:] = 1
    assert write_figures(dataset, folder, study).paths == []


def test_failed_cases_are_left_out(results):
    study, dataset, folder = results(SMALL)
    dataset["status"][0, 0] = 1
    for name in ("well_pressure", "pressure_change", "pressure_derivative", "permeability"):
        dataset[name][0, 0] = np.nan
    paths = write_figures(dataset, folder, study).paths
    maps = [path for path in paths if path.stem.startswith("pressure_map")]
    assert names(maps) == ["pressure_map_0.png", "pressure_map_1.png"]
    corners = representative_cases(dataset)  # three are left, the outer two are drawn
    assert len(corners) == 3
    for path, index in zip(maps, (corners[0], corners[-1]), strict=True):
        assert case_title(dataset, index) in caption(path)
    assert "32 cases" in caption(paths[0])


def test_representative_cases_are_corners(results):
    _, dataset, _ = results(SMALL)
    rest = {"stress_yy": 0, "rate": 0}
    assert representative_cases(dataset) == [
        {"fracture_angle": i, "aperture": j, **rest} for i in (0, 2) for j in (0, 2)
    ]
    dataset["status"][:] = 1
    dataset["status"][1, 1, 1, 1] = 0
    assert representative_cases(dataset) == [
        {"fracture_angle": 1, "aperture": 1, "stress_yy": 1, "rate": 1}
    ]
    assert representative_cases(dataset.isel(fracture_angle=0, aperture=0)[["status"]] * 0)


def test_a_study_without_axes_and_without_times(results):
    study, _, folder = results(RADIAL)
    steady = study_of(STEADY, folder)
    maps = invented_maps(study, (0,), spacing=2.4)
    maps["pressure"] = maps["pressure"].isel(elapsed_time=-1, drop=True)
    with house_style():
        path = map_figures.draw_maps(maps, case_at(steady, []).scene, "steady", folder / "m.png")
    assert "steady state" in caption(path)


def test_map_shows_what_broke_until_its_time(results, monkeypatch):
    study, _, folder = results(RADIAL)
    scene = case_at(study, (0,)).scene
    maps = invented_maps(study, (0,), spacing=2.4)
    kept = []
    monkeypatch.setattr(map_figures, "save", lambda figure, path, text: kept.append((figure, text)))
    breaks = xr.Dataset(
        {
            "event_time": ("event", [5.0, 130.0, 1e9]),
            "event_x": ("event", [1.0, 2.0, 3.0]),
            "event_y": ("event", [-1.0, -2.0, -3.0]),
        }
    )
    with house_style():
        for broken in (breaks, None):
            map_figures.draw_maps(
                maps, scene, "one", folder / "m.png", (2753.0, 121.0), breaks=broken
            )
    (figure, text), (_, without) = kept
    panels = [a for a in figure.axes if a.get_title().startswith("t = ")]
    drawn = [
        c.get_offsets().tolist()
        for panel in panels
        for c in panel.collections
        if isinstance(c, PathCollection)
    ]
    assert drawn == [[[1.0, -1.0]], [[1.0, -1.0], [2.0, -2.0]]]
    assert "white dots" in text
    assert "white dots" not in without


def test_map_shows_each_pore_in_its_own_colour(results, monkeypatch):
    study, _, folder = results(RADIAL)
    scene = case_at(study, (0,)).scene
    maps = invented_maps(study, (0,), spacing=2.4)
    kept = []
    monkeypatch.setattr(map_figures, "save", lambda figure, path, text: kept.append(figure))
    with house_style():
        map_figures.draw_maps(maps, scene, "one", folder / "m.png", (2753.0, 121.0))
    panels = [a for a in kept[0].axes if a.get_title().startswith("t = ")]
    assert [p.get_title() for p in panels] == ["t = 120 s", "t = 2753 s"]
    values = maps["pressure"].sel(elapsed_time=[120.0, 2753.0]).values / 1e6
    norm = Normalize(*map_figures.colour_limits(values))
    for panel, field in zip(panels, values, strict=True):
        # the centroid of a pore has the colour of its pressure
        found = _colours_at(panel, maps["x"].values, maps["y"].values)
        np.testing.assert_array_equal(found, colormaps["viridis"](norm(field), bytes=True))
        # a metre is as long both ways
        size = panel.get_window_extent()
        wide, high = np.ptp(panel.get_xlim()), np.ptp(panel.get_ylim())
        assert size.width / size.height == pytest.approx(wide / high, rel=1e-6)


def _colours_at(panel, x, y):
    """Colours of the image of a panel at points (n,) m."""
    (image,) = panel.images
    left, right, bottom, top = image.get_extent()
    pixels = image.get_array()
    rows, columns, _ = pixels.shape
    column = ((x - left) / (right - left) * columns).astype(int)
    row = ((y - bottom) / (top - bottom) * rows).astype(int)
    return np.asarray(pixels[row, column])


def test_polygons_follow_the_ugrid_convention(results):
    study, _, _ = results(RADIAL)
    maps = invented_maps(study, (0,), spacing=2.4)
    expected = map_figures.polygons(maps)
    nodes = np.stack([maps["mesh_node_x"].values, maps["mesh_node_y"].values], axis=1)
    np.testing.assert_array_equal(expected[7], nodes[maps["mesh_face_nodes"].values[7]])
    padded = np.full((maps.sizes["domain"], 5), np.nan)
    padded[:, :3] = maps["mesh_face_nodes"].values + 1  # counted from one, decoded fill
    shifted = maps.drop_vars("mesh_face_nodes").assign(
        mesh_face_nodes=(("domain", "corners"), padded, {"start_index": 1})
    )
    for a, b in zip(map_figures.polygons(shifted), expected, strict=True):
        np.testing.assert_array_equal(a, b)
    with pytest.raises(ValueError, match="UGRID"):
        map_figures.polygons(maps.drop_vars("mesh"))


def test_grains_are_drawn_only_inside_and_only_if_few(results, monkeypatch):
    from matplotlib.collections import EllipseCollection

    study, _, folder = results(RADIAL)
    scene = case_at(study, (0,)).scene
    maps = invented_maps(study, (0,), spacing=2.4)
    kept = []
    monkeypatch.setattr(map_figures, "save", lambda figure, path, text: kept.append(figure))
    with house_style():
        map_figures.draw_maps(maps, scene, "few", folder / "m.png")
        monkeypatch.setattr(map_figures, "MOST_GRAINS", 10)
        map_figures.draw_maps(maps, scene, "many", folder / "m.png")
    few, many = (
        [c for c in figure.axes[0].collections if isinstance(c, EllipseCollection)]
        for figure in kept
    )
    assert many == []
    assert np.all(contains(scene.region, few[0].get_offsets()))


def test_small_changes_are_drawn_as_changes(results, monkeypatch):
    study, _, folder = results(RADIAL)
    scene = case_at(study, (0,)).scene
    maps = invented_maps(study, (0,), spacing=2.4)
    maps["pressure"] = 7e6 + 1e-4 * (maps["pressure"] - 7e6)
    kept = []
    monkeypatch.setattr(map_figures, "save", lambda figure, path, text: kept.append(figure))
    with house_style():
        map_figures.draw_maps(maps, scene, "small", folder / "m.png", (2753.0,))
    panel, bar = kept[0].axes
    expected = maps["pressure"].sel(elapsed_time=2753.0).values - 7e6
    norm = Normalize(*map_figures.colour_limits(expected))
    np.testing.assert_array_equal(
        _colours_at(panel, maps["x"].values, maps["y"].values),
        colormaps["viridis"](norm(expected), bytes=True),
    )
    assert bar.get_ylabel() == "pore pressure − initial 7 MPa (Pa)"


def test_colours_are_not_taken_by_a_few_extremes():
    field = np.linspace(5.0, 7.0, 1000)
    assert map_figures.colour_limits(field) == (5.0, 7.0)
    low, high = map_figures.colour_limits(np.append(field, -900.0))
    assert low == pytest.approx(5.02, abs=0.01)
    assert high == 7.0
    low, high = map_figures.colour_limits(np.full(10, 7.0))
    assert low < 7.0 < high


@pytest.mark.parametrize(
    ("times", "wanted", "expected"),
    [
        (np.geomspace(1, 1e4, 41), None, [10, 20, 30, 40]),
        (np.geomspace(1, 1e4, 41), (1.0, 12.0), [0, 11]),
        (np.array([5.0, 9.0]), None, [0, 1]),
        (np.array([5.0, 9.0]), (1e9,), [1]),
        (np.array([5.0, 9.0]), (), [0, 1]),
    ],
)
def test_map_times(times, wanted, expected):
    assert map_figures.map_times(times, wanted) == expected


def test_log_log_curves_are_the_data(results, monkeypatch):
    study, dataset, folder = results(RADIAL)
    kept = []
    monkeypatch.setattr(
        "demflow.sweep.figures.wells.save", lambda figure, path, text: kept.append(figure)
    )

    def well_of(index, name):
        return case_at(study, list(index.values())).scene.wells[0]

    with house_style():
        draw_well(dataset, "producer", well_of, folder / "w.png")
    panel = kept[0].axes[0]
    curves = [line for line in panel.lines if len(line.get_xdata()) > 2]
    assert len(curves) == 8  # change and derivative of four packings of five
    change = dataset["pressure_change"].values[0, 0]
    np.testing.assert_allclose(curves[0].get_ydata(), change / 1e6)
    np.testing.assert_allclose(curves[0].get_xdata(), dataset["elapsed_time"].values)
    assert panel.get_xscale() == panel.get_yscale() == "log"
    # decades are as long both ways
    size = panel.get_window_extent()
    wide, high = (np.ptp(np.log10(ends)) for ends in (panel.get_xlim(), panel.get_ylim()))
    assert size.width / size.height == pytest.approx(wide / high, rel=1e-6)
    # the fan has the slopes that it names
    fan = panel.lines[len(curves) :]
    slopes = [np.diff(np.log(line.get_ydata())) / np.diff(np.log(line.get_xdata())) for line in fan]
    np.testing.assert_allclose(np.ravel(slopes), [1, 0.5, 0.25, 0], atol=1e-9)


def test_each_flow_period_is_drawn_over_its_own_time(results, monkeypatch):
    study, dataset, folder = results(RADIAL)
    kept = []
    monkeypatch.setattr(
        "demflow.sweep.figures.wells.save", lambda figure, path, text: kept.append(figure)
    )
    well = case_at(study, (0,)).scene.wells[0]
    shut_in = dataclasses.replace(well, rate=None, schedule=((0.0, 2e-5), (420.0, 0.0)))
    with house_style():
        draw_well(dataset.isel(packing=[0]), "producer", lambda i, n: shut_in, folder / "w.png")
    first, second = (line.get_xdata() for line in kept[0].axes[0].lines[:2])
    np.testing.assert_allclose(first, [120, 420])
    np.testing.assert_allclose(second, [1000, 2333, 23666])


def test_wells_without_a_rate_have_no_picture(results):
    _study, dataset, folder = results(RADIAL)
    dataset["pressure_change"][:] = np.nan
    with house_style():
        assert draw_well(dataset, "producer", lambda i, n: None, folder / "w.png") is None


def test_permeability_without_axes_or_without_values(results):
    _study, dataset, folder = results(SMALL)
    single = dataset.isel(fracture_angle=0, aperture=0, stress_yy=0, rate=0)
    with house_style():
        assert caption(draw_permeability(single, folder / "k.png")) == (
            "Diagonal of the permeability tensor."
        )
        assert (
            draw_permeability(single[["status", "permeability"]] * np.nan, folder / "k.png") is None
        )


def test_labels_come_from_the_table_of_quantities():
    assert label("pressure", np.array([5e6, 7e6])) == (1e-6, "pore pressure (MPa)")
    assert label("porosity", 0.2)[1].startswith("pore volume")


def test_helpers_of_style():
    assert pick(3, 5) == [0, 1, 2]
    assert pick(100, 4) == [0, 33, 66, 99]
    assert is_log_spaced(np.array([1.0, 10.0, 100.0]))
    assert not is_log_spaced(np.array([0.0, 30.0, 65.0]))
    assert not is_log_spaced(np.array(["a", "b"]))


@pytest.mark.parametrize("form", [Form("svg"), Form("pdf", "column"), Form("svg", "column")])
def test_other_forms_have_a_folder_of_their_own_and_the_same_bytes_each_time(results, form):
    study, dataset, folder = results(BRIEF)
    report = figures.write_figures(dataset, folder, study).paths
    first = figures.write_figures(dataset, folder, study, form).paths
    content = [path.read_bytes() for path in first]
    again = figures.write_figures(dataset, folder, study, form).paths
    assert [path.read_bytes() for path in again] == content
    assert {path.parent for path in first} == {folder / "figures" / form.suffix}
    assert [path.stem for path in first] == [path.stem for path in report]
    assert all(path.is_file() for path in report)


@pytest.mark.parametrize("width", ["column", "page"])
def test_figures_have_the_width_of_the_journal_and_text_stays_text(results, width):
    study, dataset, folder = results(BRIEF)
    drawn = figures.write_figures(dataset, folder, study, Form("svg", width)).paths
    for path in drawn:
        text = path.read_text()
        points = float(re.search(r'<svg [^>]*width="([\d.]+)pt"', text)[1])
        assert points == pytest.approx(72 * WIDTHS[width], abs=0.5)
        assert "<text" in text
    assert "permeability" in "".join(path.read_text() for path in drawn)


def _frames(path):
    with Image.open(path) as image:
        seen = []
        for k in range(image.n_frames):
            image.seek(k)
            seen.append(np.asarray(image.convert("RGB")))
    return seen


def test_an_animation_has_a_frame_a_time_and_the_same_bytes_each_time(results):
    study, dataset, folder = results(RADIAL.replace("420 s, 1420 s, ", ""))
    first = figures.write_animations(dataset, folder, study, Form("gif")).paths
    assert {path.parent for path in first} == {folder / "figures" / "gif"}
    assert names(first) == ["pressure_map_0.gif", "pressure_map_1.gif"]
    content = [path.read_bytes() for path in first]
    again = figures.write_animations(dataset, folder, study, Form("gif")).paths
    assert [path.read_bytes() for path in again] == content
    frames = _frames(first[0])
    assert len(frames) == len(invented_maps(study, (0,), spacing=2.4)["elapsed_time"])
    assert all(max(frame.shape) <= animation.MOST_PIXELS for frame in frames)
    assert all(np.any(a != b) for a, b in pairwise(frames))


def test_frames_are_the_maps_of_their_times(results, monkeypatch):
    study, _, folder = results(RADIAL)
    maps = invented_maps(study, (0,), spacing=2.4)
    times = maps["elapsed_time"].values
    monkeypatch.setattr(animation, "MOST_FRAMES", 2)
    breaks = xr.Dataset(
        {f"event_{of}": ("event", [at, 1e9]) for of, at in (("time", times[1]), ("x", 3.0))}
        | {"event_y": ("event", [-4.0, 0.0])}
    )
    seen, true = [], []

    class Writer(animation.GifWriter):
        def grab_frame(self, **options):
            panel = self.fig.axes[0]
            (dots,) = (c for c in panel.collections if isinstance(c, PathCollection))
            found = _colours_at(panel, maps["x"].values, maps["y"].values)
            seen.append((panel.get_title(), found, dots.get_offsets().tolist()))
            super().grab_frame(**options)
            true.append(np.asarray(self._frames[-1], dtype=int))

    monkeypatch.setattr(animation, "GifWriter", Writer)
    path = folder / "m.gif"
    with house_style():
        animation.draw_animation(maps, path, case_at(study, (0,)).scene, "one", breaks)
    frames = _frames(path)
    assert len(frames) == 2
    for frame, drawn in zip(frames, true, strict=True):  # even the rarest colour of the map
        codes, where = np.unique(drawn @ [1 << 16, 1 << 8, 1], return_inverse=True)
        colours = np.stack([codes >> 16, codes >> 8 & 255, codes & 255], axis=1)
        off = np.abs(frame.astype(int) - drawn).max(axis=2).ravel()
        shown = 255.0 * colormaps["viridis"](np.linspace(0.0, 1.0, 256))[:, :3]
        of_map = np.abs(colours[:, None] - shown).max(axis=2).min(axis=1) < 1.0
        assert np.count_nonzero(of_map) > 20
        assert off[of_map[where.ravel()]].max() <= 3  # half a step of the palette
        assert off[drawn.reshape(-1, 3).min(axis=1) == 255].max() == 0  # white is white
    values = maps["pressure"].isel(elapsed_time=[0, -1]).values / 1e6
    norm = Normalize(*map_figures.colour_limits(values))
    for (title, found, _), field, time in zip(seen, values, times[[0, -1]], strict=True):
        assert title == f"t = {with_unit(time, 's')}"
        np.testing.assert_array_equal(found, colormaps["viridis"](norm(field), bytes=True))
    assert [dots for *_, dots in seen] == [[], [[3.0, -4.0]]]


def test_what_cannot_move_is_told(results, monkeypatch):
    study, dataset, folder = results(RADIAL.replace(", pressure_map]", "]"))
    with pytest.raises(ResultsError, match=r"nothing to animate.*pressure_map"):
        figures.write_animations(dataset, folder, study, Form("gif"))
    assert not (folder / "figures" / "gif").exists()
    maps = invented_maps(study, (0,), spacing=2.4)
    with pytest.raises(ResultsError, match="nothing to animate"):
        animation.draw_animation(maps.isel(elapsed_time=[0]), folder / "m.gif")
    with pytest.raises(ResultsError, match="gif or mp4, not webp"):
        animation.draw_animation(maps, folder / "m.webp")
    monkeypatch.setattr(animation.shutil, "which", lambda name: None)
    with pytest.raises(ResultsError, match="needs the program ffmpeg"):
        figures.write_animations(dataset, folder, study, Form("mp4"))


def test_maps_animate_without_a_scene(results):
    study, _, folder = results(RADIAL)
    maps = invented_maps(study, (0,), spacing=2.4)
    path = Results(maps).animate(folder / "own.gif")
    assert len(_frames(path)) == maps.sizes["elapsed_time"]
