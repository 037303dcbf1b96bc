import io
import pickle
import struct
import zipfile
from collections import OrderedDict

import pytest
import torch
from torch import nn

from deblur_avatar.errors import ArtifactError
from deblur_avatar.readers import weights_files
from deblur_avatar.readers.weights_files import load_pth

FORMS = pytest.mark.parametrize("zipped", [True, False], ids=["zip", "sequence"])
KINDS = (
    torch.float16, torch.bfloat16, torch.float32, torch.float64,
    torch.uint8, torch.int8, torch.int16, torch.int32, torch.int64,
)  # fmt: skip


def save(path, content, zipped=True):
    torch.save(content, path, _use_new_zipfile_serialization=zipped)
    return path


def tensors():
    """Of every kind and layout that a saved network may hold."""
    torch.manual_seed(0)
    table = torch.rand(4, 6)
    found = {f"kind.{kind}": (100 * torch.rand(2, 3)).to(kind) for kind in KINDS}
    return found | {
        "transposed": table.t(), "part": table[1:3, ::2], "one": torch.tensor(0.5),
        "column": torch.rand(5, 1, 1, 1)[:, 0], "parameter": nn.Parameter(torch.rand(3)),
    }  # fmt: skip


@FORMS
def test_tensors_are_those_that_torch_reads_bit_for_bit(tmp_path, zipped):
    path = save(tmp_path / "a.pth", tensors(), zipped)
    expected = torch.load(path, weights_only=True)
    found = load_pth(path, expected.keys())
    assert found.keys() == expected.keys()
    for name, tensor in found.items():
        assert tensor.dtype == expected[name].dtype
        assert tensor.shape == expected[name].shape
        assert torch.equal(bits(tensor), bits(expected[name].detach()))


def bits(tensor):
    return tensor.clone(memory_format=torch.contiguous_format).flatten().view(torch.uint8)


@FORMS
def test_a_networks_own_state_is_read(tmp_path, zipped):
    network = nn.Sequential(nn.Conv2d(2, 3, 3), nn.BatchNorm2d(3))
    state = network.state_dict()
    found = load_pth(save(tmp_path / "a.pth", state, zipped), list(state))
    assert all(torch.equal(found[name], state[name]) for name in state)


@FORMS
def test_only_what_is_wanted_is_read(tmp_path, zipped, monkeypatch):
    content = {"large": torch.zeros(100_000), "small": torch.ones(2), "more": torch.zeros(100_000)}
    path = save(tmp_path / "a.pth", content, zipped)
    monkeypatch.setattr(weights_files, "MAX_BYTES", 1000)
    assert torch.equal(load_pth(path, ["small", "absent"])["small"], torch.ones(2))
    with pytest.raises(ArtifactError, match="are wanted of it"):
        load_pth(path, ["large"])


def test_tensors_of_the_first_torch_are_read(tmp_path):
    """What torch 0.1 to 0.3 wrote: no hooks, words of Python 2, storages on the device they had."""
    values = torch.arange(6.0)
    words = {
        "MAGIC": pickle.dumps(weights_files.MAGIC, 2), "VERSION": pickle.dumps(1001, 2),
        "SYSTEM": b"\x80\x02}q\x00(U\rlittle_endianq\x01\x88U\ntype_sizesq\x02}q\x03u.",
        "CONTENT": (
            b"\x80\x02ccollections\nOrderedDict\n)R(U\x01actorch._utils\n_rebuild_tensor\n"
            b"((U\x07storagectorch.cuda\nFloatStorage\nU\x0294U\x06cuda:0K\x06NtQK\x01K\x02K\x02\x86"
            b"K\x02K\x01\x86tRu."
        ),
        "KEYS": b"\x80\x02]U\x0294a.",
    }  # fmt: skip
    path = tmp_path / "a.pth"
    path.write_bytes(b"".join(words.values()) + struct.pack("<q", 6) + values.numpy().tobytes())
    assert torch.equal(load_pth(path, ["a"])["a"], torch.tensor([[1.0, 2.0], [3.0, 4.0]]))
    assert torch.equal(torch.load(path, map_location="cpu")["a"], load_pth(path, ["a"])["a"])


@FORMS
@pytest.mark.parametrize(
    ("content", "message"),
    [
        ([torch.ones(2)], "holds list, not weights"),
        ({"a": torch.ones(2), "b": 1}, "holds dict, not weights"),
        ({"a": torch.tensor([1.0, float("nan")])}, "a holds values that are not finite"),
        ({"a": torch.ones(1).expand(1000, 1000)}, "a tensor does not fit into its storage"),
        ({"a": print}, "wants to run .*print"),
    ],
)
def test_what_is_no_weights_is_refused(tmp_path, zipped, content, message):
    path = save(tmp_path / "a.pth", content, zipped)
    with pytest.raises(ArtifactError, match=message):
        load_pth(path, ["a"])


