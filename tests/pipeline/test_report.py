import json
import re
import shutil
from html.parser import HTMLParser

import numpy as np
import pytest

from deblur_avatar.errors import ArtifactError
from deblur_avatar.evaluation.findings import Scale, judged
from deblur_avatar.imaging.picture_files import read_picture, write_picture
from deblur_avatar.imaging.video_writing import write_video
from deblur_avatar.pipeline import report as pipeline_report
from deblur_avatar.pipeline.report import make_report
from deblur_avatar.reporting.avatar_pages import MAX_BYTES
from deblur_avatar.reporting.charts import chart_files
from deblur_avatar.reporting.picture_strips import (
    INPUT,
    TRUTH,
    person_box,
    strips_of_scene,
)
from deblur_avatar.reporting.report_tables import facts_of, tables_of
from deblur_avatar.reporting.results_table import markdown
from tests.measured_costs import run_of, write_costs

METHODS = ("ceiling", "oracle", "agnostic", "paper", "lean", "magic")
PSNR = {"ceiling": 30.0, "oracle": 28.0, "agnostic": 24.0, "paper": 25.0}


def result(scene, method, psnr, **changes):
    return {
        "scene": scene, "method": method,
        "image": {"psnr": psnr, "ssim": 0.9, "flip": 0.1, "lpips_vgg": None, "psnr_seen": psnr - 2},
        "novel_pose": {"psnr": psnr - 1}, "cameras": {"left": {"psnr": psnr, "psnr_foreground": 9}},
        "motion": {"joint_error_mm": 10.0}, "initial": {"joint_error_mm": 14.0},
        "model": {"gaussians": 8000},
        "counts": {"novel_views": 8}, "run": {"device": "cpu", "schedule": "medium"},
        "recovery": {"psnr": None}, "gap_to_ceiling_db": None,
    } | changes  # fmt: skip


def person(value):
    picture = np.zeros((20, 16, 3), np.uint8)
    picture[4:16, 6:10] = value
    return picture


def build_project(folder):
    """Metrics, pictures and an animation of two scenes, a few pixels each."""
    for scene, methods in (("studio", list(PSNR)), ("yard", ["oracle", "agnostic", "paper"])):
        for method in methods:
            write_result(folder / "metrics", scene, method, PSNR[method])
            drawn = folder / "evaluate" / f"{scene}-{method}"
            views = []
            for frame in (2, 7):
                names = {"render": f"{frame}-r.png", "truth": "t.png", "blurred": f"{frame}-b.png"}
                write_picture(drawn / names["render"], person(list(PSNR).index(method) * 50 + 90))
                write_picture(drawn / names["truth"], person(250))
                write_picture(drawn / names["blurred"], person(60))
                views.append({"camera": "left", "frame": frame, "novel_pose": frame == 7, **names})
            write_json(drawn / "views.json", views)
    points = [{"stage": "fusion", "iteration": i, "image": {"psnr": 20.0 + i}} for i in (1, 5)]
    curve = {"scene": "studio", "method": "paper", "disk_mb": 1.5, "points": points}
    write_json(folder / "metrics/learning_curve/studio-paper.json", curve)
    write_json(folder / "metrics/blur/studio.json", {"scene": "studio", "window": 33})
    write_costs(folder / "metrics", run_of("studio", "paper"), 100.0, {1: 5.0, 5: 25.0})
    frames = [person(value) for value in (50, 100, 150)]
    write_picture(folder / "animate/studio-paper/contact_sheet.png", frames[0])
    write_video(folder / "animate/studio-paper/video.mp4", frames, 3.0)
    for scene in ("studio", "yard"):
        for method in ("agnostic", "oracle", "paper"):
            write_page(folder, f"{scene}-{method}")
    return folder


def write_page(folder, run, text="a page"):
    path = folder / "export" / run / "avatar.html"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"<title>{run}</title>{text}")


@pytest.fixture
def project(tmp_path):
    return build_project(tmp_path)


@pytest.fixture(scope="module", autouse=True)
def charts_drawn_once():
    """A chart, half a second of drawing, is drawn once for the same rows."""
    known = {}

    def remembered(name, rows):
        asked = name, json.dumps(rows)
        if asked not in known:
            known[asked] = chart_files(name, rows)
        return dict(known[asked])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pipeline_report, "chart_files", remembered)
        yield


