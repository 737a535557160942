"""Studies as a careless or malicious hand leaves them: good ones, changed where it may hurt.

A study is taken as a tree of mappings, lists and texts. Keys, types, units, nesting, numbers and
words are changed in it, blocks go or come, axes and variants reach anywhere; some are damaged as
text or bytes besides. All follows from a source of chance numbers.
"""

from __future__ import annotations

import copy
import functools
import json
import random
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import yaml

from demflow.sweep.study.blocks import Block, Named
from demflow.sweep.study.expect import EXPECT
from demflow.sweep.study.fits import FIT
from demflow.sweep.study.laws import FORMS, keys_of
from demflow.sweep.study.load import FIGURES, LIMITS
from demflow.sweep.study.measured import DATA
from demflow.sweep.study.notes import REPORT
from demflow.sweep.study.reservoir import MODEL_PARAMETERS
from demflow.sweep.study.samples import SAMPLE
from demflow.sweep.study.scene import SCENE
from demflow.sweep.study.sections import Parameter, Section
from demflow.sweep.study.units import UNITS
from tests.sweep.study_text import EXAMPLE, SMALL

# fractures of every other kind
RANDOM = SMALL.replace(
    "  fractures:\n",
    """  fractures:
    random: {kind: set, seed: 1, intensity: 0.5 1/m, length: {power_law: 2.2, from: 1 m, to: 9 m},
             angle: {von_mises: 10, mean: 60 deg}, aperture: {log_normal: 0.5, median: 80 um}}
    bent: {kind: trace, vertices: [[0 m, 0 m], [1 m, 0.2 m], [2 m, 0 m]], aperture: 100 um}
    map: {kind: traces, file: none.geojson, origin: centroid, snap: 1 mm, unit: 1 m,
          aperture: 100 um}
""",
)
# a study of uncertain parameters with a measured test, wells with limits, and most other keys
DRAWN = """\
study: drawn
scene:
  region: {shape: rectangle, width: 14 m, height: 14 m}
  grains: {count: 500, porosity: 0.17, modulus: 20 GPa,
           refine: [{around: wells, within: 2 m, factor: 2}]}
  bonds: {kind: parallel, tensile_strength: 10 MPa, shear_strength: 20 MPa}
  stress: {xx: 20 MPa, yy: 10 MPa}
  gravity: 9.81 m/s2
  excavate:
    - {shape: circle, name: drift, at: [-3 m, -3 m], radius: 1 m}
    - {shape: rectangle, name: room, at: [3 m, 3 m], width: 1 m, height: 1 m}
  matrix: {permeability: 1 mD, half_stress: 10 MPa}
  fluid: {viscosity: 1 cP, bulk_modulus: 1 GPa}
  fractures:
    a: {kind: trace, from: [-3 m, 1 m], to: [4 m, 2 m], aperture: 100 um,
        closure: {table: [[0 MPa, 100 um], [5 MPa, 60 um], [20 MPa, 30 um]]}}
    b: {kind: set, angle: 65 deg, length: 5 m, spacing: 2 m, aperture: 90 um,
        closure: {barton_bandis: {jrc: 8, jcs: 80 MPa}}}
    c: {kind: trace, from: [-4 m, 4 m], to: [-1 m, 5 m], aperture: 80 um,
        closure: {stiffness: 1 GPa/m, largest_closure: 50 um}}
    d: {kind: trace, from: [-4 m, 2 m], to: [-1 m, 3 m], aperture: 80 um, closure: none}
  wells:
    producer: {at: [0 m, 0 m], radius: 0.3 m, rate: 1e-6 m3/s, least_pressure: 2 MPa}
    injector: {at: [2 m, -3 m], radius: 0.3 m, schedule: [[0 s, 0 m3/s], [2 h, -1e-6 m3/s]],
               largest_pressure: 12 MPa}
    left: {at: [-5 m, 0 m], radius: 0.2 m, schedule: rates.csv, group: field}
    right: {at: [5 m, 0 m], radius: 0.2 m, rate: 1e-7 m3/s, group: field}
  boundaries: {left: 7 MPa, drift: 0 Pa}
  probes: {p: {at: [3 m, 0 m]}}
  initial_pressure: 7 MPa
  times: [1 s, 1 min, 1 h, 1 d]
vary:
  closed: {parameter: fractures.b.aperture, distribution: {log_normal: 0.4, median: 80 um}}
  rate: {parameter: wells.producer.rate, distribution: {uniform: [1e-7 m3/s, 2e-6 m3/s]}}
  mode: {parameter: fluid.viscosity, distribution: {triangular: [0.5 cP, 1 cP, 3 cP]}}
  yy: {parameter: stress.yy, values: [5 MPa, 10 MPa]}
  xx: {parameter: stress.xx, file: points.csv}
sample: {count: 6, method: latin_hypercube, seed: 3}
where: [xx >= yy, yy < 2 * xx or yy != 5 MPa]
observe: [well_pressure, probe_pressure, pressure_map, boundary_flow]
solver: {method: krylov, tolerance: 1e-3}
limits: {time: 1 h, memory: 2 GB}
figures: {maps: [1 h]}
report: {notes: notes.md}
expect: {status: done}
data:
  test: {file: gauge.csv, time: "t [h]", pressure: "p [psi]", well: producer, outliers: keep,
         rates: [[0 s, 1e-6 m3/s], [2 h, 0 m3/s]]}
smoke: {grains.count: 100, sample.count: 4, vary.yy: [5 MPa]}
"""
# one with a fit of its own scene, and one whose grains and fluid move together
FITTED = (
    SMALL[: SMALL.index("vary:")]
    + """observe: [well_pressure]
data: {test: {file: gauge.csv, rates: rates.csv, well: producer}}
fit:
  to: data.test
  profile: true
  reservoir: {thickness: 4 m, volume_factor: 1.0}
  parameters: {matrix.permeability: [0.5 mD, 50 mD], wells.producer.skin_factor: [-2, 20]}
"""
)
MODELLED = """\
study: modelled
data:
  test: {file: dated.csv, date_format: "%d/%m/%Y %H:%M", zero: 2024-05-17 08:30,
         rates: [[2024-05-17 08:30, 10 m3/d], [2024-05-17 09:30, 0 m3/d]]}
fit:
  to: data.test
  models: [homogeneous, fault]
  reservoir: {porosity: 0.2, viscosity: 1 cP, compressibility: 1e-9 1/Pa, well_radius: 0.1 m,
              thickness: 10 m}
  parameters: {permeability: [1 mD, 1000 mD], skin_factor: [-4, 20],
               wellbore_storage: [1e-10 m3/Pa, 1e-6 m3/Pa], initial_pressure: [20 MPa, 40 MPa],
               distance: [5 m, 1000 m]}
"""
# what lies beside a study
FILES = {
    "gauge.csv": b"t [h],p [psi]\n0,3000\n1,2950\n2,2930\n2,2930\n3,2990\n",
    "dated.csv": b"Well A-1\nDate,Time,p [psi]\n17/05/2024,08:30,3000\n17/05/2024,09:30,2950\n"
    b"17/05/2024,09:31,2970\n",
    "rates.csv": b"time [h];rate [m3/d]\n0;10\n2;0\n",
    "points.csv": b"stress.xx [MPa]\n10\n20\n30\n",
    "notes.md": b"# What is asked\n\nHow *much* flows, and [where](https://example.org)?\n",
    "none.geojson": b'{"type": "LineString", "coordinates": [[0, 0], [3, 1], [5, -2]]}',
}
STUDIES = Path(__file__).parents[2] / "studies"
OTHER_KEYS = STUDIES.parent / "docs" / "more_keys.yaml"  # what no shipped study has
PLAIN = re.compile(r"[A-Za-z0-9.+][A-Za-z0-9 ./^+-]*")

