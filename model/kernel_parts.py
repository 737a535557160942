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

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from types import FunctionType
from typing import Any

from llvmlite import binding as llvm
from numba import types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, CompileResult
from numba.core.environment import lookup_environment

from demflow.model.kernel_thrift import thrift

# What is done to a whole before it is optimised in full: each function is tidied while it is small,
# so that less is copied into what calls it, and what calls it is brought into the form in which
# counts of arrays are seen to come to nothing, and loops to take several numbers at once.
FIRST = (
    "sroa",
    "instruction_combine",
    "simplify_cfg",
    "always_inliner",
    "loop_rotate",
    "instruction_combine",
    "jump_threading",
)


class _Linked(JITCodeLibrary):
    """Code that is optimised once, when all of it is linked."""

    def _optimize_functions(self, module: Any) -> None:
        module.data_layout = self._codegen._data_layout


class _Whole(_Linked):
    """Code that Python calls: takes in all its parts, and knows their constants."""

    def add_ir_module(self, module: Any) -> None:
        if module.name == "wrapper":
            # it takes arguments apart once a call, and is as long as many a kernel
            for function in _defined(module):
                function.attributes.add("noinline")
                function.attributes.add("optnone")
        super().add_ir_module(module)

    def finalize(self) -> None:
        self._linking_libraries = _callers_first(self._linking_libraries)
        super().finalize()

    def _optimize_final_module(self) -> None:
        first = llvm.create_new_module_pass_manager()
        for name in FIRST:
            getattr(first, f"add_{name}_pass")()
        first.add_refprune_pass()
        plain = {"opt": 0, "loop_vectorize": False, "slp_vectorize": False}
        first.run(self._final_module, self._codegen._pass_builder(**plain))
        full, builder = self._codegen._module_pass_manager()
        full.run(self._final_module, builder)

    def _finalize_specific(self) -> None:
        super()._finalize_specific()
        for variable in self._final_module.global_variables:
            environment = lookup_environment(variable.name)
            if environment is not None:
                self._codegen.set_env(variable.name, environment)


class _Part(_Linked):
    """Code that is only linked into other code."""

    def add_ir_module(self, module: Any) -> None:
        for function in _defined(module):
            # what gathers the words of an error says of itself that it stays where it is
            if "noinline" not in function.attributes:
                function.attributes.add("alwaysinline")
        super().add_ir_module(module)

    def finalize(self) -> None:
        """Leave it to the whole to link what this calls."""
        self._raise_if_finalized()
        for function in _defined(self._final_module):
            if function.linkage is llvm.Linkage.external:
                function.linkage = "linkonce_odr"  # gone once it is taken in
        self._finalize_dynamic_globals()
        self._finalized = True

    def _get_module_for_linking(self) -> Any:
        self._ensure_finalized()
        return self._final_module

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


def _defined(module: Any) -> Iterator[Any]:
    return (function for function in module.functions if not function.is_declaration)


def _callers_first(libraries: Iterable[Any]) -> list[Any]:
    """All that is called, once, behind whatever calls it: LLVM links what is asked for already."""
    seen: dict[Any, None] = {}  # what is called before what calls it

    def visit(library: Any) -> None:
        if library not in seen:
            if isinstance(library, _Part):
                library._ensure_finalized()
                for called in library._linking_libraries:
                    visit(called)
            seen[library] = None

    for library in libraries:
        visit(library)
    return list(seen)[::-1]


@contextmanager
def _parts_only(codegen: Any) -> Iterator[None]:
    """Make a part of all that is compiled meanwhile, Numba's own functions too."""
    codegen.create_library = partial(_Part, codegen)
    try:
        yield
    finally:
        del codegen.create_library


class Wholes(Compiler):
    """Numba's compiler of a kernel that Python calls."""

    def compile_extra(self, function: FunctionType) -> CompileResult:
        """Compile a function, and as parts all that it calls."""
        codegen = self.state.targetctx.codegen()
        self.state.library = _Whole(codegen, function.__qualname__)
        self.state.library.enable_object_caching()
        with _parts_only(codegen), thrift():
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
