"""Measured tests: columns, units, dates; what is sorted, joined, left out is told by its line."""

import io

import numpy as np
import pytest

from demflow.sweep.study.load import load_study
from demflow.sweep.study.measured import read_data
from demflow.sweep.study.sections import Reading
from demflow.sweep.study.tables import TableError, read_table
from demflow.sweep.study.units import parse_quantity
from demflow.sweep.study.yaml_source import StudyError, read_source

PSI = parse_quantity("1 psi", "Pa")
TIMES = np.round(np.geomspace(0.01, 100.0, 40), 5)  # h
PRESSURES = np.round(3000.0 - 40.0 * np.log(TIMES / 0.005), 3)  # psi
RATES = "rates: [[0 h, 100 bbl/d]]"


def table_of(rows, head="t [h],p [psi]"):
    return "\n".join([head, *(",".join(map(str, row)) for row in rows)]) + "\n"


def gauge(times=TIMES, pressures=PRESSURES):
    return list(zip(times.tolist(), pressures.tolist(), strict=True))


def read(tmp_path, files, **keys):
    """The test `t` of a study whose data has these keys, and the problems."""
    for name, content in files.items():
        if isinstance(content, str):
            (tmp_path / name).write_text(content, encoding="utf-8")
        else:
            (tmp_path / name).write_bytes(content)
    given = {"file": next(iter(files)), **keys}
    inner = ", ".join(f"{key}: {value}" for key, value in given.items())
    study = tmp_path / "study.yaml"
    study.write_text(f"data:\n  t: {{{inner}}}\n", encoding="utf-8")
    reading = Reading(folder=tmp_path)
    tests = read_data(read_source(study).root.entries["data"], reading)
    return tests.get("t"), [problem.message for problem in reading.problems]


def good(tmp_path, files, **keys):
    test, problems = read(tmp_path, files, **keys)
    assert problems == []
    return test


def test_units_stand_in_the_head_or_in_the_study(tmp_path):
    one = good(tmp_path, {"a.csv": table_of(gauge())})
    two = good(tmp_path, {"b.csv": table_of(gauge(), "t,p")}, time='"t [h]"', pressure='"p [psi]"')
    below = good(tmp_path, {"c.csv": table_of([("hours", "psia"), *gauge()], "time,pressure")})
    for test in (one, two, below):
        np.testing.assert_allclose(test.time, TIMES * 3600.0, rtol=1e-12)
        np.testing.assert_allclose(test.pressure, PRESSURES * PSI, rtol=1e-12)
        assert test.notes == ()
        np.testing.assert_array_equal(np.diff(test.lines), 1)
    assert one.lines[0] == 2
    assert below.lines[0] == 3


@pytest.mark.parametrize(
    ("head", "join"), [("t [h]\tp [psi]", "\t"), ("t [h];p [psi]", ";"), ("t[h] p[psi]", "  ")]
)
def test_other_signs_part_the_fields(tmp_path, head, join):
    rows = [join.join(map(str, row)) for row in gauge()]
    text = "# a logger\n\n" + "\n".join([head, *rows])
    test = good(tmp_path, {"a.txt": text})
    np.testing.assert_allclose(test.pressure, PRESSURES * PSI, rtol=1e-12)
    assert test.lines[0] == 4


def test_decimals_may_take_a_comma_where_semicolons_part_the_fields(tmp_path):
    rows = [f"{t};{p}".replace(".", ",") for t, p in gauge()]
    test = good(tmp_path, {"a.csv": "\n".join(["t [h];p [psi]", *rows])})
    np.testing.assert_allclose(test.pressure, PRESSURES * PSI, rtol=1e-12)


