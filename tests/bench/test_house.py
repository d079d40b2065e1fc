"""The bench ``house`` counts a small tree as one does by hand."""

from __future__ import annotations

import textwrap

import pytest

from bench import house

FILES = {
    "dc_kernels/__init__.py": "",
    "dc_kernels/kernels.py": """
        @wp.kernel
        def short(a: int, b: int): ...

        @wp.kernel(enable_backward=False)
        def long(a: int, b: int, c: int, d: int): ...

        class Stage:
            def call(self, a, b, /, c, d, *rest, option, other):
                def inner(a, b, c, d, e): ...
        """,
    "dc_kernels/a.py": """
        def late():
            from dc_kernels import b
        """,
    "dc_kernels/b.py": "from . import c\n",
    "dc_kernels/c.py": "from .a import late\n",
    "dc_kernels/d.py": """
        from typing import TYPE_CHECKING
        import dc_kernels.a
        from dc_kernels.kernels import _hidden, __version__, shown
        from dc_kernels import _warp
        from os import _exit
        if TYPE_CHECKING:
            from dc_kernels.e import E
        """,
    "dc_kernels/e.py": "from dc_kernels.d import x\n" + "#\n" * 200,
    "dc_kernels/_warp/__init__.py": '''
        PROSE = """It ends; it begins.
        Twice;
        thrice;
        """
        CODE = f"""
        #pragma once
        float f({x} y) {{
            return y; // done
        }}
        """
        ''',
    "pipeline/__init__.py": "",
    "bench/__init__.py": "",
    "bench/x/one.py": "",
    "README.md": "twelve bytes",
    "tests/test_far.py": "#\n" * 999,
}


@pytest.fixture
def tree(tmp_path):
    for path, text in FILES.items():
        file = tmp_path / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(textwrap.dedent(text).removeprefix("\n"))
    return tmp_path


def test_counts_of_a_small_tree(tree):
    assert house.count(tree) == {
        "max_kernel_parameters": (4, "dc_kernels/kernels.py:long"),
        "max_function_parameters": (5, "dc_kernels/kernels.py:inner"),
        "import_circles": (1, "dc_kernels.a, dc_kernels.b, dc_kernels.c"),
        "private_imports": (1, "dc_kernels/d.py: dc_kernels.kernels._hidden"),
        "most_files_in_a_folder": (7, "dc_kernels/"),
        "longest_module": (201, "dc_kernels/e.py"),
        "readme_bytes": (12, "README.md"),
        "cpp_lines_in_strings": (6, "dc_kernels/_warp/__init__.py: 6"),
    }


def test_methods_count_without_self_and_keywords(tree):
    module = house.modules(tree)["dc_kernels.kernels"]
    found = {place: (kernel, count) for place, kernel, count in house.functions(module)}
    assert found["dc_kernels/kernels.py:call"] == (False, 4)
    assert found["dc_kernels/kernels.py:short"] == (True, 2)


def test_two_circles_that_share_no_module(tree):
    (tree / "pipeline/p.py").write_text("import pipeline.q\n")
    (tree / "pipeline/q.py").write_text("from pipeline.p import x\n")
    assert house.count(tree)["import_circles"].value == 2
    # one import more makes one circle of both
    (tree / "dc_kernels/a.py").write_text("from dc_kernels import b\nimport pipeline.p\n")
    (tree / "pipeline/q.py").write_text("from pipeline.p import x\nimport dc_kernels.c\n")
    circle = "dc_kernels.a, dc_kernels.b, dc_kernels.c, pipeline.p, pipeline.q"
    assert house.count(tree)["import_circles"] == (1, circle)
