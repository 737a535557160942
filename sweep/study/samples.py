"""`sample:` of a study: axes that have laws of chance instead of values become one dimension.

Each parameter under `vary` with a `distribution` is a coordinate along the dimension `sample`,
whose points are those of a design (`sweep.study.designs`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from demflow.model.parameters import bound_problem, parameter
from demflow.sweep.study.axes import MAX_CASES, Axis, Draft, Located, find, long_name
from demflow.sweep.study.blocks import block_of
from demflow.sweep.study.designs import METHODS, block, design
from demflow.sweep.study.laws import Law, read_law
from demflow.sweep.study.sections import Parameter, Reading
from demflow.sweep.study.units import format_quantity
from demflow.sweep.study.yaml_source import Mapping, Node, Scalar

NAME = "sample"  # of the dimension


@dataclass(frozen=True)
class Sample:
    """How parameters that have a distribution are sampled together."""

    count: int = parameter(
        at_least=1, at_most=MAX_CASES, help="number of points; saltelli and morris make more cases"
    )
    method: str = parameter(default="sobol", choices=METHODS, help="the design of the points")
    seed: int = parameter(default=1, at_least=0, help="seed of what is random in the design")


SAMPLE = block_of(Sample)


def is_drawn(draft: Draft) -> bool:
    """Whether an axis has a law instead of values."""
    return "distribution" in draft.node.entries


def read_sample(node: Node | None, drawn: list[Draft], reading: Reading) -> Sample | None:
    """What `sample:` says, None where there is none or after reporting what is wrong.

    Parameters
    ----------
    node : what stands there in the file
    drawn : axes that have a law
    reading : takes the problems that are met
    """
    if node is None or (isinstance(node, Scalar) and node.empty):
        for draft in drawn[:1]:
            message = f"axis '{draft.name}' has a distribution; say how it is sampled, as in "
            reading.report(draft.place, message + "sample: {method: sobol, count: 64}")
        return None
    if not drawn:
        message = "sample: no axis under vary has a distribution, as in {distribution: {uniform: "
        reading.report(node.place, message + "[1 mD, 10 mD]}}")
        return None
    reading.places[NAME] = node.place
    problems: list[tuple[str, str]] = []
    before = len(reading.problems)
    made = SAMPLE.build(SAMPLE.read(node, NAME, reading), NAME, problems)
    for path, what in problems:
        if not reading.spoilt(path):
            reading.report(reading.place(path), f"{path}: {what}")
    return made if len(reading.problems) == before else None


def cases_of(sample: Sample, drawn: list[Draft]) -> int:
    """Points along the dimension."""
    return sample.count * block(sample.method, len(drawn))


def sampled_axis(
    sample: Sample, drawn: list[Draft], values: dict[str, Any], reading: Reading
) -> Located | None:
    """The dimension `sample`, None after reporting what is wrong with what it samples.

    Parameters
    ----------
    sample : how points are drawn, and how many
    drawn : axes that have a law
    values : values of the scene by their paths, SI
    reading : takes the problems that are met
    """
    found: list[tuple[Parameter, Law]] = []
    for draft in drawn:
        target = find(draft, draft.paths[0], draft.path_places[0], values, reading)
        node = draft.node.entries["distribution"]
        law = None
        if target is not None:
            law = read_law(node, target, draft.paths[0], reading)
        if target is None or law is None:
            reading.unreadable.update(draft.paths)
        else:
            found.append((target, law))
    if len(found) < len(drawn):
        return None
    points = design(sample.method, len(drawn), sample.count, sample.seed)
    columns = [law.quantile(points[:, k]) for k, (_, law) in enumerate(found)]
    before = len(reading.problems)
    for draft, (target, _), column in zip(drawn, found, columns, strict=True):
        _check_bounds(draft, target, column, reading)
    if len(reading.problems) > before:
        reading.unreadable.update(path for draft in drawn for path in draft.paths)
        return None
    names = " ".join(draft.name for draft in drawn)
    axis = Axis(
        name=NAME,
        parameters=tuple(draft.paths[0] for draft in drawn),
        values=tuple(zip(*columns, strict=True)),
        units=tuple(target.unit for target, _ in found),
        labels=tuple(draft.name for draft in drawn),
        long_names=tuple(
            f"{long_name(draft.paths[0], target)}; {law.in_words(target.unit)}"
            for draft, (target, law) in zip(drawn, found, strict=True)
        ),
        sampled=(
            ("sampling_method", sample.method),
            ("sampling_count", sample.count),
            ("sampling_seed", sample.seed),
            ("sampled", names),
        ),
    )
    return Located(axis, (drawn[0].place,) * len(points))


def _check_bounds(draft: Draft, target: Parameter, column: list[Any], reading: Reading) -> None:
    """Report values that a law gives and the parameter cannot have: the first of them."""
    for number, value in enumerate(column):
        what = bound_problem(target.declared, value)
        if what is not None:
            shown = value if isinstance(value, str) else format_quantity(value, target.unit)
            message = f"axis '{draft.name}': sample {number} is {shown}: {what}"
            law = draft.node.entries["distribution"]
            if isinstance(law, Mapping) and (
                "normal" in law.entries or "log_normal" in law.entries
            ):
                message += "; cut the law, as in within: [least, largest]"
            reading.report(law.place, message)
            return
