import json

import pytest
import torch
from safetensors.torch import save_file

from deblur_avatar.errors import ArtifactError
from deblur_avatar.imaging.dstnet import Dstnet, DstnetParams
from deblur_avatar.imaging.dstnet_weights import DstnetWeights, load_dstnet

SMALL = DstnetParams(features=4, blocks=1, refinements=1)


def weights(**changes: object) -> DstnetWeights:
    torch.manual_seed(0)
    tensors = Dstnet(SMALL).state_dict()
    fields = {"recipe": "{}", "clips": "0" * 64, "tensors": tensors, **SMALL.model_dump()}
    return DstnetWeights(**fields | changes)


@pytest.fixture
def folder(tmp_path):
    weights().save(tmp_path / "weights")
    return tmp_path / "weights"


def rewrite(folder, **changes: object) -> None:
    manifest = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps(manifest | changes))


def test_a_network_comes_back_as_it_was_saved(folder):
    network = load_dstnet(folder, "here")
    wanted = weights().tensors
    assert network.state_dict().keys() == wanted.keys()
    assert all(torch.equal(value, wanted[name]) for name, value in network.state_dict().items())
    assert not network.training
    assert not any(parameter.requires_grad for parameter in network.parameters())


def test_equal_weights_are_equal_bytes(folder, tmp_path):
    weights().save(tmp_path / "again")
    for name in ("manifest.json", "tensors.safetensors"):
        assert (folder / name).read_bytes() == (tmp_path / "again" / name).read_bytes()


def test_a_folder_without_weights_is_one_clear_line(tmp_path):
    with pytest.raises(ArtifactError, match=r"^here: no weights of this network: .*experiments/"):
        load_dstnet(tmp_path, "here")


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"schema": "avatar/1"}, "wanted dstnet/1"),
        ({"features": 5}, "wanted torch.float32"),
        ({"blocks": 2}, "without 'aggregate.1"),
        ({"features": 10**12}, "features is 1000000000000, wanted 1 to 256"),
        ({"refinements": 0}, "refinements is 0"),
        ({"tensors": ["leave.bias"]}, "without 'against_time"),
    ],
)
def test_weights_that_are_not_what_they_say_are_refused(folder, changes, complaint):
    rewrite(folder, **changes)
    with pytest.raises(ArtifactError, match=complaint):
        load_dstnet(folder, "here")


def test_numbers_of_another_network_are_refused(folder):
    tensors = {f"tensors.{name}": value for name, value in weights().tensors.items()}
    tensors["tensors.more"] = torch.zeros(1)
    save_file(tensors, folder / "tensors.safetensors")
    rewrite(folder, tensors=sorted(name.removeprefix("tensors.") for name in tensors))
    with pytest.raises(ArtifactError, match="must not have 'more'"):
        load_dstnet(folder, "here")


def test_numbers_that_are_none_are_refused(folder):
    tensors = {f"tensors.{name}": value for name, value in weights().tensors.items()}
    tensors["tensors.leave.bias"] = torch.full((4,), float("nan"))
    save_file(tensors, folder / "tensors.safetensors")
    with pytest.raises(ArtifactError, match="leave.bias holds values that are not finite"):
        load_dstnet(folder, "here")


@pytest.mark.parametrize("content", [b"", b"\x80\x04cos\nsystem\n.", b"PK\x03\x04" + b"\0" * 64])
def test_a_pickle_in_their_place_is_refused_unread(folder, content):
    (folder / "tensors.safetensors").write_bytes(content)
    with pytest.raises(ArtifactError, match="here: no weights of this network"):
        load_dstnet(folder, "here")