def test_dates_of_gauge_and_rates_share_a_clock(tmp_path):
    minutes = np.arange(30)
    rows = [(f"2024-05-17T08:{m:02d}:00", 3000 - m) for m in minutes]
    rates = table_of([("2024-05-17T07:00:00", 100), ("2024-05-17T08:00:00", 0)], "date,q [bbl/d]")
    files = {"a.csv": table_of(rows, "date,p [psi]"), "q.csv": rates}
    test = good(tmp_path, files, rates="q.csv")
    np.testing.assert_allclose(test.time, 3600.0 + 60.0 * minutes)
    assert [start for start, _ in test.rate_changes] == [0.0, 3600.0]
    british = [(f"17/05/2024 08:{m:02d}", 3000 - m) for m in minutes]
    _, problems = read(tmp_path, {"b.csv": table_of(british, "date,p [psi]")})
    assert "neither a number nor a date" in problems[0]
    assert "say date_format, '%d/%m/%Y %H:%M'" in problems[0]
    early = table_of([(f"05/03/2024 08:{m:02d}:00", 3000 - m) for m in minutes], "date,p [psi]")
    _, problems = read(tmp_path, {"b.csv": early})
    assert "'%d/%m/%Y %H:%M:%S' or '%m/%d/%Y %H:%M:%S', as it is meant" in problems[0]
    assert "line" in problems[0]
    test = good(
        tmp_path, {"b.csv": table_of(british, "date,p [psi]")}, date_format='"%d/%m/%Y %H:%M"'
    )
    np.testing.assert_allclose(test.time, 60.0 * minutes)
    iso = rates.replace("q [bbl/d]", "oil rate [bbl/d]")  # its dates can be read in one way only
    both = {"b.csv": table_of(british, "date,p [psi]"), "q.csv": iso}
    test = good(tmp_path, both, rates="q.csv", date_format='"%d/%m/%Y %H:%M"')
    assert [start for start, _ in test.rate_changes] == [0.0, 3600.0]
    _, problems = read(
        tmp_path, files | {"q.csv": table_of([(0, 5)], "t [h],q [bbl/d]")}, rates="q.csv"
    )
    assert "one file has dates and the other elapsed times" in problems[0]


def test_days_and_times_of_day_may_stand_in_two_columns(tmp_path):
    minutes = np.arange(30)
    rows = [("17/05/2024", f"{23 + m // 60}:{m % 60:02d}", 3000 - m) for m in minutes]
    rows += [("18/05/2024", f"0:{m:02d}", 2900 - m) for m in minutes]
    named = {"date_format": '"%d/%m/%Y %H:%M"'}
    for head in ("Date,Time,p [psi]", "Datum,Uhr,p [psi]"):
        for wanted in ({"time": head.split(",")[0]}, {"time": head.split(",")[1]}):
            test = good(tmp_path, {"a.csv": table_of(rows, head)}, **named, **wanted)
            np.testing.assert_allclose(np.diff(test.time), [60.0] * 29 + [1860.0] + [60.0] * 29)
            assert "the days of column" in test.notes[0]
    head = "Date,Time,p [psi]"
    for_rates = {"q.csv": table_of([("17/05/2024", "22:00", 80)], "Date,Time,q [bbl/d]")}
    test = good(tmp_path, {"a.csv": table_of(rows, head), **for_rates}, rates="q.csv", **named)
    assert test.time[0] == 3600.0
    days = [(f"2024-05-{d:02d}", 3000 - d) for d in range(1, 29)]
    test = good(tmp_path, {"a.csv": table_of(days, "Date,p [psi]")})
    np.testing.assert_allclose(test.time, 86400.0 * np.arange(28))
    alone = table_of([row[1:] for row in rows], "Time,p [psi]")
    _, problems = read(tmp_path, {"a.csv": alone})
    assert "column 'Time' holds times of day, as 23:00, and no column has days" in problems[0]
    twice = table_of([(row[0], "1/1/2000", *row[1:]) for row in rows], "Date,Made,Time,p [psi]")
    _, problems = read(tmp_path, {"a.csv": twice})
    assert "'Date', 'Made' have days; name another as time" in problems[0]
    assert good(tmp_path, {"a.csv": twice}, time="Date", **named).time[1] == 60.0


def test_a_list_of_rates_has_dates_where_the_pressures_have(tmp_path):
    rows = [(f"2024-05-17T08:{m:02d}:00", 3000 - m) for m in range(30)]
    files = {"a.csv": table_of(rows, "date,p [psi]")}
    dated = "[[2024-05-17 07:00:00, 100 bbl/d], [2024-05-17 08:00:00, 0 bbl/d]]"
    test = good(tmp_path, files, rates=dated)
    in_file = table_of([("2024-05-17T07:00:00", 100), ("2024-05-17T08:00:00", 0)], "date,q [bbl/d]")
    same = good(tmp_path, files | {"q.csv": in_file}, rates="q.csv")
    assert test.rate_changes == same.rate_changes
    np.testing.assert_array_equal(test.time, same.time)
    for rates, said in (
        (RATES.removeprefix("rates: "), "the pressures have dates, and so must the rates"),
        (dated.replace("2024-05-17 08:00:00", "1 h"), "so each is a date"),
        (dated.replace("0 bbl/d", "0 psi"), "is a pressure"),
        (dated.replace("100 bbl/d", "1e300 bbl/d"), "up to which numbers are computed with"),
        (dated.replace(", 0 bbl/d", ""), "is a list of 2 values"),
        (dated.replace("17 08", "16 08"), "the times must increase"),
    ):
        _, problems = read(tmp_path, files, rates=rates)
        assert said in problems[0], problems
    _, problems = read(tmp_path, {"a.csv": table_of(gauge())}, rates=dated)
    assert "the pressures have elapsed times, and so must the rates" in problems[0]


