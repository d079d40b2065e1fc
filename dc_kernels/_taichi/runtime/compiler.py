"""The kernel compiler: Taichi, or Quadrants, a maintained fork that compiles the same source; no banner on import.

The environment variable ``DEEP_CONTACT_TAICHI`` names the package, "taichi" or "quadrants"; where it is not set, Taichi
is taken if it is installed. All kernel files take ``ti`` from here.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
from typing import Any

VARIABLE = "DEEP_CONTACT_TAICHI"
PACKAGES = ("taichi", "quadrants")


def package() -> str:
    """Name of the package that compiles the kernels.

    Raises:
        ValueError: where the environment variable names another one.
        ImportError: where it is not installed, naming the extra that brings it.
    """
    wanted = os.environ.get(VARIABLE)
    if wanted and wanted not in PACKAGES:
        raise ValueError(f"the environment variable {VARIABLE} is {wanted!r}; it must be one of {PACKAGES}")
    for name in [wanted] if wanted else PACKAGES:
        if importlib.util.find_spec(name) is not None:
            return name
    name = wanted or PACKAGES[0]
    raise ImportError(
        f"the backend 'taichi' needs the package {name}: in a clone of deep-contact, pip install -e '.[{name}]'"
    )


def _load() -> Any:
    name = package()
    silent = {"ENABLE_TAICHI_HEADER_PRINT": "False", "ENABLE_QUADRANTS_HEADER_PRINT": "False"}
    before = {key: os.environ.get(key) for key in silent}
    os.environ.update({key: value for key, value in silent.items() if before[key] is None})
    try:
        return importlib.import_module(name)
    finally:
        for key, value in before.items():
            if value is None:
                del os.environ[key]


ti: Any = _load()
"""The package: ``ti.func``, ``ti.f32`` and so on."""
impl: Any = importlib.import_module(f"{ti.__name__}.lang.impl")
"""Its half-private module that knows the program which is running."""