NUMBERS = [
    *("0", "-0", "1", "-1", "2", "0.5", "3.7", "1e-300", "1e300", "-1e308", "1e-5", "1e9", "7e22"),
    *("1e400", "1e-400", ".inf", "-.inf", ".nan", "0x10", "1_000", "0,1", "1,200", "12:30", "017"),
    *("9" * 400, "9007199254740993", "100000", "1000000", "4294967296", "1e5", "2000000"),
]
UNIT_TEXTS = [
    *UNITS,
    *("Pa s", "Pa.s", "m3/s", "bbl/D", "1/Pa", "N/m", "m^2", "m^9", "m-9", "m//s", "(m", "m)", "*"),
    *("STB/D", "psig", "mpa", "kgf/cm2", "m3/(s Pa)", "m·s⁻¹", "µm", "%%", "ﬀ", "M", "m m m m m"),
]
WORDS = [
    *("", " ", "~", "null", "true", "no", "steady", "auto", "krylov", "random", "square", "circle"),
    *("periodic", "polygon", "bi-wing", "set", "trace", "explicit", "paper", "tension", "list"),
    *("linear", "log", "failed", "../../etc/passwd", "a/b", ".hidden", "CON", "$x^2$", "{{x}}"),
    *("<script>", "%s%n", "\x1b[31m", "\0", "\u202eabc", "\ud802", "\ud83d\ude00", "é", "e\u0301"),
    *("well_pressure", "permeability", "x" * 300, "é" * 200, "a.b.c", ".", "..", "[0]", "line[3]"),
]  # fmt: skip
KEYS = [
    *("study", "scene", "vary", "observe", "smoke", "solver", "limits", "figures", "expect"),
    *("variants", "values", "parameter", "parameters", "from", "to", "count", "spacing", "kind"),
    *("shape", "name", "at", "angle", "status", "message", "x", "method", "skin", "x" * 300),
    *("sample", "where", "data", "fit", "report", "distribution", "file", "columns", "weights"),
    *("to", "model", "models", "closure", "table", "law", "group", "least_pressure", "coupling"),
    *("excavate", "gravity", "notes", "rates", "within", *FORMS),
]