def test_the_clock_begins_with_the_first_rate_or_where_the_study_says(tmp_path):
    rows = [(f"2024-05-17T08:{m:02d}:00", 3000 - m) for m in range(30)]
    files = {"a.csv": table_of(rows, "date,p [psi]")}
    dated = "[[2024-05-17 08:10:00, 100 bbl/d]]"
    minutes = np.arange(30.0)
    test = good(tmp_path, files, rates=dated)
    np.testing.assert_allclose(test.time, 60.0 * (minutes - 10.0))
    assert test.rate_changes[0][0] == 0.0
    assert good(tmp_path, files).time[0] == 0.0
    test = good(tmp_path, files, rates=dated, zero="2024-05-17T08:05")
    np.testing.assert_allclose(test.time, 60.0 * (minutes - 5.0))
    assert test.rate_changes[0][0] == 300.0
    plain = {"a.csv": table_of(gauge())}
    test = good(tmp_path, plain, **{"rates": "[[1 h, 100 bbl/d]]", "zero": "1 h"})
    np.testing.assert_allclose(test.time, (TIMES - 1.0) * 3600.0, atol=1e-9)
    assert test.rate_changes[0][0] == 0.0
    for made, zero, said in (
        (files, "1 h", "need a date"),
        (plain, "2024-05-17", "need an elapsed time"),
        (plain, "1 psi", "is a pressure"),
    ):
        _, problems = read(tmp_path, made, zero=zero)
        assert said in problems[0]


def test_what_a_logger_writes_above_the_head_is_left_out_and_told(tmp_path):
    above = "Well: A-1\nGauge 12345\n\nstart, 17 May\n"
    wide = [(t, p, 88.1) for t, p in gauge()]
    text = above + table_of(wide, "t [h],p [psi],temperature [degC]")
    test = good(tmp_path, {"a.csv": text})
    np.testing.assert_allclose(test.pressure, PRESSURES * PSI, rtol=1e-12)
    assert test.notes == ("lines 1, 2, 4 above the head, left out",)
    assert test.lines[0] == 6
    trailing = "".join(f"{line},\n" for line in table_of(gauge()).splitlines()[1:])
    test = good(tmp_path, {"a.csv": "t [h],p [psi]\n" + trailing})
    assert len(test.time) == len(TIMES)


def test_disorder_is_put_right_and_told_with_its_lines(tmp_path):
    rows = gauge()
    shuffled = [*rows[:10], rows[12], rows[10], rows[11], *rows[13:]]
    test = good(tmp_path, {"a.csv": table_of(shuffled)})
    np.testing.assert_allclose(test.time, TIMES * 3600.0)
    assert "sorted by time" in test.notes[0]
    assert "line 13" in test.notes[0]
    twice = [*rows[:20], (rows[19][0], rows[19][1] + 2.0), *rows[20:]]
    test = good(tmp_path, {"a.csv": table_of(twice)})
    assert len(test.time) == len(TIMES)
    assert test.pressure[19] == pytest.approx((PRESSURES[19] + 1.0) * PSI)
    assert "line 22 repeats" in test.notes[0]
    assert "mean is taken" in test.notes[0]
    empty = [*rows[:5], (rows[5][0], ""), *rows[6:]]
    test = good(tmp_path, {"a.csv": table_of(empty)})
    assert len(test.time) == len(TIMES) - 1
    assert "line 7 without time or pressure" in test.notes[0]


def test_a_lone_spike_is_left_out_and_told_and_may_be_kept(tmp_path):
    rng = np.random.default_rng(2)
    noisy = PRESSURES + rng.normal(0.0, 0.2, len(PRESSURES))
    noisy[25] += 40.0
    files = {"a.csv": table_of(gauge(pressures=noisy))}
    test = good(tmp_path, files, rates="[[0 h, 100 bbl/d]]")
    assert len(test.time) == len(TIMES) - 1
    assert test.notes == ("line 27 off the neighbours, more than 8 times the scatter: left out",)
    test = good(tmp_path, files, outliers="keep")
    assert len(test.time) == len(TIMES)
    assert "kept" in test.notes[0]


