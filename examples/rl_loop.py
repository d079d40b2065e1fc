"""A reinforcement learning loop of 64 worlds: actions are forces, observations are views, episodes end with resets.

The task is to bring a disc to the middle of its floor. A linear policy stands in for a network.
"""

import numpy as np

import dc_kernels as dc

DT, FRAMES = 0.01, 4  # an action lasts for so many steps


def make(worlds: int, threads: int = 1) -> dc.Simulation:
    """Return worlds of one size, each with a floor and a disc."""
    builder = dc.ModelBuilder()
    for _ in range(worlds):
        builder.add_world()
        floor = builder.add_body(type=dc.BodyType.STATIC)
        builder.add_chain(floor, [(-6.0, 2.0), (-6.0, 0.0), (6.0, 0.0), (6.0, 2.0)])
        builder.add_disc(builder.add_body((0.0, 0.5)), 0.5)
    return dc.Simulation(*builder.finalize(), threads=threads)


def main(worlds: int = 64, actions: int = 250) -> tuple[int, float]:
    """Drive all worlds; return the number of episodes that reached the goal, and their mean length [s]."""
    rng = np.random.default_rng(0)
    sim = make(worlds)
    # views of the state, (worlds, bodies, ...), whose memory stays in place; body 1 is the disc
    place, velocity, force = (sim.state.worlds(name)[:, 1] for name in ("position", "velocity", "force"))
    time = sim.state.numpy("time")

    def begin(which: np.ndarray) -> None:
        """Begin episodes of some worlds at random positions."""
        at = sim.built.numpy("position").reshape(worlds, 2, 2)[which]
        at[:, 1, 0] = rng.uniform(-4.0, 4.0, len(which))
        sim.reset(which, {"position": at})

    begin(np.arange(worlds))
    lengths: list[float] = []
    for _ in range(actions):
        observation = np.stack([place[:, 0], velocity[:, 0]], axis=1)
        force[:, 0] = np.clip(observation @ (-6.0, -5.0), -10.0, 10.0)  # the policy
        sim.run(FRAMES, DT)
        reached = (np.abs(place[:, 0]) < 0.05) & (np.abs(velocity[:, 0]) < 0.05)
        done = np.flatnonzero(reached | (time > 6.0))
        lengths += time[reached].tolist()
        begin(done)  # the others continue
    assert not sim.state.numpy("flags").any()
    assert len(lengths) > worlds, "each world has come to its goal more than once, on average"
    assert place[:, 1].min() > 0.45 and place[:, 1].max() < 0.55, "all discs are on their floors"
    return len(lengths), float(np.mean(lengths))


if __name__ == "__main__":
    print("{} episodes reached the goal, after {:.2f} s on average".format(*main()))
