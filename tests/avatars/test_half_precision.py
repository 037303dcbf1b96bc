import os
import subprocess
import sys
import types

import pytest
import torch

from deblur_avatar.avatars import half_precision
from deblur_avatar.avatars.half_precision import as_computed, leaky_layers
from deblur_avatar.avatars.networks import LEAKY_SLOPE, ConditionedMLP

pytestmark = pytest.mark.portable

HALF = torch.bfloat16
CPU = torch.device("cpu")
NATIVE_HERE = half_precision._multiplies_half()
needs_native = pytest.mark.skipif(not NATIVE_HERE, reason="no native bfloat16 products here")


@pytest.fixture(params=[*["native"] * NATIVE_HERE, "pretended", "emulated", "without oneDNN"])
def way(request, monkeypatch):
    """Every way to compute the layers; `pretended` is the native one with a stand-in for oneDNN.

    Returns types of what the stand-in was called with.
    """
    called = []
    if request.param == "pretended":

        def linear_pointwise(value, weight, bias, kind, scalars, algorithm):
            called.append((value.dtype, weight.dtype, bias.dtype))
            sums = torch.addmm(bias.float(), value.float(), weight.float().T)
            sums = torch.nn.functional.leaky_relu(sums, *scalars) if scalars else sums
            return sums.to(value.dtype)

        stand_in = types.SimpleNamespace(_linear_pointwise=linear_pointwise)
        monkeypatch.setattr(torch.ops, "mkldnn", stand_in)
    if request.param == "without oneDNN":
        monkeypatch.setattr(torch.backends.mkldnn, "is_available", lambda: False)
    native = request.param in ("native", "pretended")
    monkeypatch.setattr(half_precision, "_multiplies_half", lambda: native)
    return called


@pytest.fixture(params=[(3, [32, 32], 5), (40, [32, 32, 32], 1)], ids=["coordinates", "wide"])
def sizes(request):
    """Numbers of inputs, of each hidden layer's units, and of outputs."""
    return request.param


@pytest.fixture
def network(sizes):
    torch.manual_seed(0)
    inputs, hidden, outputs = sizes
    return ConditionedMLP(inputs, 6, hidden, outputs, "bfloat16")


def layers_of(sizes):
    """Points, weights and biases; all want gradients."""
    generator = torch.Generator().manual_seed(2)
    inputs, hidden, outputs = sizes
    widths = [inputs, *hidden, outputs]
    points = torch.rand(200, inputs, generator=generator)
    weights = [
        torch.randn(after, before, generator=generator) / before**0.5
        for before, after in zip(widths, widths[1:], strict=False)
    ]
    biases = [torch.randn(width, generator=generator) / 4 for width in widths[1:]]
    return [tensor.requires_grad_() for tensor in (points, *weights, *biases)]


def differentiated(tensors, function):
    """The output of a function of layers, and the gradients of half the square of its distance."""
    count = len(tensors) // 2
    output = function(tensors[0], tensors[1 : 1 + count], tensors[1 + count :])
    grads = torch.autograd.grad((output - 1).square().sum() / 2, tensors)
    return output.detach(), *grads


def rounded(value):
    return value.to(HALF).double()


