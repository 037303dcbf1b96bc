import json
import re
from pathlib import Path

import pytest

from deblur_avatar.config.reading import (
    expand_environment,
    holds_variable,
    load_params,
    read_params,
    read_yaml,
)
from deblur_avatar.errors import ConfigError
from deblur_avatar.parameters import METRICS_OF_STAGES, check_parameters
from deblur_avatar.pipeline.animate import AnimationParams
from deblur_avatar.pipeline.blur import BlurParams
from deblur_avatar.pipeline.clip import ClipParams
from deblur_avatar.pipeline.fusion import FusionParams

ROOT = Path(__file__).parents[2]
GOOD = "blur: {frames: interpolated, factor: 8, window: 33, averaging_space: srgb}\n"


def written(tmp_path, text):
    path = tmp_path / "params.yaml"
    path.write_text(text)
    return path


def test_a_section_becomes_a_typed_object(tmp_path):
    params = load_params(written(tmp_path, GOOD), "blur", BlurParams)
    assert (params.window, params.averaging_space) == (33, "srgb")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (GOOD.replace("window", "windw"), "blur: missing key 'window'; unknown key 'windw'"),
        (GOOD.replace("33", "33.5"), "window: input should be a valid integer, got 33.5"),
        (GOOD.replace("33", "'33'"), "window: input should be a valid integer, got '33'"),
        (GOOD.replace("33", "0"), "window: input should be greater than or equal to 1, got 0"),
        (GOOD.replace("srgb", "gamma"), "averaging_space: input should be 'srgb' or 'linear'"),
        ("blur: [", "is not YAML"),
        ("blurr: {}", "blur: the file has no key 'blur', it has blurr"),
    ],
)
def test_a_mistake_is_named_with_its_key(tmp_path, text, message):
    with pytest.raises(ConfigError, match=message.replace("(", r"\(")):
        load_params(written(tmp_path, text), "blur", BlurParams)


def test_a_section_without_the_key_that_names_its_kind_is_refused(tmp_path):
    path = written(tmp_path, "fusion: {supervisions: sharp, mask: mean}\n")
    with pytest.raises(
        ConfigError, match="fusion: missing key 'supervision', which names the kind"
    ):
        load_params(path, "fusion", FusionParams)


def test_a_file_is_read_again_when_it_changes_and_what_came_of_it_is_ones_own(tmp_path):
    path = tmp_path / "params.yaml"
    path.write_text("a: {b: [1, 2]}\n")
    first = read_yaml(path)
    first["a"]["b"].append(3)
    assert read_yaml(path) == {"a": {"b": [1, 2]}}
    path.write_text("a: 4\n")
    assert read_yaml(path) == {"a": 4}


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ConfigError, match="cannot read .*nowhere.yaml: No such file"):
        load_params(tmp_path / "nowhere.yaml", "blur", BlurParams)


def test_numbers_are_read_as_dvc_reads_them(tmp_path):
    path = written(tmp_path, "rate: 1e-3\nanswer: no\n")
    assert load_params(path, "rate", float) == 1e-3
    assert load_params(path, "answer", str) == "no"


def test_a_source_decides_which_keys_a_clip_has(tmp_path):
    for clip, message in {
        "{source: film}": "clip: value: no source of this name, there is studio, .*, got .*'film'",
        "{fps: 3}": "wanted a section with the key source .studio, .*street, multiview, ",
        "[studio]": "wanted a section with the key source",
        "{source: {a: 1}}": "no source of this name",
        "{source: studio, fps: fast}": "missing key 'motion'.*fps: input should be a valid number",
        "{source: studio, root: x}": "unknown key 'root'",
    }.items():
        with pytest.raises(ConfigError, match=message):
            load_params(written(tmp_path, f"clip: {clip}"), "clip", ClipParams)


def test_the_committed_parameters_are_valid_in_every_section():
    content = read_yaml(ROOT / "params.yaml")
    check_parameters(ROOT / "params.yaml")
    for run in content["runs"].values():
        warmup = f"{run['scene']}-{run['observations']}-{run['avatar']}"
        assert warmup in content["warmups"]


def test_a_run_of_a_scene_that_does_not_exist_is_refused(tmp_path):
    text = (ROOT / "params.yaml").read_text()
    broken = text.replace("studio-paper: {scene: studio", "studio-paper: {scene: studoi")
    with pytest.raises(ConfigError, match="runs.studio-paper: no scene 'studoi'"):
        check_parameters(written(tmp_path, broken))


