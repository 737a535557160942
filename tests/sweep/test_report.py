"""The report: complete, escaped, offline."""

import base64
import hashlib
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest

import demflow.sweep.figures as figures
from demflow import sweep
from demflow.model.outcome import Status
from demflow.sweep.figures.maps import polygons
from demflow.sweep.report import write_report
from demflow.sweep.report.html import grid
from demflow.sweep.study.yaml_source import StudyError
from tests.sweep.invented import RADIAL, SWEEP, invented_dataset, invented_maps, study_of

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("one_worker")]


class Page(HTMLParser):
    """Tags, attributes and text of a page; every tag that opens must close."""

    def __init__(self, text):
        super().__init__()
        self.open, self.attributes, self.text, self.tags = [], [], [], []
        self.scripts = []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += [(tag, *attr) for attr in attrs]
        if tag not in ("meta", "img", "input", "wbr"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        within = self.open[-1] if self.open else ""
        if self.tags[-1:] == ["wbr"] and self.text:  # where a word may break it goes on
            self.tags.pop()
            self.text[-1] += data
        else:
            (self.scripts if within == "script" else self.text).append(data)

    @property
    def carried(self):
        """What the page's script reads."""
        return json.loads(self.scripts[0])


def unpacked(text):
    """The numbers behind a base64 text."""
    return np.frombuffer(base64.b64decode(text), dtype="<f8")


@pytest.fixture
def made(tmp_path, monkeypatch):
    """Write the report of a study; returns its page."""

    def make(text, change=lambda dataset: None, draw=True):
        study = study_of(text, tmp_path)
        dataset = invented_dataset(study)
        change(dataset)
        monkeypatch.setattr(
            figures, "case_of", lambda folder, at, **_: invented_maps(study, (0,) * len(at), 2.4)
        )
        paths = figures.write_figures(dataset, tmp_path, study).paths if draw else []
        path = write_report(dataset, tmp_path, study, paths)
        assert path == tmp_path / "report.html"
        return Page(path.read_text(encoding="utf-8")), dataset, study

    return make


def test_page_asks_for_nothing_but_the_pictures_beside_it(made, tmp_path):
    page, _dataset, study = made(RADIAL)
    text = " ".join(page.text)
    for word in (study.title, "5 cases, 5 done", "grains.seed", "mass balance error", "Eq. 29"):
        assert word in text
    images = [value for tag, name, value in page.attributes if (tag, name) == ("img", "src")]
    assert len(images) == 4
    assert all((tmp_path / value).is_file() and value.startswith("figures/") for value in images)
    assert not {"link", "iframe", "object"} & set(page.tags)
    assert [value for _, name, value in page.attributes if name == "href"] == images
    assert not [a for a in page.attributes if a[1] in ("action", "onclick")]
    assert not re.search(r"url\(|@import|https?:", "".join(page.text))
    assert study.text.strip() in "".join(page.text)


def test_only_the_pages_own_script_may_run(made):
    page, _, _ = made(RADIAL, draw=False)
    policy = next(v for t, n, v in page.attributes if (t, n) == ("meta", "content") and "src" in v)
    data, script = page.scripts
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}';" in policy
    assert "default-src 'none'" in policy
    assert not set("<>&") & set(data)


def test_the_page_carries_the_numbers_of_the_dataset(made):
    page, dataset, _ = made(SWEEP, draw=False)
    found = page.carried
    assert [axis["name"] for axis in found["axes"]] == list(dataset["status"].dims)
    assert np.array_equal(unpacked(found["times"]), dataset["elapsed_time"].values)
    for name in ("pressure_change", "pressure_derivative"):
        order = (*dataset["status"].dims, "well", "elapsed_time")
        expected = dataset[name].transpose(*order).values.ravel()
        assert np.array_equal(
            unpacked(found["histories"][name]["values"]), expected, equal_nan=True
        )
    tensor = dataset["permeability"].values.ravel()
    assert np.array_equal(unpacked(found["permeability"]["values"]), tensor, equal_nan=True)
    named = {one["name"]: unpacked(one["values"]) for one in found["scalars"]}
    assert np.array_equal(named["porosity"], dataset["porosity"].values.ravel(), equal_nan=True)


def test_maps_of_one_network_share_its_polygons(made):
    page, _, study = made(RADIAL, draw=False)
    maps = page.carried["maps"]
    assert 1 <= len(maps) <= 4
    assert [isinstance(one["shape"], int) for one in maps] == [False] + [True] * (len(maps) - 1)
    shape, whole = maps[0]["shape"], invented_maps(study, (0,), 2.4)
    rounded = np.frombuffer(base64.b64decode(shape["x"]), dtype="<u2")
    x = shape["low"][0] + rounded / 65535 * shape["scale"]
    corners = np.concatenate(polygons(whole))[:, 0]
    assert np.allclose(x, corners, atol=shape["scale"] / 65535)


