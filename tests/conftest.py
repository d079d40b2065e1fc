"""Settings that every test runs with."""

from __future__ import annotations

import os
import signal
import threading

import pytest
import warp as wp
from hypothesis import HealthCheck, settings

from dc_kernels.runtime import stepping

wp.config.log_level = wp.LOG_WARNING
stepping.WORTH_THREADS = 0  # scenes of tests are small, and still their threads are to be tested

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN and threading.current_thread() is threading.main_thread():
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell has it ignored by what it runs in the background

# Kernels compile in the first example of a property test, so neither a deadline nor a slow start means anything.
settings.register_profile(
    "ci",
    deadline=None,
    derandomize=True,
    max_examples=40,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.register_profile("thorough", settings.get_profile("ci"), derandomize=False, max_examples=1000)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci"))


@pytest.fixture(autouse=True)
def wakeup_descriptor():
    """Holds each test to leave the descriptor for signals' numbers as it was, which is the process's."""
    yield
    if threading.current_thread() is threading.main_thread():
        left = signal.set_wakeup_fd(-1)
        assert left == -1, f"the test leaves signals going to descriptor {left}"