EXAMPLES = (EXAMPLE, SMALL, RANDOM, DRAWN, DRAWN, DRAWN, FITTED, MODELLED)


def studies() -> list[Any]:
    """Trees of good studies: what is shipped, and the examples."""
    texts = [path.read_text() for path in (*sorted(STUDIES.glob("*.yaml")), OTHER_KEYS)]
    # every scalar as text
    loader = getattr(yaml, "CBaseLoader", yaml.BaseLoader)
    return [yaml.load(text, Loader=loader) for text in (*texts, *EXAMPLES)]


def damaged(good: list[Any], chance: random.Random) -> bytes:
    """A study with some damage, as a file holds it."""
    tree = copy.deepcopy(chance.choice(good))
    for _ in range(chance.choice((1, 1, 1, 2, 2, 3, 5, 9))):
        chance.choice(DAMAGES)(tree, chance)
    written = text(tree, chance).encode("utf-8", "surrogatepass")
    while chance.random() < 0.1:
        written = _torn(written, chance)
    return written


def beside(chance: random.Random) -> dict[str, bytes]:
    """What lies beside a study, by name, now and then torn."""
    return {
        name: _torn(content, chance) if chance.random() < 0.2 else content
        for name, content in FILES.items()
    }


def text(tree: Any, chance: random.Random) -> str:
    """A tree as YAML: flow style below the second level, strange texts quoted."""
    if not isinstance(tree, dict):
        return _flow(tree, chance)
    lines = []
    for key, value in tree.items():
        if isinstance(value, dict) and value and chance.random() < 0.9:
            inner = [f"  {_word(k, chance)}: {_flow(v, chance)}" for k, v in value.items()]
            lines.append("\n".join([f"{_word(key, chance)}:", *inner]))
        else:
            lines.append(f"{_word(key, chance)}: {_flow(value, chance)}")
    return "\n".join(lines) + "\n"


def _flow(tree: Any, chance: random.Random) -> str:
    if isinstance(tree, dict):
        inner = (f"{_word(k, chance)}: {_flow(v, chance)}" for k, v in tree.items())
        return "{" + ", ".join(inner) + "}"
    if isinstance(tree, list):
        return "[" + ", ".join(_flow(item, chance) for item in tree) + "]"
    return _word(tree, chance)


def _word(word: str, chance: random.Random) -> str:
    if PLAIN.fullmatch(word) and chance.random() < 0.97:
        return word
    return json.dumps(word)  # halves of characters as their escapes