def test_a_missing_foreign_or_damaged_file_is_one_clear_error(tmp_path):
    with pytest.raises(ArtifactError, match=r"cannot read .*absent\.pth: No such file"):
        load_pth(tmp_path / "absent.pth", ["a"])
    for zipped in (True, False):
        whole = save(tmp_path / "whole.pth", {"a": torch.rand(9)}, zipped).read_bytes()
        for length in (0, 1, 3, 4, len(whole) // 2, len(whole) - 1):
            (tmp_path / "cut.pth").write_bytes(whole[:length])
            with pytest.raises(ArtifactError, match=r"cut\.pth is not a readable \.pth file"):
                load_pth(tmp_path / "cut.pth", ["a"])
    (tmp_path / "cut.pth").write_bytes(whole[:-1])
    size = len(whole)
    with pytest.raises(ArtifactError, match=f"it ends after {size - 1} bytes of {size}"):
        load_pth(tmp_path / "cut.pth", ["a"])
    place = size - 4 * 9 - 8
    (tmp_path / "count.pth").write_bytes(whole[:place] + struct.pack("<q", 8) + whole[place + 8 :])
    with pytest.raises(ArtifactError, match="a storage has 8 numbers, 9 are wanted"):
        load_pth(tmp_path / "count.pth", ["a"])
    (tmp_path / "other.pth").write_bytes(pickle.dumps({"a": 1}))
    with pytest.raises(ArtifactError, match="neither a zip archive nor of torch's older form"):
        load_pth(tmp_path / "other.pth", ["a"])


def archive(path, members):
    """A zip archive as torch writes it, of any content."""
    with zipfile.ZipFile(path, "w") as file:
        for name, content in members.items():
            file.writestr(f"a/{name}", content)
    return path


@pytest.mark.parametrize(
    ("structure", "message"),
    [
        # A tuple in a tuple, a million deep, as a key: torch ends the process.
        (b"\x80\x04})" + b"\x85" * 1_000_000 + b"K\x01s.", "nested over 60 levels"),
        (b"\x80\x02}r\xff\xff\xff\x7f.", "an object is numbered 2147483647"),
        (b"cos\nsystem\n(S'true'\ntR.", r"wants to run os\.system"),
        (b"Pkey\n.", "wants to run a persistent object 'key'"),
        (b"\x80\x02}X\x01\x00\x00\x00aNs.", "holds dict, not weights"),
        (b"\x80\x02" + b"0" * 5_000_000, "claims 5000002 bytes"),
    ],
)
def test_a_structure_that_would_do_harm_is_refused(tmp_path, structure, message):
    path = archive(tmp_path / "a.pth", {"data.pkl": structure})
    with pytest.raises(ArtifactError, match=message):
        load_pth(path, ["a"])


@pytest.mark.parametrize(
    ("layout", "message"),
    [
        ((0, (3,), (1,)), "does not fit into its storage"),
        ((1, (2,), (1,)), "out of bounds"),
        ((0, (2,), (9,)), "out of bounds"),
        ((0, (-1,), (1,)), "does not fit into its storage"),
        ((0, (2**63,), (1,)), "does not fit into its storage"),
        ((0, (1,) * 1000, (1,) * 1000), "does not fit into its storage"),
        ((0, ("2",), (1,)), "does not fit into its storage"),
        ((0, 2, 1), "TypeError"),
    ],
)
def test_a_tensor_stays_within_its_storage(tmp_path, layout, message):
    path = archive(tmp_path / "a.pth", {"data.pkl": claim(*layout), "data/0": b"\0" * 8})
    with pytest.raises(ArtifactError, match=message):
        load_pth(path, ["a"])


def test_a_storage_has_as_many_bytes_as_it_claims(tmp_path):
    members = {"data.pkl": claim(0, (2,), (1,)), "data/0": b"\0" * 9}
    with pytest.raises(ArtifactError, match="data/0 claims 9 bytes; at most 8"):
        load_pth(archive(tmp_path / "long.pth", members), ["a"])
    with pytest.raises(ArtifactError, match="is not a readable"):
        load_pth(archive(tmp_path / "short.pth", members | {"data/0": b"\0" * 7}), ["a"])
    # A few bytes could unfold to any size; torch compresses nothing.
    packed = archive(tmp_path / "packed.pth", {"data.pkl": members["data.pkl"]})
    with zipfile.ZipFile(packed, "a", zipfile.ZIP_DEFLATED) as file:
        file.writestr("a/data/0", b"\0" * 8)
    with pytest.raises(ArtifactError, match="data/0 claims 8 bytes"):
        load_pth(packed, ["a"])
    with pytest.raises(ArtifactError, match="the other order of bytes"):
        load_pth(archive(tmp_path / "big.pth", members | {"byteorder": b"big"}), ["a"])


def claim(offset, size, stride):
    """A pickle of one tensor, laid out so in a storage of two numbers."""

    class Storage:
        pass

    class Tensor:
        def __reduce__(self):
            return torch._utils._rebuild_tensor_v2, (
                Storage(), offset, size, stride, False, OrderedDict(),
            )  # fmt: skip

    class Pickler(pickle.Pickler):
        def persistent_id(self, value):
            if isinstance(value, Storage):
                return "storage", torch.FloatStorage, "0", "cpu", 2
            return None

    stream = io.BytesIO()
    Pickler(stream, 2).dump({"a": Tensor()})
    return stream.getvalue()
