"""What the commands share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

try:
    from tyro.conf import Positional as Positional
except ImportError:  # cli.parse() says what is missing
    Positional = Annotated  # type: ignore[assignment,misc]


@dataclass(frozen=True, kw_only=True)
class Common:
    """Options of every command."""

    json: bool = False
    """Print one line of JSON last, and no progress bar."""
