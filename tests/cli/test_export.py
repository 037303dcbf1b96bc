import logging

import numpy as np
import pytest

from deblur_avatar.animation.amass import read_amass
from deblur_avatar.cli.main import main
from deblur_avatar.exports.live_viewer import LiveViewer
from deblur_avatar.motion.frame import FixedMotion
from tests.exports.page_header import header_of
from tests.exports.requirement import imported


def test_a_run_is_written_as_splats_and_as_motion(project, scene):
    assert main(["export", "capsules-lean", "--format", "ply", "--out", "a.ply"]) == 0
    assert (
        main(["export", "capsules-lean", "--format", "ply", "--frame", "7", "--out", "b.ply"]) == 0
    )
    header = (project / "a.ply").read_bytes().partition(b"end_header")[0].decode()
    assert f"element vertex {len(scene.avatar.means)}\n" in header
    assert (project / "a.ply").read_bytes() != (project / "b.ply").read_bytes()
    out = "exports/motion.npz"
    assert main(["export", "avatars/anna/anna-paper", "--format", "npz", "--out", out]) == 0
    assert len(read_amass(project / out).transl) == len(scene.motion.timestamps)


def test_a_run_is_written_as_a_page_with_another_beside_it(project):
    words = ["export", "capsules-lean", "--format", "page", "--pictures", "2"]
    assert main([*words, "--out", "a.html"]) == 0
    beside = ["--beside", "avatars/anna/anna-lean", "--motions", "own"]
    assert main([*words, *beside, "--out", "b.html"]) == 0
    assert "anna-lean" not in (project / "a.html").read_text()
    assert "<h1>capsules-lean | anna-lean</h1>" in (project / "b.html").read_text()


def test_sharp_frames_that_the_scene_knows_go_on_the_page(project, scene):
    words = ["export", "capsules-lean", "--format", "page", "--motions", "own", "--out", "a.html"]
    for known in (False, True):
        if known:
            scene.observations.save(project / "data/preprocess/capsules/sharp")
        assert main(words) == 0
        header = header_of((project / "a.html").read_bytes())
        assert ("truth0" in header["arrays"]) == known


def test_a_sequence_is_a_folder(project):
    words = ["export", "capsules-lean", "--format", "ply_sequence", "--out", "frames"]
    assert main(words) == 0
    assert len(list((project / "frames").iterdir())) == 8


def test_a_sequence_does_not_mix_with_what_lies_there(project, capsys):
    words = ["export", "capsules-lean", "--format", "ply_sequence", "--out", "frames"]
    jumping = ["--motion", "builtin:jumping_jacks", "--seconds", "0.5"]
    (project / "frames").mkdir()
    assert main([*words, *jumping]) == 0
    before = {file: file.read_bytes() for file in (project / "frames").iterdir()}
    assert len(before) == 16
    assert main(words) == 1  # 8 frames, and 8 of jumping would follow
    [line] = capsys.readouterr().err.splitlines()
    assert "--out frames: there are files in it, which would stand beside the new ones" in line
    assert {file: file.read_bytes() for file in (project / "frames").iterdir()} == before


def test_a_folder_with_one_run_needs_no_name(project):
    text = (project / "params.yaml").read_text()
    (project / "params.yaml").write_text(text[: text.index("  unmade")])
    assert main(["export", ".", "--format", "npz", "--out", "a.npz"]) == 0
    with np.load("a.npz") as content:
        assert "mocap_framerate" in content


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("capsules-len --format ply --out a.ply", "no run 'capsules-len' in params.yaml"),
        (
            "avatars/anna --format ply --out a.ply",
            "the runs anna-lean, anna-paper, unmade; name",
        ),
        ("avatars/bob --format ply --out a.ply", "no params.yaml in .*avatars, which should name"),
        (
            "unmade --format ply --out a.ply",
            "ArtifactError: no avatar/1 in data/fusion/unmade",
        ),
        ("capsules-lean --format ply --out a.obj", "a file of this format ends in .ply"),
        ("capsules-lean --format ply --frame 8 --out a.ply", "frame 8 of 8; frames are counted"),
        (
            "capsules-lean --format ply --frame -1 --out a.ply",
            "frame: .*greater than or equal",
        ),
        ("capsules-lean --format npz --frame 1 --out a.npz", "export: unknown key 'frame'"),
        ("capsules-lean --format page --motions fly.bvh --out a.html", "no motion file fly.bvh"),
        ("capsules-lean --format page --fps 0 --out a.html", "fps: .*greater than 0"),
        ("capsules-lean --format page --beside bob --out a.html", "no run 'bob' in params.yaml"),
        ("capsules-lean --format page --out a.htm", "a file of this format ends in .html"),
        ("capsules-lean --format ply --motions own --out a.ply", "unknown key 'motions'"),
        ("capsules-lean --format ply_sequence --out a.ply", "this format is a folder of files"),
        ("capsules-lean --format bvh --motion builtin:x --out a.bvh", "no built-in motion 'x'"),
        ("capsules-lean --format bvh --beside anna --out a.bvh", "--beside anna: only a page"),
    ],
)
def test_what_cannot_be_exported_is_one_clear_line(project, capsys, words, message):
    assert main(["export", *words.split()]) == 1
    [line] = capsys.readouterr().err.splitlines()
    with pytest.raises(AssertionError, match=message):
        raise AssertionError(line)
    assert not list(project.glob("a.*"))


