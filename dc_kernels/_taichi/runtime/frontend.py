"""What the compiler's Python half is spared while it reads our sources, which it does anew in each process.

For each node of a tree it makes a text that shows a reader where it stands, at half the time of a step's tree, and a
function's source is looked for at each of its calls. Errors name file, line and function here, and show the line.
"""

import contextlib
import functools
import importlib
from collections.abc import Iterator
from typing import Any
from unittest import mock

from dc_kernels._taichi.runtime.compiler import ti


def _position(self: Any, node: Any) -> str:
    """Where a node stands, for an error."""
    line = node.lineno + self.lineno_offset
    return f'File "{self.file}", line {line}, in {self.func.func.__name__}:\n{self.src[node.lineno - 1]}\n'


def _found() -> list[tuple[Any, str, Any]]:
    """Modules and classes of the compiler, names in them, and what is put there; none that this version lacks."""
    found: list[tuple[Any, str, Any]] = []
    if ti.__name__ == "taichi":  # Quadrants makes each text once
        with contextlib.suppress(ImportError, AttributeError):
            context = importlib.import_module("taichi.lang.ast.ast_transformer_utils").ASTTransformerContext
            if hasattr(context, "get_pos_info"):
                found.append((context, "get_pos_info", _position))
        with contextlib.suppress(ImportError, AttributeError):
            module = importlib.import_module("taichi.lang.kernel_impl")
            for name in ("getsourcelines", "getsourcefile"):
                found.append((module, name, functools.cache(getattr(module, name))))
    return found


_replacements = _found()


@contextlib.contextmanager
def reading() -> Iterator[None]:
    """Read sources in half the time."""
    with contextlib.ExitStack() as stack:
        for owner, name, replacement in _replacements:
            stack.enter_context(mock.patch.object(owner, name, replacement))
        yield
