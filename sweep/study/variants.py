"""An axis of variants: its points are named scenes, each a few overrides of the study's.

Where other axes move numbers, this one may change what there is: the region, the fractures,
the wells, the times, the solver. A variant is written as the smoke block is, paths to values,
and is put into the tree of the study before that is read; `expect` beside them says how its
cases should end.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from demflow.sweep.study.axes import Axis, Draft, Located
from demflow.sweep.study.blocks import NAME_RULE, is_name
from demflow.sweep.study.overrides import overlaid
from demflow.sweep.study.scene import SCENE
from demflow.sweep.study.sections import BESIDE_SCENE, NoParameter, Reading
from demflow.sweep.study.yaml_source import Mapping, Node, Place, Scalar, Sequence

KEYS = ("variants", "values")
FIXED = tuple(key for key in BESIDE_SCENE if key not in ("observe", "solver", "expect"))


class Variant(NamedTuple):
    """One point: the study's tree with its overrides in it."""

    name: str
    place: Place
    tree: Mapping
    blocks: tuple[str, ...]  # of the scene that it overrides
    expect: Node | None


class VariantAxis(NamedTuple):
    """The axis of which the points are known, but not their scenes."""

    name: str
    position: int  # among the axes of the study
    points: tuple[Variant, ...]

    def located(self, values: list[dict[str, Any]]) -> Located:
        """The axis, from the values of each variant's scene."""
        blocks = tuple(dict.fromkeys(block for point in self.points for block in point.blocks))
        axis = Axis(
            name=self.name,
            parameters=blocks,
            values=tuple(tuple(scene.get(block) for block in blocks) for scene in values),
            units=("",) * len(blocks),
            labels=(),
            long_names=(),
            names=tuple(point.name for point in self.points),
        )
        return Located(axis, tuple(point.place for point in self.points))


def without_variants(vary: Node | None) -> Node | None:
    """`vary` without its axes of variants."""
    if not isinstance(vary, Mapping):
        return vary
    kept = {name: node for name, node in vary.entries.items() if not _is_one(node)}
    return Mapping(vary.place, kept, vary.keys)


def read_variants(root: Mapping, reading: Reading) -> VariantAxis | None:
    """The axis of variants of a study, None where it has none; reports what is wrong with it."""
    vary = root.entries.get("vary")
    if not isinstance(vary, Mapping):
        return None
    named = [name for name, node in vary.entries.items() if _is_one(node)]
    if not named:
        return None
    if len(named) > 1:
        message = f"axis '{named[1]}': one axis of variants is enough; '{named[0]}' is one already"
        reading.report(vary.keys[named[1]], message)
    name, node = named[0], vary.entries[named[0]]
    assert isinstance(node, Mapping)
    for key, place in node.keys.items():
        if key not in KEYS:
            reading.report(place, f"axis '{name}' has variants; it takes no '{key}'")
    points = [_point(root, *one, reading) for one in _chosen(name, node, vary.keys[name], reading)]
    if not points:
        return None
    return VariantAxis(name, list(vary.entries).index(name), tuple(points))


def found_everywhere(
    drafts: list[Draft], axis: VariantAxis, values: list[dict[str, Any]], reading: Reading
) -> bool:
    """Whether every variant has what the other axes vary; reports what is missing.

    Parameters
    ----------
    drafts : axes of which only the paths have been read
    axis : of the variants
    values : of the scene, one for each variant
    reading : takes the problems that are met
    """
    before = len(reading.problems)
    for draft in drafts:
        for path, place in zip(draft.paths, draft.path_places, strict=True):
            for point, scene in zip(axis.points[1:], values[1:], strict=True):
                try:
                    SCENE.find(scene, tuple(path.split(".")))
                except (NoParameter, TypeError, KeyError):
                    message = f"axis '{draft.name}': '{path}' names no parameter of '{point.name}'"
                    reading.report(place, message)
    return len(reading.problems) == before


def _is_one(node: Node) -> bool:
    return isinstance(node, Mapping) and "variants" in node.entries


def _chosen(
    name: str, node: Mapping, place: Place, reading: Reading
) -> list[tuple[str, Place, Node]]:
    """Name, place and overrides of the variants that `values` names; of all without it."""
    variants = node.entries["variants"]
    if not isinstance(variants, Mapping) or not variants.entries:
        message = f"axis '{name}': variants is a mapping of names to overrides of the scene"
        reading.report(variants.place if variants else place, message)
        return []
    names = {key: variants.keys[key] for key in variants.entries}
    listed = node.entries.get("values")
    if listed is not None:
        items = listed.items if isinstance(listed, Sequence) else (listed,)
        chosen = [item for item in items if isinstance(item, Scalar) and item.text in names]
        for item in items:
            if item not in chosen:
                text = item.text if isinstance(item, Scalar) else "this"
                message = f"axis '{name}': '{text}' is none of its variants, {', '.join(names)}"
                reading.report(item.place, message)
        names = {item.text: item.place for item in chosen}
    for key in names:
        if not is_name(key.replace(".", "-")):
            message = f"'{key}' is no name; use '.', {NAME_RULE}"
            reading.report(variants.keys[key], message)
    return [(key, at, variants.entries[key]) for key, at in names.items()]


def _point(root: Mapping, name: str, place: Place, node: Node, reading: Reading) -> Variant:
    """One variant; what it cannot override is reported."""
    if isinstance(node, Scalar) and node.empty:
        node = Mapping(node.place, {}, {})
    if not isinstance(node, Mapping):
        message = f"variant '{name}' is a mapping of paths to values, as in {{grains.count: 300}}"
        reading.report(node.place, message)
        node = Mapping(place, {}, {})
    entries, keys = dict(node.entries), dict(node.keys)
    expect = entries.pop("expect", None)
    for key in list(entries):
        if key.split(".")[0] in (*FIXED, "study", "title"):
            reading.report(keys[key], f"variant '{name}': '{key}' is the same for all cases")
            del entries[key]
    tree, _, problems = overlaid(root, Mapping(node.place, entries, keys), f"variant '{name}'")
    reading.problems += problems
    blocks = tuple(dict.fromkeys(key.split(".")[0] for key in entries))
    return Variant(name, place, tree, blocks, expect)
