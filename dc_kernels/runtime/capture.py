"""Graphs that a user records with ``wp.ScopedCapture`` on the CPU: launches become part of them, the rest refuses.

Warp records for one thread at a time, but lets every thread's launches believe that they are recorded. So a launch asks
whether it is its own thread that records, and otherwise runs as always.
"""

from __future__ import annotations

import functools
from types import SimpleNamespace
from typing import Any

import numpy as np

from dc_kernels.runtime.building import start_warp

HOST = "a part of it runs on the host"


def recording() -> bool:
    """Whether this thread records a graph on the CPU, so that launches are noted and not run."""
    runtime, device, own_thread = _recorder()
    # the first is asked most often, and is the cheapest to ask
    return runtime._apic_capture is not None and device.is_capturing and own_thread()


def refuse_recording(what: str, why: str) -> None:
    """Raise, if this thread records a graph on the CPU, before anything is part of it.

    Args:
        what: the call that cannot be recorded.
        why: the reason, or what to do instead.

    Raises:
        RuntimeError: naming the call.
    """
    if recording():
        raise RuntimeError(f"{what} cannot be recorded in a graph: {why}")


STALE = -1
"""Count of each world in arrays that a stage has left, as its room grew: who still reads them is to notice."""


class Recordings:
    """Tells whether a graph was replayed that knows the arrays of a stage from before they were allocated anew."""

    def __init__(self) -> None:
        """Nothing is recorded yet."""
        self._live = False
        self._retired: list[tuple[np.ndarray, Any]] = []

    def note(self) -> None:
        """A call became part of a graph."""
        self._live = True

    def renew(self, written: np.ndarray, launches: Any) -> np.ndarray:
        """Zeros in place of an array that each call writes; graphs that were recorded so far write to the old one.

        Args:
            written: integers of each world, none of which a call makes -1.
            launches: what knows the arrays of before, which is kept for those graphs.
        """
        if self._live:
            written.fill(-1)
            self._retired.append((written, launches))
            self._live = False
        return np.zeros_like(written)

    def check(self, version: int) -> None:
        """Raise for a replay of a graph that was recorded before arrays were allocated anew.

        Args:
            version: ``layout_version`` of the stage.

        Raises:
            RuntimeError: naming it.
        """
        stale = [written for written, _ in self._retired if (written != -1).any()]
        for written in stale:
            written.fill(-1)
        if stale:
            raise RuntimeError(
                f"a graph was replayed that was recorded before layout_version changed to {version}: it writes to the "
                "arrays of before; record it anew"
            )


def clear(array: Any) -> None:
    """Fill an array of a backend in the CPU's memory with zeros: now, or in a recording at each replay."""
    if recording():
        array.zero_()
    elif hasattr(array, "fill"):
        array.fill(0)
    else:
        array.numpy().fill(0)


@functools.cache
def _recorder() -> tuple[Any, Any, Any]:
    """What holds the graph that Warp records, its CPU, and what tells whether it is of the present thread."""
    import warp as wp
    from warp._src import context

    start_warp()
    own_thread = getattr(context.runtime.core, "wp_apic_get_recording_state", lambda: True)
    runtime = context.runtime if hasattr(context.runtime, "_apic_capture") else SimpleNamespace(_apic_capture=True)
    return runtime, wp.get_device("cpu"), own_thread


def refuse_hosted(backend: str, schedule: str, device: str) -> None:
    """Raise RuntimeError for a step that the host takes part in, which no graph on the CPU or the device can hold."""
    if device != "cpu":
        import warp as wp

        if wp.get_device(device).is_capturing:
            raise RuntimeError("a step on a GPU cannot be recorded in a graph: the host looks for worlds without room")
    if backend != "warp":
        refuse_recording(f"a step of the {backend} backend", "it runs at once")
    if schedule != "world":
        refuse_recording(f"a step with schedule {schedule!r}", "the host drives it")
