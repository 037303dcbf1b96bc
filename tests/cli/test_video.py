import dataclasses
import errno
import json
import logging
import os
import shutil
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from deblur_avatar.cli import running_dvc
from deblur_avatar.cli import video as command
from deblur_avatar.cli.avatar_params import name_of, prepare
from deblur_avatar.cli.main import main
from deblur_avatar.config.reading import load_params
from deblur_avatar.errors import ArtifactError, ConfigError
from deblur_avatar.evaluation.findings import Scale, judged
from deblur_avatar.files import write_json
from deblur_avatar.pipeline.clip import ClipParams
from deblur_avatar.sources.monocular import MonocularParams
from deblur_avatar.training.resume import Snapshot
from tests.process_state import ended_here
from tests.sources.small_videos import picture, write_video

ROOT = Path(__file__).parents[2]


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A checkout with nothing but the two files that an avatar's folder is made from."""
    for name in ("params.yaml", "dvc.yaml"):
        shutil.copy(ROOT / name, tmp_path / name)
    (tmp_path / "stages").mkdir()
    return tmp_path


@pytest.fixture
def video(root: Path) -> Path:
    return write_video(root / "My Clip 2.mp4", [picture(index) for index in range(3)])


def content(path: Path) -> dict:
    return YAML(typ="safe", pure=True).load(path)


def test_a_video_gets_a_folder_that_can_be_run(root: Path, video: Path):
    folder = prepare(video, name_of(video), "lean", "medium", root).folder
    assert folder == root / "avatars" / "my_clip_2"
    clip = load_params(folder / "params.yaml", "scenes.my_clip_2.clip", ClipParams)
    assert isinstance(clip, MonocularParams)
    assert Path(clip.path) == video
    assert (folder / "dvc.yaml").read_bytes() == (root / "dvc.yaml").read_bytes()
    places = content(folder / "params.yaml")["from"]
    assert (folder / places["root"]).resolve() == root
    assert (folder / places["bodies"]).resolve() == root / "data/body"  # the root's is used
    assert (folder / places["footage"]).resolve() == folder / "data"
    assert content(folder / "params.yaml")["bodies"] == {}


def test_a_section_of_its_own_is_taken_from_the_avatars_file(root: Path, video: Path):
    path = prepare(video, "anna", "lean", "medium", root).folder / "params.yaml"
    path.write_text(path.read_text() + "check: {on_failure: stop}\n")
    prepare(video, "anna", "lean", "medium", root)
    assert content(path)["from"]["check"] == "params.yaml"
    assert content(path)["from"]["avatars"] == "../../params.yaml"


def test_what_the_user_changed_stays(root: Path, video: Path):
    folder = prepare(video, "anna", "lean", "medium", root).folder
    path = folder / "params.yaml"
    path.write_text(path.read_text().replace("field_of_view: 60.0", "field_of_view: 75.0"))
    prepare(video, "anna", "agnostic", "medium", root)
    changed = content(path)
    assert changed["scenes"]["anna"]["clip"]["field_of_view"] == 75.0
    assert set(changed["runs"]) == {"anna-lean", "anna-agnostic"}
    assert changed["runs"]["anna-lean"]["avatar"] == "one_sided"
    assert changed["runs"]["anna-agnostic"]["avatar"] == "paper"
    assert set(changed["animations"]) == {"anna-lean", "anna-agnostic"}
    assert "avatar.html" in changed["exports"]["anna-lean"]["files"]
    assert set(changed["exports"]["anna-agnostic"]["files"]) == {
        "rig.glb", "pose.ply", "motion.bvh", "motion.npz",
    }  # fmt: skip


def test_where_there_is_no_recipe_for_videos_the_methods_own_is_taken(root: Path, video: Path):
    shared = root / "params.yaml"
    shared.write_text(shared.read_text().replace("\n  one_sided:", "\n  another:"))
    path = prepare(video, "anna", "lean", "medium", root).folder / "params.yaml"
    assert content(path)["runs"]["anna-lean"]["avatar"] == "lean"


def test_an_older_folder_keeps_its_recipe(root: Path, video: Path):
    path = prepare(video, "anna", "lean", "medium", root).folder / "params.yaml"
    older = path.read_text().replace("one_sided", "lean")
    path.write_text(older)
    prepare(video, "anna", "lean", "medium", root)
    assert path.read_text() == older


