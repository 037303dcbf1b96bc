from pathlib import Path

import pytest

from deblur_avatar.config.reading import parse, read_yaml
from deblur_avatar.errors import ConfigError
from deblur_avatar.training.params import RecipeParams

ROOT = Path(__file__).parents[2]


def recipe(name):
    return read_yaml(ROOT / "params.yaml")["avatars"][name]


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("paper", {"precision": "half"}, "precision: input should be 'float32' or 'bfloat16'"),
        ("lean", {"precision": "float32"}, "unknown key 'model.precision'"),
        ("lean", {"kind": "hair"}, "no kind of this name, there is arah_small, "),
        ("paper", {"color": None, "nonrigid": None, "skinning": None}, "is of kind plain"),
    ],
)
def test_networks_and_only_networks_have_a_precision(name, change, message):
    content = recipe(name)
    parse(RecipeParams, content, name)
    content["model"] |= change
    with pytest.raises(ConfigError, match=message):
        parse(RecipeParams, content, name)


@pytest.mark.parametrize(
    "key", ["nonrigid", "skinning", "color", "max_norm", "regularisers.isometry_means"]
)
def test_an_avatar_without_networks_states_no_key_that_is_about_them(key):
    content = recipe("lean")
    *section, last = key.split(".")
    (content["fitting"][section[0]] if section else content["fitting"])[last] = 1.0
    with pytest.raises(ConfigError, match=f"unknown key 'fitting.{key}'"):
        parse(RecipeParams, content, "lean")


@pytest.mark.parametrize("part", ["nonrigid", "skinning", "color"])
def test_a_network_that_is_not_there_is_not_fitted_and_one_that_is_there_is(part):
    content = recipe("paper")
    content["model"][part] = None
    with pytest.raises(ConfigError, match=f"{part} must be null in both model and fitting"):
        parse(RecipeParams, content, "paper")
    content["fitting"][part] = None
    parse(RecipeParams, content, "paper")


def test_every_loss_of_the_table_has_a_weight_and_no_other_has():
    content = recipe("lean")
    content["losses"]["hinge"] = content["losses"].pop("mask")
    with pytest.raises(ConfigError, match="missing key 'losses.mask'; unknown key 'losses.hinge'"):
        parse(RecipeParams, content, "lean")
