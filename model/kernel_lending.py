"""Arrays that a function of a kernel is given are lent: nobody counts them while it runs.

Numba counts how often an array is in use, one more for each name that it has and one less where
that ends, and for a tuple so with all of its arrays. Most of it is taken out again where LLVM
sees that it comes to nothing; what is left stands in loops, and to find it takes a good part of
compiling. But who calls a function holds what it hands on until the function returns. So its
arguments, fields of these, and other names of either are counted by nobody here; what is made
inside, kept in a new tuple or returned is counted as ever.
"""

# Numba gives types to few of these:
# mypy: disable-error-code="no-untyped-call, attr-defined"
from __future__ import annotations

from typing import Any

from numba import types
from numba.core import ir
from numba.core.lowering import Lower


class Lending(Lower):
    """Numba's lowering of a function, without counts of what is lent to it."""

    _lent: frozenset[str] = frozenset()  # variables that are never given anything else
    _counts = True

    def init(self) -> None:
        """Find the variables that hold what is lent, and nothing else wherever they are set."""
        super().init()
        if self.generator_info is not None:
            return  # it goes on after it has returned
        given: dict[str, list[Any]] = {}
        for block in self.blocks.values():
            for assign in block.find_insts(ir.Assign):
                given.setdefault(assign.target.name, []).append(assign.value)
        kinds = types.Array, types.BaseTuple
        open_ = {name for name in given if isinstance(self.typeof(name), kinds)}
        lent: set[str] = set()
        while found := {
            name
            for name in open_ - lent
            if all(self._source(name, value) in lent | {""} for value in given[name])
        }:
            lent |= found
        self._lent = frozenset(lent)
        # what an argument is called holds everywhere, and needs no place on the stack
        self._singly_assigned_vars |= {
            name for name in lent if [type(value) for value in given[name]] == [ir.Arg]
        }

    def _source(self, name: str, value: Any) -> str | None:
        """The variable that another is set to, "" for an argument, None where it counts."""
        if isinstance(value, ir.Arg):
            kind, source = self.typeof(f"arg.{value.name}"), ""
        elif isinstance(value, ir.Var):
            kind, source = self.typeof(value.name), str(value.name)
        elif (place := self._place(value)) is not None:
            kind, source = self.typeof(value.value.name)[place], str(value.value.name)
        else:
            return None
        return source if kind == self.typeof(name) else None

    def _place(self, value: Any) -> int | None:
        """Which field of a tuple is taken, None where it is none."""
        if not isinstance(value, ir.Expr) or value.op not in ("getattr", "static_getitem"):
            return None
        kind = self.typeof(value.value.name)
        if value.op == "getattr":
            named = isinstance(kind, types.BaseNamedTuple) and value.attr in kind.fields
            return int(kind.fields.index(value.attr)) if named else None
        whole = isinstance(kind, types.BaseTuple) and isinstance(value.index, int)
        return value.index % len(kind) if whole else None

    def lower_inst(self, inst: Any) -> None:
        """Set a variable that holds what is lent without counting it."""
        self._counts = not (isinstance(inst, ir.Assign) and inst.target.name in self._lent)
        try:
            super().lower_inst(inst)
        finally:
            self._counts = True

    def lower_assign(self, kind: Any, inst: Any) -> Any:
        """Take a field of what is lent as it is."""
        if self._counts or not isinstance(inst.value, ir.Expr):
            return super().lower_assign(kind, inst)
        whole = self.loadvar(inst.value.value.name)
        return self.builder.extract_value(whole, self._place(inst.value))

    def delvar(self, name: str) -> None:
        """End a variable, if there is anything to count."""
        if name not in self._lent:
            super().delvar(name)

    def incref(self, kind: Any, value: Any) -> None:
        """Count an array, or those of a tuple, once more."""
        if self._counts:
            super().incref(kind, value)

    def decref(self, kind: Any, value: Any) -> None:
        """Count an array, or those of a tuple, once less."""
        if self._counts:
            super().decref(kind, value)
