"""The JSON Schema for editors: it takes what loads and marks what an editor can see is wrong."""

import json
from copy import deepcopy
from pathlib import Path

import jsonschema
import pytest
from ruamel.yaml import YAML
from study_text import EXAMPLE, SMALL

from demflow.model.scene import OBSERVABLES
from demflow.sweep.study.schema import study_schema


def valid(schema, value) -> bool:
    return jsonschema.Draft202012Validator(schema).is_valid(value)


def parsed(text):
    return YAML(typ="safe", pure=True).load(text)


@pytest.fixture(scope="module")
def schema():
    return study_schema()


@pytest.mark.slow
def test_it_is_json_of_the_stated_dialect(schema):
    assert json.loads(json.dumps(schema)) == schema
    jsonschema.Draft202012Validator.check_schema(schema)
    assert schema["$schema"] == "https://json-schema.org/draft/2020-12/schema"


@pytest.mark.parametrize(
    "text",
    [
        EXAMPLE,
        SMALL,
        SMALL.replace("{p: {at: [3, 0]}}", ""),
        SMALL + "limits: {time: 10 min, memory: 4 GB}\nfigures: {maps: [1 s], compare: linear}\n",
        SMALL
        + "data: {t: {file: a.csv, rates: [['2024-05-17 08:30', 5 m3/d], ['2024-05-18', 0]]}}\n",
    ],
)
def test_it_takes_what_loads(schema, text):
    assert valid(schema, parsed(text))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("viscosity:", "viscocity:"),
        ("viscosity: 1 cP", "viscosity: -1"),
        ("viscosity: 1 cP", "viscosity: cP"),
        ("shape: rectangle", "shape: circle"),
        ("kind: set", "kind: sets"),
        ("porosity: 0.17", "porosity: 0.5"),
        ("count: 500", "count: 1.5"),
        ("study: small", "study: ../x"),
        ("study: small\n", ""),
        ("[well_pressure, pressure_map]", "[well_presure]"),
        ("at: [3, 0]", "at: [3]"),
        ("values: [5 MPa, 10 MPa]", "values: []"),
        ("  yy: {", "  y-y: {"),
        ("tolerance: 1e-3", "tolerance: 2"),
        ("tolerance: 1e-3", "method: fast"),
    ],
)
def test_it_marks_mistakes(schema, old, new):
    assert SMALL.count(old) == 1
    assert not valid(schema, parsed(SMALL.replace(old, new)))


STUDIES = Path(__file__).parents[2] / "studies"


@pytest.mark.parametrize("path", sorted(STUDIES.glob("*.yaml")), ids=lambda path: path.stem)
def test_it_takes_every_study_that_is_shipped(schema, path):
    assert valid(schema, parsed(path.read_text()))


def test_a_key_may_be_left_out_where_an_axis_can_give_it(schema):
    lacks = SMALL.replace("viscosity: 1 cP, ", "")
    assert valid(schema, parsed(lacks))
    assert not valid(schema, parsed(lacks[: lacks.index("vary:")] + "observe: [well_pressure]\n"))


def test_every_object_is_closed_but_the_named_ones(schema):
    """A misspelt key is seen wherever keys are fixed."""

    def closed(node):
        if isinstance(node, dict):
            if node.get("type") == "object" and "properties" in node:
                assert node["additionalProperties"] is False
            for inner in node.values():
                closed(inner)
        elif isinstance(node, list):
            for inner in node:
                closed(inner)

    closed(deepcopy(schema))


def test_it_says_what_the_dataclasses_say(schema):
    scene = schema["properties"]["scene"]["properties"]
    assert scene["fluid"]["anyOf"][0]["properties"]["viscosity"]["description"] == (
        "dynamic viscosity [Pa s; for instance 1 cP]"
    )
    assert schema["properties"]["observe"]["items"]["enum"] == list(OBSERVABLES)
    kinds = scene["fractures"]["anyOf"][0]["additionalProperties"]["anyOf"]
    assert [kind["properties"]["kind"]["const"] for kind in kinds] == [
        *("bi-wing", "set", "set", "trace", "traces"),
    ]
