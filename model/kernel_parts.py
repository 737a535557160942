"""Kernels inside kernels: linked into what calls them, and made machine code there alone.

Numba optimises each function and translates it on its own, with wrappers through which Python
and C may call it, before it links it into its caller, where the same happens again. Here a kernel
that another one calls is a *part*: it is typed and lowered, once for each types of arguments,
and the rest is left to the kernel that Python calls, which takes it in wherever it calls it. Left
to its own judgement the compiler would do so with the smallest only, since it meets parts before
they are optimised; and a call that hands on the arrays of some tuples, a hundred numbers and more,
takes ten times as long as a law of contact.
"""

# Numba gives types to few of these:
# mypy: disable-error-code="no-untyped-call, attr-defined"
from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache, partial
from types import FunctionType
from typing import Any

from numba import types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, CompileResult
from numba.core.environment import lookup_environment


class _Linked(JITCodeLibrary):
    """Code that is optimised once, when all of it is linked."""

    def _optimize_functions(self, module: Any) -> None:
        module.data_layout = self._codegen._data_layout


class _Whole(_Linked):
    """Code that Python calls: knows the constants of all its parts."""

    def _finalize_specific(self) -> None:
        super()._finalize_specific()
        for variable in self._final_module.global_variables:
            environment = lookup_environment(variable.name)
            if environment is not None:
                self._codegen.set_env(variable.name, environment)


class _Part(_Linked):
    """Code that is only linked into other code."""

    def _optimize_functions(self, module: Any) -> None:
        super()._optimize_functions(module)
        for function in module.functions:
            # what gathers the words of an error says of itself that it stays where it is
            stays = any(b"noinline" in words for words in function.attributes)
            if not function.is_declaration and not stays:
                function.add_function_attribute("alwaysinline")

    def _optimize_final_module(self) -> None:
        """Leave it to the whole."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, _name: str) -> int:
        """Tell that there is none."""
        self._ensure_finalized()
        return 0

    @property
    def codegen(self) -> _Part:
        """What sets constants where the code lies: the whole does."""
        return self

    def set_env(self, _name: str, _environment: Any) -> None:
        """Leave it to the whole."""


@contextmanager
def _parts_only(codegen: Any) -> Iterator[None]:
    """Make a part of all that is compiled meanwhile, Numba's own functions too."""
    codegen.create_library = partial(_Part, codegen)
    try:
        yield
    finally:
        del codegen.create_library


@cache
def _looked_up(function: types.Function, context: Any, args: Any, keywords: Any) -> Any:
    return types.BaseFunction.get_call_type(function, context, args, dict(keywords))


def _signature(function: types.Function, context: Any, args: Any, keywords: Any) -> Any:
    return _looked_up(function, context, tuple(args), tuple(keywords.items()))


@contextmanager
def _signatures_kept() -> Iterator[None]:
    """Look up but once what each of Numba's own functions makes of arguments of some types.

    Numba does so at each call, and tries one after another all that the function may mean.
    """
    functions: Any = types.Function  # which inherits it
    functions.get_call_type = _signature
    try:
        yield
    finally:
        del functions.get_call_type


class Wholes(Compiler):
    """Numba's compiler of a kernel that Python calls."""

    def compile_extra(self, function: FunctionType) -> CompileResult:
        """Compile a function, and as parts all that it calls."""
        codegen = self.state.targetctx.codegen()
        self.state.library = _Whole(codegen, function.__qualname__)
        self.state.library.enable_object_caching()
        with _parts_only(codegen), _signatures_kept():
            return super().compile_extra(function)


def calls_part(compiled: Any, part: Any) -> None:
    """Have other kernels link a part where they call a compiled kernel.

    The part is not compiled anew for each literal number that it is called with.
    """

    def get_call_template(args: Any, keywords: dict[str, Any]) -> Any:
        keywords = {name: types.unliteral(kind) for name, kind in keywords.items()}
        return part.get_call_template([types.unliteral(kind) for kind in args], keywords)

    compiled.get_call_template = get_call_template
    compiled.get_overload = part.get_overload
