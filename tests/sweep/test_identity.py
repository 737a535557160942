"""A product's identity: the same everywhere, and different where anything differs."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from dataclasses import dataclass, make_dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from demflow.sweep.plan.identity import encode, product_id

plain = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_nan=False)
    | st.text(max_size=5)
    | st.sampled_from(["", "0", "T", "1", "1.0"]),
    lambda inner: (
        st.lists(inner, max_size=4).map(tuple)
        | st.dictionaries(st.text(max_size=3), inner, max_size=3)
    ),
    max_leaves=8,
)


def exactly(value: object) -> object:
    """A value with its types, and with the sign of zero."""
    if isinstance(value, tuple):
        return ("tuple", *(exactly(v) for v in value))
    if isinstance(value, dict):
        return ("dict", *((k, exactly(value[k])) for k in sorted(value)))
    if isinstance(value, float):
        return ("float", value.hex())
    return (type(value).__name__, value)


@pytest.mark.slow
@given(plain, plain)
def test_encodings_are_equal_exactly_where_values_are(a, b):
    assert (encode(a) == encode(b)) == (exactly(a) == exactly(b))


@given(plain)
def test_encoding_is_repeatable(value):
    assert encode(value) == encode(value)


def test_numbers_that_compare_equal_are_told_apart_by_type():
    assert len({encode(v) for v in (1, 1.0, True, "1", (1,))}) == 5
    assert encode(0.0) != encode(-0.0)
    assert encode(math.nan) == encode(math.nan)
    assert encode(np.float64(0.1)) == encode(0.1)
    assert encode(np.int64(3)) == encode(3)


def test_arrays_count_with_type_shape_and_content():
    array = np.arange(6.0)
    others = [array[:5], array.reshape(2, 3), array.astype("f4"), array + 1, list(array)]
    assert all(encode(array) != encode(other) for other in others)
    assert encode(array) == encode(array.astype(">f8"))
    assert encode(np.arange(12.0)[::2]) == encode(np.arange(12.0)[::2].copy())


def test_an_option_added_later_leaves_identities_alone():
    @dataclass(frozen=True)
    class Block:
        a: float

    later = make_dataclass("Block", [("a", float), ("b", float, None)])
    renamed = make_dataclass("Other", [("a", float)])
    assert encode(Block(1.0)) == encode(later(1.0))
    assert encode(later(1.0)) != encode(later(1.0, 0.0))
    assert encode(Block(1.0)) != encode(renamed(1.0))


@pytest.mark.parametrize("value", [object(), {1, 2}, lambda: 0, np.array([None]), (1, [object()])])
def test_what_has_no_content_is_refused(value):
    with pytest.raises(TypeError):
        encode(value)


def test_every_part_counts():
    base = ("flow", 1, {"a": encode(1)}, {"p": "x"})
    changed = [
        ("flux", 1, {"a": encode(1)}, {"p": "x"}),
        ("flow", 2, {"a": encode(1)}, {"p": "x"}),
        ("flow", 1, {"a": encode(2)}, {"p": "x"}),
        ("flow", 1, {"b": encode(1)}, {"p": "x"}),
        ("flow", 1, {"a": encode(1), "b": encode(1)}, {"p": "x"}),
        ("flow", 1, {}, {"p": "x"}),
        ("flow", 1, {"a": encode((None,))}, {"p": "x"}),
        ("flow", 1, {"a": encode(1)}, {"q": "x"}),
        ("flow", 1, {"a": encode(1)}, {"p": "y"}),
        ("flow", 1, {"a": encode(1)}, {"p": "x", "q": "x"}),
        ("flow", 1, {"a": encode(1)}, {}),
    ]
    assert len({product_id(*parts) for parts in (base, *changed)}) == len(changed) + 1


@given(st.permutations(["x", "y", "z"]))
def test_no_order_counts(names):
    number = {"x": 1, "y": 2, "z": 3}
    reads = {name: encode(number[name]) for name in names}
    parents = {name: f"made by {name}" for name in names}
    ordered = {name: reads[name] for name in number}, {name: parents[name] for name in number}
    assert product_id("s", 1, reads, parents) == product_id("s", 1, *ordered)


def test_what_is_not_there_does_not_count():
    """A stage may be given more one day: nothing that was made without it changes."""
    before = product_id("flow", 1, {"a": encode(1)}, {"p": "x"})
    after = product_id("flow", 1, {"a": encode(1), "b": encode(None)}, {"p": "x", "q": None})
    assert before == after


def test_identities_are_the_same_in_every_process():
    code = (
        "from demflow.model.scene import *\n"
        "from demflow.sweep.plan.identity import encode, product_id\n"
        "grains = Grains(count=7, porosity=0.17)\n"
        "value = (grains, Circle(2.0), {'b': 1, 'a': (0.1, None, 'x')})\n"
        "print(product_id('pack', 1, {'v': encode(value)}, {'p': 'q', 'r': None}))\n"
    )
    printed = {
        subprocess.run(
            [sys.executable, "-c", code],
            env={**os.environ, "PYTHONHASHSEED": seed, "PYTHONPATH": os.pathsep.join(sys.path)},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for seed in ("0", "1", "4711")
    }
    assert len(printed) == 1
    assert len(printed.pop().strip()) == 64
