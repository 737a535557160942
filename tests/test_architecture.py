"""Imports flow one way, and each outer library has one door.

Modules are named here without the `demflow.` that all of them lie in.
"""

import ast
import functools
import graphlib
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent

# A room may import the rooms before it in its list, and itself.
MODEL = (
    ("model.parameters",),
    ("model.region",),
    ("model.scene",),
    (
        "model.outcome",
        "model.compilation",
        "model.products",
        "model.transient",
        "model.threads",
    ),
    ("model.kernel_lending",),
    ("model.kernel_thrift",),
    ("model.kernel_cache", "model.kernel_parts"),
    ("model.compile",),
    ("model.memory",),
    ("model.quantities",),
    ("model.mechanics.contact",),
    ("model.mechanics.motion",),
    ("model.mechanics.specimen",),
    ("model.mechanics.packing", "model.mechanics.static"),
    ("model.mechanics.loading",),
    ("model.network",),
    ("model.flow.linear",),
    ("model.flow.equation",),
    ("model.flow.solvers",),
    ("model.permeability", "model.fracture_network", "model.controls"),
    ("model.coupling",),
    ("model.amounts", "model.families"),
    ("model.limited", "model.members"),
    ("model.history",),
    ("model.observe", "model.maps"),
    ("model.emulation", "model.states", "model.tensors"),
    ("model.stages",),
)
# The study and its cases are read without the model's machinery; what runs comes after, and
# what is made of results reads no stage.
SWEEP = (
    ("sweep.printable",),
    ("sweep.errors",),
    ("sweep.study",),
    ("sweep.plan",),
    ("sweep.store",),
    ("sweep.execution",),
    ("sweep.dataset",),
    ("sweep.prepared",),
    ("sweep.analysis",),
    ("sweep.figures",),
    ("sweep.accessor",),
    ("sweep.report",),
    ("sweep.engine",),
    ("sweep.fitting",),
    ("sweep.command",),
)
HALLS = ("model", "model.mechanics", "model.flow", "sweep")  # hold rooms and nothing else
# All that a study needs of the model: what a scene is, what is measured, how a case ended.
CONTRACT = ("model.parameters", "model.region", "model.scene", "model.outcome", "model.quantities")
MACHINERY = {
    "sweep.accessor": (
        "model.transient",
    ),  # rooms of the sweep that may see more of the model, and what
    "sweep.plan": ("model.stages",),
    "sweep.execution": ("model.stages", "model.products", "model.memory", "model.compilation"),
    "sweep.dataset": ("model.maps", "model.products"),
    "sweep.fitting": ("model.products",),
    "sweep.command": ("model.compilation",),
    "sweep.analysis": ("model.analytic", "model.transient", "model.threads"),
    "sweep.figures": ("model.analytic", "model.transient"),
}
DOORS = {  # outer library: the only rooms that may import it
    "numba": {
        "model.compile",
        "model.kernel_cache",
        "model.kernel_parts",
        "model.kernel_lending",
        "model.kernel_thrift",
    },
    "qdldl": {"model.mechanics.static.stiffness", "model.coupling.matrix"},
    "threadpoolctl": {"model.threads"},
    "dask": {"sweep.execution.local", "sweep.execution.cluster"},
    "distributed": {
        "sweep.execution.lots",
        "sweep.execution.pool",
        "sweep.execution.local",
        "sweep.execution.cluster",
        "sweep.execution.worker",
    },
    "netCDF4": {
        "sweep.dataset.collect",
        "sweep.dataset.file",
        "sweep.dataset.ragged",
        "sweep.dataset.writer",
    },
    "yaml": {"sweep.study.yaml_source"},
    "rich": {"sweep.command.progress_line"},
    "cryptography": {"sweep.execution.certificate"},
}


