"""Values and axes → scenes: the blocks that an axis touches are built anew, the rest is kept."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from demflow.model.parameters import SceneError
from demflow.model.scene import Scene
from demflow.sweep.study.axes import Axis
from demflow.sweep.study.scene import SCENE
from demflow.sweep.study.sections import Parameter

MOST_KEPT = 4096  # variants of one block that are kept; beyond it they are built again


class SceneBuilder:
    """Builds the scene at any index of the axes; equal blocks are one object."""

    def __init__(self, values: Mapping[str, Any], axes: Sequence[Axis]):
        self._values = values
        self._axes = axes
        # what was built of each block, and what was wrong with it, by the points of its axes
        self._parts: dict[str, dict[tuple[int, ...], tuple[Any, list[tuple[str, str]]]]]
        self._parts = {key: {} for key in SCENE.members}
        # block -> the axes that touch it
        # variants come first: they say what there is, and other axes move numbers in it
        order = sorted(range(len(axes)), key=lambda number: not axes[number].names)
        self._touching: dict[str, tuple[int, ...]] = {
            key: tuple(
                number
                for number in order
                if any(path.split(".")[0] == key for path in axes[number].parameters)
            )
            for key in SCENE.members
        }
        self._present = tuple(key for key in SCENE.members if key in values or self._touching[key])

    def touching(self, block: str) -> tuple[int, ...]:
        """Numbers of the axes that touch a block: cases that agree on them have the same one."""
        return self._touching[block]

    def scene(self, index: Sequence[int]) -> Scene:
        """The scene at an index; raises SceneError with everything that is wrong with it."""
        problems: list[tuple[str, str]] = []
        parts = self._build(index, problems)
        if problems:
            raise SceneError(problems)
        return Scene(**parts)

    def problems(
        self, index: Sequence[int], *, whole: bool, unreadable: Collection[str] = ()
    ) -> list[tuple[str, str]]:
        """What is wrong at an index, as (path, what); `whole` checks across blocks too.

        Fractures that are wrong by themselves, or that have a path among the unreadable ones, are
        not looked at across blocks: nobody could draw them.

        Parameters
        ----------
        index : position on every axis
        whole : whether blocks are checked with each other too
        unreadable : paths of values that could not be read
        """
        problems: list[tuple[str, str]] = []
        parts = self._build(index, problems)
        wrong = {
            path.split(".")[1]
            for path in (*unreadable, *(path for path, _ in problems))
            if path.startswith("fractures.")
        }
        if wrong:
            drawn = parts.get("fractures", ())
            parts["fractures"] = tuple(one for one in drawn if one.name not in wrong)
        if whole and not any(path.startswith("region") for path, _ in problems):
            try:
                Scene(**parts)
            except SceneError as error:
                # what a part that could not be built lacks is no further problem
                holds = {
                    path[:k] for path, _ in problems for k, one in enumerate(path) if one == "."
                }
                problems += [one for one in error.problems if one[0] not in holds]
        return problems

    def _build(self, index: Sequence[int], problems: list[tuple[str, str]]) -> dict[str, Any]:
        parts = {}
        for key in self._present:
            at = tuple([index[number] for number in self._touching[key]])
            kept = self._parts[key]
            if at in kept:
                parts[key], told = kept[at]
                problems += told
                continue
            member = SCENE.members[key]
            values = self._assigned(key, index)
            if values is None and not isinstance(member.section, Parameter):
                continue  # it could not be read
            before = len(problems)
            parts[key] = member.section.build(values, key, problems)
            if len(kept) >= MOST_KEPT:
                kept.clear()
            kept[at] = parts[key], problems[before:]
        return parts

    def _assigned(self, key: str, index: Sequence[int]) -> Any:
        """The values of a block with those of the axes put in."""
        values = self._values.get(key)
        for number in self._touching[key]:
            axis = self._axes[number]
            for path, value in zip(axis.parameters, axis.values[index[number]], strict=True):
                head, *parts = path.split(".")
                if head == key:
                    values = _assign(values, parts, value)
        return values


def _assign(values: Any, parts: Sequence[str], value: Any) -> Any:
    """A copy of nested values with one of them replaced."""
    if not parts:
        return value
    copy = dict(values or {})
    copy[parts[0]] = _assign(copy.get(parts[0]), parts[1:], value)
    return copy