def test_an_older_animation_stays_on_black_and_a_new_one_is_on_grey(root: Path, video: Path):
    path = prepare(video, "anna", "lean", "medium", root).folder / "params.yaml"
    assert content(path)["animations"]["anna-lean"]["backdrop"] == 0.5
    path.write_text(path.read_text().replace("    backdrop: 0.5\n", ""))
    prepare(video, "anna", "paper", "medium", root)
    shown = {name: section["backdrop"] for name, section in content(path)["animations"].items()}
    assert shown == {"anna-lean": 0.0, "anna-paper": 0.5}


def test_what_the_user_noted_stays(root: Path, video: Path):
    path = prepare(video, "anna", "lean", "medium", root).folder / "params.yaml"
    noted = path.read_text().replace("shutter: 0.5", "shutter: 0.25  # a phone, by daylight")
    noted = f"# of the garden\n{noted}\n# look at the masks again\n"
    path.write_text(noted)
    prepare(video, "anna", "lean", "medium", root)
    assert path.read_text() == noted
    prepare(video, "anna", "paper", "large", root)
    lines = path.read_text().splitlines()
    assert {"# of the garden", "# look at the masks again"} <= set(lines)
    assert "      shutter: 0.25  # a phone, by daylight" in lines
    assert content(path)["schedule"] == "large"
    assert set(content(path)["runs"]) == {"anna-lean", "anna-paper"}


def test_a_full_disk_leaves_an_avatars_file_as_it_was(root: Path, video: Path, monkeypatch):
    path = prepare(video, "anna", "lean", "medium", root).folder / "params.yaml"
    before = path.read_text()

    def half(file, written):
        with file.open("wb") as begun:
            begun.write(written[: len(written) // 2])
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", half)
    with pytest.raises(ArtifactError, match=r"cannot write .*anna/params\.yaml: .*No space left"):
        prepare(video, "anna", "paper", "medium", root)
    assert path.read_text() == before


def test_a_schedule_that_the_user_wrote_stays_until_another_is_asked_for(root: Path, video: Path):
    path = prepare(video, "anna", "lean", None, root).folder / "params.yaml"
    assert content(path)["schedule"] == "large"
    path.write_text(path.read_text().replace("schedule: large", "schedule: huge"))
    prepare(video, "anna", "lean", None, root)
    assert content(path)["schedule"] == "huge"
    prepare(video, "anna", "lean", "medium", root)
    assert content(path)["schedule"] == "medium"


def test_one_name_is_one_video(root: Path, video: Path):
    prepare(video, "anna", "lean", "medium", root)
    other = write_video(root / "b.mp4", [picture(index) for index in range(3)])
    with pytest.raises(ConfigError, match="choose another --name"):
        prepare(other, "anna", "lean", "medium", root)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: [", "is not YAML"),
        ("\0", "is not YAML"),
        ("", "the file has no key 'scenes', it has no keys"),
        ("a: &a {b: *a}", "the file has no key 'scenes', it has a"),
        ("scenes: {anna: 1}", "scenes.anna has no key 'clip'"),
        ("scenes: {anna: {clip: {path: [1]}}}", r"scenes\.anna\.clip\.path: .*valid string"),
        ('scenes: {anna: {clip: {path: "\\0"}}}\n%s', "choose another --name"),
        ('scenes: {anna: {clip: {path: "\\ud800"}}}\n%s', "choose another --name"),
        ("scenes: {anna: {clip: {path: x}}}\nruns: {}", "the file has no key 'warmups', it has"),
        ("scenes: {anna: {clip: {path: x}}}\nwarmups: {}\nruns: 5", "runs: .*valid dictionary"),
    ],
)
def test_a_damaged_file_of_an_avatar_is_named_and_stays(root, video, text, message):
    text = text.replace("%s", "warmups: {}\nruns: {}\nanimations: {}")
    path = root / "avatars/anna/params.yaml"
    path.parent.mkdir(parents=True)
    path.write_text(text)
    with pytest.raises(ConfigError, match=f"avatars/anna/params.yaml.*{message}"):
        prepare(video, "anna", "lean", "medium", root)
    assert path.read_text() == text


@pytest.mark.parametrize("section", ["methods", "schedules", "avatars"])
def test_a_repositorys_damaged_parameters_are_named(root, video, section):
    parameters = content(root / "params.yaml")
    with (root / "params.yaml").open("w") as file:
        YAML().dump(parameters | {section: None}, file)
    with pytest.raises(ConfigError, match=rf"params\.yaml: {section}: .*valid dictionary"):
        prepare(video, "anna", "lean", "medium", root)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"method": "magic"}, "no method 'magic', there is agnostic, no_motion, lean, paper, "),
        ({"method": "oracle"}, "--method oracle is fitted to sharp obs.*; choose among agnostic, "),
        ({"method": "ceiling"}, "--method ceiling is fitted to exact observations, a video has bl"),
        ({"method": "predeblur"}, "--method predeblur is fitted to deblurred observations"),
        (
            {"schedule": "eternal"},
            "no schedule 'eternal', there is medium, short, large, fine, huge",
        ),
        ({"name": "../up"}, "a name is small letters"),
        ({"name": "2nd"}, "a name is small letters"),
        ({"name": "a" * 201}, r"--name a{20}\.\.\.: 201 letters, choose 200 at most"),
        ({"name": "a" * 300}, "300 letters, choose 200 at most"),
    ],
)
def test_what_cannot_be_run_is_refused_before_anything_is_written(
    root: Path, video: Path, changes: dict[str, str], message: str
):
    asked = {"name": "anna", "method": "lean", "schedule": "medium"} | changes
    with pytest.raises(ConfigError, match=message):
        prepare(video, here=root, **asked)
    assert not (root / "avatars").exists()


