"""Which seeds of worlds are for what, so that no network is tested on a world that it was trained on."""

from __future__ import annotations

from dc_kernels.model.settings import Seed, checker

check_seed = checker(Seed)
"""Returns a seed, or raises an error with the name."""
TUNING_SEED = 80_000
"""First seed of the worlds on which gains of ContactNet are chosen; its training takes seeds below [1]."""
VALIDATION_SEED = 90_000
"""First seed of the worlds that validate ContactNet [1]."""
HELD_OUT_SEED = 100_000
"""First seed of the worlds for tests: no training uses seeds from here on [1]."""


def check_seeds(first: int, count: int) -> None:
    """Raise a ``ValueError`` unless ``count`` seeds from ``first`` on fit the 63 bits that files hold."""
    if first + count > 2**63:
        raise ValueError(f"seed is {first}; the seeds of {count} worlds from there on exceed {2**63 - 1}")


def check_training_seeds(first: int, count: int) -> None:
    """Raise a ``ValueError`` unless ``count`` seeds from ``first`` on are free for training."""
    if first < 0 or first + count > HELD_OUT_SEED:
        raise ValueError(f"seeds {first} to {first + count - 1}: those from {HELD_OUT_SEED} on are for tests")
