"""Read a data set with h5py and hdf5plugin, train a network on it, and use it as ``--start FILE`` of a run."""

import json
import tempfile
from pathlib import Path

import h5py
import hdf5plugin  # noqa: F401  (h5py reads zstd with it)
import numpy as np
import torch

import dc_kernels as dc
from pipeline.cli import main as deep_contact
from pipeline.networks.checkpoint import save_checkpoint
from pipeline.networks.models import build

GENERATE = "generate thesis --bodies 10 --worlds {worlds} --steps 60 --grids --grid-size 5 5 --out {folder}/data"
SIMULATE = "simulate thesis --bodies 10 --steps 60 --start {folder}/mine.safetensors --out {folder}/run"


def train(data: Path, epochs: int) -> tuple[torch.nn.Module, dc.Grid, list[float]]:
    """Read images of all states, and fit a small network to the impulses; return its loss in each epoch."""
    with h5py.File(data / "index.h5") as file:
        good = (file["step/flags"][:] == 0) & (np.diff(file["step/contact_start"][:]) > 0)
        image = torch.from_numpy(file["grid/input"][:][good])  # bodies and contacts, (states, 6, rows, columns)
        label = torch.from_numpy(file["grid/label"][:][good])  # normal and tangential impulses [N s]
        options = json.loads(file.attrs["config"])
    grid = dc.Grid.from_box((0.0, 0.0), options["grid_size"], options["grid_spacing"])
    torch.manual_seed(0)
    size = {"rows": image.shape[2], "columns": image.shape[3], "channels": image.shape[1]}
    network = build("pressure", {**size, "width": 0.5})
    network.set_scales(image.std(dim=(0, 2, 3)).clamp(min=1e-3), label.std(dim=(0, 2, 3)), 10.0)
    optimizer = torch.optim.Adam(network.parameters(), lr=3e-3)
    losses = []
    for _ in range(epochs):
        total = 0.0
        for batch in torch.randperm(len(image)).split(32):
            loss = (network(image[batch]) - label[batch]).square().mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            total += float(loss.detach()) * len(batch)
        losses.append(total / len(image))
    return network, grid, losses


def main(worlds: int = 6, epochs: int = 10) -> tuple[float, float, int]:
    """Make a data set, train, and run the scene with the network as start; return losses and its calls in the run."""
    with tempfile.TemporaryDirectory() as folder:
        deep_contact(GENERATE.format(worlds=worlds, folder=folder).split())
        network, grid, losses = train(Path(folder) / "data", epochs)
        # a start needs the specification of the input images, and how to gather at the contacts
        manifest = {"images": dc.ImageSpec(grid).to_dict(), "decode": {"reverse": True}}
        save_checkpoint(Path(folder) / "mine.safetensors", network, manifest)
        deep_contact(SIMULATE.format(folder=folder).split())
        summary = json.loads((Path(folder) / "run" / "summary.json").read_text())
    found = summary["network"]
    assert losses[-1] < 0.9 * losses[0], losses
    assert found["calls"] and found["calls"] + found["skipped"] == 60, "it answers in each step with contacts"
    return losses[0], losses[-1], found["calls"]


if __name__ == "__main__":
    print("loss: {:.3g} in the first epoch, {:.3g} in the last; answers in the run: {}".format(*main()))
