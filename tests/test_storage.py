import dataclasses
import json
from pathlib import Path
from typing import ClassVar

import pytest
import torch
from jaxtyping import Float32, UInt8
from torch import Tensor

from deblur_avatar.artifacts import Reference
from deblur_avatar.errors import ArtifactError
from deblur_avatar.storage import Artifact


@dataclasses.dataclass(frozen=True, kw_only=True)
class Inner(Artifact):
    """A nested artifact."""

    schema: ClassVar[str] = "inner/1"

    values: Float32[Tensor, " N"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Example(Artifact):
    """One field of every kind."""

    schema: ClassVar[str] = "example/1"

    frames: UInt8[Tensor, "F H W 3"]
    mattes: UInt8[Tensor, "F H W"] | None
    times: Float32[Tensor, " F"]
    inner: Inner
    extra: dict[str, Tensor]
    name: str
    numbers: tuple[int, ...]
    share: float | None


def example(**changes):
    values = {
        "frames": torch.arange(2 * 3 * 4 * 3, dtype=torch.uint8).reshape(2, 3, 4, 3),
        "mattes": torch.arange(2 * 3 * 4, dtype=torch.uint8).reshape(2, 3, 4),
        "times": torch.tensor([0.5, 1.5]),
        "inner": Inner(values=torch.arange(3.0)),
        "extra": {"a": torch.ones(2), "b.c": torch.zeros(1, dtype=torch.int64)},
        "name": "walk",
        "numbers": (1, 2),
        "share": 0.25,
    }
    return Example(**{**values, **changes})


def contents(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_what_is_saved_is_what_is_loaded(tmp_path):
    saved = example()
    saved.save(tmp_path / "x")
    loaded = Example.load(tmp_path / "x")
    assert torch.equal(loaded.frames, saved.frames)
    assert torch.equal(loaded.mattes, saved.mattes)
    assert torch.equal(loaded.inner.values, saved.inner.values)
    assert {k: v.tolist() for k, v in loaded.extra.items()} == {"a": [1, 1], "b.c": [0]}
    assert (loaded.name, loaded.numbers, loaded.share) == ("walk", (1, 2), 0.25)


def test_fields_that_are_none_stay_none(tmp_path):
    example(mattes=None, share=None).save(tmp_path / "x")
    loaded = Example.load(tmp_path / "x")
    assert loaded.mattes is None
    assert loaded.share is None


def test_equal_content_is_equal_bytes(tmp_path):
    example().save(tmp_path / "a")
    example().save(tmp_path / "b")
    assert contents(tmp_path / "a") == contents(tmp_path / "b")


def test_saving_again_replaces_the_whole_folder(tmp_path):
    example().save(tmp_path / "x")
    (tmp_path / "x" / "frames" / "000099.png").write_bytes(b"left over")
    example().save(tmp_path / "x")
    assert Example.load(tmp_path / "x").frames.shape == (2, 3, 4, 3)
    assert [p.name for p in tmp_path.iterdir()] == ["x"]


def test_a_failed_save_leaves_the_old_artifact_whole(tmp_path, monkeypatch):
    example(name="old").save(tmp_path / "x")

    def full(*arguments, **options):
        raise OSError("No space left on device")

    monkeypatch.setattr("deblur_avatar.storage.save_file", full)
    with pytest.raises(ArtifactError, match="cannot write example/1.*No space left"):
        example(name="new").save(tmp_path / "x")
    assert Example.load(tmp_path / "x").name == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["x"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"times": torch.zeros(3)}, "times must be"),
        ({"times": torch.tensor([0.0, float("nan")])}, "times holds values that are not finite"),
        ({"times": torch.zeros(2).double()}, "times must be"),
        ({"mattes": torch.zeros(2, 3, 5, dtype=torch.uint8)}, "mattes must be"),
        ({"name": 3}, "name must be"),
        ({"share": "much"}, "share must be"),
        ({"inner": None}, "inner is missing"),
        ({"extra": {"a": torch.tensor([float("inf")])}}, "extra.a holds values"),
    ],
)
def test_an_artifact_cannot_be_built_wrong(changes, message):
    with pytest.raises(ArtifactError, match=message):
        example(**changes)


def test_a_missing_artifact_says_how_to_get_it(tmp_path):
    with pytest.raises(ArtifactError, match=r"no example/1 in .*run `dvc repro` or `dvc pull`"):
        Example.load(tmp_path / "nothing")


def damage_manifest(folder):
    (folder / "manifest.json").write_text("{")


def damage_schema(folder):
    manifest = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps(manifest | {"schema": "example/0"}))


def damage_tensors(folder):
    (folder / "tensors.safetensors").write_bytes(b"\x00" * 20)


def lose_a_tensor_file(folder):
    (folder / "tensors.safetensors").unlink()


def lose_an_image(folder):
    (folder / "frames" / "000001.png").unlink()


def damage_an_image(folder):
    (folder / "frames" / "000001.png").write_bytes(b"not a picture")


def damage_a_nested_one(folder):
    (folder / "inner" / "manifest.json").unlink()


def forget_a_field(folder):
    manifest = json.loads((folder / "manifest.json").read_text())
    del manifest["name"]
    (folder / "manifest.json").write_text(json.dumps(manifest))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (damage_manifest, "manifest.json is damaged"),
        (damage_schema, "holds example/0, wanted example/1"),
        (damage_tensors, "tensors.safetensors"),
        (lose_a_tensor_file, "tensors.safetensors"),
        (lose_an_image, "frames: wanted 2 images, found 1"),
        (damage_an_image, "000001.png is not an image"),
        (damage_a_nested_one, "no inner/1"),
        (forget_a_field, "name is missing"),
    ],
)
def test_a_damaged_artifact_is_refused_by_name(tmp_path, damage, message):
    example().save(tmp_path / "x")
    damage(tmp_path / "x")
    with pytest.raises(ArtifactError, match=message):
        Example.load(tmp_path / "x")


def test_an_empty_stack_of_images_comes_back_empty(tmp_path):
    reference = Reference(
        images=torch.zeros(0, 4, 6, 3, dtype=torch.uint8),
        mattes=torch.zeros(0, 4, 6, dtype=torch.uint8),
        seen=None,
        camera_indices=torch.zeros(0, dtype=torch.long),
        frame_indices=torch.zeros(0, dtype=torch.long),
        novel_pose=torch.zeros(0, dtype=torch.long),
        background=(0.0, 0.0, 0.0),
        motion_times=None,
        motion=None,
    )
    reference.save(tmp_path / "x")
    assert Reference.load(tmp_path / "x").images.shape == (0, 4, 6, 3)
