import json
import logging

import pytest

from deblur_avatar.errors import ArtifactError
from deblur_avatar.evaluation.findings import (
    Scale,
    failures,
    judged,
    read_findings,
    tell,
    worst,
)
from deblur_avatar.files import write_json

FALLING = Scale(0.75, 0.5, "IoU", "look at the masks")
RISING = Scale(0.15, 0.45, "share", "use a shorter exposure")
NEVER_FAILS = Scale(240, None, "degrees", "let the person turn")


@pytest.mark.parametrize(
    ("scale", "verdicts"),
    [
        (FALLING, {0.9: "ok", 0.75: "ok", 0.6: "warn", 0.5: "warn", 0.3: "fail"}),
        (RISING, {0.1: "ok", 0.15: "ok", 0.3: "warn", 0.45: "warn", 0.9: "fail"}),
        (NEVER_FAILS, {300.0: "ok", 1.0: "warn"}),
    ],
)
def test_rising_and_falling_numbers_are_judged_by_their_own_side(scale, verdicts):
    assert {value: judged(scale, value).verdict for value in verdicts} == verdicts


def test_advice_comes_with_what_is_not_ok_alone():
    assert judged(FALLING, 0.9).advice == ""
    assert judged(FALLING, 0.6).advice == judged(FALLING, 0.1).advice == "look at the masks"
    assert judged(FALLING, None).verdict == "unknown"


def test_the_worst_verdict_counts():
    assert worst(["ok", "warn", "fail"]) == "fail"
    assert worst(["ok", "unknown", "warn"]) == "warn"
    assert worst(["ok", "unknown"]) == "ok"
    assert worst(["unknown"]) == worst([]) == "unknown"  # nobody has looked


@pytest.mark.parametrize("scale", [FALLING, RISING, NEVER_FAILS])
def test_no_number_fails_and_is_told_as_such(scale, caplog, tmp_path):
    finding = judged(scale, float("nan"))
    assert (finding.value, finding.verdict, finding.advice) == (None, "fail", scale.advice)
    content = {"verdict": worst([finding.verdict]), "findings": {"mask_iou": vars(finding)}}
    tell("anna", content)
    assert f"FAIL anna: mask iou no number {scale.unit}. {scale.advice}" in caplog.messages
    write_json(tmp_path / "anna.json", content)
    told = failures(read_findings(tmp_path / "anna.json"))
    assert told == [f"Mask iou: no number ({scale.unit}). {scale.advice}"]


def test_what_is_bad_is_told_loudly_and_what_is_well_is_not(caplog):
    findings = {"mask_iou": vars(judged(FALLING, 0.3)), "share": vars(judged(RISING, 0.1))}
    with caplog.at_level(logging.INFO):
        tell("anna", {"verdict": "fail", "findings": findings})
    loud = [entry.getMessage() for entry in caplog.records if entry.levelno >= logging.WARNING]
    assert loud == ["FAIL anna: mask iou 0.3 IoU. look at the masks"]


@pytest.mark.parametrize(
    ("name", "listed", "parts", "part"),
    [
        (
            "worst_part_open",
            "open",
            {"head": 0.1, "right_elbow": 0.6, "left_hip": 0.2},
            "right forearm",
        ),
        ("worst_part_open", "open", {"head": 0.6, "right_elbow": 0.5, "left_hip": None}, "head"),
        ("worst_part_inside", "parts", {"left arm": 0.2, "right leg": 0.9}, "left arm"),
    ],
)
def test_the_worst_part_of_the_body_is_named(name, listed, parts, part, caplog, tmp_path):
    content = {"verdict": "fail", "findings": {name: vars(judged(RISING, 0.6))}, listed: parts}
    tell("anna", content)
    words = name.replace("_", " ")
    assert any(f"anna: {words} ({part}) 0.6" in message for message in caplog.messages)
    write_json(tmp_path / "anna.json", content)
    (told,) = failures(read_findings(tmp_path / "anna.json"))
    assert told.startswith(f"{words.capitalize()} ({part}): 0.6")


def test_a_check_that_lists_no_parts_names_none(tmp_path):
    content = {"findings": {"worst_part_open": vars(judged(RISING, 0.6))}, "open": {}}
    write_json(tmp_path / "anna.json", content)
    (told,) = failures(read_findings(tmp_path / "anna.json"))
    assert told.startswith("Worst part open: 0.6")


def test_what_failed_is_said_with_its_number_and_what_to_do(tmp_path):
    findings = {"mask_iou": vars(judged(FALLING, 0.3)), "share": vars(judged(RISING, 0.3))}
    path = tmp_path / "anna.json"
    path.write_text(json.dumps({"verdict": "fail", "findings": findings}))
    assert failures(read_findings(path)) == ["Mask iou: 0.3 (IoU). look at the masks"]


@pytest.mark.parametrize(
    "content",
    [
        "{",
        "[]",
        "{}",
        '{"findings": 3}',
        '{"findings": {"a": {"value": "much"}}}',
        '{"findings": {}, "open": 3}',
    ],
)
def test_damaged_findings_are_named(tmp_path, content):
    (tmp_path / "anna.json").write_text(content)
    with pytest.raises(ArtifactError, match=r"anna\.json"):
        read_findings(tmp_path / "anna.json")
