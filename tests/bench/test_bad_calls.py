"""The bad calls of the bench: how each is judged, and that some of every kind are refused by name."""

from __future__ import annotations

import inspect

import pytest

import dc_kernels as dc
from bench.faults.calls import TARGETS, Call, judge, run_group

INNER = {
    *("Broadphase.check", "Narrowphase.check", "NeighborSearch.check", "Stencil.arguments", "Stencil.check_gather"),
    *("Stencil.support", "to_torch"),
}
"""What has a public name and promises errors, but takes what other calls have checked."""


def refuse(error):
    def function(**arguments):
        raise error

    return function


@pytest.mark.parametrize(
    ("function", "outcome"),
    [
        (refuse(ValueError("count is 0; it must be > 0")), "clear"),
        (refuse(TypeError("shape is 0")), "clear"),  # another name that the argument has
        (refuse(OverflowError("count does not fit")), "clear"),
        (refuse(ValueError("counts differ")), "unclear"),
        (refuse(ValueError("count\nis 0")), "unclear"),
        (refuse(RuntimeError("count is 0")), "unclear"),
        (lambda **arguments: None, "silent"),
    ],
)
def test_a_call_is_judged_by_its_error(function, outcome):
    assert judge(Call("f", ("count", "shape"), lambda: function, dict))[0] == outcome


def promising():
    """Public functions, classes and methods of the package that promise errors: name, last part of it, function."""
    for name in dc.__all__:
        thing = getattr(dc, name)
        if inspect.isclass(thing):
            for method, function in inspect.getmembers(thing, lambda f: inspect.isfunction(f) or inspect.ismethod(f)):
                if not method.startswith("_") and "Raises:" in (function.__doc__ or ""):
                    yield f"{name}.{method}", method, function
            if "Raises:" in (thing.__init__.__doc__ or ""):
                yield name, name, thing
        elif callable(thing) and "Raises:" in (thing.__doc__ or ""):
            yield name, name, thing


def test_every_argument_of_what_promises_errors_is_tried():
    pytest.importorskip("torch")
    tried: dict[str, set[str]] = {}
    for targets in TARGETS.values():
        for target in targets():
            tried.setdefault(target.name.split(".")[-1].removesuffix("()"), set()).update(target.hints)
    tried["assign"].add("values")  # under the name of the field
    missing = {}
    for name, last, function in promising():
        parameters = inspect.signature(function).parameters.values()
        named = {p.name for p in parameters if p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL) and p.name != "self"}
        if name not in INNER and named - tried.get(last, set()):
            missing[name] = named - tried.get(last, set())
    assert missing == {}


def test_some_calls_of_a_group_are_refused_by_name():
    found = run_group("builder", 97)
    assert len(found) > 15
    assert [(name, text) for name, what, text in found if what != "clear"] == []


def test_what_ends_a_process_is_counted_and_the_others_are_made(tmp_path):
    script = tmp_path / "crashing.py"
    script.write_text(
        "import os, sys\n"
        "from bench.faults import calls\n"
        "judge = calls.judge\n"
        "calls.judge = lambda call: os.abort() if 'add_disc(radius=None)' in call.name else judge(call)\n"
        "calls.serve(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))\n"
    )
    found = run_group("builder", 1, (str(script),))
    assert [(name, what, text) for name, what, text in found if what != "clear"] == [
        ("add_disc(radius=None)", "unclear", "crashed with -6")
    ]
    assert len({name for name, _, _ in found}) > 1000
