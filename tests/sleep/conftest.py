"""A scene at rest."""

import pytest

from tests.sleep.yard import ALL, DT, asleep_in, simulation


@pytest.fixture(scope="module")
def at_rest():
    """A yard in which all sleep, to be cloned."""
    sim = simulation()
    sim.run(100, DT)
    assert asleep_in(sim) == set(ALL)
    return sim