@pytest.fixture(scope="module")
def report(tmp_path_factory, charts_drawn_once):
    """Of a project that nobody changes."""
    return made(build_project(tmp_path_factory.mktemp("project")))


def write_json(path, content):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content))


def write_result(metrics, scene, method, psnr):
    write_json(metrics / scene / f"{method}.json", result(scene, method, psnr))
    write_costs(metrics, run_of(scene, method), 100.0)


def made(project, metrics="metrics"):
    """The report over all runs that have results."""
    paths = [path for path in (project / metrics).glob("*/*.json") if path.stem in METHODS]
    names = sorted((path.parent.name, path.stem) for path in paths)
    runs = {f"{scene}-{method}": run_of(scene, method) for scene, method in names}
    folders = project / "evaluate", project / "animate"
    return make_report(
        runs, list(runs), project / metrics, *folders,
        exports=project / "export", exported=list(runs),
    )  # fmt: skip


class Page(HTMLParser):
    """Addresses, tags and words of a page; complains about tags that are not closed."""

    VOID = ("meta", "img", "br", "link", "input")

    def __init__(self, text):
        super().__init__()
        self.addresses, self.open, self.words, self.rows = [], [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.addresses += [
            v for k, v in attrs if k in ("src", "href", "poster", "srcset", "action")
        ]
        if tag not in self.VOID:
            self.open.append(tag)
        if tag == "tr":
            self.rows.append([])

    def handle_startendtag(self, tag, attrs):
        self.addresses += [v for k, v in attrs if k in ("src", "href", "xlink:href")]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if data.strip():
            self.words.append(data.strip())
            if self.rows and "table" in self.open and "tr" in self.open:
                self.rows[-1].append(data.strip())


def test_the_page_loads_nothing_from_anywhere(report):
    page = Page(report.page)
    assert page.open == []
    assert page.addresses
    beside = {a for a in page.addresses if not a.startswith(("data:", "#"))}
    assert beside == {f"media/{page}" for page in report.avatars}
    assert set(report.avatars) == {"studio-paper.html", "yard-paper.html"}
    text = re.sub(r"data:[^\"]+", "", report.page)
    outside = re.findall(r"(?:https?:)?//[^\s\"'<>)]+", text)
    assert set(outside) <= {"http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"}
    assert "@import" not in text
    assert "url(" not in re.sub(r"url\(#\w+\)", "", text)
    assert len(report.page) < 5_000_000


def test_the_page_shows_every_method_from_input_to_truth(report):
    page = Page(report.page)
    labels = page.words
    start = labels.index(INPUT)
    assert labels[start : start + 5] == [INPUT, "agnostic", "paper", "oracle", TRUTH]
    pictures = [address for address in page.addresses if address.startswith("data:image/jpeg")]
    assert len(pictures) == 2 * 2 * 5 + 1  # scenes, views, columns; one contact sheet
    assert sum(address.startswith("data:video/mp4") for address in page.addresses) == 1


def test_pictures_keep_their_proportions_at_any_width(report):
    style = re.search(r"\.strip img \{([^}]*)\}", report.page)[1]
    assert "width: 100%" in style
    assert "height: auto" in style


def test_the_page_has_the_numbers_of_the_files(report):
    rows = Page(report.page).rows
    paper = next(row for row in rows if row[0] == "paper")
    assert paper[1] == "25.00"
    assert "not measured" in paper
    assert "0.25" in paper  # recovery: one of four decibels
    assert "5.00" in paper  # to the ceiling


def test_the_summary_averages_methods_over_scenes_and_fills_in_recovery(report):
    summary = report.summary
    assert summary["methods"]["paper"]["scenes"] == ["studio", "yard"]
    assert summary["methods"]["ceiling"]["scenes"] == ["studio"]
    assert summary["methods"]["paper"]["image"]["psnr"] == 25.0
    assert summary["methods"]["paper"]["recovery"]["psnr"] == pytest.approx(0.25)
    assert summary["methods"]["paper"]["gap_to_ceiling_db"] == pytest.approx(5.0)
    assert summary["scenes"]["yard"]["paper"]["gap_to_ceiling_db"] is None
    assert summary["scenes"]["studio"]["paper"]["image"]["lpips_vgg"] is None


def test_experiments_are_compared_by_a_few_numbers(project):
    made(project).save(project / "reports")
    content = json.loads((project / "reports" / "metrics.json").read_text())
    assert set(content) == {"studio", "yard"}
    assert content["yard"]["paper"] == {
        "psnr": 25.0, "recovery": pytest.approx(0.25), "reblur_psnr": None, "train_s": 100.0,
    }  # fmt: skip


def test_the_page_shows_both_charts_and_what_snapshots_told(project):
    report = made(project)
    assert report.page.count("<svg") == 2
    assert report.summary["scenes"]["studio"]["paper"]["speed"] == {
        "disk_mb": 1.5, "time_to_paper_s": 25.0, "pareto": True,
    }  # fmt: skip
    (project / "metrics/learning_curve/studio-paper.json").unlink()
    report = made(project)
    assert report.page.count("<svg") == 1
    report.save(project / "reports")
    assert json.loads((project / "reports/media/quality_over_time.json").read_text()) == []
    assert not (project / "reports/media/quality_over_time.svg").exists()


def test_equal_results_give_equal_bytes(project, monkeypatch):
    monkeypatch.setattr(pipeline_report, "chart_files", chart_files)  # drawn each time
    for name in ("a", "b"):
        made(project).save(project / name)
    files = sorted(p.relative_to(project / "a").as_posix() for p in (project / "a").rglob("*.*"))
    media = [
        *(f"quality_over_time.{kind}" for kind in ("json", "png", "svg")),
        *(f"speed_accuracy.{kind}" for kind in ("json", "png", "svg")),
        "strip.png", "studio-paper.html", "yard-paper.html",
    ]  # fmt: skip
    beside = [f"media/{name}" for name in media]
    assert files == ["index.html", *beside, "metrics.json", "summary.json", "table.md"]
    for name in files:
        assert (project / "a" / name).read_bytes() == (project / "b" / name).read_bytes(), name


def test_the_table_for_the_readme_has_one_part_a_scene(report):
    text = report.tables
    assert text.index("**studio**") < text.index("**yard**")
    assert "| `paper` | **25.00** |" in text
    assert "LPIPS" not in text  # nobody measured it
    assert "to ceiling" not in text[text.index("**yard**") :]


def test_scenes_that_saw_the_same_methods_are_averaged_with_their_spread(project):
    assert "Mean over" not in made(project).tables  # two scenes, and not the same methods
    for scene, gain in (("a", 0.0), ("b", 1.0), ("c", 2.0)):
        for method in ("oracle", "agnostic"):
            write_result(project / "repeated", scene, method, PSNR[method] + gain)
    report = made(project, "repeated")
    title = "Mean over 3 scenes \u00b1 standard deviation"
    assert report.tables.startswith(f"**{title}**")
    assert "| `agnostic` | 25.00 \u00b1 1.00 |" in report.tables
    page = Page(report.page)
    assert title in page.words
    assert "25.00 \u00b1 1.00" in page.words


def test_nothing_at_all_is_still_a_page(tmp_path):
    report = made(tmp_path)
    assert "No results yet" in report.page
    assert Page(report.page).open == []
    assert report.strip is None
    assert report.log == "no results yet; `make repro` makes them"
    report.save(tmp_path / "reports")


def test_a_run_without_pictures_has_its_numbers(project):
    for path in (project / "evaluate/yard-paper").iterdir():
        path.unlink()
    (project / "evaluate/yard-paper").rmdir()
    report = made(project)
    assert sum(row[0] == "paper" for row in Page(report.page).rows) > 2
    assert report.page.count("Without pictures of") == 1
    assert "Without pictures of paper:" in report.page


def test_a_report_is_made_from_metrics_alone_and_names_the_strips_that_are_missing(project, report):
    for folder in ("evaluate", "animate"):
        shutil.rmtree(project / folder)
    alone = made(project)
    assert alone.strip is None
    assert "Without pictures of oracle, agnostic, paper:" in alone.page
    assert "<img" not in alone.page
    assert (alone.tables, alone.charts, alone.summary) == (
        report.tables, report.charts, report.summary,
    )  # fmt: skip
    assert "Without pictures" not in report.page


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("metrics/yard/paper.json", "{", r"cannot read .*yard/paper\.json"),
        ("metrics/yard/paper.json", "[1]", r"yard/paper\.json holds a list"),
        ("evaluate/yard-paper/views.json", "{", r"views\.json is damaged"),
        ("evaluate/yard-paper/views.json", '[{"camera": 1}]', r"views\.json is damaged"),
        ("evaluate/yard-paper/2-r.png", "", r"2-r\.png is not a picture"),
    ],
)
def test_a_damaged_file_is_named(project, name, content, message):
    (project / name).write_text(content)
    with pytest.raises(ArtifactError, match=message):
        made(project)


