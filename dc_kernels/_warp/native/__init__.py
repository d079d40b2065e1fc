"""C++ of the kernels' inner loops: headers that are read as the body of a native function, with their types as macros.

A header is the body of one function, whose parameters are those of the Warp function that takes it; ``prelude.h`` names
what all share. ``REAL`` is the scalar type, and whatever else a header asks for at its top comes in as a macro. Compile
errors name the header and its line.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path

SCALARS = {"float32": "float", "float64": "double"}
FOLDER = Path(__file__).parent


@cache
def header(name: str) -> str:
    """The text of a header, marked with its name and lines for the compiler."""
    text = (FOLDER / name).read_text(encoding="utf-8")
    return f'\n#line 1 "dc_kernels/_warp/native/{name}"\n{text}'


def native_code(*names: str, dtype: str, **macros: object) -> str:
    """The body of a native function: headers in order, between the definitions of their macros and their end.

    Args:
        names: files in this folder, as "solve/sweep.h".
        dtype: "float32" or "float64": what ``REAL`` is.
        macros: further macros by name; True and False become 1 and 0.
    """
    values = {"REAL": SCALARS[dtype], **macros}
    define = [f"#define {name} {int(value) if isinstance(value, bool) else value}" for name, value in values.items()]
    undefine = [f"#undef {name}" for name in values]
    return "\n".join(["", *define, *map(header, names), *undefine, ""])


def in_parts(body: str, result: str, taken: str, arrays: Sequence[str], given: str = "int first, int last") -> str:
    """The body of a native function whose loop threads may share: ``part(first, last)`` is what it does to a range.

    It is compiled once, whoever calls it, and takes arrays by their addresses alone.

    Args:
        body: what ``part`` does, as ``native_code`` gives it.
        result: what the body returns, in C++; 0 where it returns nothing.
        taken: how the parts are taken (``native/runtime/``), which returns what the function does.
        arrays: parameters that the body reads as ``name.data``; numbers are taken by themselves.
        given: parameters of ``part``, in C++.
    """
    held = ", ".join(f"{name} = held({name}.data)" for name in arrays)
    return f"""
auto held = [](auto* data) {{ struct {{ decltype(data) data; }} array = {{data}}; return array; }};
auto part = [=, {held}]({given}) __attribute__((noinline)) -> {result} {{{body}return 0;
}};{taken}"""
