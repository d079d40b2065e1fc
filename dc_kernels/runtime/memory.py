"""Memory that something would take, refused before it is allocated: what does not fit would end the process later."""

from __future__ import annotations

import os

LARGE = 1e8  # bytes from which on anything is looked at, so that small allocations cost nothing
SHARE = 0.9  # of what is free: the rest is for what is not counted


def free_memory() -> float:
    """Bytes that this machine has free, or has at all where it does not say; inf where it says neither."""
    try:
        with open("/proc/meminfo") as file:
            for line in file:
                if line.startswith("MemAvailable:"):
                    return 1024.0 * float(line.split()[1])
    except (OSError, ValueError):
        pass
    try:
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, OSError, ValueError):
        return float("inf")


def check_memory(name: str, size: float, least: float = LARGE) -> None:
    """Raise a MemoryError for what would not fit into the free memory.

    Args:
        name: of the setting or array that asks for it.
        size: that it would take [B].
        least: less is not looked at [B].

    Raises:
        MemoryError: naming it, the memory that it would take, and what is free.
    """
    if size >= least and size > SHARE * (free := free_memory()):
        raise MemoryError(f"{name} would take {size / 1e9:.4g} GB of memory; {free / 1e9:.4g} GB are free")
