"""The bad calls of the bench: how each is judged, and that some of every kind are refused by name."""

from __future__ import annotations

import pytest

from bench.faults.calls import Call, judge, run_group


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
