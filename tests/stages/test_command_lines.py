"""Every stage's script starts by itself: other tests run most of them where all is imported."""

import ast

import pytest

from tests.stages.running import ROOT

SCRIPTS = sorted((ROOT / "stages").glob("*.py"))


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_a_script_starts_and_says_what_it_does_and_takes(start_script, script):
    done = start_script(script.stem, "--help")
    assert done.returncode == 0, done.stderr
    (main,) = [
        node
        for node in ast.parse(script.read_text()).body
        if isinstance(node, ast.FunctionDef) and node.name == "main"
    ]
    assert ast.get_docstring(main).split()[0] in done.stdout
    for argument in main.args.args:
        assert f"--{argument.arg.replace('_', '-')} " in done.stdout