@pytest.mark.parametrize("later", [0.0, 5.0])
@pytest.mark.parametrize(
    "words",
    [
        "export capsules-lean --format page --out a.html",
        "export capsules-lean --format npz --out a.npz",
        "view capsules-lean",
    ],
)
def test_frames_that_were_chosen_anew_since_the_fit_are_no_part_of_it(
    project, scene, monkeypatch, capsys, words, later
):
    monkeypatch.setattr(LiveViewer, "run", LiveViewer.stop)
    taken = slice(0, 5 if later == 0 else None)
    given = FixedMotion(scene.observations.poses.at(taken))
    times = scene.observations.timestamps[taken] + later
    given.to_artifact(scene.avatar.betas, times).save(project / "data/fusion/capsules-lean/motion")
    assert main(words.split()) == 1
    [line] = capsys.readouterr().err.splitlines()
    assert f"capsules-lean was fitted to {len(times)} frames from {later:.3f} to" in line
    assert "its scene now has 8 frames from 0.000 to" in line
    assert not list(project.glob("a.*"))


# As DVC writes it, of what matters here.
LOCK = """\
schema: '2.0'
stages:
  preprocess@capsules:
    cmd: python pipeline/stages/preprocess.py --scene capsules
    params:
      params.yaml:
        schedule: {schedule}
        seed: 0
    outs:
    - path: data/preprocess/capsules/blurred
      hash: md5
      md5: 9c7601a35dc496f58d32376971c02713.dir
    - path: data/preprocess/capsules/exact
      hash: md5
      md5: 8a831d1f1a5f2b1fdceea123ec50a2da.dir
  fusion@anna-lean:
    cmd: python pipeline/stages/fusion.py --avatar lean
    deps:
    - path: data/preprocess/capsules/blurred
      hash: md5
      md5: {fitted_to}.dir
    - path: data/trajectory/anna-lean
      hash: md5
      md5: 189e38a76b66a15e948ebf61967159ad.dir
    params:
      params.yaml:
        schedule: large
        seed: 0
"""
ANOTHER, SAME = "3f1c0f9d2e7b4a55a1d0c4b7e8f60912", "9c7601a35dc496f58d32376971c02713"
FILM = [
    "export avatars/anna/anna-lean --format page --motions own --pictures 2 --out a.html",
    "export avatars/anna/anna-lean --format npz --out a.npz",
    "view avatars/anna/anna-lean --port 0",
]


@pytest.mark.parametrize("words", FILM)
def test_another_film_of_equal_length_is_no_part_of_the_fit(project, monkeypatch, capsys, words):
    monkeypatch.setattr(LiveViewer, "run", LiveViewer.stop)
    (project / "avatars/anna/dvc.lock").write_text(LOCK.format(schedule="large", fitted_to=ANOTHER))
    assert main(words.split()) == 1
    [line] = capsys.readouterr().err.splitlines()
    assert "anna-lean was fitted to other frames than its scene has now" in line
    assert not list(project.glob("a.*"))


def test_a_lock_of_many_runs_is_read_too(project, capsys):
    others = "".join(f"  clip@{n}:\n    cmd: {'x' * 1000}\n" for n in range(300))
    lock = LOCK.format(schedule="large", fitted_to=ANOTHER)
    (project / "avatars/anna/dvc.lock").write_text(lock + others)
    assert main(FILM[0].split()) == 1
    assert "fitted to other frames" in capsys.readouterr().err


@pytest.mark.parametrize(
    "lock",
    [
        LOCK.format(schedule="large", fitted_to=SAME),
        LOCK.format(schedule="short", fitted_to=ANOTHER),  # the same film, at another size
        LOCK.format(schedule="large", fitted_to=ANOTHER).replace("fusion@", "trajectory@"),
        LOCK.format(schedule="large", fitted_to=ANOTHER).replace("preprocess@", "clip@"),
        LOCK.format(schedule="large", fitted_to=ANOTHER).replace("    outs:", "    outs"),
        "stages:",
    ],
    ids=["the same", "another schedule", "not fitted", "not prepared", "damaged", "empty"],
)
def test_frames_of_which_the_lock_says_nothing_else_are_shown(project, lock):
    (project / "avatars/anna/dvc.lock").write_text(lock)
    assert main(FILM[1].split()) == 0


def test_an_avatar_is_shown_live_on_this_machine_alone(project, monkeypatch, caplog):
    imported("viser")
    monkeypatch.setattr(LiveViewer, "run", LiveViewer.stop)
    with caplog.at_level(logging.INFO):
        assert main(["view", "capsules-lean", "--port", "0"]) == 0
    assert "http://127.0.0.1:" in caplog.text


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("view bob", "no run 'bob' in params.yaml"),
        ("view unmade", "ArtifactError: no avatar/1 in data/fusion/unmade"),
        ("view capsules-lean --motions fly.bvh", "no motion file fly.bvh"),
    ],
)
def test_what_cannot_be_shown_live_is_one_clear_line(project, capsys, words, message):
    assert main(words.split()) == 1
    [line] = capsys.readouterr().err.splitlines()
    assert message in line
