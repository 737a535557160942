"""The smoke block: overrides that make a study small, put into its tree before it is read.

A key is a path, as axes have it (`grains.count`, `times.per_decade`), or one that starts with
another key of the study (`vary.aperture.count`, `figures.maps`). `vary.aperture: [20 um]` is
short for the values of that axis. What is overridden is then read and checked like
the rest.
"""

from __future__ import annotations

from demflow.sweep.study.axes import SPACING
from demflow.sweep.study.sections import BESIDE_SCENE
from demflow.sweep.study.units import nearest
from demflow.sweep.study.yaml_source import Mapping, Node, Place, Problem, Scalar, Sequence

_UNWRITTEN = (
    "solver",
    "limits",
    "figures",
    "report",
    "expect",
)  # a study without one has it all the same


def overlaid(
    root: Mapping, smoke: Node, what: str = "smoke"
) -> tuple[Mapping, set[Place], list[Problem]]:
    """The tree with the overrides, the places that they come from, and their problems.

    `what` names the overrides in messages.

    Parameters
    ----------
    root : the study’s tree
    smoke : overrides by paths
    what : what it is, for messages
    """
    if not isinstance(smoke, Mapping):
        message = f"{what} is a mapping of paths to values, as in {{grains.count: 300}}"
        return root, set(), [Problem(*smoke.place, message)]
    problems: list[Problem] = []
    written: set[Place] = set()
    for path, node in smoke.entries.items():
        place = smoke.keys[path]
        written |= {place, *_places(node)}
        parts = path.split(".")
        if parts[0] == "smoke" or (parts[0] == "vary" and len(parts) == 1):
            problems.append(Problem(*place, f"{what} cannot override '{path}' as a whole"))
            continue
        within = parts if parts[0] in (*BESIDE_SCENE, "title") else ["scene", *parts]
        if parts[0] in _UNWRITTEN and parts[0] not in root.entries:
            root = _put(root, parts[:1], Mapping(place, {}, {}), place)
        try:
            root = _put(root, within, node, place)
        except _Missing as missing:
            like = nearest(missing.key, missing.valid)
            hint = f"did you mean '{like}'?" if like else f"valid are {', '.join(missing.valid)}"
            message = f"{what}: '{path}': the study has no '{missing.key}'; {hint}"
            problems.append(Problem(*place, message))
    return root, written, problems


class _Missing(Exception):
    def __init__(self, key: str, valid: list[str]):
        self.key, self.valid = key, valid


def _put(mapping: Mapping, parts: list[str], node: Node, place: Place) -> Mapping:
    """A copy of a tree with the node at a path replaced, or added to a mapping that is there."""
    key, *rest = parts
    entries, keys = dict(mapping.entries), dict(mapping.keys)
    if rest:
        inner = entries.get(key)
        if not isinstance(inner, Mapping):
            raise _Missing(key, [k for k, v in entries.items() if isinstance(v, Mapping)])
        if key == "vary" and len(rest) == 1 and isinstance(node, Sequence):
            entries[key] = _with_values(inner, rest[0], node, place)
        else:
            entries[key] = _put(inner, rest, node, place)
    else:
        entries[key], keys[key] = node, place
    return Mapping(mapping.place, entries, keys)


def _with_values(vary: Mapping, name: str, values: Sequence, place: Place) -> Mapping:
    """The axes with the values of one replaced, however it gave them."""
    axis = vary.entries.get(name)
    if not isinstance(axis, Mapping):
        raise _Missing(name, list(vary.entries))
    kept = {key: node for key, node in axis.entries.items() if key not in SPACING}
    replaced = Mapping(axis.place, kept | {"values": values}, axis.keys | {"values": place})
    return Mapping(vary.place, vary.entries | {name: replaced}, vary.keys)


def _places(node: Node) -> set[Place]:
    """The places of a node and of everything in it."""
    if isinstance(node, Scalar):
        return {node.place}
    if isinstance(node, Sequence):
        return {node.place}.union(*map(_places, node.items))
    return {node.place, *node.keys.values()}.union(*map(_places, node.entries.values()))
