"""docs/baselines.md says what experiments/rivals measured, and calls nothing sound that is not."""

import json
import re

import pytest

from deblur_avatar.config.reading import read_params
from tests.structure.pipeline_files import PARAMS, ROOT

RIVALS = ROOT / "experiments" / "rivals"
PAGE = (ROOT / "docs" / "baselines.md").read_text()
ROW = re.compile(
    r"^\| `(\w+)` \| ([\d.]+) \| ([\d.]+) \| ([+−][\d.]+) \| −([\d.]+) \| (sound|fails) \|", re.M
)
REDUCED = "_small"
LIMITS = {False: 1.5, True: 3.0}  # dB below the oracle of `networks`; of reduced avatars more


def measured(avatar):
    return json.loads((RIVALS / "metrics" / "studio" / f"{avatar}.json").read_text())["image"]


def stated():
    return ROW.findall(PAGE)


@pytest.mark.parametrize("row", stated(), ids=lambda row: row[0])
def test_soundness_is_what_was_measured(row):
    avatar, psnr, seen, gap, below, verdict = row
    oracle = json.loads((ROOT / "metrics/studio/oracle.json").read_text())["image"]["psnr"]
    image = measured(avatar)
    assert (psnr, seen) == (f"{image['psnr']:.2f}", f"{image['psnr_seen']:.2f}")
    assert gap.replace("−", "-") == f"{image['psnr'] - oracle:+.2f}"
    limit = LIMITS[avatar.endswith(REDUCED)]
    assert float(below) == limit
    assert verdict == ("sound" if image["psnr"] >= oracle - limit else "fails")


def test_every_avatar_that_was_measured_is_on_the_page():
    found = {path.stem for path in (RIVALS / "metrics" / "studio").glob("*.json")}
    assert found == {row[0] for row in stated()}
    assert found
    assert found <= {run["avatar"] for run in read_params(RIVALS / PARAMS)["runs"].values()}