@pytest.mark.parametrize("stage", ["blur", "cost", "learning_curve"])
def test_a_scene_that_is_named_like_a_stage_is_refused(tmp_path, stage):
    text = (ROOT / "params.yaml").read_text()
    scene = json.dumps(read_yaml(ROOT / "params.yaml")["scenes"]["studio"])
    broken = re.sub(r"(?m)^scenes:\n", f"scenes:\n  {stage}: {scene}\n", text)
    with pytest.raises(ConfigError, match=rf"scenes\.{stage}: metrics/{stage} is where a stage"):
        check_parameters(written(tmp_path, broken))


def test_the_folders_that_stages_write_metrics_to_are_known():
    pipeline = (ROOT / "dvc.yaml").read_text()
    assert set(re.findall(r"metrics/(\w+)/", pipeline)) <= METRICS_OF_STAGES


def test_every_section_is_immutable(tmp_path):
    params = load_params(written(tmp_path, GOOD), "blur", BlurParams)
    with pytest.raises(ValueError, match="frozen"):
        params.window = 3


def test_sections_that_a_file_lacks_come_from_the_file_it_shares(tmp_path):
    (tmp_path / "deep").mkdir()
    written(tmp_path, GOOD + "seed: 3\n")
    (tmp_path / "deep/own.yaml").write_text("shared: ../params.yaml\nseed: 4\n")
    whole = load_params(tmp_path / "params.yaml", "blur", BlurParams)
    assert load_params(tmp_path / "deep/own.yaml", "blur", BlurParams) == whole
    assert load_params(tmp_path / "deep/own.yaml", "seed", int) == 4
    with pytest.raises(ConfigError, match="the file has no key 'shared'"):
        load_params(tmp_path / "deep/own.yaml", "shared", str)
    (tmp_path / "deep/own.yaml").write_text("shared: gone.yaml\n")
    with pytest.raises(ConfigError, match="cannot read .*gone.yaml: No such file"):
        load_params(tmp_path / "deep/own.yaml", "seed", int)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: 2001-13-45", "month must be in 1..12"),
        ("a: !!int ''", "index out of range"),
        ("a: " + "9" * 5000, "4300 digits"),
        ("[" * 500, "recursion"),
    ],
)
def test_damaged_yaml_is_refused_whatever_its_reader_raises(tmp_path, text, message):
    with pytest.raises(ConfigError, match=f"is not YAML.*{message}"):
        read_yaml(written(tmp_path, text))


def test_a_section_that_contains_itself_is_refused(tmp_path):
    path = written(tmp_path, "clip: &a {source: studio, motion: *a}")
    with pytest.raises(ConfigError, match=r"params\.yaml: clip: it contains itself"):
        load_params(path, "clip", ClipParams)


def test_a_file_that_is_far_larger_than_parameters_is_refused_unread(tmp_path):
    with pytest.raises(ConfigError, match="has over 256 kB; is it a parameter file"):
        read_yaml(written(tmp_path, "a: b\n" * 60_000))


def test_parameter_files_that_share_each_other_are_refused(tmp_path):
    (tmp_path / "other.yaml").write_text("shared: params.yaml")
    with pytest.raises(ConfigError, match="shared leads through over 8 files"):
        read_params(written(tmp_path, "shared: other.yaml"))


def test_a_shared_file_without_sections_is_refused(tmp_path):
    (tmp_path / "other.yaml").write_text("- a list")
    with pytest.raises(ConfigError, match="other.yaml must hold sections, got .'a list'"):
        read_params(written(tmp_path, "shared: other.yaml"))


@pytest.mark.parametrize("value", [".inf", ".nan"])
def test_numbers_of_parameters_are_finite(tmp_path, value):
    text = f"""a: {{scene: s, motion: own, start: 0.0, seconds: 1.0, fps: 25.0, image_size: 64,
  turns: {value}, travel: 0.0, margin: 0.1,
  backdrop: 0.0}}"""
    with pytest.raises(ConfigError, match="turns: input should be a finite number"):
        load_params(written(tmp_path, text), "a", AnimationParams)


@pytest.mark.parametrize("text", ["$(HALL:-attic)/one", "${HALL:-attic}/one"])
def test_variables_stand_in_parentheses_or_braces(monkeypatch, text):
    monkeypatch.setenv("HALL", "cellar")
    assert expand_environment(text, "x") == "cellar/one"
    monkeypatch.setenv("HALL", "")
    assert expand_environment(text, "x") == "attic/one"


@pytest.mark.parametrize(
    ("text", "held"),
    [("a/$(HALL)", True), ("${HALL:-attic}/one", True), ("$HALL", False), ("$()/${}", False)],
)
def test_what_would_be_taken_for_a_variable_can_be_asked(text, held):
    assert holds_variable(text) == held
