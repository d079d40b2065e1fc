"""The shape of the source tree as figures: long parameter lists, import circles, crowded folders, long modules.

Nothing is imported or run: each Python file of ``dc_kernels``, ``pipeline`` and ``bench`` is parsed, and counted as
``measure`` says. ``tests/project/test_house.py`` holds every figure at or below a bound.
"""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from bench import timing

SUMMARY = (
    "shape of the source tree: parameters, import circles, private imports, long modules and folders, C++ in strings"
)
BARS = {
    "max_kernel_parameters": 12,
    "max_function_parameters": 10,
    "import_circles": 0,
    "private_imports": 0,
    "most_files_in_a_folder": 16,
    "longest_module": 450,
    "readme_bytes": 8000,
    "cpp_lines_in_strings": 100,
}
KEYS = tuple(BARS)
THREADS = 1
PACKAGES = ("dc_kernels", "pipeline", "bench")
BACKENDS = ("_warp", "_numpy", "_taichi")  # folders that hold kernels: their underscore says that users don't need them
ROOT = Path(__file__).resolve().parents[1]
# A line of C or C++: it ends with a semicolon or an opening brace, begins with a closing one, or is a directive.
CPP_LINE = re.compile(r";\s*(//.*)?$|\{\{?\s*$|^\s*\}\}?|^\s*#(if|else|endif|define|pragma)")
CPP_LINES = 3  # a string with more such lines is a piece of C++


class Figure(NamedTuple):
    """A count, and the place or the places that it was found at."""

    value: int
    where: str


@dataclass(frozen=True)
class Module:
    """A Python file: its dotted name, path below the root, text, and the nodes of its syntax tree, breadth first."""

    name: str
    path: str
    text: str
    nodes: tuple[ast.AST, ...]

    @property
    def package(self) -> str:
        """Return the package that a relative import starts from."""
        return self.name if self.path.endswith("__init__.py") else self.name.rpartition(".")[0]


def modules(root: Path) -> dict[str, Module]:
    """Parse all modules of the three packages below a folder; return them by dotted name."""
    found = {}
    for package in PACKAGES:
        for file in sorted((root / package).rglob("*.py")):
            path = file.relative_to(root).as_posix()
            name = path.removesuffix(".py").replace("/", ".").removesuffix(".__init__")
            text = file.read_text(encoding="utf-8")
            found[name] = Module(name, path, text, tuple(ast.walk(ast.parse(text, path))))  # walked once: it is slow
    return found


def functions(module: Module) -> Iterator[tuple[str, bool, int]]:
    """Yield of each function, nested ones and methods included, its place, whether it is a kernel, and its parameters.

    Parameters are those that can be passed by position; ``self``, ``cls`` and keyword-only ones don't count.
    """
    for node in module.nodes:
        if not isinstance(node, ast.FunctionDef):
            continue
        positional = [argument.arg for argument in (*node.args.posonlyargs, *node.args.args)]
        count = len(positional) - (positional[:1] in (["self"], ["cls"]))
        kernel = any("kernel" in ast.unparse(decorator) for decorator in node.decorator_list)
        yield f"{module.path}:{node.name}", kernel, count


def most_parameters(tree: dict[str, Module], kernels: bool) -> Figure:
    """Find the longest parameter list of a kernel, or of any other function."""
    found = (item for module in tree.values() for item in functions(module))
    counts = [(count, place) for place, kernel, count in found if kernel == kernels]
    return Figure(*max(counts, key=lambda pair: pair[0], default=(0, "")))


def imports(module: Module) -> Iterator[tuple[str, str]]:
    """Yield what a module imports, inside functions too: (module, name), the name empty for ``import module``.

    Imports below ``if TYPE_CHECKING`` are left out, since they never run.
    """
    typing_only = {
        id(inner)
        for node in module.nodes
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        for statement in node.body
        for inner in ast.walk(statement)
    }
    for node in module.nodes:
        if id(node) in typing_only:
            continue
        if isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parts = module.package.split(".")
                parts = parts[: len(parts) - node.level + 1]
                base = ".".join([*parts, base] if base else parts)
            yield from ((base, alias.name) for alias in node.names)