@functools.cache
def imports() -> dict[str, set[str]]:
    """Modules that each module of ours imports, wherever in the file."""
    found: dict[str, set[str]] = {}
    for path in sorted([*ROOT.glob("model/**/*.py"), *ROOT.glob("sweep/**/*.py")]):
        parts = path.relative_to(ROOT).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        names: set[str] = set()
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{name}: relative imports hide where things come from"
                names |= {f"{node.module}.{alias.name}" for alias in node.names}
        found[name] = {n.removeprefix("demflow.") for n in names}
    return found


def lies_in(module: str, rooms) -> bool:
    return any(module == room or module.startswith(room + ".") for room in rooms)


def place(module: str, order) -> int | None:
    return next((k for k, rooms in enumerate(order) if lies_in(module, rooms)), None)


@pytest.mark.parametrize(("top", "order"), [("model", MODEL), ("sweep", SWEEP)])
def test_imports_flow_one_way(top, order):
    for module, names in imports().items():
        if module in HALLS or not lies_in(module, [top]) or lies_in(module, ["model.analytic"]):
            continue
        here = place(module, order)
        assert here is not None, f"{module} has no place in the order of rooms"
        for name in names:
            there = place(name, order)
            if there is not None:
                same_room = there == here and place(name, [order[here]]) is not None
                assert there < here or (same_room and _room(name, order) == _room(module, order)), (
                    f"{module} imports {name}"
                )


def _room(module: str, order) -> str:
    return next(room for rooms in order for room in rooms if lies_in(module, [room]))


def test_no_module_imports_itself_by_a_detour():
    def home(name):
        while name and name not in imports():
            name = name.rpartition(".")[0]
        return name

    graph = {m: {home(n) for n in names} - {m, ""} for m, names in imports().items()}
    graphlib.TopologicalSorter(graph).prepare()  # raises CycleError, which names the circle


def test_the_model_knows_nothing_of_studies():
    for module, names in imports().items():
        if lies_in(module, ["model"]):
            outer = ("sweep", "dask", "distributed", "xarray", "netCDF4", "yaml", "matplotlib")
            assert not [n for n in names if lies_in(n, outer)], module


def test_closed_forms_stand_alone():
    """They judge the model, so they share nothing with it."""
    analytic = [m for m in imports() if lies_in(m, ["model.analytic"])]
    assert len(analytic) > 4
    allowed = ("numpy", "scipy", "math", "__future__", "collections", "functools", "typing")
    for module in analytic:
        for name in imports()[module]:
            assert lies_in(name, (*allowed, "model.analytic")), f"{module} imports {name}"


def test_the_sweep_sees_the_contract_and_few_rooms_more():
    for module, names in imports().items():
        if not lies_in(module, ["sweep"]):
            continue
        allowed = [*CONTRACT, *MACHINERY.get(_room_of_sweep(module), ())]
        for name in names:
            if lies_in(name, ["model"]):
                assert lies_in(name, allowed), f"{module} imports {name}"


def _room_of_sweep(module: str) -> str:
    return ".".join(module.split(".")[:2])


@pytest.mark.parametrize("library", DOORS)
def test_outer_libraries_have_one_door(library):
    users = {
        module for module, names in imports().items() if any(lies_in(n, [library]) for n in names)
    }
    assert users <= DOORS[library]


@pytest.mark.slow
def test_nothing_that_is_read_can_be_executed():
    """Studies and results are data: no module has the means to run what it reads."""
    for module, names in imports().items():
        assert not [n for n in names if lies_in(n, ("pickle", "marshal", "shelve", "dill"))], module
    for path in ROOT.glob("sweep/**/*.py"):
        calls = [
            node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)
        ]
        for call in calls:
            called = ast.unparse(call.func)
            assert called not in ("eval", "exec", "compile", "__import__", "np.load"), path


def test_the_rule_can_fail():
    """The reader of imports finds what is there."""
    assert "model.compile.kernel" in imports()["model.flow.linear.factor"]
    assert "numba.njit" in imports()["model.compile"]
    assert place("model.stages", MODEL) > place("model.flow.solvers.registry", MODEL)
