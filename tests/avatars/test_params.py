from pathlib import Path

import pytest

from deblur_avatar.avatars.params import ModelParams
from deblur_avatar.config.reading import parse, read_yaml
from deblur_avatar.errors import ConfigError

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(
    ("networks", "change", "message"),
    [
        (True, {"precision": None}, "networks need a precision, float32 or bfloat16"),
        (True, {"precision": "half"}, "precision: input should be 'float32' or 'bfloat16'"),
        (False, {"precision": "float32"}, "without networks takes no precision; remove the key"),
    ],
)
def test_networks_and_only_networks_have_a_precision(networks, change, message):
    starts = read_yaml(ROOT / "params.yaml")["starts"]
    model = starts["paper" if networks else "lean"]["model"]
    parse(ModelParams, model, "model")
    with pytest.raises(ConfigError, match=message):
        parse(ModelParams, model | change, "model")