@pytest.mark.parametrize("seed", range(6))
def test_neither_noise_nor_a_change_of_the_rate_is_a_spike(tmp_path, seed):
    rng = np.random.default_rng(seed)
    times = np.concatenate([np.geomspace(0.001, 10.0, 120), 10.0 + np.geomspace(0.001, 10.0, 120)])
    fall = 40.0 * np.log1p(times / 0.0005)
    fall[120:] -= 40.0 * np.log1p((times[120:] - 10.0) / 0.0005)
    files = {"a.csv": table_of(gauge(times, 3000.0 - fall + rng.normal(0, 0.5, 240)))}
    test = good(tmp_path, files, rates="[[0 h, 100 bbl/d], [10 h, 0 m3/s]]")
    assert test.notes == ()
    assert good(tmp_path, files).notes == ()  # nobody told of the change


def test_gaps_and_drift_are_told(tmp_path):
    times = np.concatenate([np.linspace(0, 1, 60), np.linspace(5, 6, 60)])
    pressures = np.where(times < 2, 3000.0 + 0.5 * times, 2900.0 - times)
    pressures += np.random.default_rng(0).normal(0, 0.01, 120)
    files = {"a.csv": table_of(gauge(times, pressures))}
    test = good(tmp_path, files, rates="[[1.5 h, 100 bbl/d]]")
    assert any("nothing measured for 1.44e+04 s after line 61" in note for note in test.notes)
    (drift,) = [note for note in test.notes if "drifts" in note]
    assert f"{0.5 * 24 * PSI:.2g}"[:3] in drift
    assert "lines 2 to 61" in drift


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (table_of(gauge(), "t,p [psi]"), "column 't' has no unit"),
        (table_of(gauge(), "t [h],p [mD]"), "column 'p': 1 mD is a permeability"),
        (table_of(gauge(), "t [h],p [psig]"), "psig counts from the pressure of the air"),
        (table_of(gauge(), "t [h],x [psi]"), "no column is the pressure"),
        (table_of([(1, 2)]), "a test needs at least 3"),
        (table_of([*gauge(), ("x", 5)]), "line 42: 'x' in column 't' is no number"),
        (table_of([*gauge(), (1, 2, 3)]), "line 42: more fields than the head has names"),
        ("1,2\n3,4\n5,6\n", "line 1 holds numbers"),
        ("", "the file is empty"),
        ("t [h],p [psi]\n", "a head at most"),
    ],
)
def test_a_file_that_is_no_test_is_refused_with_what_to_mend(tmp_path, text, said):
    test, problems = read(tmp_path, {"a.csv": text})
    assert test is None
    assert said in problems[0]


def test_what_the_study_says_of_columns_is_checked(tmp_path):
    files = {"a.csv": table_of(gauge())}
    _, problems = read(tmp_path, files, pressure='"p [bar]"')
    assert "in psi by its file and in bar by the study" in problems[0]
    _, problems = read(tmp_path, files, pressure="q")
    assert "no column is named 'q'" in problems[0]
    _, problems = read(tmp_path, files, rates="no.csv")
    assert "no.csv: there is no such file" in problems[0]
    _, problems = read(
        tmp_path, files | {"b.csv": table_of([(0, 5), (0, 6)], "t [h],q [bbl/d]")}, rates="b.csv"
    )
    assert "line 3: a second rate from the same time" in problems[0]
    _, problems = read(tmp_path, {"a.xlsx": b"PK"})
    assert "the tables that can be read" in problems[0]


LAS = """~VERSION INFORMATION
 VERS. 2.0 : CWLS LOG ASCII STANDARD
 WRAP. NO : ONE LINE PER STEP
~WELL INFORMATION
 STRT.H 0.0 :
 STOP.H 3.0 :
 STEP.H 0.0 :
 NULL. -999.25 :
 WELL. P1 :
~CURVE INFORMATION
 TIME.H : elapsed
 PRES.PSI : gauge
~ASCII
"""