def import_graph(tree: dict[str, Module]) -> dict[str, set[str]]:
    """Return the modules of the tree that each one imports."""
    graph: dict[str, set[str]] = {}
    for module in tree.values():
        targets = set()
        for base, name in imports(module):
            submodule = f"{base}.{name}"
            targets.add(submodule if submodule in tree else base)
        graph[module.name] = {target for target in targets if target in tree} - {module.name}
    return graph


def reached(graph: dict[str, set[str]], start: str) -> set[str]:
    """Return all modules that importing one brings in, over any number of steps."""
    found: set[str] = set()
    waiting = list(graph[start])
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            waiting += graph[name]
    return found


def import_circles(tree: dict[str, Module]) -> Figure:
    """Find groups of modules that all import each other, directly or not (strongly connected components)."""
    graph = import_graph(tree)
    closure = {name: reached(graph, name) for name in graph}
    groups = {
        frozenset(other for other in closure[name] if name in closure[other]) for name in graph if name in closure[name]
    }
    circles = sorted(", ".join(sorted(group)) for group in groups)
    return Figure(len(circles), "; ".join(circles))


def private_imports(tree: dict[str, Module], root: Path) -> Figure:
    """Find names with a leading underscore that a module takes from another; the backends' folders don't count."""
    found = []
    for module in tree.values():
        for base, name in imports(module):
            private = name.startswith("_") and not name.startswith("__") and name not in BACKENDS
            folder = root.joinpath(*base.split("."), name)
            if private and base.split(".")[0] in PACKAGES and not folder.is_dir():
                found.append(f"{module.path}: {base}.{name}")
    return Figure(len(found), "; ".join(found))


def fullest_folder(tree: dict[str, Module]) -> Figure:
    """Find the folder with the most Python files, those of its subfolders not counted."""
    counts = Counter(module.path.rpartition("/")[0] for module in tree.values())
    folder, count = max(counts.items(), key=lambda pair: pair[1], default=("", 0))
    return Figure(count, f"{folder}/")


def longest_module(tree: dict[str, Module]) -> Figure:
    """Find the file with the most lines."""
    path, lines = max(
        ((module.path, module.text.count("\n")) for module in tree.values()), key=lambda pair: pair[1], default=("", 0)
    )
    return Figure(lines, path)


def cpp_lines(module: Module) -> set[int]:
    """Return the lines of a module that belong to strings of C++."""
    lines = module.text.split("\n")
    found: set[int] = set()
    for node in module.nodes:
        if not (isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))):
            continue
        first, last = node.lineno, node.end_lineno or node.lineno
        if last > first and sum(bool(CPP_LINE.search(line)) for line in lines[first - 1 : last]) > CPP_LINES:
            found.update(range(first, last + 1))
    return found


def cpp_in_strings(tree: dict[str, Module]) -> Figure:
    """Count the lines of C++ that stand in Python strings, and find the module with most of them."""
    counts = {module.path: len(cpp_lines(module)) for module in tree.values()}
    path, most = max(counts.items(), key=lambda pair: pair[1], default=("", 0))
    return Figure(sum(counts.values()), f"{path}: {most}" if most else "")


def count(root: Path = ROOT) -> dict[str, Figure]:
    """Count every figure of the tree below a folder, by key of ``BARS``."""
    tree = modules(root)
    return {
        "max_kernel_parameters": most_parameters(tree, kernels=True),
        "max_function_parameters": most_parameters(tree, kernels=False),
        "import_circles": import_circles(tree),
        "private_imports": private_imports(tree, root),
        "most_files_in_a_folder": fullest_folder(tree),
        "longest_module": longest_module(tree),
        "readme_bytes": Figure((root / "README.md").stat().st_size, "README.md"),
        "cpp_lines_in_strings": cpp_in_strings(tree),
    }


def measure(quick: bool) -> dict[str, Any]:
    """Return the figures by key, ``where`` each stands, and how many are above their bar; ``quick`` changes nothing."""
    figures = count()
    return {
        **{key: figure.value for key, figure in figures.items()},
        "where": {key: figure.where for key, figure in figures.items()},
        "above": sum(figures[key].value > bar for key, bar in BARS.items()),
    }


def report(values: dict[str, Any]) -> str:
    """Return a table of each figure and its bar, and the place of each figure."""
    table = timing.table(("", "figure", "at most"), [(key, values[key], bar) for key, bar in BARS.items()])
    places = [f"{key}: {where}" for key, where in values["where"].items() if where]
    return "\n".join((table, "", *places))