VIEW = {
    "camera": "left", "frame": 2, "novel_pose": False, "render": "2-r.png", "truth": "t.png",
    "blurred": "2-b.png",
}  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "place"),
    [
        *(({name: None}, f"0.{name}") for name in VIEW if name != "truth"),
        ({"frame": "2"}, r"0\.frame"),
        ({"novel_pose": 1}, r"0\.novel_pose"),
        ({"render": ["2-r.png"]}, r"0\.render"),
        ({"truth": ["t.png"]}, r"0\.truth"),
        ({"blurred": "../yard-agnostic/2-b.png"}, r"0\.blurred"),
        ({"blurred": "2\x00.png"}, r"0\.blurred"),
        ({"render": ""}, r"0\.render"),
    ],
)
def test_an_entry_of_views_that_is_none_is_named(project, changes, place):
    view = {key: value for key, value in {**VIEW, **changes}.items() if value is not None}
    write_json(project / "evaluate/yard-paper/views.json", [view])
    with pytest.raises(ArtifactError, match=rf"yard-paper/views\.json is damaged: {place}: "):
        made(project)


def test_names_from_files_cannot_change_the_page(project):
    name = "<script>alert(1)</script>"
    views = json.loads((project / "evaluate/yard-paper/views.json").read_text())
    for method in ("oracle", "agnostic", "paper"):
        renamed = [{**view, "camera": name} for view in views]
        write_json(project / f"evaluate/yard-{method}/views.json", renamed)
    assert name not in made(project).page


