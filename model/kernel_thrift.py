"""Numba without what it does again and again for nobody, while kernels are compiled.

Each of these takes the place of a function of Numba's, tells what kernels need as that would, and
changes nothing of the code that is made.
"""

# Numba gives types to few of these:
# mypy: disable-error-code="no-untyped-call, attr-defined"
from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import cache
from typing import Any

from numba import types
from numba.core.postproc import PostProcessor, VariableLifetime
from numba.core.runtime.context import NRTContext
from numba.core.transforms import canonicalize_cfg
from numba.core.typed_passes import NativeLowering

from demflow.model.kernel_lending import Lending


@cache
def _looked_up(function: types.Function, context: Any, args: Any, keywords: Any) -> Any:
    return types.BaseFunction.get_call_type(function, context, args, dict(keywords))


def _signature(function: types.Function, context: Any, args: Any, keywords: Any) -> Any:
    """Look up but once what each of Numba's own functions makes of arguments of some types.

    Numba does so at each call, and tries one after another all that the function may mean.
    """
    return _looked_up(function, context, tuple(args), tuple(keywords.items()))


def _counted(memory: NRTContext, builder: Any, kind: Any, value: Any) -> list[tuple[Any, Any]]:
    """Take of a value what is counted: of an array, one of its nine numbers, and not all."""
    models = memory._context.data_model_manager
    model = models[kind]
    own = [(kind, model.get_nrt_meminfo(builder, value))] if model.has_nrt_meminfo() else []
    inner = (pair for pair in model.traverse(builder) if models[pair[0]].contains_nrt_meminfo())
    return own + [
        found for part, take in inner for found in _counted(memory, builder, part, take(value))
    ]


_run = PostProcessor.run


def _tidied(
    processor: PostProcessor, emit_dels: bool = False, extend_lifetimes: bool = False
) -> None:
    """Leave out which variables live where a block begins: only generators want to know."""
    ir = processor.func_ir
    if ir.is_generator:
        _run(processor, emit_dels, extend_lifetimes)
        return
    ir.blocks = canonicalize_cfg(ir.blocks)
    ir.variable_lifetime = VariableLifetime(ir.blocks)
    ir.generator_info = None
    if emit_dels:
        processor._insert_var_dels(extend_lifetimes=extend_lifetimes)


@contextmanager
def _instead(owner: Any, name: str, value: Any) -> Iterator[None]:
    """Let an attribute have a value meanwhile."""
    own, before = name in vars(owner), getattr(owner, name)
    setattr(owner, name, value)
    try:
        yield
    finally:
        if own:
            setattr(owner, name, before)
        else:
            delattr(owner, name)


@contextmanager
def thrift() -> Iterator[None]:
    """Compile with these within a `with` block."""
    functions: Any = types.Function  # which inherits it
    with ExitStack() as stack:
        for owner, name, value in (
            (functions, "get_call_type", _signature),
            (NRTContext, "get_meminfos", _counted),
            (PostProcessor, "run", _tidied),
            (NativeLowering, "lowering_class", Lending),
        ):
            stack.enter_context(_instead(owner, name, value))
        yield