def twin(points, weights, biases):
    """The same layers and gradients in float64, rounded where half precision rounds."""
    points, *rest = (tensor.detach().double() for tensor in (points, *weights, *biases))
    weights, biases = rest[: len(rest) // 2], rest[len(rest) // 2 :]
    narrow = points.shape[1] < half_precision.NARROW
    value, inputs = points if narrow else rounded(points), []
    for layer, (weight, bias) in enumerate(zip(weights[:-1], biases[:-1], strict=True)):
        inputs.append(rounded(value))
        exact = layer == 0 and narrow
        weight, bias = (weight, bias) if exact else (rounded(weight), rounded(bias))
        sums = value @ weight.T + bias
        value = rounded(torch.where(sums > 0, sums, LEAKY_SLOPE * sums))
    output = value @ weights[-1].T + biases[-1]
    inputs.append(value)
    back = rounded(output - 1)
    weight_grads, bias_grads = [], []
    for layer in reversed(range(len(weights))):
        weight_grads.insert(0, rounded(back.T @ inputs[layer]))
        bias_grads.insert(0, rounded(back.sum(0)))
        back = rounded(back @ rounded(weights[layer]))
        if layer > 0:
            slopes = torch.where(inputs[layer] > 0, 1.0, LEAKY_SLOPE).double()
            back = rounded(back * slopes)
    return output, back, *weight_grads, *bias_grads


def test_every_way_agrees_with_exact_sums_rounded_at_the_same_places(way, sizes):
    tensors = layers_of(sizes)
    found = differentiated(tensors, lambda *layers: leaky_layers(*layers, LEAKY_SLOPE))
    count = len(tensors) // 2
    wanted = twin(tensors[0], tensors[1 : 1 + count], tensors[1 + count :])
    for index, (one, other) in enumerate(zip(found, wanted, strict=True)):
        assert one.dtype == torch.float32
        # Sums in another order are rounded to the other neighbour now and then.
        assert (one - other).norm() < 2e-3 * other.norm(), index
        if index > 0:  # all but the output are bfloat16 numbers
            assert torch.equal(one, one.to(HALF).float()), index
            assert (one == other).double().mean() > 0.9, index


def test_native_products_get_what_they_can_multiply(way, sizes):
    leaky_layers(*split(layers_of(sizes)), LEAKY_SLOPE)
    narrow = sizes[0] < half_precision.NARROW
    hidden = [(HALF,) * 3] * len(sizes[1])
    if narrow:
        hidden[0] = (torch.float32,) * 3
    assert way in ([], [*hidden, (torch.float32,) * 3])


def split(tensors):
    count = len(tensors) // 2
    return tensors[0], tensors[1 : 1 + count], tensors[1 + count :]


@needs_native
def test_emulated_products_are_the_native_ones(sizes, monkeypatch):
    tensors = layers_of(sizes)
    native = differentiated(tensors, lambda *layers: leaky_layers(*layers, LEAKY_SLOPE))
    monkeypatch.setattr(half_precision, "_multiplies_half", lambda: False)
    emulated = differentiated(tensors, lambda *layers: leaky_layers(*layers, LEAKY_SLOPE))
    for index, (one, other) in enumerate(zip(native, emulated, strict=True)):
        assert (one - other).norm() < 2e-3 * other.norm(), index


def with_gradients(network):
    """Outputs and all gradients."""
    torch.manual_seed(1)
    inputs = network.layers[0].in_features - 6
    points, condition = torch.rand(200, inputs), torch.rand(6)
    points.requires_grad_()
    condition.requires_grad_()
    network.zero_grad()
    output = network(points, condition)
    (output - 1).square().sum().backward()
    found = {name: value.grad.clone() for name, value in network.named_parameters()}
    return {"output": output.detach(), "points": points.grad, "condition": condition.grad} | found


def test_half_precision_changes_outputs_little_and_keeps_gradients_directions(way, network, sizes):
    inputs, hidden, outputs = sizes
    plain = ConditionedMLP(inputs, 6, hidden, outputs, "float32")
    plain.load_state_dict(network.state_dict())
    half, full = with_gradients(network), with_gradients(plain)
    for name, wanted in full.items():
        assert half[name].dtype == torch.float32
        assert not torch.equal(half[name], wanted), name
        if name == "output":
            assert (half[name] - wanted).norm() / wanted.norm() < 0.01
        alike = torch.nn.functional.cosine_similarity(half[name].flatten(), wanted.flatten(), dim=0)
        assert alike > 0.99, name


def test_half_precision_gives_the_same_bits_twice(way, network):
    first, second = with_gradients(network), with_gradients(network)
    assert all(torch.equal(first[name], second[name]) for name in first)


def test_coordinates_keep_all_their_digits(way):
    # Two points half a millimetre apart, which one metre in bfloat16 cannot tell from each other.
    points = torch.tensor([[1.0, 1.0, 1.0], [1.0005, 1.0, 1.0]])
    weights = [torch.eye(3) * 1000, torch.eye(3)]
    biases = [torch.full((3,), -1000.0), torch.zeros(3)]
    output = leaky_layers(points, weights, biases, 0.01)
    torch.testing.assert_close(output[1] - output[0], torch.tensor([0.5, 0, 0]), atol=5e-3, rtol=0)


def test_inputs_that_are_fixed_get_no_gradient(way, network):
    inputs = network.layers[0].in_features - 6
    network(torch.rand(8, inputs), torch.rand(6)).sum().backward()
    assert all(value.grad is not None for value in network.parameters())


def test_double_precision_stays_double_precision(way, network, sizes):
    inputs, hidden, outputs = sizes
    plain = ConditionedMLP(inputs, 6, hidden, outputs, "float32").double()
    plain.load_state_dict(network.double().state_dict())
    points, condition = torch.rand(5, inputs).double(), torch.rand(6).double()
    assert torch.equal(network(points, condition), plain(points, condition))


@pytest.mark.parametrize(
    ("able", "used", "native"),
    [
        ({"avx2": True, "avx512_bf16": True}, "AVX512", True),  # Zen 4 and 5
        ({"avx2": True, "amx_bf16": True}, "AVX512", True),
        ({"avx2": True, "avx512_f": True}, "AVX512", False),  # Skylake
        ({"avx2": True, "avx512_bf16": False}, "AVX2", False),  # Zen 2 and 3
        ({"avx2": True, "avx512_bf16": True}, "AVX2", False),  # held back by ATEN_CPU_CAPABILITY
        ({}, "DEFAULT", False),
    ],
)
def test_bfloat16_is_native_where_the_processor_has_it_and_torch_may_use_it(
    able, used, native, monkeypatch
):
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: able)
    monkeypatch.setattr(torch.backends.cpu, "get_cpu_capability", lambda: used)
    assert half_precision._multiplies_half.__wrapped__() == native
    monkeypatch.setattr(half_precision, "_multiplies_half", lambda: native)
    way = "native" if native else "emulated"
    assert as_computed("bfloat16", CPU) == {"precision": f"bfloat16, {way}", "cpu": used}
    for precision in ("float32", None):
        assert as_computed(precision, CPU) == {"precision": "float32", "cpu": used}
    assert as_computed("bfloat16", torch.device("cuda"))["precision"] == "bfloat16, emulated"


def test_torch_held_back_to_older_instructions_emulates_and_says_so():
    code = (
        "import torch; from deblur_avatar.avatars.half_precision import as_computed;"
        "print(*as_computed('bfloat16', torch.device('cpu')).values(), sep='; ')"
    )
    environment = os.environ | {"ATEN_CPU_CAPABILITY": "default"}
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout == "bfloat16, emulated; DEFAULT\n"