def test_only_views_that_all_methods_drew_are_lined_up(project):
    path = project / "evaluate/studio-agnostic/views.json"
    write_json(path, json.loads(path.read_text())[:1])
    folders = {m: project / "evaluate" / f"studio-{m}" for m in PSNR}
    strips = strips_of_scene(folders, max_strips=4)
    assert len(strips) == 1
    assert list(strips[0].pictures) == [INPUT, "agnostic", "paper", "oracle", TRUTH]
    assert "frame 2" in strips[0].caption
    assert not strips[0].novel_pose


def test_every_picture_of_a_strip_shows_the_person_large_and_in_the_same_place(project):
    folders = {m: project / "evaluate" / f"studio-{m}" for m in PSNR}
    strip = strips_of_scene(folders, max_strips=1)[0]
    boxes = {label: person_box([picture]) for label, picture in strip.pictures.items()}
    left, top, right, bottom = boxes[TRUTH]
    # Twelve rows of twenty, enlarged no more than twofold: 24 rows and a margin.
    assert 20 <= bottom - top <= 32
    assert abs((left + right) - strip.pictures[TRUTH].shape[1]) <= 4
    for label in ("agnostic", "paper", "oracle"):
        assert max(abs(a - b) for a, b in zip(boxes[label], boxes[TRUTH], strict=True)) <= 2


def test_strips_are_spread_over_the_views(project):
    for method in PSNR:
        folder = project / "evaluate" / f"studio-{method}"
        view = json.loads((folder / "views.json").read_text())[0]
        write_json(folder / "views.json", [{**view, "frame": frame} for frame in range(9)])
    folders = {m: project / "evaluate" / f"studio-{m}" for m in PSNR}
    frames = [
        re.search(r"frame (\d+)", s.caption)[1] for s in strips_of_scene(folders, max_strips=3)
    ]
    assert frames == ["0", "4", "8"]


