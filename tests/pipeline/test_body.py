from pathlib import Path

import pytest

from deblur_avatar.artifacts.body import Body
from deblur_avatar.bodies import anny
from deblur_avatar.bodies.anny import AnnyBodyParams
from deblur_avatar.bodies.registry import BODIES
from deblur_avatar.bodies.smpl import SmplBodyParams
from deblur_avatar.config.reading import parse
from deblur_avatar.config.section import Params
from deblur_avatar.errors import ConfigError
from deblur_avatar.pipeline.body import BodyParams, build_body


def test_anny_is_baked_with_the_shape_numbers_asked_for(
    monkeypatch: pytest.MonkeyPatch, body: Body
):
    asked = []
    monkeypatch.setattr(anny, "bake_anny", lambda count: asked.append(count) or body)
    assert build_body(AnnyBodyParams(source="anny", shape_components=7)) is body
    assert asked == [7]


def test_the_path_of_an_smpl_file_may_come_from_the_environment(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    monkeypatch.setenv("SMPL_HOME", str(tmp_path))
    params = SmplBodyParams(source="smpl", file="${SMPL_HOME}/model.npz", shape_components=10)
    with pytest.raises(ConfigError, match=rf"no SMPL model at {tmp_path}/model\.npz"):
        build_body(params)


def test_a_variable_that_is_not_set_is_refused(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("SMPL_HOME", raising=False)
    params = SmplBodyParams(source="smpl", file="${SMPL_HOME}/model.npz", shape_components=10)
    with pytest.raises(ConfigError, match="SMPL_HOME"):
        build_body(params)


def test_a_new_body_is_a_class_and_a_line(monkeypatch: pytest.MonkeyPatch, body: Body):
    class StickParams(Params):
        source: str

        def build(self) -> Body:
            return body

        def missing_files(self, where: str) -> tuple[str, ...]:
            return ()

    with pytest.raises(ConfigError, match="no source of this name, there is anny, smpl"):
        parse(BodyParams, {"source": "stick"}, "bodies.me")
    monkeypatch.setitem(BODIES, "stick", StickParams)
    assert build_body(parse(BodyParams, {"source": "stick"}, "bodies.me")) is body
