"""The report: all results on one page, as one summary and as one table.

Works on whatever scenes and methods there are, and from metrics alone: strips of pictures that are
not on this machine are named on the page. Equal results give equal bytes: no dates, no hosts.
"""

import logging
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from deblur_avatar.config.runs import RunParams
from deblur_avatar.errors import ArtifactError
from deblur_avatar.evaluation.costs import cost_files, read_costs, with_seconds
from deblur_avatar.evaluation.findings import failed_checks
from deblur_avatar.evaluation.recovery import (
    compared,
    pooled,
    standard_deviations,
)
from deblur_avatar.files import read_json, write_bytes, write_json
from deblur_avatar.imaging.picture_files import read_picture, write_picture
from deblur_avatar.reporting.avatar_pages import AvatarPage, best_page
from deblur_avatar.reporting.charts import CHARTS, chart_files
from deblur_avatar.reporting.page import data_uri, picture_uri, render_page
from deblur_avatar.reporting.picture_strips import (
    LEFT_OUT,
    Picture,
    Strip,
    strip_sheet,
    strips_of_scene,
)
from deblur_avatar.reporting.report_tables import (
    NOT_KNOWN,
    estimated_shutters,
    facts_of,
    tables_of,
)
from deblur_avatar.reporting.results_table import (
    BOUNDS,
    NOT_MEASURED,
    Table,
    look_up,
    markdown,
    method_order,
    plain,
    results_table,
    short_columns,
)
from deblur_avatar.reporting.sortable_tables import sorting
from deblur_avatar.reporting.speed_accuracy import rows_of_methods, rows_over_time, with_speed

logger = logging.getLogger(__name__)

TEMPLATE = Path(__file__).parent / "report.html.jinja"
STRIPS = 4  # of each scene on the page
README_STRIPS = 2
REPEATS = 3  # scenes that saw the same methods, before a mean over them is shown
MAX_VIDEO = 1_500_000  # bytes; a longer one stays out of the page
# What `dvc metrics diff` and `dvc exp show` compare, of each scene and method.
DECLARED = {
    "psnr": ("image", "psnr"),
    "recovery": ("recovery", "psnr"),
    "reblur_psnr": ("reblur", "psnr"),
    "train_s": ("cost", "train_s"),
}
MOMENT = {"stage", "iteration"}  # what each point of a learning curve has at least
MEDIA = "media"  # folder of what a page shows, beside it
SHEET_WIDTH = 900  # pixels of an animation's contact sheet on the page

Results = dict[str, dict[str, Any]]  # by method


@dataclass(frozen=True)
class Report:
    """What is written to `reports/`; what a page shows lies in its `media`."""

    page: str
    summary: dict[str, Any]
    tables: str  # Markdown
    charts: dict[str, bytes]  # files by name
    strip: Picture | None  # for the README
    avatars: dict[str, bytes]  # pages to turn by hand, files by name
    log: str  # for a terminal

    def save(self, folder: Path) -> None:
        """Write the page, `summary.json`, `metrics.json`, `table.md`, and in `media` the avatars'
        pages, the charts and `strip.png`.

        A chart is its rows (`.json`, for `dvc plots show`) and its picture (`.svg`, `.png`);
        without rows it is an empty list alone.

        Raises:
            ArtifactError: if the disk refuses.
        """
        files = {"index.html": self.page.encode(), "table.md": self.tables.encode()}
        media = {
            f"{MEDIA}/{file}": content for file, content in (self.charts | self.avatars).items()
        }
        for file, content in (files | media).items():
            write_bytes(folder / file, content)
        write_json(folder / "summary.json", self.summary)
        write_json(folder / "metrics.json", declared(self.summary["scenes"]))
        if self.strip is not None:
            write_picture(folder / MEDIA / "strip.png", self.strip)


def make_report(
    runs: Mapping[str, RunParams], animated: Collection[str], metrics: Path, pictures: Path,
    animations: Path, hidden: Collection[str] = (), *, exports: Path, exported: Collection[str],
) -> Report:  # fmt: skip
    """Read the results of these runs and put them on one page; nothing else that lies there counts.

    Args:
        runs: by name, `<scene>-<method>`; those without results are left out.
        animated: those that were animated.
        metrics: `<scene>/<method>.json`, and `blur/<scene>.json`, `preprocess/<scene>.json`,
            `check/<scene>.json`, `learning_curve/<run>.json`, `cost/<stage>/<item>.json` and so on.
        pictures: what `evaluate` drew, one folder a run; runs without one have no strip.
        animations: what `animate` drew, one folder a run.
        hidden: scenes of which no picture may be shown, in no page either.
        exports: what `export` wrote, one folder a run.
        exported: those that were exported.

    Raises:
        ArtifactError: if a file is damaged; names it.
    """
    shown = {name: animations / name for name in animated if runs[name].scene not in hidden}
    curves = read_learning_curves(metrics, runs)
    scenes = {
        scene: with_speed(compared(results), curves.get(scene, {}))
        for scene, results in read_results(metrics, runs).items()
    }
    strips = {s: _strips(s, results, pictures, hidden) for s, results in scenes.items()}
    avatars = _avatars(scenes, hidden, exports, exported)
    charts = _charts(scenes, curves)
    repeated = _repeated(scenes)
    main = _main_tables(scenes, repeated)
    page = render_page(
        TEMPLATE,
        headline=_headline(scenes),
        failed=failed_checks(metrics, sorted({r.scene for r in runs.values()}), sorted(runs)),
        machine=_machine(scenes),
        media=MEDIA,
        charts={name: charts[f"{name}.svg"].decode() for name in CHARTS if f"{name}.svg" in charts},
        quiet=(NOT_MEASURED, NOT_KNOWN),
        repeated=repeated,
        sorting=sorting(),
        scenes=[
            _section(scene, results, strips[scene], metrics, pictures)
            | {
                "hidden": scene in hidden,
                "avatar": avatars.get(scene),
                "animations": _animations(scene, results, shown),
            }
            for scene, results in scenes.items()
        ],
    )
    return Report(
        page=page,
        summary=_summary(scenes),
        tables="".join(f"**{scene}**\n\n{markdown(table)}\n" for scene, table in main.items()),
        charts=charts,
        strip=_readme_strip(strips),
        avatars={page.file: page.content for page in avatars.values()},
        log=_log(main),
    )