def _torn(written: bytes, chance: random.Random) -> bytes:
    """Bytes with a piece cut out, doubled, turned or put in."""
    a, b = sorted(chance.randrange(len(written) + 1) for _ in range(2))
    b = min(b, a + chance.choice((1, 3, 40)))
    pieces = [b"", written[a:b] * 2, written[a:b][::-1], bytes(chance.randrange(256) for _ in "ab")]
    pieces += [
        b"\t",
        b"\n",
        b"\n\n  ",
        b"{" * 30,
        b"- ",
        b": ",
        b"# ",
        b"*a",
        b"&a ",
        b"!!x ",
        b"|\n",
    ]
    return written[:a] + chance.choice(pieces) + written[b:]


# where something lies: its container and its key or position
Spot = tuple[Any, Any]


def _spots(tree: Any) -> Iterator[Spot]:
    if isinstance(tree, dict | list):
        for key in tree if isinstance(tree, dict) else range(len(tree)):
            yield tree, key
            yield from _spots(tree[key])


def numbers_of(tree: Any) -> Iterator[Spot]:
    """Where texts begin as a number does."""
    for inside, key in _spots(tree):
        if isinstance(inside[key], str) and inside[key][:1].isdigit():
            yield inside, key


def _spot(tree: Any, chance: random.Random) -> Spot:
    """Somewhere: at the top as often as deep down, so that blocks change as often as numbers."""
    spots = list(_spots(tree))
    blocks = [spot for spot in spots if isinstance(spot[0][spot[1]], dict)]
    return chance.choice(blocks if blocks and chance.random() < 0.4 else spots or [(tree, None)])


def _any_value(chance: random.Random, depth: int = 0) -> Any:
    """A value of any kind."""
    kind = chance.random()
    if kind < 0.35:
        unit = chance.choice(UNIT_TEXTS) if chance.random() < 0.6 else ""
        return f"{chance.choice(NUMBERS)} {unit}".strip()
    if kind < 0.6:
        return chance.choice(WORDS)
    if depth > 2:
        return "1"
    if kind < 0.8:
        return [_any_value(chance, depth + 1) for _ in range(chance.choice((0, 1, 2, 2, 3, 60)))]
    return {
        chance.choice(KEYS + WORDS): _any_value(chance, depth + 1)
        for _ in range(chance.choice((0, 1, 2, 4)))
    }


def _another_value(tree: Any, chance: random.Random) -> None:
    inside, key = _spot(tree, chance)
    if key is not None:
        inside[key] = _any_value(chance)


def _another_number(tree: Any, chance: random.Random) -> None:
    """One number with its unit kept, or one unit with its number."""
    spots = [*numbers_of(tree)]
    if spots:
        inside, key = chance.choice(spots)
        number, _, unit = inside[key].partition(" ")
        if chance.random() < 0.6:
            number = chance.choice(NUMBERS)
        else:
            unit = chance.choice(UNIT_TEXTS)
        inside[key] = f"{number} {unit}".strip()


def _nudged(tree: Any, chance: random.Random) -> None:
    """One number as somebody might have meant it: such studies often stay valid."""
    spots = [*numbers_of(tree)]
    if spots:
        inside, key = chance.choice(spots)
        number, _, unit = inside[key].partition(" ")
        try:
            value = chance.choice((-1.0, 0.1, 0.5, 0.9, 1.1, 2.0, 10.0, 1000.0)) * float(number)
        except ValueError:
            return
        whole = number.isdigit() and len(number) < 18 and chance.random() < 0.9
        inside[key] = f"{round(value) if whole else f'{value:.6g}'} {unit}".strip()


def _without(tree: Any, chance: random.Random) -> None:
    inside, key = _spot(tree, chance)
    if key is not None:
        del inside[key]


def _misspelt(tree: Any, chance: random.Random) -> None:
    """A key with another name, or a word with another letter."""
    inside, key = _spot(tree, chance)
    if isinstance(inside, dict) and key is not None:
        other = chance.choice((*KEYS, key[:-1] + "x", key + "s", key.upper(), key + ".x"))
        inside[other] = inside.pop(key) if chance.random() < 0.8 else copy.deepcopy(inside[key])


def _exchanged(tree: Any, chance: random.Random) -> None:
    (a, i), (b, j) = _spot(tree, chance), _spot(tree, chance)
    if i is not None and j is not None:
        a[i], b[j] = copy.deepcopy(b[j]), copy.deepcopy(a[i])


def _nested(tree: Any, chance: random.Random) -> None:
    inside, key = _spot(tree, chance)
    if key is not None:
        for _ in range(chance.choice((1, 1, 2, 25))):
            inside[key] = [inside[key]] if chance.random() < 0.5 else {"a": inside[key]}


