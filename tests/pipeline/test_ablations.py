import json

import pytest

from deblur_avatar.errors import ArtifactError
from deblur_avatar.pipeline.ablations import report_ablations
from tests.measured_costs import run_of, write_costs


def write(folder, seed, method, psnr):
    path = folder / f"seed_{seed}" / "metrics" / "studio" / f"{method}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    content = {"scene": "studio", "method": method, "image": {"psnr": psnr, "lpips_vgg": None}}
    path.write_text(json.dumps(content))
    write_costs(folder / f"seed_{seed}" / "metrics", run_of("studio", method), 100.0 + seed)


def watch(folder, seed, method, curve):
    """Write a learning curve: seconds and PSNR after 10, 20, ... iterations."""
    path = folder / f"seed_{seed}" / "metrics" / "learning_curve" / f"studio-{method}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    points = [
        {"stage": "fusion", "iteration": 10 * place,
         "image": {"psnr": psnr}, "validation_psnr": psnr + 5}
        for place, (_, psnr) in enumerate(curve, 1)
    ]  # fmt: skip
    content = {"scene": "studio", "method": method, "disk_mb": 1.0 + seed, "points": points}
    path.write_text(json.dumps(content))
    times = {10 * place: seconds for place, (seconds, _) in enumerate(curve, 1)}
    metrics = folder / f"seed_{seed}" / "metrics"
    write_costs(metrics, run_of("studio", method), 100.0 + seed, times)


def gathered(folder):
    """The report over all seeds and runs that have results."""
    folders = sorted(folder.glob("seed_*"))
    names = {path.stem for path in folder.glob("seed_*/metrics/studio/*.json")}
    runs = {f"studio-{name}": run_of("studio", name) for name in names}
    return report_ablations(folders, runs, "studio", "medium")


@pytest.fixture
def watched(results):
    for seed in (0, 1):
        watch(results, seed, "paper", [(2.0, 20.0 + seed), (8.0, 26.0 + seed)])
        watch(results, seed, "agnostic", [(1.0, 25.0 + seed), (4.0 + seed, 28.0 + seed)])
        watch(results, seed, "oracle", [(1.0, 20.0), (2.0, 22.0)])
    return results


@pytest.fixture
def results(tmp_path):
    for seed, gain in ((0, 1.0), (1, 2.0)):
        write(tmp_path, seed, "oracle", 30.0 + seed)
        write(tmp_path, seed, "agnostic", 26.0 + seed)
        write(tmp_path, seed, "paper", 26.0 + seed + gain)
    return tmp_path


def test_numbers_are_means_and_spreads_over_seeds(results):
    report = gathered(results)
    paper = report.summary["methods"]["paper"]
    assert paper["image_psnr"] == {"mean": 28.0, "std": pytest.approx(2**0.5)}
    assert paper["seeds"] == 2
    assert "| full | 28.00 \u00b1 1.41 |" in report.tables


def test_recovery_is_taken_within_each_seed(results):
    report = gathered(results)
    share = report.summary["methods"]["paper"]["recovery_psnr"]
    assert share["mean"] == pytest.approx((0.25 + 0.5) / 2)


def test_the_papers_numbers_stand_beside_marked_as_of_other_data(results):
    report = gathered(results)
    assert "30.24" in report.tables
    assert "another data set" in report.tables
    assert "another data set" in report.page
    assert 'class="other">30.24' in report.page


def test_what_nobody_ran_has_no_row_and_what_nobody_measured_no_number(results):
    report = gathered(results)
    assert "cubic" not in report.tables
    assert "not measured" in report.tables


def test_one_seed_has_no_spread(tmp_path):
    write(tmp_path, 0, "agnostic", 26.0)
    write(tmp_path, 0, "paper", 28.0)
    report = gathered(tmp_path)
    assert report.summary["methods"]["paper"]["image_psnr"] == {"mean": 28.0, "std": None}
    assert "| full | 28.00 |" in report.tables


def test_no_results_at_all_are_refused(tmp_path):
    with pytest.raises(ArtifactError, match="no results of studio"):
        gathered(tmp_path)


def test_files_are_written_for_reading_and_for_dvc(results, tmp_path):
    gathered(results).save(tmp_path / "out")
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "index.html", "tables.md", "summary.json", "speed_accuracy.json", "speed_accuracy.png",
        "speed_accuracy.svg", "quality_over_time.json",
    }  # fmt: skip
    assert "<svg" in (tmp_path / "out/index.html").read_text()


def test_the_chart_has_means_between_their_spreads_and_the_front_of_the_means(results):
    charts = gathered(results).charts
    rows = {row["method"]: row for row in json.loads(charts["speed_accuracy.json"])}
    assert rows["paper"]["psnr_db"] == 28.0
    assert rows["paper"]["psnr_high_db"] == pytest.approx(28.0 + 2**0.5, abs=1e-3)
    assert rows["paper"]["psnr_low_db"] == pytest.approx(28.0 - 2**0.5, abs=1e-3)
    assert rows["paper"]["training_s"] == 100.5
    assert [method for method, row in rows.items() if row["pareto"]] == ["paper"]


def test_a_disk_that_refuses_leaves_every_file_whole(results, tmp_path, monkeypatch):
    folder = tmp_path / "out"
    report = gathered(results)
    report.save(folder)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert not any(name.endswith(".part") for name in before)

    def half(path, content):
        with path.open("wb") as file:
            file.write(content[: len(content) // 2])
        raise OSError("disk full")

    monkeypatch.setattr(type(folder), "write_bytes", half)
    with pytest.raises(ArtifactError, match=r"cannot write .*out/.*: disk full"):
        report.save(folder)
    assert before == {path.name: path.read_bytes() for path in folder.iterdir()}


def test_curves_are_means_over_seeds_at_the_same_iteration(watched):
    charts = gathered(watched).charts
    rows = [row for row in json.loads(charts["quality_over_time.json"])
            if (row["method"], row["measure"]) == ("agnostic", "novel views")]  # fmt: skip
    assert [(row["iteration"], row["training_s"], row["psnr_db"]) for row in rows] == [
        (10, 1.0, 25.5), (20, 4.5, 28.5),
    ]  # fmt: skip
    assert {"quality_over_time.svg", "quality_over_time.png"} <= charts.keys()


def test_when_a_method_is_as_good_as_paper_is_read_off_the_mean_curves(watched):
    report = gathered(watched)
    (line,) = (text for text in report.tables.splitlines() if "without motion" in text)
    reached = report.summary["methods"]["agnostic"]["speed_time_to_paper_s"]["mean"]
    assert reached == pytest.approx(4.5 ** (1 / 3))  # a third of the way from 25.5 to 28.5
    assert "| 2 |" in line
    assert report.summary["methods"]["agnostic"]["speed_disk_mb"]["mean"] == 1.5


def test_a_method_that_never_is_as_good_as_paper_says_so(watched):
    (line,) = (
        text for text in gathered(watched).tables.splitlines() if text.startswith("| oracle")
    )
    assert "| never |" in line


def test_without_avatars_kept_on_the_way_nothing_is_said_to_be_never(results):
    report = gathered(results)
    assert "never" not in report.tables
    assert "quality_over_time.svg" not in report.charts
    assert "Quality over training time" not in report.page


def test_seeds_that_were_looked_at_at_other_iterations_are_refused(watched):
    watch(watched, 1, "agnostic", [(1.0, 25.0)])
    with pytest.raises(ArtifactError, match="agnostic was looked at after other iterations"):
        gathered(watched)