def test_all_columns_are_cut_alike_to_the_person():
    dim = np.full((30, 30, 3), 40, np.uint8)
    dim[10:20, 12:18] = 200
    shifted = np.roll(dim, 3, axis=1)
    assert person_box([dim]) == (11, 9, 19, 21)
    assert person_box([dim, shifted]) == (11, 9, 22, 21)
    assert person_box([np.full((30, 20, 3), 9, np.uint8)]) == (0, 0, 20, 30)


def test_the_strip_of_the_readme_is_a_picture_of_all_columns(project):
    made(project).save(project / "reports")
    picture = read_picture(project / "reports/media/strip.png")
    assert picture.shape[1] > 5 * 200


def test_filmed_scenes_show_what_alignment_of_colours_changes():
    one = {"left": {"psnr_seen": 21.0}}
    filmed = {"color_aligned": {"cameras": one}, "body_iou": {"left": 0.91}}
    tables = tables_of({"agnostic": result("s", "agnostic", 20.0, **filmed)}, {})
    (table,) = [t for t in tables if t and t.title == "Camera by camera, colours aligned"]
    text = markdown(table)
    assert "21.00" in text
    assert "0.91" in text
    plain_tables = tables_of({"agnostic": result("s", "agnostic", 20.0)}, {})
    assert "colours aligned" not in " ".join(t.title for t in plain_tables if t)


def test_what_fails_its_check_or_its_self_check_is_told_of_on_top(project):
    good = vars(judged(Scale(0.02, 0.1, "share", "look at the masks"), 0.01))
    bad = vars(judged(Scale(0.02, 0.1, "share", "look at the masks"), 0.3))
    for method, found in (("paper", bad), ("oracle", good)):
        content = {"verdict": found["verdict"], "findings": {"outside_filmed": found}}
        write_json(project / f"metrics/self_check/studio-{method}.json", content)
    page = made(project).page
    before = page.split('<div class="figures">')[0]
    assert "studio-paper fails its self-check; do not trust what it shows" in before
    assert "Outside filmed: 0.3 (share). look at the masks" in before
    assert "studio-oracle fails" not in page
    assert "studio fails" not in page
    content = {"verdict": "fail", "findings": {"person_share": bad}}
    write_json(project / "metrics/check/studio.json", content)
    page = made(project).page
    assert (
        "studio fails its check; look before you trust what it shows"
        in page.split('<div class="figures">')[0]
    )
    (project / "metrics/self_check/studio-paper.json").write_text("{}")
    with pytest.raises(ArtifactError, match=r"studio-paper\.json is damaged"):
        made(project)


def test_no_picture_of_a_hidden_scene_leaves_the_machine(project, tmp_path):
    runs = {f"{s}-{m}": run_of(s, m) for s in ("studio", "yard") for m in METHODS}
    folders = project / "metrics", project / "evaluate", project / "animate"
    exports = {"exports": project / "export", "exported": list(runs)}

    def pictures(hidden):
        report = make_report(runs, list(runs), *folders, hidden, **exports)
        report.save(tmp_path / "-".join(["reports", *hidden]))
        return report.page.count("data:image"), report.page.count("data:video")

    everything, yard = pictures(()), pictures(("yard",))
    assert 0 < yard[0] < everything[0]
    without = make_report(runs, list(runs), *folders, ("yard",), **exports)
    assert "may not be passed on" in without.page
    assert pictures(("studio", "yard")) == (0, 0)
    assert not (tmp_path / "reports-studio-yard/media/strip.png").exists()
    assert (tmp_path / "reports-yard/media/strip.png").exists()
    assert (tmp_path / "reports/media/yard-paper.html").exists()
    assert not list(tmp_path.glob("reports-*yard/media/yard-*.html"))
    assert "yard-paper.html" not in without.page


def test_few_cameras_are_shown_apart_and_many_are_not():
    def titles_with(count):
        cameras = {f"cam{i}": {"psnr": 20.0} for i in range(count)}
        found = tables_of({"agnostic": result("s", "agnostic", 20.0, cameras=cameras)}, {})
        return [table.title for table in found]

    assert "Camera by camera" in titles_with(3)
    assert "Camera by camera" not in titles_with(8)
    assert "Camera by camera" not in titles_with(1)


def test_tables_that_nobody_measured_are_left_out():
    bare = {"scene": "s", "method": "agnostic", "image": {"psnr": 20.0}}
    assert [table.title for table in tables_of({"agnostic": bare}, {})] == ["Novel views"]