def _charts(scenes: Mapping[str, Results], curves: Mapping[str, Results]) -> dict[str, bytes]:
    charts = chart_files("speed_accuracy", rows_of_methods(scenes))
    return charts | chart_files("quality_over_time", rows_over_time(curves))


def _avatars(
    scenes: Mapping[str, Results], hidden: Collection[str], exports: Path, exported: Collection[str]
) -> dict[str, AvatarPage]:
    """The pages to turn by hand, of scenes that may be shown and have one."""
    shown = {scene: results for scene, results in scenes.items() if scene not in hidden}
    pages = {s: best_page(s, results, exports, exported) for s, results in shown.items()}
    return {scene: page for scene, page in pages.items() if page is not None}


def _main_tables(scenes: Mapping[str, Results], repeated: Table | None) -> dict[str, Table]:
    """What stands in docs/results.md and on a terminal: means first, where there are any."""
    main = {} if repeated is None else {repeated.title: repeated}
    return main | {s: results_table(found, short_columns(found)) for s, found in scenes.items()}


def _section(
    scene: str, results: Results, strips: Sequence[Strip], metrics: Path, pictures: Path
) -> dict[str, Any]:
    """Facts, tables and strips of one scene."""
    preprocess = _read(metrics / "preprocess" / f"{scene}.json")
    return {
        "name": scene,
        "facts": facts_of(_read(metrics / "blur" / f"{scene}.json"), preprocess)
        + estimated_shutters(results),
        "strips": [_on_page(strip) for strip in strips],
        "tables": tables_of(results, preprocess),
        "without_pictures": _without_pictures(scene, results, pictures),
    }


def declared(scenes: Mapping[str, Results]) -> dict[str, Any]:
    """The few numbers that experiments are compared by, of each scene and method."""
    return {
        scene: {
            method: {name: look_up(result, path) for name, path in DECLARED.items()}
            for method, result in results.items()
        }
        for scene, results in scenes.items()
    }


def _repeated(scenes: Mapping[str, Results]) -> Table | None:
    """Means and deviations over scenes, where at least `REPEATS` saw the same methods."""
    if len(scenes) < REPEATS or len({frozenset(results) for results in scenes.values()}) > 1:
        return None
    methods = next(iter(scenes.values()))
    means = {method: pooled(scenes, method) for method in methods}
    deviations = {
        method: standard_deviations([results[method] for results in scenes.values()])
        for method in methods
    }
    title = f"Mean over {len(scenes)} scenes \u00b1 standard deviation"
    return results_table(means, short_columns(means), deviations=deviations, title=title)


def read_results(metrics: Path, runs: Mapping[str, RunParams]) -> dict[str, Results]:
    """Results of these runs by scene and method, with what they cost.

    Raises:
        ArtifactError: if a file is damaged.
    """
    scenes: dict[str, Results] = {}
    for run_params in sorted(runs.values(), key=lambda run_params: run_params.method):
        scene, method = run_params.scene, run_params.method
        path = metrics / scene / f"{method}.json"
        if path.exists():
            content = _read(path)
            if (content.get("scene"), content.get("method")) != (scene, method):
                raise ArtifactError(f"{path} is not of {method} on {scene}; run `dvc repro`")
            costs = read_costs(cost_files(metrics / "cost", run_params))
            last = {"cost": costs, "run": content.pop("run", {})}
            scenes.setdefault(scene, {})[method] = content | last
    # The scene with a known truth comes first: it says most.
    return dict(sorted(scenes.items(), key=lambda item: ("ceiling" not in item[1], item[0])))