def test_images_say_what_they_show(made):
    page, _, _ = made(RADIAL)
    alternatives = [value for tag, name, value in page.attributes if name == "alt"]
    assert len(alternatives) == 4
    assert all(len(text) > 20 for text in alternatives)


def test_comparison_tables_are_in_the_page(made):
    page, _, _ = made(RADIAL)
    text = " ".join(page.text)
    assert "compare radial by time" in text
    assert "relative error, mean" in text


def test_failures_are_listed_with_their_message_and_everything_is_escaped(made):
    evil = "<script>alert('x')</script> & \"more\""

    def fail(dataset):
        dataset["status"][1, 0, 0, 0] = 2
        dataset["message"][1, 0, 0, 0] = evil
        dataset.attrs["history"] = evil

    page, _, _ = made(SWEEP.replace("Angle, aperture, stress and rate", "a < b & c"), fail, False)
    text = " ".join(page.text)
    assert page.tags.count("script") == 2
    assert page.carried["message"] == {"12": evil}
    assert text.count(evil) == 2
    assert "timed out" in text
    assert "fracture angle 30°, aperture 20 µm" in text
    assert "a < b & c" in text
    assert "36 cases, 35 done" in text


def test_many_failures_are_counted_not_listed(made):
    def fail(dataset):
        dataset["status"][:] = 1

    page, _, _ = made(SWEEP.replace("count: 3", "count: 9"), fail, False)
    text = " ".join(page.text)
    assert "108 cases, 0 done" in text
    assert "58 more are not listed" in text


def test_numbers_are_those_of_the_dataset(made):
    def known(dataset):
        dataset["porosity"][:] = np.array([0.1, 0.2, 0.3, 0.4, 0.5])
        dataset["mass_balance_error"][:] = [1e-15, 3e-12, np.nan, 0, 0]

    page, _, _ = made(RADIAL, known, False)
    cells = [cell for cell in page.text if cell.strip()]
    at = cells.index("porosity")
    assert cells[at + 1 : at + 4] == ["0.1", "0.3", "0.5"]
    at = cells.index("mass balance error")
    assert cells[at + 2] == "3×10⁻¹²"


def test_a_study_without_axes(made):
    single = RADIAL[: RADIAL.index("vary:")] + RADIAL[RADIAL.index("observe:") :]
    page, _, _ = made(single.replace("figures: {compare: radial}", ""))
    assert "Nothing was varied" in " ".join(page.text)


def test_missing_numbers_are_dashes():
    assert "<td class='number'>–</td>" in grid(("a",), [(float("nan"),)])
    assert "<td>&lt;</td>" in grid(("a",), [("<",)])


NOTES = """\
# Why

A *set*, and | a | table.

<script>alert(1)</script> [a link](https://example.org) ![no](https://example.org/x.png)
[bad](javascript:alert(1))
"""


def test_notes_are_shown_and_hold_nothing_that_runs(made, tmp_path):
    (tmp_path / "notes.md").write_text(NOTES)
    page, _, study = made(RADIAL + "report: {notes: notes.md}\n", draw=False)
    text = " ".join(page.text)
    assert study.report.notes == NOTES
    assert "Why" in text
    assert "<script>alert(1)</script>" in text
    assert page.tags.count("script") == 2
    assert "img" not in page.tags
    links = {value for _, name, value in page.attributes if name == "href"}
    assert links == {"https://example.org", "https://example.org/x.png"}


def test_notes_that_are_not_there_are_told_with_their_place(tmp_path):
    with pytest.raises(StudyError, match=r"report.notes: none.md: there is no such file"):
        study_of(RADIAL + "report: {notes: none.md}\n", tmp_path)


LEFT_OUT = """
study: left-out
scene:
  region: {shape: circle, radius: 1 m}
  grains: {count: 150, packing: square}
  matrix: {aperture: 10 um}
  fluid: {viscosity: 1 cP, bulk_modulus: 1 GPa}
  wells: {w: {at: [0, 0], radius: 0.1 m, rate: 1e-9 m3/s}}
  boundaries: {outer: 1 MPa}
  initial_pressure: 1 MPa
  times: {first: 1 s, last: 1e4 s, per_decade: 3}
vary:
  size: {parameter: region.radius, values: [3 m, 1 m]}
  width: {parameter: wells.w.radius, values: [0.1 m, 1.5 m]}
where: size > 2 m or width < 1 m
observe: [well_pressure]
"""


def test_combinations_that_are_left_out_need_be_no_scenes(tmp_path):
    """The wider of the wells would fill the smaller region."""
    (tmp_path / "study.yaml").write_text(LEFT_OUT)
    dataset = sweep.run(tmp_path / "study.yaml", results=tmp_path / "results", workers=1)
    assert int((dataset["status"] == Status.DONE).sum()) == 3
    found = Page((tmp_path / "results" / "left-out" / "report.html").read_text()).carried
    assert found["status"].count("left out") == 1
    periods = found["periods"]
    starts = [periods["lists"][k] for k in periods["which"]]
    assert starts == [[] if word == "left out" else [0.0] for word in found["status"]]