def _many(tree: Any, chance: random.Random) -> None:
    """An entry many times over."""
    inside, key = _spot(tree, chance)
    times = chance.choice((3, 30, 200))
    if isinstance(inside, list) and key is not None:
        inside.extend(copy.deepcopy(inside[key]) for _ in range(times))
    elif key is not None:
        inside |= {f"{key}{k}": copy.deepcopy(inside[key]) for k in range(times)}


def _paths(section: Section, path: str, names: tuple[str, ...]) -> Iterator[str]:
    """Every path of the grammar, with some names."""
    if isinstance(section, Block):
        for key, member in section.members.items():
            yield from _paths(member.section, f"{path}.{key}".lstrip("."), names)
    elif isinstance(section, Named):
        for name in names:
            yield from _paths(section.inner, f"{path}.{name}", names)
    else:
        yield path
        for inner in vars(section).values():  # sections that hold several forms
            forms = inner.values() if isinstance(inner, dict) else inner
            for form in forms if isinstance(inner, dict | tuple) else (inner,):
                if isinstance(form, Section) and not isinstance(form, Parameter):
                    yield from _paths(form, path, names)


@functools.cache
def _paths_of_scenes(names: tuple[str, ...]) -> list[str]:
    return [*_paths(SCENE, "", names)]


def _any_path(tree: Any, chance: random.Random) -> str:
    scene = tree.get("scene") if isinstance(tree, dict) else None
    scene = scene if isinstance(scene, dict) else {}
    blocks = (scene.get(key) for key in ("wells", "fractures", "probes", "boundaries"))
    names = [str(name) for block in blocks if isinstance(block, dict) for name in block]
    if chance.random() < 0.05:
        return chance.choice((*KEYS, "scene.stress.xx", "a..b"))
    return chance.choice(_paths_of_scenes(tuple(names[:20]) or ("p",)))


def _inside(tree: Any, key: str, chance: random.Random) -> dict[str, Any]:
    """A mapping at the top of a study, made where there is none."""
    if not isinstance(tree, dict):
        return {}
    if not isinstance(tree.get(key), dict):
        tree[key] = {}
    return tree[key]


def _quantity(chance: random.Random) -> str:
    units = ("", "m", "MPa", "deg", "mD", "s", "m3/s")
    return f"{chance.choice(NUMBERS[:13])} {chance.choice(units)}".strip()


def _axis(tree: Any, chance: random.Random) -> None:
    """One axis more, anywhere."""
    path = _any_path(tree, chance)
    value: Callable[[], Any] = lambda: (  # noqa: E731
        _quantity(chance) if chance.random() < 0.7 else _any_value(chance)
    )
    forms: list[dict[str, Any]] = [
        {"parameter": path, "values": [value() for _ in range(chance.choice((1, 2, 3)))]},
        {
            "parameter": path,
            "from": value(),
            "to": value(),
            "count": chance.choice(("2", "3", "1000", "1e9", "x")),
            "spacing": chance.choice(("log", "linear", "x")),
        },
        {
            "parameters": [path, _any_path(tree, chance)],
            "values": [[value(), value()] for _ in range(2)],
        },
    ]
    names = ("a", "b", "aperture", "x" * 300, "well", "method", "é", "stress", "\ud802")
    _inside(tree, "vary", chance)[chance.choice(names)] = chance.choice(forms)


def _variants(tree: Any, chance: random.Random) -> None:
    """An axis of variants that override anything."""
    overrides = {
        chance.choice([*WORDS, "a", "b"]): {
            _any_path(tree, chance): _any_value(chance)
            if chance.random() < 0.7
            else _quantity(chance)
            for _ in range(chance.choice((0, 1, 3)))
        }
        for _ in range(chance.choice((1, 2, 4)))
    }
    _inside(tree, "vary", chance)["v"] = {"variants": overrides}


def _smoke(tree: Any, chance: random.Random) -> None:
    _inside(tree, "smoke", chance)[_any_path(tree, chance)] = _any_value(chance)


def _block(tree: Any, chance: random.Random) -> None:
    """A value where the grammar has one, whatever the scene has."""
    *parts, last = _any_path(tree, chance).split(".")
    inside = _inside(tree, "scene", chance)
    for part in parts:
        inside = _inside(inside, part, chance)
    inside[last] = _quantity(chance) if chance.random() < 0.6 else _any_value(chance)


