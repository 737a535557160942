"""JSON Schema (2020-12) of a study, for editors: made from the grammar that reads studies.

It is as strict as a schema can be without repeating the model: keys, words, the form of
quantities, bounds of bare numbers. Units' dimensions and what holds between blocks are
`load_study`'s to check.
"""

from __future__ import annotations

import typing
from typing import Any

from demflow.sweep.study.axes import MAX_CASES
from demflow.sweep.study.blocks import Block, Forms, Law, Listed, Named, OneOf, Words
from demflow.sweep.study.expect import EXPECT
from demflow.sweep.study.fits import FIT
from demflow.sweep.study.laws import FORMS, keys_of
from demflow.sweep.study.load import FIGURES, LIMITS, NAME_PATTERN
from demflow.sweep.study.measured import DATA, RateForms
from demflow.sweep.study.notes import REPORT, TextFile
from demflow.sweep.study.reservoir import MODEL_PARAMETERS
from demflow.sweep.study.samples import SAMPLE
from demflow.sweep.study.scene import (
    SCENE,
    InitialForms,
    MapFiles,
    ProbeForms,
    Times,
    WordOr,
    WordOrBlock,
)
from demflow.sweep.study.schedules import Schedule
from demflow.sweep.study.sections import Parameter, Section
from demflow.sweep.study.tables import READERS
from demflow.sweep.study.units import QUANTITY_PATTERN, example

DATE_PATTERN = r"^\s*\d{4}-?\d{2}-?\d{2}(?:[ T].*)?$"

_BOUNDS = {
    "above": "exclusiveMinimum",
    "at_least": "minimum",
    "below": "exclusiveMaximum",
    "at_most": "maximum",
}

Schema = dict[str, Any]


def study_schema() -> Schema:
    """The schema as a dict that `json.dumps` takes."""
    scene = _schema(SCENE.without("observe", "solver")) | {"description": "what is modelled"}
    value = {"description": "a value of the parameter: a quantity, a word or a list"}
    path = {"type": "string", "description": "path inside scene, as in wells.producer.rate"}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "demflow study",
        "type": "object",
        "required": ["study"],
        # without a scene only reservoir models can be fitted
        "anyOf": [{"required": ["scene", "observe"]}, {"required": ["data", "fit"]}],
        "additionalProperties": False,
        "properties": {
            "study": {
                "type": "string",
                "pattern": f"^{NAME_PATTERN}$",
                "description": "name; results/<name> is where it writes",
            },
            "title": {"type": "string", "description": "one line for figures and report"},
            "scene": _relaxed(scene),
            "vary": {
                "type": "object",
                "description": f"axes; they multiply, up to {MAX_CASES} cases",
                "propertyNames": {"pattern": "^[A-Za-z][A-Za-z0-9_]*$"},
                "additionalProperties": {"oneOf": _axis_forms(path, value)},
            },
            "sample": _schema(SAMPLE)
            | {"description": "how the axes with a distribution are sampled together"},
            "where": {
                "type": ["string", "array"],
                "items": {"type": "string"},
                "description": "which combinations are cases, as in stress_xx >= stress_yy",
            },
            "observe": _schema(SCENE.members["observe"].section)
            | {"description": "what is wanted; it decides what is run"},
            "solver": _schema(SCENE.members["solver"].section),
            "limits": _schema(LIMITS),
            "figures": _schema(FIGURES),
            "report": _schema(REPORT),
            "expect": _schema(EXPECT) | {"description": "how the cases end, within which bounds"},
            "smoke": {
                "type": "object",
                "description": "overrides that make the study small: path -> value",
            },
            "data": {
                "type": "object",
                "description": "measured tests by name",
                "additionalProperties": _schema(DATA),
            },
            "fit": _fit(),
        },
        # an axis may give what the scene leaves out
        "if": {"not": {"required": ["vary"]}},
        "then": {"properties": {"scene": scene}},
    }


def _relaxed(schema: Any) -> Any:
    """A schema that lets keys be left out, but those that say of which kind a block is."""
    if isinstance(schema, list):
        return [_relaxed(one) for one in schema]
    if not isinstance(schema, dict):
        return schema
    relaxed = {("anyOf" if key == "oneOf" else key): _relaxed(one) for key, one in schema.items()}
    if "required" in schema:
        tags = (key for key in schema["required"] if "const" in schema["properties"][key])
        relaxed["required"] = list(tags)
    return relaxed


