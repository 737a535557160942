"""The JSON Schema for editors: it takes what loads and marks what an editor can see is wrong."""

import json
import re
from copy import deepcopy

import pytest
from ruamel.yaml import YAML
from study_text import EXAMPLE, SMALL

from demflow.model.scene import OBSERVABLES
from demflow.sweep.study.schema import study_schema

_TYPES = {
    "object": dict,
    "array": list,
    "string": str,
    "integer": int,
    "number": (int, float),
    "null": type(None),
    "boolean": bool,
}


def valid(schema, value) -> bool:
    """The keywords of JSON Schema that the schema of a study uses, word by word."""
    if schema is True or schema is False:
        return schema
    known = {
        "$schema", "title", "description", "default", "type", "enum", "const", "anyOf", "oneOf",
        "pattern", "minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum", "required",
        "properties", "additionalProperties", "propertyNames", "items", "prefixItems", "minItems",
        "uniqueItems",
    }  # fmt: skip
    assert set(schema) <= known, set(schema) - known
    if "type" in schema and not isinstance(value, _TYPES[schema["type"]]):
        return False
    checks = [
        "enum" not in schema or value in schema["enum"],
        "const" not in schema or value == schema["const"],
        "anyOf" not in schema or any(valid(s, value) for s in schema["anyOf"]),
        "oneOf" not in schema or sum(valid(s, value) for s in schema["oneOf"]) == 1,
    ]
    if isinstance(value, str):
        checks.append(re.search(schema.get("pattern", ""), value) is not None)
    if isinstance(value, int | float) and not isinstance(value, bool):
        checks += [
            value >= schema.get("minimum", value),
            value <= schema.get("maximum", value),
            "exclusiveMinimum" not in schema or value > schema["exclusiveMinimum"],
            "exclusiveMaximum" not in schema or value < schema["exclusiveMaximum"],
        ]
    if isinstance(value, list):
        first = schema.get("prefixItems", [])
        checks += [valid(s, v) for s, v in zip(first, value, strict=False)]
        checks += [valid(schema.get("items", True), v) for v in value[len(first) :]]
        checks.append(len(value) >= schema.get("minItems", 0))
        if schema.get("uniqueItems"):
            checks.append(len(set(value)) == len(value))
    if isinstance(value, dict):
        properties = schema.get("properties", {})
        checks.append(all(key in value for key in schema.get("required", [])))
        for key, inner in value.items():
            checks.append(valid(schema.get("propertyNames", True), key))
            checks.append(
                valid(properties.get(key, schema.get("additionalProperties", True)), inner)
            )
    return all(checks)


def parsed(text):
    return YAML(typ="safe", pure=True).load(text)


@pytest.fixture(scope="module")
def schema():
    return study_schema()


def test_it_is_json_of_the_stated_dialect(schema):
    assert json.loads(json.dumps(schema)) == schema
    assert schema["$schema"] == "https://json-schema.org/draft/2020-12/schema"


@pytest.mark.parametrize(
    "text",
    [
        EXAMPLE,
        SMALL,
        SMALL.replace("{p: {at: [3, 0]}}", ""),
        SMALL + "limits: {time: 10 min, memory: 4 GB}\nfigures: {maps: [1 s], compare: linear}\n",
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
        ("viscosity: 1 cP, ", ""),
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


def test_every_object_is_closed_but_the_named_ones(schema):
    """A misspelt key is seen wherever keys are fixed."""

    def closed(node):
        if isinstance(node, dict):
            if "properties" in node:
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
    kinds = scene["fractures"]["anyOf"][0]["additionalProperties"]["oneOf"]
    assert [kind["properties"]["kind"]["const"] for kind in kinds] == [
        *("bi-wing", "set", "set", "trace", "traces"),
    ]