def _law(tree: Any, chance: random.Random) -> None:
    """One axis more whose values are drawn, by a law that is right more often than not."""

    def own(path: str) -> str:
        fits = "1e-5" if chance.random() < 0.5 else _quantity(chance)
        return fits if "." in path else _quantity(chance)

    path = _any_path(tree, chance)
    law: dict[str, Any] = {}
    for key in chance.choice([keys_of(name) for name in FORMS]):
        many = key in ("uniform", "log_uniform", "triangular", "discrete", "weights", "within")
        count = chance.choice((0, 1, 2, 2, 2, 3, 3))
        if chance.random() < 0.9:
            law[key] = [own(path) for _ in range(count)] if many else own(path)
    axis: dict[str, Any] = {"parameter": path, "distribution": law}
    if chance.random() < 0.2:
        axis |= {chance.choice(("count", "values", "file", "columns", "spacing")): own(path)}
    if chance.random() < 0.1:
        axis["distribution"] = _any_value(chance)
    _inside(tree, "vary", chance)[chance.choice(("a", "b", "sample", "xx", "é"))] = axis
    if chance.random() < 0.8:
        _part(tree, "sample", SAMPLE, chance)


def _part(tree: Any, key: str, section: Section, chance: random.Random) -> None:
    """One value of a block at the top of a study, whatever it has."""
    inside = _inside(tree, key, chance)
    *parts, last = chance.choice([*_paths(section, "", ("test", "p"))]).split(".")
    for part in parts:
        inside = _inside(inside, part, chance)
    counts = ("2", "16", "17", "1e9", "-1", "0")
    inside[last] = chance.choice(
        (*counts, _quantity(chance), _quantity(chance), _any_value(chance), chance.choice([*FILES]))
    )


def _own_blocks(tree: Any, chance: random.Random) -> None:
    sections = {
        **{"sample": SAMPLE, "expect": EXPECT, "report": REPORT, "limits": LIMITS, "fit": FIT},
        **{"figures": FIGURES, "data": Named(DATA)},
    }
    key = chance.choice([*sections])
    _part(tree, key, sections[key], chance)


def _fitted(tree: Any, chance: random.Random) -> None:
    """Something else to fit, between any bounds."""
    fit = _inside(tree, "fit", chance)
    inside = _inside(fit, "parameters", chance)
    names = [_any_path(tree, chance), *(name for own in MODEL_PARAMETERS.values() for name in own)]
    bounds = [_quantity(chance) for _ in range(chance.choice((0, 1, 2, 2, 2, 3)))]
    inside[chance.choice(names)] = bounds if chance.random() < 0.8 else _any_value(chance)
    if chance.random() < 0.3:
        fit["models"] = [chance.choice([*MODEL_PARAMETERS, *WORDS[:20]]) for _ in "ab"]


def _where(tree: Any, chance: random.Random) -> None:
    """A condition of words that conditions have, in any order."""
    axes = tree.get("vary") if isinstance(tree, dict) else None
    names = [str(name) for name in axes][:9] if isinstance(axes, dict) else []
    words = [*"()<>=*", *("<=", ">=", "!=", "==", "and", "or", "not", "((((", "(" * 60)]
    words += [*names * 4, "sample", "x", *NUMBERS[:12], _quantity(chance), *WORDS[:12]]
    said = " ".join(chance.choice(words) for _ in range(chance.choice((1, 3, 3, 3, 7, 7, 400))))
    if isinstance(tree, dict):
        if names and chance.random() < 0.5:
            sign = chance.choice(("<", "<=", ">", "!=", "==", "="))
            said = f"{chance.choice(names)} {sign} {chance.choice([*names, _quantity(chance)])}"
        tree["where"] = said if chance.random() < 0.7 else [said, _any_value(chance)]


DAMAGES = (
    *[_nudged] * 6,
    *(_law, _law, _own_blocks, _own_blocks, _fitted, _where),
    *(_another_value, _another_number, _another_number, _without, _without, _misspelt, _exchanged),
    *(_nested, _many, _axis, _axis, _axis, _variants, _variants, _smoke, _block, _block),
)
