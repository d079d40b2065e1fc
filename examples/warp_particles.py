"""Particles of plain Warp through splat, a convolution, gather and back to the particles, in one recorded graph.

The particles use only arrays and kernels of Warp. The output of a convolution layer, 3 x 3 with ReLU, for their mass on
a grid pushes them apart like a pressure. On the CPU a graph can only hold launches, and no network of
torch: the layer is a kernel.
"""

import numpy as np
import warp as wp

import dc_kernels as dc

SIDE, DT, STIFFNESS = 4.0, 0.02, 0.5


@wp.kernel(enable_backward=False)
def convolve(
    image: wp.array3d(dtype=float),
    weight: wp.array3d(dtype=float),
    bias: float,
    relu: int,
    out: wp.array3d(dtype=float),
):
    """Filter the image's first channel by weight c into channel c of the result, with zeros beyond the border."""
    c, row, column = wp.tid()
    total = float(bias)
    for i in range(3):
        for j in range(3):
            y = row + i - 1
            x = column + j - 1
            if y >= 0 and y < image.shape[1] and x >= 0 and x < image.shape[2]:
                total += weight[c, i, j] * image[0, y, x]
    if relu == 1:
        total = wp.max(total, 0.0)
    out[c, row, column] = total


@wp.kernel(enable_backward=False)
def move(place: wp.array(dtype=wp.vec2), velocity: wp.array(dtype=wp.vec2), force: wp.array(dtype=wp.vec2)):
    """Make a semi-implicit Euler step within walls."""
    i = wp.tid()
    v = 0.98 * (velocity[i] + DT * force[i])
    x = place[i] + DT * v
    velocity[i] = v
    place[i] = wp.vec2(wp.clamp(x[0], 0.0, SIDE), wp.clamp(x[1], 0.0, SIDE))


def main(count: int = 400, steps: int = 200) -> tuple[float, float]:
    """Let a dense cloud spread; return the densest node before and after [kg]."""
    wp.init()
    rng = np.random.default_rng(0)
    begin = rng.normal(0.5 * SIDE, 0.15, (count, 2)).astype(np.float32)
    grid = dc.Grid.from_box((0.0, 0.0), (SIDE, SIDE), 0.25)
    with wp.ScopedDevice("cpu"):
        place, velocity = wp.array(begin, dtype=wp.vec2), wp.zeros(count, dtype=wp.vec2)
        mass = wp.full(count, 1.0 / count, dtype=float).reshape((count, 1))
        density, pressure = (wp.zeros((1, 1, *grid.shape), dtype=float) for _ in range(2))
        slope, force = wp.zeros((1, 2, *grid.shape), dtype=float), wp.zeros((count, 2), dtype=float)
        blur = wp.full((1, 3, 3), 1.0 / 9.0, dtype=float)
        sobel = np.array([[-1, 0, 1], [-2, 0, 2], [-1, 0, 1]], np.float32) / 8.0
        down = wp.array(-STIFFNESS * 1e3 * np.stack([sobel, sobel.T]), dtype=float)  # along -gradient
        onto = dc.Transfer(grid, dc.Stencil(h=0.5)).at(place).splat(mass, density)
        back = dc.Transfer(grid, dc.Stencil("bilinear")).at(place).gather(slope, force)

        def step():
            onto()
            wp.launch(convolve, (1, *grid.shape), inputs=[density[0], blur, 0.0, 1], outputs=[pressure[0]])
            wp.launch(convolve, (2, *grid.shape), inputs=[pressure[0], down, 0.0, 0], outputs=[slope[0]])
            back()
            wp.launch(move, count, inputs=[place, velocity, force.view(wp.vec2)])

        onto()
        before = float(density.numpy().max())
        step()  # compiles and loads all kernels
        launched = place.numpy()
        place.assign(begin)
        velocity.zero_()
        with wp.ScopedCapture() as capture:
            step()
        place.assign(begin)
        velocity.zero_()
        wp.capture_launch(capture.graph)
        assert np.array_equal(place.numpy(), launched), "a replay has the bits of the launches"
        for _ in range(steps - 1):
            wp.capture_launch(capture.graph)
        onto()
        assert abs(density.numpy().sum() - 1.0) < 1e-4, "the splat keeps the mass"
        after = float(density.numpy().max())
    assert after < 0.3 * before, (before, after)
    return before, after


if __name__ == "__main__":
    print("densest node: {:.3f} kg at first, {:.3f} kg when the cloud has spread".format(*main()))
