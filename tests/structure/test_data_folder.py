"""data/README.md says what comes to lie there."""

import re
from pathlib import Path

from ruamel.yaml import YAML

ROOT = Path(__file__).parents[2]


def test_the_readme_names_every_folder_that_stages_write_to_data():
    stages = YAML(typ="safe", pure=True).load(ROOT / "dvc.yaml")["stages"]
    written = {
        (match[1], name)
        for name, stage in stages.items()
        for out in stage.get("do", stage).get("outs", [])
        if (match := re.match(r"data/(\w+)/", next(iter(out)) if isinstance(out, dict) else out))
    }
    rows = re.findall(
        r"^\| `(\w+)/[^`]*` \| `(\w+)` \|", (ROOT / "data/README.md").read_text(), re.M
    )
    assert set(rows) == written
