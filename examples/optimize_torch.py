"""Move particles by gradients through splat, a CNN and gather, to match the output for hidden particles."""

import torch

import dc_kernels as dc
from dc_kernels.torch_ops.transfer import gather_torch, splat_torch


def main(count: int = 30, steps: int = 150) -> tuple[float, float]:
    """Move the particles by Adam; return the loss before and after."""
    torch.manual_seed(0)
    grid, stencil = dc.Grid.from_box((0.0, 0.0), (4.0, 4.0), 0.25), dc.Stencil(h=0.75)
    network = torch.nn.Sequential(
        torch.nn.Conv2d(1, 8, 5, padding=2), torch.nn.Tanh(), torch.nn.Conv2d(8, 2, 3, padding=1)
    ).requires_grad_(False)
    mass = torch.full((count, 1), 1.0)

    def seen(points):
        """Return the network's output for the particles' image, (1, 2, rows, columns)."""
        return network(splat_torch(points, mass, grid, stencil))

    hidden = 0.5 + 3.0 * torch.rand(count, 2)
    wanted = seen(hidden)
    points = (hidden + 0.3 * torch.randn(count, 2)).clamp(0.2, 3.8).requires_grad_()
    optimizer = torch.optim.Adam([points], lr=0.01)
    losses = []
    for _ in range(steps):
        optimizer.zero_grad()
        off = seen(points) - wanted
        # errors at the nodes, and at the particles, whose positions gather is also differentiable by
        loss = off.square().sum() + gather_torch(off, points, grid).square().sum()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.1 * losses[0], (losses[0], losses[-1])
    return losses[0], losses[-1]


if __name__ == "__main__":
    torch.set_num_threads(1)  # for such small images threads cost more than they gain
    print("loss: {:.4g} at first, {:.4g} at the end".format(*main()))
