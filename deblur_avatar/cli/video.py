"""From a video of one person to an avatar: a check, a page for any browser, a report.

Works in any folder and writes ./<name>/, in a checkout of the repository avatars/<name>/:

  avatar.html    the avatar in any browser: turn it, move it, open the shutter
  params.yaml    what was estimated from nothing; yours to change, then run the command again
  data/check/    is the clip fit for training? look at this first
  data/self_check/  is the avatar usable? the command's last line says so
  data/animate/  a video of what was filmed while the camera goes round
  data/export/   a rig, splats and motions for other programs
  reports/       how well blurred frames that were set aside are explained

DVC makes it step by step. Ctrl-C stops it; the same command goes on where it stopped, within a
step, too. Once all is made it says so and changes nothing.

With --preview there is a first avatar.html after the warm-up, a fifth of the way: open it, and load
it anew at the end.

Some minutes: five on two cores for 247 frames, most of them for masks and poses.
"""

import argparse
import importlib.util
import logging
import shutil
from pathlib import Path
from typing import Any

from deblur_avatar.body_estimation.pose_model import installed_model
from deblur_avatar.cli.avatar_params import BODY, PAGE, name_of, prepare
from deblur_avatar.cli.footage_contents import contents_of, followed_footage
from deblur_avatar.cli.homes import PARAMS, Home
from deblur_avatar.cli.run_on_disk import RunOnDisk
from deblur_avatar.cli.running_dvc import reproduce
from deblur_avatar.cli.setup import ALONE
from deblur_avatar.cli.shared_bodies import make_body
from deblur_avatar.config.reading import load_params, parse
from deblur_avatar.errors import ConfigError
from deblur_avatar.evaluation.findings import failures, read_findings
from deblur_avatar.exports.registry import ExportParams
from deblur_avatar.files import read_json

logger = logging.getLogger(__name__)

HARDLY = 0.5  # of the shutter's time that it may be off: from there on it is hardly known
EXAMPLES = """\
examples:
  deblur-avatar video clip.mp4
  deblur-avatar video clip.mp4 --name anna --schedule medium     a quick look: 192 pixels
  deblur-avatar export anna --format gltf_rig --out anna.glb     afterwards
  deblur-avatar view anna                                        afterwards, networks and all
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of the subcommand."""
    parser.epilog = EXAMPLES
    parser.add_argument("video", type=Path, help="a video file or a folder of pictures")
    parser.add_argument("--name", default="", help="of the avatar; default: after the file")
    parser.add_argument(
        "--method", default="lean",
        help="a row of the tables (default: lean); there is agnostic, no_motion, lean, paper, "
        "no_nonrigid, no_fusion, n3, n5, n7, n9, n13, cubic, learned, released, mad, mad_literal, "
        "network",
    )  # fmt: skip
    parser.add_argument(
        "--schedule",
        help="short, medium: 192 pixels; large (default, unless the avatar's file says another), "
        "fine (longer): 512; huge: 1024; full: the paper's",
    )  # fmt: skip
    parser.add_argument(
        "--preview", action="store_true", help="show a first avatar early, while the rest is fitted"
    )
    parser.add_argument(
        "--own-body", action="store_true",
        help="bake the body in this folder, take and leave none in the user's cache",
    )  # fmt: skip


def run(asked: argparse.Namespace) -> int:
    """Prepare and run; returns DVC's exit code.

    Raises:
        ConfigError: if something cannot be run as asked, is not installed, or `clip` names a file
            that is not there.
        ArtifactError: if the video cannot be read, or the disk refuses.
    """
    _check_installed()
    name = asked.name or name_of(asked.video)
    home = prepare(asked.video, name, asked.method, asked.schedule, Path())
    contents = contents_of(home.folder, name)
    run = f"{name}-{asked.method}"
    sharing = home.independent and not asked.own_body  # a checkout's avatars share one anyway
    code = make_body(home.folder, BODY) if sharing else 0
    if code == 0:
        with followed_footage(home, name, BODY, contents) as code:
            code = code or reproduce(*_better_poses(home.folder, name), folder=home.folder)
            code = code or _check(home.folder, name)
            code = code or (_first_look(home, run) if asked.preview else 0)
            code = code or reproduce(*targets(name, asked.method), folder=home.folder)
    if code == 0:
        _show(home, name, run)
    return code


def targets(name: str, method: str) -> list[list[str]]:
    """What to ask DVC for once the check is made, in order: all of the method asked for."""
    run = f"{name}-{method}"
    made = [f"{stage}@{run}" for stage in ("self_check", "export", "animate", "evaluate")]
    return [made, ["--single-item", "report"]]


def _check(folder: Path, name: str) -> int:
    """Make the check, and say so before the long part if it fails; returns DVC's exit code."""
    code = reproduce([f"check@{name}"], folder=folder)
    if code == 0 and failures(read_findings(folder / f"metrics/check/{name}.json")):
        logger.warning(
            "The clip FAILS its check: look at %s/data/check/%s/index.html. Ctrl-C stops, else it "
            "goes on", folder, name,
        )  # fmt: skip
    return code