def test_help_lists_the_methods_that_a_video_can_be_fitted_by(root, video, capsys):
    with pytest.raises(ConfigError) as refused:
        prepare(video, "anna", "magic", None, root)
    with pytest.raises(SystemExit):
        main(["video", "--help"])
    (_, listed) = str(refused.value).split("there is ")
    assert listed.count(", ") > 10
    assert f"(default: lean); there is {listed} " in " ".join(capsys.readouterr().out.split()) + " "


def test_a_video_that_cannot_be_read_is_refused_before_anything_is_written(root: Path):
    with pytest.raises(ConfigError, match=r"no video and no folder .*no\.mp4"):
        prepare(root / "no.mp4", "anna", "lean", "medium", root)
    (root / "empty.mp4").touch()
    with pytest.raises(ArtifactError, match=r"empty\.mp4 cannot be decoded"):
        prepare(root / "empty.mp4", "anna", "lean", "medium", root)
    assert not (root / "avatars").exists()


@pytest.mark.parametrize(
    ("called", "message"),
    [
        ("$(1).mp4", r"/\$\(1\)\.mp4: \$\(\.\.\.\) and .* are variables in params\.yaml; rename"),
        ("${HOME}/a.mp4", r"/\$\{HOME\}/a\.mp4: .* are variables in params\.yaml; rename"),
        ("a $(DATE:-now).mp4", "are variables in params.yaml"),
        ("a\x85b.mp4", r"/a\\x85b\.mp4': params\.yaml cannot keep such letters; rename"),
        ("caf\udce9.mp4", r"/caf\\udce9\.mp4': params\.yaml cannot keep such letters; rename"),
    ],
)
def test_a_video_whose_name_would_be_read_as_another_is_refused(root, video, called, message):
    (root / called).parent.mkdir(exist_ok=True)
    video.rename(root / called)
    with pytest.raises(ConfigError, match=message):
        prepare(root / called, "anna", "lean", "medium", root)
    assert not (root / "avatars").exists()


@pytest.mark.parametrize(
    "called", ["$1.mp4", "$().mp4", "a: b # c.mp4", "ü\u2028😀\n.mp4", f"{60 * 'a  '}.mp4", "~"]
)
def test_any_other_name_is_read_as_it_was_written(root, video, called):
    video.rename(root / called)
    for method in ("lean", "paper"):
        path = prepare(root / called, "anna", method, "medium", root).folder / "params.yaml"
        assert load_params(path, "scenes.anna.clip", ClipParams).path == str(root / called)


