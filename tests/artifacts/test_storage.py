import dataclasses
import json
from pathlib import Path
from typing import ClassVar

import pytest
import torch
from jaxtyping import Float32, UInt8
from safetensors.torch import load_file, save_file
from torch import Tensor

from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.reference import Reference
from deblur_avatar.artifacts.storage import Artifact
from deblur_avatar.errors import ArtifactError


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


def test_what_a_killed_process_left_is_gone_with_the_next_save(tmp_path, monkeypatch):
    def killed(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr("deblur_avatar.artifacts.storage.save_file", killed)
    monkeypatch.setattr("shutil.rmtree", lambda *arguments, **options: None)
    with pytest.raises(KeyboardInterrupt):
        example().save(tmp_path / "x")
    monkeypatch.undo()
    assert [p.name for p in tmp_path.iterdir()] != []
    example().save(tmp_path / "x")
    assert [p.name for p in tmp_path.iterdir()] == ["x"]


def test_a_failed_save_leaves_the_old_artifact_whole(tmp_path, monkeypatch):
    example(name="old").save(tmp_path / "x")

    def full(*arguments, **options):
        raise OSError("No space left on device")

    monkeypatch.setattr("deblur_avatar.artifacts.storage.save_file", full)
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


def change_manifest(**changes):
    def damage(folder):
        manifest = json.loads((folder / "manifest.json").read_text())
        (folder / "manifest.json").write_text(json.dumps(manifest | changes))

    return damage


def nest_the_manifest_deeply(folder):
    (folder / "manifest.json").write_text("[" * 100_000)


def empty_an_image(folder):
    (folder / "frames" / "000001.png").write_bytes(b"")


def put_a_folder_for_an_image(folder):
    lose_an_image(folder)
    (folder / "frames" / "000001.png").mkdir()


def claim_a_huge_image(folder):
    """A header of 40,000 x 40,000 pixels, which OpenCV would make room for."""
    path = folder / "frames" / "000001.png"
    content = bytearray(path.read_bytes())
    content[16:24] = (40_000).to_bytes(4, "big") * 2
    path.write_bytes(content)


def change_tensors(**changes):
    def damage(folder):
        path = folder / "tensors.safetensors"
        tensors = {**load_file(path), **changes}
        save_file({key: value for key, value in tensors.items() if value is not None}, path)

    return damage


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
        (nest_the_manifest_deeply, "manifest.json is damaged"),
        (change_manifest(share=float("inf")), r"share must be float \| None, got float inf"),
        (change_manifest(share=10**400), "share must be float"),
        (change_manifest(numbers=[1, "2"]), "numbers must be tuple"),
        (change_manifest(numbers=[[]]), "numbers must be tuple"),
        (change_manifest(frames={"images": []}), "the manifest's entry is damaged"),
        (change_manifest(frames={"images": [float("inf")] * 4}), "the manifest's entry is damaged"),
        (change_manifest(frames={"images": [-1, -2, 4, 3]}), "the manifest's entry is damaged"),
        (change_manifest(frames={"images": [2, 10**7, 10**7, 3]}), "entry is damaged"),
        (change_manifest(frames={"images": [2, 10**4, 10**4, 3]}), "not an image of shape"),
        (empty_an_image, "000001.png is not an image"),
        (put_a_folder_for_an_image, "000001.png is not an image"),
        (claim_a_huge_image, "000001.png is not an image"),
        (change_tensors(extra=torch.zeros(2)), "extra must be dict"),
        (
            change_tensors(**{"extra.a": torch.zeros(2).to(torch.float8_e4m3fn)}),
            "extra.a is of torch.float8_e4m3fn, which no artifact holds",
        ),
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


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"vertices": 0}, "a body has vertices and joints"),
        ({"parents": (-1, -7)}, "each after its parent"),
        ({"parents": (-1, "0")}, "parents must be tuple"),
    ],
)
def test_a_body_that_cannot_be_is_refused(changes, message):
    points = changes.get("vertices", 3)
    values = {
        "vertices": torch.zeros(points, 3),
        "shape_dirs": torch.zeros(points, 3, 1),
        "joints": torch.zeros(2, 3),
        "joint_dirs": torch.zeros(2, 3, 1),
        "pose_dirs": None,
        "parents": (-1, 0),
        "lbs_weights": torch.full((points, 2), 0.5),
        "faces": torch.zeros(0, 3, dtype=torch.long),
        "uvs": None,
        "joint_names": ("root", "end"),
        "licence": "free",
    }
    parents = {"parents": changes.get("parents", (-1, 0))}
    with pytest.raises(ArtifactError, match=message):
        Body(**{**values, **parents})
