"""What a kernel reads and writes of the arrays that it is given, found from its source and that of what it calls.

A kernel is compiled with the fields of groups that it uses, as each costs half a microsecond of every launch, and
memory that it only reads may be shared or read-only.
"""

from __future__ import annotations

import ast
import functools
import inspect
import textwrap
from collections.abc import Mapping
from typing import Any, NamedTuple


class Group(NamedTuple):
    """A group of arrays, by the name that a kernel has for it."""

    name: str


class Array(NamedTuple):
    """An array: a field of a group, or an argument itself, whose field is empty."""

    group: str
    field: str


class Uses(NamedTuple):
    """What is used of the arguments of a kernel, in the order in which it is met."""

    used: dict[Array, None]
    written: set[Array]


def uses_of(function: Any, given: Mapping[str, Group | Array]) -> Uses:
    """What a function uses of arguments and their fields, also in functions that it gives them to.

    Args:
        function: of Python, before Taichi has it.
        given: its arguments that are groups or arrays, by name.

    Raises:
        TypeError: for a use that cannot be followed, as of a group under another name.
    """
    uses = Uses({}, set())
    _Reader(function, dict(given), uses).read()
    return uses


@functools.cache
def _tree(function: Any) -> ast.FunctionDef:
    return ast.parse(textwrap.dedent(inspect.getsource(function))).body[0]  # type: ignore[return-value]


@functools.cache
def plain(function: Any) -> Any:
    """The Python function that a function of Taichi or Quadrants was made of; None for anything else."""
    for _ in range(4):
        if inspect.isfunction(function) and not hasattr(function, "__wrapped__"):
            return function
        function = (
            getattr(function, "__wrapped__", None) or getattr(function, "fn", None) or getattr(function, "func", None)
        )
    return None


class _Reader(ast.NodeVisitor):
    """Reads one function, and what it calls, with what its arguments stand for."""

    def __init__(self, function: Any, given: dict[str, Any], uses: Uses) -> None:
        self.function, self.given, self.uses = function, given, uses
        self.outer = dict(inspect.getclosurevars(function).globals) | dict(inspect.getclosurevars(function).nonlocals)

    def read(self) -> None:
        for statement in _tree(self.function).body:
            self.visit(statement)

    def _stands_for(self, node: ast.AST) -> Any:
        """What a name, a field of a group, or a global stands for; None where it is a value at run time."""
        if isinstance(node, ast.Name):
            return self.given.get(node.id, self.outer.get(node.id))
        if isinstance(node, ast.Attribute):
            base = self._stands_for(node.value)
            if isinstance(base, Group):
                return Array(base.name, node.attr)
            if base is not None and not isinstance(base, Array):
                return getattr(base, node.attr, None)
        return None

    def _use(self, node: ast.AST, written: bool) -> bool:
        """Note an array that a node stands for; whether it does."""
        found = self._stands_for(node)
        if isinstance(found, Array):
            self.uses.used.setdefault(found)
            if written:
                self.uses.written.add(found)
        elif isinstance(found, Group):
            place = f"{self.function.__module__}.{self.function.__qualname__}, line {node.lineno}"  # type: ignore[attr-defined]
            raise TypeError(
                f"{place}: the group {found.name} must be given to a function, or one of its fields be taken"
            )
        return isinstance(found, Array)

    def visit_Name(self, node: ast.Name) -> None:
        self._use(node, False)

    def visit_Attribute(self, node: ast.Attribute) -> None:
        if not self._use(node, False):
            self.visit_inside(node.value)

    def visit_If(self, node: ast.If) -> None:
        """Of ``if ti.static(...)`` the branch alone that is compiled."""
        decided = self._decided(node.test)
        if decided is None:
            self.generic_visit(node)
        for statement in [] if decided is None else node.body if decided else node.orelse:
            self.visit(statement)

    def _decided(self, test: ast.expr) -> bool | None:
        """What a condition is when a kernel is compiled; None where only the run decides it."""
        if not isinstance(test, ast.Call) or getattr(self._stands_for(test.func), "__name__", "") != "static":
            return None
        names = {node.id for node in ast.walk(test) if isinstance(node, ast.Name)}
        if names & set(self.given) or not names <= set(self.outer):
            return None
        return bool(eval(compile(ast.Expression(test.args[0]), "<static>", "eval"), dict(self.outer)))

    def visit_inside(self, node: ast.AST) -> None:
        """What an attribute is taken of: of a group only a field, which was looked for."""
        self.visit(node)

    def visit_Subscript(self, node: ast.Subscript) -> None:
        written = not isinstance(node.ctx, ast.Load)
        base: ast.AST = node
        while isinstance(base, ast.Subscript):
            self.visit(base.slice)
            base = base.value
        if not self._use(base, written):
            self.visit(base)

    def visit_Call(self, node: ast.Call) -> None:
        callee = self._stands_for(node.func)
        called = None if callee is None else plain(callee)
        home = getattr(called, "__module__", "") or ""
        if called is None or home.split(".")[0] in ("taichi", "quadrants"):
            atomic = getattr(called, "__name__", "").startswith("atomic")
            for argument in [*node.args, *(word.value for word in node.keywords)]:
                if atomic and isinstance(argument, ast.Subscript):
                    argument.ctx = ast.Store()
                self.visit(argument)
            return
        names = list(inspect.signature(called).parameters)
        given = {}
        for name, argument in [*zip(names, node.args), *((word.arg, word.value) for word in node.keywords)]:
            found = self._stands_for(argument)
            if isinstance(found, Group | Array) or callable(found):
                given[name] = found
            else:
                self.visit(argument)
        _Reader(called, given, self.uses).read()