def test_a_video_that_begins_with_frames_alike_is_taken(root: Path):
    """As one that fades in: whether it can be read is asked of its first two frames."""
    alike = write_video(root / "alike.mp4", [picture(index // 2) for index in range(6)])
    prepare(alike, "anna", "lean", "medium", root)
    assert (root / "avatars" / "anna" / "params.yaml").is_file()


@pytest.mark.parametrize(
    ("file", "name"),
    [
        ("clip.mp4", "clip"),
        ("2024-05-01.MOV", "v_2024_05_01"),
        ("Ä.mp4", "video"),
        ("9" * 251 + ".mp4", "v_" + "9" * 198),
    ],
)
def test_a_file_s_name_becomes_the_avatar_s(file: str, name: str):
    assert name_of(Path(file)) == name


class Pipeline:
    """Stands in for DVC, and fails on request."""

    def __init__(self, monkeypatch, code=lambda words: 0):
        self.asked, self.code, self.folders = [], code, set()
        monkeypatch.setattr(running_dvc, "finish", self)
        monkeypatch.setattr(running_dvc, "refresh", lambda root: [])
        monkeypatch.setattr(command, "ALONE", {})

    def __call__(self, words, environment, folder):
        self.asked.append(" ".join(words[4:]))
        self.folders.add(folder)
        stage, _, name = words[-1].partition("@")
        if stage == "check":
            (folder / "metrics/check").mkdir(parents=True, exist_ok=True)
            write_json(folder / f"metrics/check/{name}.json", {"verdict": "ok", "findings": {}})
        if stage == "evaluate":
            (folder / "metrics/trajectory").mkdir(parents=True, exist_ok=True)
            write_json(folder / f"metrics/trajectory/{name}.json", {})
        return self.code(words[-1])


def test_the_check_comes_before_the_training(root, video, monkeypatch):
    monkeypatch.chdir(root)
    pipeline = Pipeline(monkeypatch, lambda word: 3 if "evaluate" in word else 0)
    assert main(["video", str(video), "--name", "anna"]) == 3
    assert pipeline.folders == {Path("avatars/anna")}
    made = "self_check@anna-lean export@anna-lean animate@anna-lean evaluate@anna-lean"
    assert pipeline.asked == ["check@anna", made]


@pytest.mark.parametrize("value", [0.9, 0.1])
def test_a_failed_check_is_told_of_before_the_long_part(root, video, monkeypatch, caplog, value):
    monkeypatch.chdir(root)
    folder, told = Path("avatars/anna"), []

    def made(word):
        if word == "check@anna":
            found = vars(judged(Scale(0.75, 0.5, "IoU", "look at the masks"), value))
            content = {"verdict": found["verdict"], "findings": {"mask_body_iou": found}}
            write_json(folder / "metrics/check/anna.json", content)
        told.append("The clip FAILS its check" in caplog.text)
        return 3 if "evaluate" in word else 0

    Pipeline(monkeypatch, made)
    assert main(["video", str(video), "--name", "anna"]) == 3
    assert told == [False, value < 0.5]


def test_another_film_or_masks_of_the_same_name_are_read_again(root, video, monkeypatch, caplog):
    monkeypatch.chdir(root)
    folder, words = Path("avatars/anna"), ["video", str(video), "--name", "anna"]
    prepare(video, "anna", "lean", None, root)
    masks = root / "masks"
    masks.mkdir()
    (masks / "0.png").write_bytes(b"rough")
    params = folder / "params.yaml"
    params.write_text(params.read_text().replace("masks: null", f"masks: {masks}"))

    def stopped(word):
        (folder / "data/clip/anna").mkdir(parents=True, exist_ok=True)
        return 3 if word == "evaluate@anna-lean" else 0

    def asked():
        pipeline = Pipeline(monkeypatch, stopped)
        assert main(words) == 3
        return pipeline.asked

    again = "--force --single-item clip@anna"
    assert again not in asked()  # there is none yet
    assert again not in asked()  # and now it is the same
    (masks / "0.png").write_bytes(b"better")
    assert asked()[0] == again
    assert again not in asked()
    write_video(video, [picture(index) for index in (2, 1, 0)])
    caplog.clear()
    with caplog.at_level(logging.INFO):
        assert asked()[0] == again
    assert "The footage of anna may have changed" in caplog.text
    (folder / "footage.json").unlink()  # as of a version that kept none
    assert asked()[0] == again
    write_video(video, [picture(index) for index in (1, 0, 2)])
    shutil.rmtree(folder / "data")  # DVC's cache has the former clip
    assert asked()[0] == again


def test_files_that_lie_in_an_avatars_folder_are_followed_too(root, video, monkeypatch, capsys):
    monkeypatch.chdir(root)
    monkeypatch.setenv("CLIPS", "../..")
    folder = prepare(video, "anna", "lean", None, Path()).folder
    params, mask = folder / "params.yaml", folder / "masks/0.png"
    text = params.read_text().replace("masks: null", "masks: masks")
    params.write_text(text.replace(str(root), "$(CLIPS)"))  # as stages see them, which run there
    mask.parent.mkdir()

    def asked(content):
        mask.write_bytes(content)
        (folder / "data/clip/anna").mkdir(parents=True, exist_ok=True)
        pipeline = Pipeline(monkeypatch, lambda word: 3 if "check@" in word else 0)
        assert main(["video", video.name, "--name", "anna"]) == 3
        return pipeline.asked

    again = "--force --single-item clip@anna"
    assert asked(b"rough")[0] == again  # nothing was known yet
    assert asked(b"rough") == ["check@anna"]
    assert asked(b"better")[0] == again
    monkeypatch.delenv("CLIPS")
    assert main(["video", video.name, "--name", "anna"]) == 1
    assert "clip.path: set the environment variable CLIPS" in capsys.readouterr().err


@pytest.fixture
def brought(root, video, tmp_path_factory, monkeypatch):
    """What a finished avatar's clip was made of, by key; far from a checkout."""
    monkeypatch.chdir(tmp_path_factory.mktemp("anywhere"))
    folder = prepare(video, "anna", "lean", None, Path()).folder
    places = {"path": video} | {key: root / key for key in ("masks", "keypoints", "poses")}
    text = (folder / "params.yaml").read_text()
    for key in ("masks", "keypoints", "poses"):
        places[key].mkdir()
        (places[key] / "0").touch()
        text = text.replace(f" {key}: null", f" {key}: {places[key]}")
    (folder / "params.yaml").write_text(text)
    (folder / "data/clip/anna/frames").mkdir(parents=True)
    Pipeline(monkeypatch, lambda word: 3 if "check@" in word else 0)
    assert main(["video", str(video), "--name", "anna"]) == 3
    return places


def refusal(video, monkeypatch, capsys):
    """The only line that is said, once nothing was run and nothing is gone or remembered."""
    pipeline, record = Pipeline(monkeypatch), Path("anna/footage.json").read_text()
    capsys.readouterr()
    assert main(["video", str(video), "--name", "anna"]) == 1
    assert pipeline.asked == []
    assert Path("anna/data/clip/anna/frames").exists()
    assert Path("anna/footage.json").read_text() == record
    (said,) = capsys.readouterr().err.splitlines()
    return said


@pytest.mark.parametrize("key", ["path", "masks", "keypoints", "poses"])
def test_a_file_that_went_away_is_told_and_the_clip_stays(brought, video, monkeypatch, capsys, key):
    brought[key].rename(brought[key].with_name("elsewhere"))
    said = refusal(video, monkeypatch, capsys)
    assert f"anna/params.yaml: scenes.anna.clip.{key}: nothing is at {brought[key]}; bring" in said


def test_an_empty_folder_is_that_of_a_disk_that_is_away(brought, video, monkeypatch, capsys):
    (brought["masks"] / "0").unlink()
    assert "clip.masks: nothing is at" in refusal(video, monkeypatch, capsys)


def test_a_file_that_never_was_there_is_told_and_the_clip_stays(
    brought, video, monkeypatch, capsys
):
    params = Path("anna/params.yaml")
    params.write_text(params.read_text().replace(str(brought["poses"]), "no.npz"))
    assert "clip.poses: nothing is at anna/no.npz; bring" in refusal(video, monkeypatch, capsys)


def test_poses_are_estimated_again_once_the_larger_model_is_there(root, video, monkeypatch):
    monkeypatch.chdir(root)
    prepare(video, "anna", "lean", None, root)
    folder = Path("avatars/anna")
    again = ["blur@anna", "--force --single-item preprocess@anna"]

    def asked(installed, estimated):
        monkeypatch.setattr(command, "installed_model", lambda: installed)
        write_json(folder / "metrics/preprocess/anna.json", {"pose_model": estimated})
        pipeline = Pipeline(monkeypatch, lambda word: 3 if "check@" in word else 0)
        assert main(["video", str(video), "--name", "anna"]) == 3
        return pipeline.asked[:-1]

    assert asked("heavy", "full") == []  # metrics came with a clone, data are not there
    (folder / "data/preprocess/anna").mkdir(parents=True)
    assert asked("heavy", "full") == again
    assert asked("full", "full") == []
    assert asked("heavy", "heavy") == []
    assert asked("full", "heavy") == []  # what is better stays
    assert asked("heavy", None) == []  # poses were given


def test_far_from_a_checkout_there_is_a_body_before_footage_is_read_again(
    video, tmp_path_factory, monkeypatch
):
    monkeypatch.chdir(tmp_path_factory.mktemp("anywhere"))
    prepare(video, "anna", "lean", None, Path())
    Path("anna/data/clip/anna").mkdir(parents=True)
    pipeline = Pipeline(monkeypatch, lambda word: 5 if "clip@" in word else 0)
    assert main(["video", str(video), "--name", "anna", "--own-body"]) == 5
    assert pipeline.asked == ["body@anny", "--force --single-item clip@anna"]


def test_what_could_not_be_read_again_is_read_again_the_next_time(root, video, monkeypatch):
    monkeypatch.chdir(root)
    folder, words = Path("avatars/anna"), ["video", str(video), "--name", "anna"]
    (folder / "data/clip/anna").mkdir(parents=True)
    for _ in range(2):
        pipeline = Pipeline(monkeypatch, lambda word: 5)
        assert main(words) == 5
        assert pipeline.asked == ["--force --single-item clip@anna"]
        shutil.rmtree(folder / "data", ignore_errors=True)  # DVC takes away what it makes again


@pytest.mark.parametrize("words", [[], ["--own-body"]])
def test_far_from_a_checkout_the_users_other_folders_are_asked_for_a_body(
    video, cache, tmp_path_factory, monkeypatch, words
):
    monkeypatch.chdir(tmp_path_factory.mktemp("anywhere"))
    pipeline = Pipeline(monkeypatch, lambda word: 3 if word == "check@anna" else 0)
    assert main(["video", str(video), "--name", "anna", *words]) == 3
    shared = [f"{cache}/bodies {command} body@anny" for command in ("repro", "push")]
    assert pipeline.asked == [*([] if words else shared), "check@anna"]


def test_what_is_not_installed_is_said_before_anything_is_written(root, video, monkeypatch, capsys):
    monkeypatch.chdir(root)
    Pipeline(monkeypatch)
    monkeypatch.setattr(command, "ALONE", {"no_such_module": "no_such_module==1"})
    assert main(["video", str(video), "--name", "anna"]) == 1
    assert "no_such_module not installed; run once: deblur-avatar setup" in capsys.readouterr().err
    assert not (root / "avatars").exists()


@pytest.mark.parametrize(
    ("source", "std", "said"),
    [
        ("frames", 8.0, "open for 31.0 ms, give or take 8.0, as the frames tell"),
        (
            "frames",
            16.0,
            "open for 31.0 ms, give or take 16.0, as the frames hardly tell; set clip.exposure_s "
            "where you know better",
        ),
        ("guess", 8.0, "31.0 ms is a guess, nothing moved enough to tell"),
        (None, 8.0, ""),
    ],
)
def test_how_long_the_shutter_was_open_is_said_where_the_footage_does_not(
    caplog, source, std, said
):
    told = {"shutter_s": 0.031, "shutter_std_s": std / 1e3, "shutter_from": source}
    with caplog.at_level(logging.INFO):
        command._tell_shutter({} if source is None else told)
    assert [said] == [line.removeprefix("The shutter:  ") for line in caplog.messages or [""]]


@pytest.mark.parametrize("method", ["lean", "paper"])
def test_a_first_look_is_shown_after_the_warm_up(root, video, scene, monkeypatch, caplog, method):
    monkeypatch.chdir(root)
    folder = Path("avatars/anna")
    recipe, page = ("one_sided" if method == "lean" else "paper"), folder / "avatar.html"
    seen = {}

    def make(word):
        if word.startswith("warmup"):
            scene.observations.save(folder / "data/preprocess/anna/blurred")
            avatar = dataclasses.replace(scene.avatar, iteration=480)
            avatar.save(folder / f"data/warmup/anna-blurred-{recipe}/avatar")
        seen[word] = page.exists()
        return 3 if word.startswith("evaluate") else 0

    pipeline = Pipeline(monkeypatch, make)
    with caplog.at_level(logging.INFO):
        words = ["video", str(video), "--name", "anna", "--method", method, "--preview"]
        assert main([*words, "--schedule", "medium"]) == 3
    first, rest = f"warmup@anna-blurred-{recipe}", f"evaluate@anna-{method}"
    assert pipeline.asked[:2] == ["check@anna", first]
    assert pipeline.asked[2].startswith("self_check@anna")
    assert seen[rest] == (method == "lean")
    if method == "lean":
        assert "anna-lean, step 480 of 2400" in page.read_text()
        assert f"A first look, the rest goes on: {page}" in caplog.messages
    else:
        assert "No first look: an avatar with networks fits on no page" in caplog.messages


@pytest.mark.parametrize("earlier", ["finished", "stopped"])
def test_a_first_look_is_not_of_an_earlier_fit(root, video, scene, monkeypatch, earlier):
    monkeypatch.chdir(root)
    folder = Path("avatars/anna")
    before = folder / "data/fusion/anna-lean"
    if earlier == "finished":
        scene.avatar.save(before / "avatar")
        scene.motion.save(before / "motion")
    else:
        before = before.with_name(".anna-lean.unfinished") / "snapshots/001500"
        Snapshot(avatar=scene.avatar, motion=scene.motion).save(before)
    os.utime(before, (1e9, 1e9))

    def make(word):
        if word.startswith("warmup"):  # other masks, say
            scene.observations.save(folder / "data/preprocess/anna/blurred")
            avatar = dataclasses.replace(scene.avatar, iteration=480)
            avatar.save(folder / "data/warmup/anna-blurred-one_sided/avatar")
        return 3 if word.startswith("evaluate") else 0

    Pipeline(monkeypatch, make)
    words = ["video", str(video), "--name", "anna", "--preview", "--schedule", "medium"]
    assert main(words) == 3
    assert "anna-lean, step 480 of 2400" in (folder / "avatar.html").read_text()


@pytest.mark.parametrize(
    ("before", "value", "last"),
    [
        (0.9, 0.9, "The avatar passes its self-check"),
        (0.9, 0.1, "The avatar FAILS its self-check:"),
        (0.9, float("nan"), "The avatar FAILS its self-check:"),
        (0.9, None, "The self-check could measure nothing"),
        (0.1, 0.9, "The clip FAILS its check"),
        (0.1, None, "The clip FAILS its check"),
        (0.1, 0.1, "The avatar FAILS its check and its self-check:"),
    ],
)
@pytest.mark.parametrize("checkout", [True, False])
def test_the_checks_have_the_last_word(
    root, video, tmp_path_factory, monkeypatch, caplog, before, value, last, checkout
):
    here = root if checkout else tmp_path_factory.mktemp("anywhere")
    folder = Path("avatars/anna") if checkout else Path("anna")
    monkeypatch.chdir(here)

    def found(word):
        for checked, number in (("check/anna", before), ("self_check/anna-lean", value)):
            found = vars(judged(Scale(0.75, 0.5, "IoU", "look at the masks"), number))
            path = folder / f"metrics/{checked}.json"
            path.parent.mkdir(parents=True, exist_ok=True)
            content = {"verdict": found["verdict"], "findings": {"coverage_iou": found}}
            path.write_text(json.dumps(content))
        page = folder / "data/export/anna-lean/avatar.html"
        page.parent.mkdir(parents=True, exist_ok=True)
        page.write_text("anna-lean")
        return 0

    pipeline = Pipeline(monkeypatch, found)
    with caplog.at_level(logging.INFO):
        assert main(["video", str(video), "--name", "anna"]) == 0
    assert pipeline.folders == {folder}
    assert pipeline.asked[-1] == "--single-item report"
    assert caplog.messages[-1].startswith(last)
    assert ("look at the masks" in caplog.text) == ("FAILS" in last)
    assert (folder / "avatar.html").read_text() == "anna-lean"
    assert f"Turn it by hand: {folder}/avatar.html" in caplog.messages


def test_a_missing_video_is_one_clear_line(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(ROOT)
    words = ["video", "no.mp4"]
    done = ended_here(words, lambda: main(words))
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].startswith("ConfigError: clip.path: no video")
    assert "Traceback" not in done.stderr