def _better_poses(folder: Path, name: str) -> list[list[str]]:
    """What to ask DVC for, if poses were estimated before the larger pose model was installed.

    DVC does not follow what is installed.
    """
    metrics = folder / f"metrics/preprocess/{name}.json"
    estimated = (folder / f"data/preprocess/{name}").exists() and metrics.exists()
    if not estimated or read_json(metrics).get("pose_model") != "full":
        return []
    if installed_model() == "full":
        return []
    logger.info("MediaPipe's larger pose model was installed since: poses are estimated again")
    return [[f"blur@{name}"], ["--force", "--single-item", f"preprocess@{name}"]]


def _first_look(home: Home, run: str) -> int:
    """Warm up, and show what there is then; returns DVC's exit code.

    The warm-up is an avatar at the given poses, without a model of blur. A stage that was made
    already is not made again, and a page that is newer is left alone.
    """
    on_disk = RunOnDisk(home.folder, run)
    code = reproduce([f"warmup@{on_disk.warmup}"], folder=home.folder)
    kept = on_disk.newest_since_warmup() if code == 0 else None
    if kept is None or kept.iteration >= on_disk.schedule.fusion:
        return code
    page = load_params(home.folder / PARAMS, f"exports.{run}.files", dict).get(PAGE)
    if page is None:
        logger.info("No first look: an avatar with networks fits on no page")
        return code
    exporter = parse(ExportParams, page, f"exports.{run}.files.{PAGE}")
    exporter.export(on_disk.fitted(kept, on_disk.observations()), home.folder / PAGE)
    logger.info("A first look, the rest goes on: %s", home.folder / PAGE)
    return code


def _check_installed() -> None:
    """Refuse to begin a pipeline whose second step would find nothing to detect people with."""
    missing = [name for name in ALONE if importlib.util.find_spec(name) is None]
    if missing:
        raise ConfigError(f"{' and '.join(missing)} not installed; run once: deblur-avatar setup")


def _show(home: Home, name: str, run: str) -> None:
    """Say where everything lies, and at last whether it can be trusted."""
    folder = home.folder
    logger.info("The check:    %s/data/check/%s/index.html", folder, name)
    logger.info("The avatar:   %s/data/fusion/%s/avatar", folder, run)
    logger.info("All round:    %s/data/animate/%s/video.mp4 and contact_sheet.png", folder, run)
    logger.info("The self-check: %s/data/self_check/%s/index.html", folder, run)
    logger.info("The report:   %s/reports/index.html", folder)
    _show_page(folder, run)
    metrics = folder / "metrics"
    _tell_shutter(read_json(metrics / f"trajectory/{run}.json"))
    _tell_verdict(metrics / f"check/{name}.json", metrics / f"self_check/{run}.json")


def _show_page(folder: Path, run: str) -> None:
    """The avatar as a page for any browser, of avatars that can be shown on one."""
    page, made = folder / PAGE, folder / "data/export" / run / PAGE
    if made.is_file():
        shutil.copyfile(made, page)
        logger.info("Turn it by hand: %s", page)
    else:
        logger.info("No page: an avatar with networks fits on none; --method lean makes one")


def _tell_shutter(fitted: dict[str, Any]) -> None:
    """How long the shutter was open, where the footage does not say: all blur hangs on it."""
    source, seconds = fitted.get("shutter_from"), fitted.get("shutter_s", 0.0)
    if source == "frames":
        std = fitted["shutter_std_s"]
        hardly = std > HARDLY * seconds
        logger.info(
            "The shutter:  open for %.1f ms, give or take %.1f, as the frames %s",
            1e3 * seconds, 1e3 * std,
            "hardly tell; set clip.exposure_s where you know better" if hardly else "tell",
        )  # fmt: skip
    elif source == "guess":
        logger.info("The shutter:  %.1f ms is a guess, nothing moved enough to tell", 1e3 * seconds)


def _tell_verdict(before: Path, after: Path) -> None:
    """What failed before and after fitting; the verdict last, in a sentence that nobody misses."""
    told = {"check": read_findings(before), "self-check": read_findings(after)}
    failed = {what: found for what, content in told.items() if (found := failures(content))}
    for what, sentences in failed.items():
        for sentence in sentences:
            logger.warning("FAILED %s: %s", what, sentence)
    verdict = told["self-check"]["verdict"]
    if "self-check" in failed:
        logger.warning(
            "The avatar FAILS its %s: do not trust what it shows.", " and its ".join(failed)
        )
    elif failed:
        logger.warning(
            "The clip FAILS its check, whatever the avatar says of itself (%s): look before you "
            "trust what it shows.", verdict,
        )  # fmt: skip
    elif verdict == "unknown":
        logger.warning("The self-check could measure nothing: look before you trust what it shows.")
    else:
        logger.info("The avatar passes its self-check (%s).", verdict)
