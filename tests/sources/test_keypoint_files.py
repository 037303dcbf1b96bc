import json
from pathlib import Path

import numpy as np
import pytest

from deblur_avatar.errors import ArtifactError
from deblur_avatar.sources.keypoint_files import follow_person, read_keypoints

NOSE, LEFT_WRIST, RIGHT_WRIST, LEFT_ANKLE, LEFT_TOE = 0, 15, 16, 27, 31


def points(count: int, x: float, height: float) -> np.ndarray:
    """A column of points, the first on top."""
    column = np.linspace(10, 10 + height, count)
    return np.stack([np.full(count, x), column, np.full(count, 0.9)], axis=1)


def openpose(*people: np.ndarray) -> dict[str, object]:
    return {"people": [{"pose_keypoints_2d": person.ravel().tolist()} for person in people]}


def write(path: Path, content: object) -> Path:
    path.write_text(json.dumps(content))
    return path


def test_openpose_s_points_find_their_landmarks(tmp_path: Path):
    person = points(25, 50, 100)
    (tmp_path / "a").mkdir()
    for index in (0, 1, 10, 2):
        write(tmp_path / "a" / f"v_{index}_keypoints.json", openpose(person + [index, 0, 0]))
    frames = read_keypoints(tmp_path / "a")
    assert [frame[0][NOSE, 0] for frame in frames] == [50, 51, 52, 60]  # by number, not by letter
    marks = frames[0][0]
    assert marks[LEFT_WRIST].tolist() == pytest.approx(person[7].tolist())
    assert marks[RIGHT_WRIST].tolist() == pytest.approx(person[4].tolist())
    assert marks[LEFT_TOE].tolist() == pytest.approx(person[19].tolist())
    assert marks[1].tolist() == [0, 0, 0]  # an inner corner of an eye, which OpenPose has not


def test_coco_s_points_find_their_landmarks_and_frames(tmp_path: Path):
    person = points(17, 50, 100)
    entries = [
        {"image_id": name, "keypoints": person.ravel().tolist()} for name in ("000002.jpg", 0)
    ]
    frames = read_keypoints(write(tmp_path / "a.json", {"annotations": entries}))
    assert [len(people) for people in frames] == [1, 0, 1]
    assert frames[2][0][LEFT_WRIST].tolist() == pytest.approx(person[9].tolist())
    assert frames[2][0][LEFT_ANKLE].tolist() == pytest.approx(person[15].tolist())


def test_coco_s_flags_become_confidences(tmp_path: Path):
    person = points(17, 50, 100)
    person[:, 2] = 2
    person[9, 2] = 1
    entry = {"image_id": 0, "keypoints": person.ravel().tolist()}
    (found,) = read_keypoints(write(tmp_path / "a.json", [entry]))[0]
    assert (found[NOSE, 2], found[LEFT_WRIST, 2]) == (1.0, 0.5)


def test_the_larger_longer_tracked_person_is_taken_and_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    frames = []
    for index in range(6):
        near, far = points(25, 100 + 5 * index, 90), points(25, 300, 60)
        # In which order a frame lists them says nothing; a giant passes by in one frame.
        people = [far, near] if index % 2 else [near, far]
        frames.append(openpose(*people, *([points(25, 500, 200)] if index == 3 else [])))
    person = follow_person(read_keypoints(write(tmp_path / "a.json", frames)), "a.json")
    assert person[:, NOSE, 0].tolist() == [100, 105, 110, 115, 120, 125]
    assert "2 people; the larger, longer-tracked one is taken" in caplog.text


def test_a_person_who_was_not_found_leaves_zeros(tmp_path: Path):
    frames = [openpose(points(25, 50, 90)), openpose(), openpose(points(25, 52, 90))]
    person = follow_person(read_keypoints(write(tmp_path / "a.json", frames)), "a.json")
    assert (person[:, NOSE, 2] > 0).tolist() == [True, False, True]
    assert follow_person([[], []], "nobody").any() == np.False_


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "is not JSON"),
        ("{}", "neither OpenPose's nor COCO's"),
        ("[]", "neither OpenPose's nor COCO's"),
        ('[{"image_id": 0}]', "neither OpenPose's nor COCO's"),
        ('[{"image_id": "x", "keypoints": []}]', "holds no frame number"),
        ('[{"image_id": 0, "keypoints": [1, 2]}]', "x, y, confidence"),
        ('[{"image_id": 0, "keypoints": [1, 2, 3]}]', "1 points a person, known are 17"),
        ('{"people": [{}]}', "is not OpenPose's JSON: lacks 'pose_keypoints_2d'"),
    ],
)
def test_files_of_another_format_are_refused(tmp_path: Path, content: str, message: str):
    path = tmp_path / "a.json"
    path.write_text(content)
    with pytest.raises(ArtifactError, match=message):
        read_keypoints(path)


def test_what_is_not_there_is_named(tmp_path: Path):
    with pytest.raises(ArtifactError, match=r"cannot read .*no\.json"):
        read_keypoints(tmp_path / "no.json")
    with pytest.raises(ArtifactError, match=r"holds no \.json files"):
        read_keypoints(tmp_path)
