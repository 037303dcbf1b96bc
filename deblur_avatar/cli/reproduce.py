"""Run the whole pipeline as far as this machine has the footage.

Scenes whose files are missing are named and left out; everything else is reproduced, and the report
is written over all results there are.
"""

import logging
import os
import subprocess
import sys
from pathlib import Path

from deblur_avatar.config.reading import load_params, read_yaml
from deblur_avatar.errors import ConfigError
from deblur_avatar.pipeline.body import BodyParams
from deblur_avatar.pipeline.parameters import SceneParams, check_parameters

logger = logging.getLogger(__name__)

PARAMS = Path("params.yaml")


def missing_footage(params_file: Path) -> dict[str, str]:
    """Scenes that cannot be made here, each with the reason.

    Raises:
        ConfigError: if the parameter file cannot be run at all.
    """
    check_parameters(params_file)
    missing = {}
    for scene in load_params(params_file, "scenes", dict):
        params = load_params(params_file, f"scenes.{scene}", SceneParams)
        body = load_params(params_file, f"bodies.{params.body}", BodyParams)
        reasons = params.clip.missing_files(f"scenes.{scene}.clip")
        reasons += body.missing_files(f"bodies.{params.body}")
        if reasons:
            missing[scene] = "; ".join(reasons)
    return missing


def targets(params_file: Path, missing: dict[str, str]) -> list[str]:
    """What to ask DVC for: nothing (all of it), or the last stages of scenes that can be made."""
    if not missing:
        return []
    runs = read_yaml(params_file)["runs"]
    kept = [name for name, run in runs.items() if run["scene"] not in missing]
    animated = read_yaml(params_file)["animations"]
    scenes = dict.fromkeys(runs[name]["scene"] for name in kept)
    return [
        *(f"check@{scene}" for scene in scenes),
        *(f"{stage}@{name}" for name in kept for stage in ("evaluate", "timeline")),
        *(f"animate@{name}" for name in animated if name in kept),
    ]


def main() -> int:
    """Reproduce, then write and print the report's table; returns DVC's exit code."""
    dvc = [sys.executable, "-m", "dvc"]
    # Stage commands say `python`: the environment's own, whatever the shell's path says.
    here = str(Path(sys.executable).parent)
    environment = os.environ | {"PATH": f"{here}{os.pathsep}{os.environ.get('PATH', '')}"}
    missing = missing_footage(PARAMS)
    for scene, reason in missing.items():
        logger.warning("scene %s is left out: %s", scene, reason)
    wanted = targets(PARAMS, missing)
    steps = [[*dvc, "repro", *wanted]]
    if wanted:
        steps.append([*dvc, "repro", "--single-item", "report"])
    for step in steps:
        code = subprocess.run(step, env=environment, check=False).returncode
        if code != 0:
            return code
    logger.info("%s", Path("reports/table.md").read_text())
    logger.info("The report: reports/index.html")
    return 0


if __name__ == "__main__":
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stdout)
    try:
        raise SystemExit(main())
    except ConfigError as error:
        sys.stderr.write(f"ConfigError: {error}\n")
        raise SystemExit(1) from None
