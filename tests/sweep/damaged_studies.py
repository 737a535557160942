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
    map: {kind: traces, file: none.geojson, origin: centroid, snap: 1 mm, aperture: 100 um}
""",
)
STUDIES = Path(__file__).parents[2] / "studies"
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
]


def studies() -> list[Any]:
    """Trees of good studies: what is shipped, and the examples."""
    texts = [path.read_text() for path in sorted(STUDIES.glob("*.yaml"))]
    # every scalar as text
    loader = getattr(yaml, "CBaseLoader", yaml.BaseLoader)
    return [yaml.load(text, Loader=loader) for text in (*texts, EXAMPLE, SMALL, RANDOM)]


def damaged(good: list[Any], chance: random.Random) -> bytes:
    """A study with some damage, as a file holds it."""
    tree = copy.deepcopy(chance.choice(good))
    for _ in range(chance.choice((1, 1, 1, 2, 2, 3, 5, 9))):
        chance.choice(DAMAGES)(tree, chance)
    written = text(tree, chance).encode("utf-8", "surrogatepass")
    while chance.random() < 0.1:
        written = _torn(written, chance)
    return written


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
    spots = [s for s in _spots(tree) if isinstance(s[0][s[1]], str) and s[0][s[1]][:1].isdigit()]
    if spots:
        inside, key = chance.choice(spots)
        number, _, unit = inside[key].partition(" ")
        if chance.random() < 0.6:
            number = chance.choice(NUMBERS)
        else:
            unit = chance.choice(UNIT_TEXTS)
        inside[key] = f"{number} {unit}".strip()


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


DAMAGES = (
    *(_another_value, _another_number, _another_number, _without, _without, _misspelt, _exchanged),
    *(_nested, _many, _axis, _axis, _axis, _variants, _variants, _smoke, _block, _block),
)