def _axis_forms(path: Schema, value: Schema) -> list[Schema]:
    listed = {"type": "array", "minItems": 1, "items": value}
    spaced = {
        "parameter": path,
        "from": _quantity({}, "first value"),
        "to": _quantity({}, "last value"),
        "count": {"type": "integer", "minimum": 1, "maximum": MAX_CASES},
        "spacing": {"enum": ["linear", "log"]},
    }
    together = {
        "parameters": {"type": "array", "minItems": 1, "items": path},
        "values": {"type": "array", "minItems": 1, "items": {"type": "array", "items": value}},
    }
    drawn = {"parameter": path, "distribution": {"oneOf": [*map(_law, FORMS)]}}
    tabled = {
        "file": {"type": "string", "description": "CSV with a column for each parameter"},
        "columns": {"type": "array", "items": {"type": "string"}},
    }
    variants = {
        "variants": {
            "type": "object",
            "minProperties": 1,
            "additionalProperties": {
                "type": ["object", "null"],
                "description": "overrides of the scene: path -> value; expect says how it ends",
            },
        },
        "values": {"type": "array", "items": {"type": "string"}},
    }
    return [
        _object({"parameter": path, "values": listed}, ["parameter", "values"]),
        _object(spaced, ["parameter", "from", "to", "count"]),
        _object(together, ["parameters", "values"]),
        _object(drawn, ["parameter", "distribution"]),
        _object({"parameter": path, **tabled}, ["parameter", "file"]),
        _object({"parameters": together["parameters"], **tabled}, ["parameters", "file"]),
        _object(variants, ["variants"]),
    ]


def _law(name: str) -> Schema:
    """The schema of a law of chance."""
    number = _quantity({}, "a value, in the parameter's unit")
    form, several = FORMS[name], {"type": "array", "minItems": 1, "items": {}}
    properties: Schema = {name: several}
    if form.numbers == 1:
        properties[name] = _quantity({}, "standard deviation")
    elif form.numbers:
        count = {"minItems": form.numbers, "maxItems": form.numbers}
        properties[name] = {"type": "array", "items": number, **count}
    for key in keys_of(name)[1:]:
        properties[key] = several if key in ("within", "weights") else number
    return _object(properties, [name, *([form.beside] if form.beside else [])])


def _schema(section: Section) -> Schema:
    if isinstance(section, Parameter):
        return _parameter(section)
    if isinstance(section, Block):
        return _block(section, {})
    if isinstance(section, OneOf):
        return {
            "oneOf": [
                _block(form, {section.tag: {"const": word}})
                for word, block in section.blocks.items()
                for form in (block.blocks if isinstance(block, Forms) else (block,))
            ]
        }
    if isinstance(section, Named):
        return {"type": "object", "additionalProperties": _schema(section.inner)}
    if isinstance(section, Listed):
        return {"type": "array", "items": _schema(section.inner)}
    if isinstance(section, Law):
        blocks = {id(block): block for block in section.laws.values()}  # several keys, one block
        laws = [_block(block, {}) for block in blocks.values()]
        return {"anyOf": [_schema(section.number), *laws]}
    if isinstance(section, WordOr):
        return {"anyOf": [{"enum": list(section.words)}, _schema(section.value)]}
    if isinstance(section, WordOrBlock):
        return {
            "anyOf": [_schema(section.block.members[section.key].section), _schema(section.block)]
        }
    if isinstance(section, MapFiles | TextFile):
        text = section.declared.metadata["help"]
        return {"type": "string", "description": f"{text}; its path relative to the study"}
    if isinstance(section, Words):
        items = {"enum": list(section.choices)}
        return {"type": "array", "minItems": 1, "uniqueItems": True, "items": items}
    return _forms(section)


