"""Markdown tables and figures."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence
from typing import Any

from bench import timing

Record = dict[str, Any]
"""The values of a bench by key, as its JSON line holds them, with ``bench``, ``quick`` and ``machine``."""


def figure(value: Any, digits: int = 3) -> str:
    """Write a value for people: about three digits, no exponent from 1e-4 on, - where there is none."""
    if isinstance(value, float) and 1e-4 <= abs(value) < 1e-3:
        return f"{value:.{digits - 1}g}"
    return timing.number(value, digits)


def table(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Write a Markdown table; values that are no text become figures."""
    lines = [header, ["---"] * len(header), *([figure(value) for value in row] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def span(values: Iterable[float]) -> str:
    """Write the least and the largest of some values, as "1 to 1.3"; one where they look alike, - without any."""
    kept = list(values)
    if not kept:
        return "-"
    low, high = (f"{value:.2g}" if value < 10 else figure(value) for value in (min(kept), max(kept)))
    return low if low == high else f"{low} to {high}"


def paragraphs(*parts: str) -> str:
    """Join parts of a section by empty lines; prose is wrapped at 120 columns, empty parts are left out."""
    return "\n\n".join(part if part[0] in "|!-#<" or "\n\n" in part else wrapped(part) for part in parts if part)


def wrapped(prose: str) -> str:
    """Wrap a paragraph at 120 columns; links and names stay whole."""
    return textwrap.fill(prose, 120, break_long_words=False, break_on_hyphens=False)