def test_las_files_are_read(tmp_path):
    rows = "\n".join(f"{t} {p}" for t, p in [*gauge(), (101.0, -999.25)])
    test = good(tmp_path, {"a.las": LAS + rows + "\n"}, time="TIME", pressure="PRES")
    np.testing.assert_allclose(test.time, TIMES * 3600.0)
    np.testing.assert_allclose(test.pressure, PRESSURES * PSI)
    assert "row 41 without time or pressure" in test.notes[0]
    named = good(tmp_path, {"a.las": LAS + rows + "\n"})
    np.testing.assert_array_equal(named.pressure, test.pressure)
    days = "\n".join(f"17/05/2024 08:{m:02d} {3000.0 - m}" for m in range(30))
    in_two = LAS.replace(" TIME.H : elapsed", " DATE. : day\n TIME. : time of day")
    dated = good(tmp_path, {"a.las": in_two + days + "\n"}, date_format='"%d/%m/%Y %H:%M"')
    np.testing.assert_allclose(dated.time, 60.0 * np.arange(30))
    _, problems = read(tmp_path, {"b.las": "no las at all"})
    assert "no LAS file, or a damaged one" in problems[0]


def test_summaries_of_a_simulator_are_read(tmp_path):
    import resfo as files

    days = TIMES / 24.0
    values = np.array([days, PRESSURES, np.where(days < 1, 50.0, 0.0)], dtype=np.float32).T
    spec = [
        ("KEYWORDS", [b"TIME    ", b"WBHP    ", b"WWPR    "]),
        ("WGNAMES ", [b":+:+:+:+", b"P1      ", b"P1      "]),
        ("UNITS   ", [b"DAYS    ", b"PSIA    ", b"STB/DAY "]),
    ]
    steps = [("PARAMS  ", row) for row in values]
    made = {}
    for name, content in (("CASE.UNSMRY", steps), ("CASE.SMSPEC", spec)):
        buffer = io.BytesIO()
        files.write(buffer, content)
        made[name] = buffer.getvalue()
    test = good(tmp_path, made, pressure='"WBHP:P1"', rate='"WWPR:P1"')
    np.testing.assert_allclose(test.time, TIMES * 3600.0, rtol=1e-5)
    np.testing.assert_allclose(test.pressure, PRESSURES * PSI, rtol=1e-5)
    rates = [rate for _, rate in test.rate_changes]
    np.testing.assert_allclose(rates, [50 * parse_quantity("1 bbl/d", "m3/s"), 0.0], rtol=1e-5)
    with pytest.raises(TableError, match="SMSPEC is not beside it"):
        read_table({"CASE.UNSMRY": made["CASE.UNSMRY"]})
    with pytest.raises(TableError, match="no summary, or a damaged one"):
        read_table({"CASE.UNSMRY": b"x" * 100, "CASE.SMSPEC": b"y" * 100})


STUDY = """study: fitted
data:
  test: {file: a.csv, rates: [[0 h, 100 bbl/d]]}
fit:
  to: data.test
  model: homogeneous
  reservoir: {porosity: 0.2, viscosity: 1 cP, compressibility: 1e-9 1/Pa, well_radius: 0.1 m}
  parameters:
    permeability: [1 mD, 1000 mD]
    initial_pressure: 3000 psi
"""


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("to: data.test", "to: data.tset", "there is no data.tset; did you mean 'test'?"),
        ("model: homogeneous", "model: homogenous", "did you mean 'homogeneous'?"),
        ("permeability: [1", "permeabilty: [1", "did you mean 'permeability'?"),
        ("initial_pressure: 3000 psi", "skin_factor: 2", "needs initial_pressure"),
        ("[1 mD, 1000 mD]", "[10 mD, 1 mD]", "the bounds between which it is sought"),
        ("[1 mD, 1000 mD]", "[1 psi, 2 psi]", "is a pressure"),
        ("[1 mD, 1000 mD]", "5 mD", "nothing is left to fit"),
        ("[1 mD, 1000 mD]", "[0 mD, 5 mD]", "must be above zero"),
        (", viscosity: 1 cP", "", "fit.reservoir lacks viscosity"),
        ("model: homogeneous", "model: fault", "fault needs distance"),
        ("file: a.csv", "fil: a.csv", "unknown key 'fil' in data.test"),
        ("fit:", "observe: [well_pressure]\nfit:", "'observe' is for a scene"),
    ],
)
def test_a_fit_that_cannot_be_is_refused_at_its_place(tmp_path, old, new, said):
    (tmp_path / "a.csv").write_text(table_of(gauge()))
    path = tmp_path / "study.yaml"
    path.write_text(STUDY)
    assert load_study(path, alone=True).fit.models == ("homogeneous",)
    with pytest.raises(StudyError, match="no scene, so that nothing is run"):
        load_study(path)
    path.write_text(STUDY.replace(old, new, 1))
    with pytest.raises(StudyError) as raised:
        load_study(path, alone=True)
    assert said in str(raised.value)
    assert "there is no data.test" not in str(raised.value)  # it is there, and told to be wrong
