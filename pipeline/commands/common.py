"""What the commands share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from dc_kernels.model.settings import Settings

try:
    from tyro.conf import Positional as Positional
    from tyro.conf import UseAppendAction as Several
except ImportError:  # cli.parse() says what is missing
    Positional = Several = Annotated  # type: ignore[assignment,misc]


@dataclass(frozen=True, kw_only=True)
class Common(Settings):
    """Options of every command."""

    json: bool = False
    """Print one line of JSON last, and no progress bar."""
    plugin: Several[tuple[Path, ...]] = ()
    """Python file that is run first and registers networks or starts."""
