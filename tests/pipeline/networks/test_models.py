"""Networks of the theses: their sizes, what they map to what, scales, refusals."""

from __future__ import annotations

import dataclasses
import itertools
import re

import pytest

torch = pytest.importorskip("torch")
torch.set_num_threads(1)
from pipeline.networks import models  # noqa: E402
from pipeline.networks.models import GridConfig, build  # noqa: E402

NAMES = ("convfc", "pressure", "peak", "unet")
SMALL = GridConfig(rows=13, columns=18, channels=3, width=0.25)


def small(name: str, seed: int = 0, **changes):
    torch.manual_seed(seed)
    return build(name, dataclasses.replace(SMALL, **changes)).eval()


def test_convfc_has_the_parameters_of_the_thesis():
    with torch.device("meta"):
        network = build("convfc", {"rows": 41, "columns": 41, "channels": 5})
    assert models.parameter_count(network) == 33_441_410


def test_the_other_networks_have_the_layers_of_their_theses():
    """Weights by hand, biases included: filters, sizes and scales at full width."""
    channels, nodes = 6, 61 * 61
    first = channels * 16 * 16 + 16
    pressure = first + 3 * 2 * (16 * 16 * 16 + 16) + (16 * 8 + 8) + (8 * 4 + 4) + (4 * 2 + 2)
    sizes = [channels, 8, 16, 32, 64]
    peak = sum(a * b * 16 + b for a, b in itertools.pairwise(sizes)) + sum(a * 6 + 6 for a in sizes)
    peak += 6 * nodes * 512 + 512 + 512 * 2 * nodes + 2 * nodes
    with torch.device("meta"):
        assert models.parameter_count(build("pressure")) == pressure
        assert models.parameter_count(build("peak")) == peak


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("rows", "columns"), [(13, 18), (16, 8), (61, 61)])
def test_an_image_is_answered_by_one_of_its_size(name, rows, columns):
    network = small(name, rows=rows, columns=columns, outputs=4)
    answer = network(torch.rand(2, 3, rows, columns))
    assert answer.shape == (2, 4, rows, columns)
    assert answer.is_contiguous()
    assert answer.dtype == torch.float32


@pytest.mark.parametrize("name", NAMES)
def test_every_weight_learns(name):
    network = small(name, dropout=0.0).train()
    network(torch.randn(4, 3, 13, 18)).square().sum().backward()
    for key, weight in network.named_parameters():
        assert weight.grad is not None, key
        if not key.endswith("bias"):  # a filter whose ReLU is shut learns nothing, but not all of them are
            assert weight.grad.any(), key


@pytest.mark.parametrize("name", NAMES)
def test_states_of_a_batch_do_not_mix(name):
    network = small(name)
    images = torch.randn(3, 3, 13, 18)
    alone = torch.cat([network(image[None]) for image in images])
    torch.testing.assert_close(network(images), alone, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("name", NAMES)
def test_the_seed_decides_the_weights(name):
    image = torch.rand(1, 3, 13, 18)
    first, again, other = (small(name, seed)(image) for seed in (1, 1, 2))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


@pytest.mark.parametrize("size", [(13, 18), (16, 16), (21, 9)])
def test_a_coarse_scale_lies_over_the_fine_one(size):
    """Halved and enlarged again, a ramp is the same ramp away from the border: nothing is shifted, at any size."""
    rows, columns = size
    ramp = torch.arange(columns)[None, None, None] + 10.0 * torch.arange(rows)[None, None, :, None]
    twice = models.halved(models.halved(ramp))
    inner = (..., slice(4, rows - 6), slice(4, columns - 6))
    for coarse, factor in ((models.halved(ramp), 2), (twice, 4)):
        back = models.enlarged(coarse, factor, ramp)
        assert back.shape == ramp.shape
        torch.testing.assert_close(back[inner], ramp[inner])


@pytest.mark.parametrize("name", NAMES)
def test_scales_are_units_of_channels_and_answers(name):
    network, images = small(name), torch.randn(2, 3, 13, 18)
    answer = network(images)
    units = torch.tensor([2.0, 0.5, 100.0])
    network.set_scales(units, [3.0, 7.0])
    scaled = network(images * units[:, None, None])
    torch.testing.assert_close(scaled, answer * torch.tensor([3.0, 7.0])[:, None, None], rtol=1e-4, atol=1e-5)


def test_beyond_the_bound_an_input_makes_no_difference():
    network, images = small("pressure"), torch.randn(2, 3, 13, 18)
    network.set_scales([1.0, 1.0, 2.0], [1.0, 1.0], bound=5.0)
    images[:, 2, 3] = 10.0
    answer = network(images)
    images[:, 2, 3] = 1e6
    assert torch.equal(network(images), answer)
    images[:, 2, 3] = 9.0
    assert not torch.equal(network(images), answer)


@pytest.mark.parametrize(
    ("channels", "outputs", "bound", "message"),
    [
        ([1.0, 1.0], [1.0, 1.0], 1.0, r"channels has shape \(2,\); it must be \(3,\)"),
        ([1.0, 0.0, 1.0], [1.0, 1.0], 1.0, r"channels\[1\] is 0.0"),
        ([1.0, 1.0, 1.0], [1.0, float("nan")], 1.0, r"outputs\[1\] is nan"),
        ([1.0, 1.0, 1.0], [1.0, 1.0], 0.0, "bound is 0.0"),
    ],
)
def test_scales_out_of_range_are_refused(channels, outputs, bound, message):
    with pytest.raises(ValueError, match=message):
        small("pressure").set_scales(channels, outputs, bound)


@pytest.mark.parametrize(
    ("name", "config", "message"),
    [
        ("lenet", None, r"network is 'lenet'; it must be one of \('convfc', 'pressure', 'peak', 'unet', 'contactnet'"),
        ("unet", {"depth": 3}, "config of unet has the field 'depth'; it has .*'rows'"),
        ("unet", {"rows": 7}, r"GridConfig.rows is 7; it must be an integer in \[8, 65536\)"),
        ("unet", {"columns": 61.0}, "GridConfig.columns is 61.0"),
        ("unet", {"width": 0.0}, r"GridConfig.width is 0.0; it must be in \(0, 16\]"),
        ("peak", {"dropout": 1.0}, r"GridConfig.dropout is 1.0; it must be in \[0, 1\)"),
        ("peak", int, "config of peak is a type; it must be a GridConfig"),
    ],
)
def test_a_network_that_cannot_be_built_is_refused(name, config, message):
    with pytest.raises(ValueError, match=message):
        build(name, config)


@pytest.mark.parametrize("shape", [(2, 4, 13, 18), (2, 3, 18, 13), (3, 13, 18)])
def test_images_of_another_shape_are_refused(shape):
    with pytest.raises(ValueError, match=r"images has shape .*; the network reads \(B, 3, 13, 18\)"):
        small("pressure")(torch.zeros(shape))


def test_a_module_of_another_make_has_no_configuration():
    with pytest.raises(ValueError, match=r"model is a Linear that models.build did not make"):
        models.config_dict(torch.nn.Linear(1, 1))


@pytest.mark.parametrize("shape", [(3, 1, 9, 9), (3, 2, 8, 9), (3, 2, 81)])
def test_an_answer_of_another_shape_names_the_network(shape):
    class Short(models.GridNetwork):
        def answer(self, x):
            return x.new_zeros(shape)

    network = Short(models.GridConfig(rows=9, columns=9, channels=4))
    with pytest.raises(ValueError, match=rf"Short\.answer gave shape {re.escape(str(shape))}; .* \(3, 2, 9, 9\)"):
        network(torch.zeros(3, 4, 9, 9))
