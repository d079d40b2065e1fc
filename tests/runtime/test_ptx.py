"""All kernels of all variants compile to PTX, which needs no GPU; those that would do nothing there are listed."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re

import pytest
import warp as wp

from dc_kernels import _warp
from dc_kernels.runtime.backends import make_kernels
from dc_kernels.solve.rows import COLUMNS, JOINTED, OWN, SURFACED

ARCHITECTURE = 75  # the oldest that Warp supports here; its code for others differs in a few lines only
OPTIONS = {
    "dtype": ("float32", "float64"),
    "variant": ("discs", "surfaces"),  # in which each of the conditions on variants holds and does not
    "only_discs": (False, True),
    "rolls": (False, True),
    "traits": (False, True),
    "dim": (2, 3),
}
"""What the factories of kernels take, by parameter, and all its values."""
ROWS = {"solve.position": ("discs", "joints", "surfaces")}
"""Variants of the file with whose kernels those of a row are compiled, where one condition comes behind another."""
CPU_ONLY = {
    *("splat_worlds", "divide_image", "gather_points", "gather_gradient", "count_tiles", "list_tiles", "splat_tiles"),
    *("bound_points", "sort_points", "sweep_pairs", "sweep_lists", "order_lists"),
    *("sum_neighbors", "pull_neighbors", "run_launches", "serve", "look_at_fields"),
    *("solve_features", "answer_contacts", "answer_worlds"),
    *("build_tree", "cast_shapes", "find_overlaps", "find_closest"),
}
"""Kernels whose work is native code in lanes of the CPU: on a GPU they do nothing, and have to be written anew for it.
``repeat_launches`` calls compiled functions of the CPU, too."""


def factories():
    """Each file of kernels, and the names of the functions in it that make some."""
    prefix = f"{_warp.__name__}."
    for file in sorted(info.name for info in pkgutil.walk_packages(_warp.__path__, prefix) if not info.ispkg):
        module = importlib.import_module(file)
        for name, value in vars(module).items():
            if (name == "kernels" or name.endswith("_kernels")) and value.__module__ == file:
                yield file.removeprefix(prefix), name, value


def variants():
    """Tests of each factory in which each value of each option occurs: in float32 all but the last, float64 with that.

    Kernels differ in the scalar type by its name alone, and a variant takes up to 6 s. What is made for a scalar type
    and nothing else is compiled in float32 only.
    """
    for file, name, factory in factories():
        parameters = list(inspect.signature(factory).parameters)
        values = [OPTIONS[parameter] for parameter in parameters]
        if file in ROWS:
            values[parameters.index("variant")] = ROWS[file]
        if parameters == ["dtype"]:
            values = [OPTIONS["dtype"][:1]]
        count = max((len(choices) for choices in values), default=1)
        for k in range(count):
            options = tuple(choices[k] if len(choices) == count else choices[k == count - 1] for choices in values)
            yield pytest.param(file, name, options, id="-".join(map(str, (file, name, *options))))


def stores(text):
    """How often each kernel of a PTX file writes to memory that others see, by its mangled name."""
    found = re.findall(r"\.visible \.entry (\w+)_cuda_kernel_forward\((.*?\n\})", text, re.DOTALL)
    return {name: len(re.findall(r"\b(?:st\.global|st\.[ufbv]|atom|red\.)", body)) for name, body in found}


def test_variants_meet_both_sides_of_each_condition():
    assert set(COLUMNS) == {"discs", "general", "joints", "rows", "surfaces"}  # a new one may ask for more
    for holds in (("discs",), JOINTED, OWN, SURFACED):
        assert {variant in holds for variant in OPTIONS["variant"]} == {True, False}


def test_all_files_of_kernels_are_looked_at():
    files, found = set(), set()
    for file, name, factory in factories():
        options = [OPTIONS[parameter][0] for parameter in inspect.signature(factory).parameters]
        files.add(file)
        found |= set(make_kernels("warp", file, *options, factory=name))
    assert files >= {
        "collide.broadphase",
        "solve.schedules",
        "grid.images",
        "delassus.first_order",
        "runtime.sequences",
    }
    assert found >= CPU_ONLY


@pytest.fixture(scope="module")
def stores_of(tmp_path_factory):
    """What ``stores`` finds in a Warp module, which is compiled once: several files may have their kernels in one."""
    for parameters in variants():  # then the modules are whole
        file, name, options = parameters.values
        make_kernels("warp", file, *options, factory=name)
    found = {}

    def look(module):
        if module.name not in found:
            folder, level = tmp_path_factory.mktemp("ptx"), module.options["optimization_level"]
            module.options["optimization_level"] = None  # on that of the tests a GPU's compiler takes longer
            module.mark_modified()
            wp.compile_aot_module(module, arch=ARCHITECTURE, use_ptx=True, module_dir=str(folder))
            module.options["optimization_level"] = level
            module.mark_modified()
            (path,) = folder.glob("*.ptx")
            found[module.name] = stores(path.read_text())
        return found[module.name]

    return look


@pytest.mark.parametrize(("file", "name", "options"), list(variants()))
def test_kernels_compile_for_a_gpu(stores_of, file, name, options):
    idle = set()
    table = make_kernels("warp", file, *options, factory=name)
    for key, kernel in table.items():
        written = stores_of(kernel.module)
        mangled = kernel.get_mangled_name()
        assert mangled in written, f"{key} is not in the PTX"
        if not written[mangled]:
            idle.add(key)
    assert idle == CPU_ONLY & set(table)