def test_the_poses_before_fitting_stand_first_and_are_not_ranked():
    results = {
        "agnostic": result("s", "agnostic", 20.0), "paper": result("s", "paper", 21.0),
    }  # fmt: skip
    results["paper"]["motion"] = {"joint_error_mm": 15.0}
    table = next(t for t in tables_of(results, {}) if t.title == "Motion against the truth")
    assert [row for row, _ in table.rows] == ["initial", "agnostic", "paper"]
    assert [cells[0].text for _, cells in table.rows] == ["14.0", "10.0", "15.0"]
    assert [cells[0].rank for _, cells in table.rows] == [None, 1, 2]


def test_fitted_bodies_are_shown_camera_by_camera():
    preprocess = {"fit": {"cam01": {"reprojection_px": 4.61, "iou": 0.85, "offset_px": [0, 1]}}}
    table = tables_of({"agnostic": result("s", "agnostic", 20.0)}, preprocess)[-1]
    assert table.of == "camera"
    assert [cell.text for cell in table.rows[0][1]] == ["4.6", "0.850"]


def test_facts_are_said_as_far_as_they_are_known():
    blur = {
        "window": 33, "averaging_space": "linear", "exposure_ms": 68.75, "blur": None,
        "interpolation": {"psnr": 41.67, "psnr_person": None},
    }  # fmt: skip
    preprocess = {"frames": {"train": 70, "validation": 8, "without_person": 2}}
    assert facts_of(blur, preprocess) == [
        "70 frames train, 8 validate", "2 frames without a person left out",
        "shutter open for 69 ms", "33 sub-frames averaged as linear light",
        "interpolated frames match held-out ones at 41.7 dB",
    ]  # fmt: skip
    assert facts_of({}, {}) == []


def test_an_estimated_shutter_is_a_fact(project):
    untrue(project, "paper", 30.0)
    untrue(project, "lean", 31.0)
    path = project / "metrics" / "mine" / "lean.json"
    write_json(path, json.loads(path.read_text()) | {"shutter_s": 0.0309})
    assert "lean finds that the shutter was open for 30.9 ms" in made(project).page
    assert made(project).page.count("finds that the shutter") == 1


def untrue(project, method, explained):
    """A scene of a user's own video: nothing but blurred frames to compare with."""
    content = result("mine", method, 0.0) | {
        "image": None, "novel_pose": None, "cameras": {}, "counts": {"novel_views": 0},
        "motion": {"joint_error_mm": None}, "initial": {"joint_error_mm": None},
        "reblur": {"psnr": explained, "psnr_train": explained + 1},
    }  # fmt: skip
    write_json(project / "metrics" / "mine" / f"{method}.json", content)
    folder = project / "evaluate" / f"mine-{method}"
    names = {"render": "r.png", "blurred": "b.png", "averaged": "a.png"}
    for name in names.values():
        write_picture(folder / name, person(200))
    write_json(folder / "views.json", [{"camera": "c", "frame": 3, "novel_pose": False, **names}])


def test_a_scene_without_truth_says_how_well_its_blurred_frames_are_explained(project):
    untrue(project, "lean", 31.25)
    untrue(project, "agnostic", 29.0)
    report = made(project)
    page = Page(report.page)
    assert "This footage has no sharp truth" in report.page
    assert "| `lean` | **31.25** |" in report.tables
    assert "31.25" in report.log
    assert not page.open
    (strip,) = strips_of_scene({"lean": project / "evaluate" / "mine-lean"}, 4)
    assert list(strip.pictures) == [INPUT, "lean"]
    assert report.summary["methods"]["lean"]["recovery"]["psnr"] is None
    assert {row["scene"] for row in json.loads(report.charts["speed_accuracy.json"])} == {
        "studio",
        "yard",
    }


@pytest.mark.parametrize("points", [None, 3, [1], [{"stage": "fusion"}]])
def test_a_damaged_learning_curve_is_named_with_what_to_do(project, points):
    path = project / "metrics/learning_curve/studio-paper.json"
    write_json(path, {"scene": "studio", "method": "paper", "points": points})
    with pytest.raises(ArtifactError, match=r"studio-paper\.json is damaged.*dvc repro"):
        made(project)


