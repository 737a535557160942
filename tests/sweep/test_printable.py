"""What others wrote is shown as what it is, and what is said stays short."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from study_text import SMALL, broken, load, problems

from demflow.sweep.printable import printable, printable_lines, shortened
from demflow.sweep.study.load import StudyError
from demflow.sweep.study.yaml_source import MOST_TOLD


@pytest.mark.slow
@given(st.text(st.characters(exclude_categories=())))
def test_any_text_can_be_printed_and_keeps_what_can_be_seen(text):
    shown = printable(text)
    assert shown.isprintable()
    shown.encode("utf-8")  # also halves of characters
    assert printable(shown) == shown
    assert (shown == text) == text.isprintable()


def test_controls_are_seen():
    assert printable("a\x1b[31m\0b\u202ec\ud802") == r"a\x1b[31m\x00b\u202ec\ud802"
    assert printable_lines("one\x07\ntwo") == "one\\x07\ntwo"


@pytest.mark.slow
@given(st.text(), st.integers(10, 50))
def test_a_long_text_keeps_its_ends(text, most):
    short = shortened(text, most)
    assert len(short) <= most
    if len(text) > most:
        first, last = short.split(" … ") if short.count(" … ") == 1 else ("", "")
        assert text.startswith(first)
        assert text.endswith(last)
    else:
        assert short == text


@pytest.mark.parametrize(
    ("escape", "name"),
    [
        ("\\ud802", None),
        ("\\e[31m", "U+001B"),
        ("\\0", "U+0000"),
        ("\\u202e", "U+202E (right-to-left override)"),
        ("\\u200f", "U+200F (right-to-left mark)"),
        ("\\x9b", "U+009B"),
    ],
)
@pytest.mark.parametrize("where", ["key", "title", "name", "word"])
def test_what_nobody_sees_is_refused_in_a_study(tmp_path, where, escape, name):
    text = {
        "key": SMALL.replace("porosity:", f'"porosity{escape}":'),
        "title": f'title: "a {escape}"\n' + SMALL,
        "name": SMALL.replace("producer:", f'"producer{escape}":'),
        "word": SMALL.replace("[well_pressure,", f'["well_pressure{escape}",'),
    }[where]
    with pytest.raises(StudyError) as caught:
        load(tmp_path, text)
    said = str(caught.value)
    assert (name or "bad YAML") in said
    assert all(line.isprintable() for line in said.split("\n"))
    said.encode("utf-8")


def test_of_many_problems_the_first_hundred_are_told_and_all_are_counted(tmp_path):
    wrong = "\n".join(f"    w{k}: {{at: [0, 0], radius: 1 kg, rate: 1 kg}}" for k in range(400))
    with pytest.raises(StudyError) as caught:
        load(tmp_path, broken("  wells:\n", f"  wells:\n{wrong}\n"))
    error = caught.value
    assert len(error.problems) == MOST_TOLD
    assert error.count == 800
    assert str(error).count("\n") == MOST_TOLD
    assert str(error).endswith("… and 700 more problems")
    assert len({problem.message for problem in error.problems}) == MOST_TOLD


def test_what_is_told_does_not_grow_with_the_file(tmp_path):
    """Hundred thousand mistakes, and one of half a megabyte."""
    many = ", ".join(f"a{k}: x" for k in range(100_000))
    long = "x" * 500_000
    for text in (f"{{{many}}}", f"{long}: 1", SMALL.replace("small", long), f"study: [{many}]"):
        with pytest.raises(StudyError) as caught:
            load(tmp_path, text)
        assert len(str(caught.value)) < 50_000


@pytest.mark.parametrize("first", ["producer", "\u212bngström", "\u00c5ngström"])
def test_names_that_are_the_same_once_normalised_are_one_name(tmp_path, first):
    """A dataset keeps both signs of the ångström as one."""
    well = "{at: [2, 2], radius: 1 ft, rate: 1 bbl/day}"
    second = first.replace("\u212b", "\u00c5")
    text = SMALL.replace("producer:", f"{first}:").replace(
        "  wells:\n", f"  wells:\n    {second}: {well}\n"
    )
    (found,) = problems(tmp_path, text)
    assert "duplicate key" in found


@pytest.mark.parametrize("name", ["x" * 101, "é" * 60])
def test_names_are_as_long_as_files_and_datasets_take_them(tmp_path, name):
    for text in (
        SMALL.replace("producer:", f"{name}:"),
        SMALL.replace("  yy:", f"  {name}:"),
        SMALL.replace("  yy:", f"  v: {{variants: {{{name}: {{grains.count: 300}}}}}}\n  yy:"),
    ):
        (found,) = problems(tmp_path, text)
        assert "name" in found
    good = name[: 100 // len(name[0].encode())]
    assert not problems(tmp_path, SMALL.replace("producer:", f"{good}:"))


def test_a_page_shows_what_cannot_be_seen():
    from demflow.sweep.report.html import escape

    assert escape("a\u202e<b>\x1b\n\tc") == "a\\u202e&lt;b&gt;\\x1b\n        c"