def read_learning_curves(metrics: Path, runs: Mapping[str, RunParams]) -> dict[str, Results]:
    """The learning curves of these runs, by scene and method, with seconds.

    Raises:
        ArtifactError: if a file is damaged.
    """
    found: dict[str, Results] = {}
    for name, run_params in sorted(runs.items()):
        path = metrics / "learning_curve" / f"{name}.json"
        if path.exists():
            content = _read(path)
            points = content.get("points")
            if not isinstance(points, list) or not all(map(_is_moment, points)):
                raise ArtifactError(
                    f"{path} is damaged: its points must each have {', '.join(sorted(MOMENT))}; "
                    "run `dvc repro`"
                )
            curve = with_seconds(content, cost_files(metrics / "cost", run_params))
            found.setdefault(run_params.scene, {})[run_params.method] = curve
    return found


def _is_moment(point: Any) -> bool:
    return isinstance(point, dict) and point.keys() >= MOMENT


def _read(path: Path) -> dict[str, Any]:
    """A metrics file; empty if there is none."""
    return read_json(path) if path.exists() else {}


def _summary(scenes: Mapping[str, Results]) -> dict[str, Any]:
    methods = dict.fromkeys(method for results in scenes.values() for method in results)
    return {
        "methods": {method: pooled(scenes, method) for method in methods},
        "scenes": {scene: dict(results) for scene, results in scenes.items()},
    }


def _strips(scene: str, results: Results, pictures: Path, hidden: Collection[str]) -> list[Strip]:
    if scene in hidden:
        return []
    folders = {method: pictures / f"{scene}-{method}" for method in results}
    return strips_of_scene({m: f for m, f in folders.items() if f.is_dir()}, STRIPS)


def _without_pictures(scene: str, results: Results, pictures: Path) -> list[str]:
    """Methods whose pictures are not on this machine, though their numbers are."""
    shown = [method for method in method_order(results) if method not in LEFT_OUT]
    return [method for method in shown if not (pictures / f"{scene}-{method}").is_dir()]


def _readme_strip(strips: Mapping[str, Sequence[Strip]]) -> Picture | None:
    """A few strips of the first scene that has any."""
    for found in strips.values():
        if found:
            return strip_sheet(found[:README_STRIPS])
    return None


def _headline(scenes: Mapping[str, Results]) -> list[dict[str, str]]:
    """For each scene the method that wins back most."""
    figures = []
    for scene, results in scenes.items():
        shares = {
            method: share
            for method, result in results.items()
            if method not in (*BOUNDS, "agnostic")
            and (share := look_up(result, ("recovery", "psnr"))) is not None
        }
        if shares:
            best = max(shares, key=lambda method: shares[method])
            figures.append(
                {
                    "number": f"{shares[best]:.2f}".replace("-", "\u2212"),
                    "caption": f"recovery of {best} on {scene}",
                }
            )
        cost = _cost_of_blur(results)
        if cost is not None and cost > 0:
            figures.append({"number": f"{cost:.1f} dB", "caption": f"what blur costs on {scene}"})
    return figures


def _cost_of_blur(results: Results) -> float | None:
    sharp, blurred = (
        look_up(results.get(method, {}), ("image", "psnr")) for method in ("oracle", "agnostic")
    )
    return None if sharp is None or blurred is None else sharp - blurred


def _machine(scenes: Mapping[str, Results]) -> str:
    """On what and how long the results were trained, as far as all agree."""
    runs = [result.get("run", {}) for results in scenes.values() for result in results.values()]
    devices = sorted({str(entry["device"]) for entry in runs if "device" in entry})
    schedules = sorted({str(entry["schedule"]) for entry in runs if "schedule" in entry})
    words = {"cpu": "a CPU", "cuda": "a GPU"}
    device = " and ".join(words.get(device, device) for device in devices) or "one machine"
    return f"{device}, schedule {' and '.join(schedules)}" if schedules else device


def _animations(scene: str, results: Results, folders: Mapping[str, Path]) -> list[dict[str, str]]:
    shown = []
    for method in results:
        folder = folders.get(f"{scene}-{method}")
        if folder is not None and (sheet := folder / "contact_sheet.png").is_file():
            video = folder / "video.mp4"
            playable = video.is_file() and video.stat().st_size <= MAX_VIDEO
            shown.append(
                {
                    "sheet": picture_uri(_narrowed(read_picture(sheet))),
                    "video": data_uri(video.read_bytes(), "video/mp4") if playable else "",
                    "caption": f"{method}, driven by a motion that it was not trained on.",
                }
            )
    return shown


def _narrowed(picture: Picture) -> Picture:
    height, width = picture.shape[:2]
    if width <= SHEET_WIDTH:
        return picture
    size = (SHEET_WIDTH, round(height * SHEET_WIDTH / width))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA))


def _on_page(strip: Strip) -> dict[str, Any]:
    return {
        "caption": strip.caption,
        "pictures": [
            {
                "label": label, "uri": picture_uri(picture),
                "width": picture.shape[1], "height": picture.shape[0],
            }
            for label, picture in strip.pictures.items()
        ],
    }  # fmt: skip


def _log(main: Mapping[str, Table]) -> str:
    if not main:
        return "no results yet; `make repro` makes them"
    return "\n\n".join(f"{scene}\n{plain(table)}" for scene, table in main.items())