def test_of_each_scene_the_best_method_that_has_a_page_can_be_turned(project):
    report = made(project)  # the oracle is better, and a bound
    assert report.avatars["yard-paper.html"] == b"<title>yard-paper</title>a page"
    assert 'data-page="media/yard-paper.html"' in report.page
    assert "Turn the avatar of paper by hand" in report.page
    shutil.rmtree(project / "export/yard-paper")
    assert sorted(made(project).avatars) == ["studio-paper.html", "yard-agnostic.html"]
    for name in ("agnostic", "oracle"):
        (project / f"export/yard-{name}/avatar.html").rename(project / f"export/yard-{name}/a.ply")
    assert sorted(made(project).avatars) == ["studio-paper.html"]


def test_without_a_sharp_truth_the_best_is_who_explains_blurred_frames_best(project):
    untrue(project, "lean", 31.25)
    untrue(project, "agnostic", 29.0)
    for method in ("agnostic", "lean"):
        write_page(project, f"mine-{method}")
    assert "mine-lean.html" in made(project).avatars


def test_a_page_that_is_too_large_to_go_along_stays_where_it_is(project):
    write_page(project, "yard-paper", "x" * MAX_BYTES)
    report = made(project)
    assert sorted(report.avatars) == ["studio-paper.html"]
    assert "yard-paper.html" not in report.page


def test_files_of_other_runs_are_ignored(project):
    report = made(project)
    write_result(project / "metrics", "studio", "gone", 40.0)
    write_result(project / "metrics", "attic", "paper", 40.0)
    old = {"scene": "yard", "method": "paper", "disk_mb": 9.0, "points": []}
    write_json(project / "metrics/learning_curve/attic-paper.json", old)
    shutil.copytree(project / "animate/studio-paper", project / "animate/studio-gone")
    write_page(project, "studio-gone")
    for scene in ("studio", "yard"):
        for method in ("agnostic", "oracle"):
            shutil.rmtree(project / f"export/{scene}-{method}")
    runs = {
        f"{scene}-{method}": run_of(scene, method)
        for scene, methods in report.summary["scenes"].items()
        for method in methods
    }
    folders = project / "evaluate", project / "animate"
    exports = {"exports": project / "export", "exported": ["studio-paper", "yard-paper"]}
    again = make_report(runs, ["studio-paper"], project / "metrics", *folders, **exports)
    assert again.summary == report.summary
    assert again.charts == report.charts
    assert again.page == report.page


def test_results_of_another_run_in_a_run_s_place_are_refused(project):
    write_json(project / "metrics/yard/paper.json", result("yard", "lean", 30.0))
    with pytest.raises(ArtifactError, match=r"yard/paper\.json is not of paper on yard"):
        made(project)


def test_costs_come_from_their_own_files(project):
    cost = made(project).summary["scenes"]["studio"]["paper"]["cost"]
    assert cost == {
        "train_s": 100.0, "warmup_s": 0.0, "trajectory_s": 0.0, "fusion_s": 100.0,
        "peak_memory_mb": 300.0, "render_fps": 50.0,
    }  # fmt: skip


def test_what_was_estimated_stands_beside_its_truth():
    steps = {
        "mattes": {"iou": 0.875, "mae": 0.016}, "focal": {"estimated_px": 831.4, "true_px": 739.1},
        "poses": {
            "initial": {"rooted_mm": 101.1, "registered_mm": 88.8},
            "fitted": {"rooted_mm": 100.4, "registered_mm": 88.9, "depth_ratio": 1.096},
        },
    }  # fmt: skip
    own = result("s", "lean", 17.0) | {"steps": steps, "in_true_poses": {"psnr_seen": 13.5}}
    table = next(t for t in tables_of({"lean": own}, {}) if t.title == "What was estimated")
    texts = [cell.text for cell in table.rows[0][1]]
    assert texts == [
        "0.875", "0.0160", "831", "739", "101.1", "100.4", "88.8", "88.9", "1.096", "13.50",
    ]  # fmt: skip
    bare = tables_of({"lean": result("s", "lean", 17.0)}, {})
    assert "What was estimated" not in [t.title for t in bare]
