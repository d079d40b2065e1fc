"""Tables of the groups of arrays of a simulation, and of the lists of pairs in which it reports what touches."""

from __future__ import annotations

from typing import Any

from dc_kernels.model.fields import (
    CACHE,
    CONTACTS,
    JOINTS,
    MODEL,
    MOTION,
    PAIRS,
    ROWS,
    SLEEPERS,
    STATE,
    STATS,
    field_table,
)
from dc_kernels.model.rules import COUNT, NOT_NEGATIVE, Number


def _list(axis: str, prefix: str, meaning: str) -> list[tuple[Any, ...]]:
    """Rows of a list of pairs of shapes, sorted by them, which lie in slots of an axis of their own."""
    return [
        (f"{prefix}count", "world", "int32", "1", f"pairs of each world {meaning}", COUNT),
        (f"{prefix}a", axis, "int32", "1", "shape A of each"),
        (f"{prefix}b", axis, "int32", "1", "shape B of each"),
    ]


def _pair_lists(noun: str, start: str, verb: str) -> list[tuple[Any, ...]]:
    """Rows of pairs that have something in common, and of what a step has changed of them."""
    return [
        ("parts", "world", "int32", "1", "whole substeps of a step", COUNT),
        ("part", "world", "int32", "1", "of these taken, of the present step", COUNT),
        *_list(noun, "", f"that {verb}, from {start} on"),
        *_list(f"earlier {noun}", "before_", "that did so when the step before had ended"),
        *_list(f"begun {noun}", "begun_", "that do so since the last step"),
        *_list(f"ended {noun}", "ended_", "that have ceased to in the last step"),
    ]


# Pairs of a sensor and another shape; all axes are empty where no shape is a sensor (events/lists.py).
OVERLAPS = field_table(*_pair_lists("overlap", "pairs.start", "overlap or touch where the last step began"))

# Pairs of shapes with contacts that press or overlap; all axes are empty but where SolverConfig.contact_events is.
TOUCHES = field_table(
    *_pair_lists("touching pair", "contacts.contact_start", "touch at the end of the last step"),
    (
        "impulse",
        "touching pair",
        "real",
        "N s",
        "normal impulse of all contacts of the pair together, of the last step",
    ),
    ("speed", "touching pair", "real", "m/s", "at which it approached before the last substep, 0 where it did not"),
    ("temp", "touching pair", "real", "m/s", "the same while lists are merged"),
    ("blow", "touching pair", "real", "m/s", "speed at which it hit in the last step, 0 where it did not"),
    ("point", "touching pair", "vec2", "m", "where it hit, relative to the world's origin"),
    ("normal", "touching pair", "vec2", "1", "unit vector there, from A to B"),
    *_list("hitting touching pair", "hit_", "that hit each other in the last step"),
    ("hit_speed", "hitting touching pair", "real", "m/s", "at which they approached", NOT_NEGATIVE),
    ("hit_point", "hitting touching pair", "vec2", "m", "where, relative to the world's origin"),
    ("hit_normal", "hitting touching pair", "vec2", "1", "unit vector there, from A to B"),
)

# Contacts that do not act in the present step (collide/switches.py); all axes are empty where none can be off.
SWITCHES = field_table(
    (
        "count",
        "world",
        "int32",
        "1",
        "contacts that are off, sorted by key, from contact_start of the contacts on",
        COUNT,
    ),
    ("enabled", "contact", "int32", "1", "of the contacts that act: 0: change_contacts switches it off", Number(0, 1)),
) | {field.name: field for field in CONTACTS.values() if field.per == "contact"}

LISTS = {
    "": "count",
    "earlier ": "before_count",
    "begun ": "begun_count",
    "ended ": "ended_count",
    "hitting ": "hit_count",
}
"""The field that holds the length of a list in each world, by what its axis has before the noun."""

GROUPS = {
    "model": MODEL,
    "state": STATE,
    "joints": JOINTS,
    "contacts": CONTACTS,
    "cache": CACHE,
    "pairs": PAIRS,
    "rows": ROWS,
    "motion": MOTION,
    "stats": STATS,
    "sleepers": SLEEPERS,
    "overlaps": OVERLAPS,
    "touches": TOUCHES,
    "switches": SWITCHES,
}
"""Tables by the name that a group of arrays has as attribute of a simulation and as argument of a kernel."""