def _fit() -> Schema:
    """The block `fit`: the keys of `FitBlock`, parameters by name, models by word."""
    quantity = {"type": ["number", "string"]}
    bounds = {"type": "array", "prefixItems": [quantity, quantity], "minItems": 2, "items": False}
    word = {"enum": list(MODEL_PARAMETERS)}
    words = {"anyOf": [word, {"type": "array", "minItems": 1, "items": word}]}
    block = _schema(FIT)
    block["properties"] |= {
        "parameters": {
            "type": "object",
            "minProperties": 1,
            "description": "[low, high] of what is fitted, or one value of what is known",
            "additionalProperties": {"anyOf": [bounds, quantity]},
        },
        "model": words | {"description": "reservoir model; without one the scene is fitted"},
        "models": words | {"description": "several, of which the data choose"},
    }
    block["required"].append("parameters")
    return block


def _forms(section: Section) -> Schema:
    """The schema of what can be written in several forms."""
    if isinstance(section, Times):
        return {"oneOf": [_schema(section.listed), _schema(section.spaced)]}
    if isinstance(section, RateForms):
        pairs = _schema(section.pairs)
        date = {"type": "string", "pattern": DATE_PATTERN}
        dated = [date, *pairs["items"]["prefixItems"][1:]]
        both = [pairs, {**pairs, "items": {**pairs["items"], "prefixItems": dated}}]
        return {"anyOf": [_schema(section.word), *both]}
    if isinstance(section, ProbeForms):
        return {"oneOf": [_schema(section.point), _schema(section.line)]}
    if isinstance(section, InitialForms):
        forms = [_schema(section.number), {"const": section.word}, _schema(section.field)]
        return {"anyOf": forms}
    raise TypeError(f"no schema for {type(section).__name__}")


def _object(properties: Schema, required: list[str]) -> Schema:
    return {
        "type": "object",
        "properties": properties,
        "required": required,
        "additionalProperties": False,
    }


def _block(block: Block, tag: Schema) -> Schema:
    """A mapping with the keys of a dataclass; an optional key may stand empty."""
    properties = dict(tag)
    required = list(tag)
    for key, member in block.members.items():
        inner = _schema(member.section)
        if member.required:
            required.append(key)
        else:
            inner = {"anyOf": [inner, {"type": "null"}]}
        properties[key] = inner
    text = (block.cls.__doc__ or "").strip().splitlines()
    return _object(properties, required) | {"description": text[0] if text else ""}


def _parameter(parameter: Parameter) -> Schema:
    meta = parameter.declared.metadata
    if parameter.choices:
        return {"enum": list(parameter.choices), "description": parameter.help}
    bounds = {word: meta[key] for key, word in _BOUNDS.items() if meta.get(key) is not None}
    schema = _value(parameter.type, parameter.unit, bounds)
    default = parameter.declared.default
    if isinstance(default, int | float | str) and default == default:  # NaN: there is none
        schema["default"] = default
    if isinstance(parameter, Schedule):
        file = {"type": "string", "pattern": rf"\.({'|'.join(kind[1:] for kind in READERS)})$"}
        schema = {"anyOf": [schema, file]}
    return schema | {"description": _described(parameter)}


def _described(parameter: Parameter) -> str:
    if parameter.unit == "1":
        return parameter.help
    unit = f"{parameter.unit}; for instance " if ", " not in parameter.unit else ""
    return f"{parameter.help} [{unit}{', '.join(map(example, parameter.unit.split(', ')))}]"


def _value(kind: Any, unit: str, bounds: Schema) -> Schema:
    arguments = typing.get_args(kind)
    if arguments and arguments[-1] is Ellipsis:
        return {"type": "array", "items": _value(arguments[0], unit, bounds)}
    if arguments:
        units = unit.split(", ")
        units = units if len(units) == len(arguments) else [unit] * len(arguments)
        items = [_value(one, u, bounds) for one, u in zip(arguments, units, strict=True)]
        return {"type": "array", "prefixItems": items, "minItems": len(items), "items": False}
    if kind is str:
        return {"type": "string"}
    if kind is bool:
        return {"type": "boolean"}
    if kind is int:
        return {"type": "integer", **bounds}
    return _quantity(bounds, "")


def _quantity(bounds: Schema, description: str) -> Schema:
    forms = [{"type": "number", **bounds}, {"type": "string", "pattern": QUANTITY_PATTERN}]
    return {"anyOf": forms} | ({"description": description} if description else {})
