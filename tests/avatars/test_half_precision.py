import pytest
import torch

from deblur_avatar.avatars import half_precision
from deblur_avatar.avatars.half_precision import leaky_layers, worthwhile
from deblur_avatar.avatars.networks import ConditionedMLP

needs_half = pytest.mark.skipif(
    not worthwhile(torch.zeros(1, 3)), reason="this processor does not multiply bfloat16"
)


@pytest.fixture(params=[(3, [32, 32], 5), (40, [32, 32, 32], 1)], ids=["coordinates", "wide"])
def network(request):
    torch.manual_seed(0)
    inputs, hidden, outputs = request.param
    return ConditionedMLP(inputs, 6, hidden, outputs)


def with_gradients(network, monkeypatch, half):
    """Outputs and all gradients, with or without half precision."""
    torch.manual_seed(1)
    inputs = network.layers[0].in_features - 6
    points, condition = torch.rand(200, inputs), torch.rand(6)
    points.requires_grad_()
    condition.requires_grad_()
    network.zero_grad()
    with monkeypatch.context() as patch:
        if not half:
            patch.setattr(half_precision, "_multiplies_half", lambda: False)
        output = network(points, condition)
        (output - 1).square().sum().backward()
    found = {name: value.grad.clone() for name, value in network.named_parameters()}
    return {"output": output.detach(), "points": points.grad, "condition": condition.grad} | found


@needs_half
def test_half_precision_changes_outputs_little_and_keeps_gradients_directions(network, monkeypatch):
    half = with_gradients(network, monkeypatch, half=True)
    full = with_gradients(network, monkeypatch, half=False)
    for name, wanted in full.items():
        assert half[name].dtype == torch.float32
        assert not torch.equal(half[name], wanted), name
        if name == "output":
            assert (half[name] - wanted).norm() / wanted.norm() < 0.01
        alike = torch.nn.functional.cosine_similarity(half[name].flatten(), wanted.flatten(), dim=0)
        assert alike > 0.99, name


@needs_half
def test_half_precision_gives_the_same_bits_twice(network, monkeypatch):
    first = with_gradients(network, monkeypatch, half=True)
    second = with_gradients(network, monkeypatch, half=True)
    assert all(torch.equal(first[name], second[name]) for name in first)


@needs_half
def test_coordinates_keep_all_their_digits():
    # Two points half a millimetre apart, which one metre in bfloat16 cannot tell from each other.
    points = torch.tensor([[1.0, 1.0, 1.0], [1.0005, 1.0, 1.0]])
    weights = [torch.eye(3) * 1000, torch.eye(3)]
    biases = [torch.full((3,), -1000.0), torch.zeros(3)]
    output = leaky_layers(points, weights, biases, 0.01)
    torch.testing.assert_close(output[1] - output[0], torch.tensor([0.5, 0, 0]), atol=5e-3, rtol=0)


@needs_half
def test_inputs_that_are_fixed_get_no_gradient(network):
    inputs = network.layers[0].in_features - 6
    network(torch.rand(8, inputs), torch.rand(6)).sum().backward()
    assert all(value.grad is not None for value in network.parameters())


def test_double_precision_stays_double_precision():
    assert not worthwhile(torch.zeros(1, 3, dtype=torch.float64))
