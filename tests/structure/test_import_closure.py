import subprocess
import sys
from pathlib import Path

import pytest

from tests.structure.import_closure import (
    code_dependencies,
    expanded,
    import_closure,
    write_dependencies,
)

PIPELINE = """\
# The story.
stages:
  cut: # why
    foreach: ${scenes}
    do:
      desc: Cut
      cmd: >-
        python stages/cut.py --scene ${key}
        --out data/cut/${key}
      deps: [stages/old.py, "data/raw/${key}", deblur_avatar]
      outs: ["data/cut/${key}"]
"""
FILES = {
    "dvc.yaml": PIPELINE,
    "stages/cut.py": "from pathlib import Path\nfrom deblur_avatar.pipeline.cut import cut\n",
    "deblur_avatar/__init__.py": "",
    "deblur_avatar/pipeline/__init__.py": "",
    "deblur_avatar/pipeline/cut.py": (
        "import numpy\n\ndef cut():\n    from deblur_avatar.geometry import planes\n"
        "    from ..imaging.knives import sharpen\n    return (planes, sharpen)\n"
    ),
    "deblur_avatar/pipeline/glue.py": "import deblur_avatar.pipeline.cut\n",
    "deblur_avatar/geometry/__init__.py": "",
    "deblur_avatar/geometry/planes.py": "import math\n",
    "deblur_avatar/geometry/deep/__init__.py": "",
    "deblur_avatar/imaging/__init__.py": "",
    "deblur_avatar/imaging/knives.py": 'SOURCE = "edge.cpp"\nOTHER = "absent.cpp"\n',
    "deblur_avatar/imaging/edge.cpp": "",
    "deblur_avatar/imaging/spoons.cpp": "",
}


@pytest.fixture
def project(tmp_path):
    for name, text in FILES.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return tmp_path


def test_imports_inside_functions_relative_ones_and_named_files_count(project):
    closure = import_closure(project / "stages/cut.py", project)
    assert {str(path.relative_to(project)) for path in closure} == {
        "stages/cut.py", "deblur_avatar/__init__.py", "deblur_avatar/pipeline/__init__.py",
        "deblur_avatar/pipeline/cut.py", "deblur_avatar/geometry/__init__.py",
        "deblur_avatar/geometry/planes.py", "deblur_avatar/imaging/__init__.py",
        "deblur_avatar/imaging/knives.py", "deblur_avatar/imaging/edge.cpp",
    }  # fmt: skip


def test_a_folder_that_is_needed_whole_is_listed_as_the_folder(project):
    script = project / "stages/cut.py"
    assert "deblur_avatar/geometry/planes.py" in code_dependencies(script, project)
    (project / "deblur_avatar/geometry/deep/__init__.py").unlink()
    (project / "deblur_avatar/geometry/deep").rmdir()
    (project / "deblur_avatar/geometry/__pycache__").mkdir()
    (project / "deblur_avatar/geometry/__pycache__/planes.pyc").write_bytes(b"")
    listed = code_dependencies(script, project)
    assert listed[0] == "stages/cut.py"
    assert "deblur_avatar/geometry" in listed
    assert "deblur_avatar/geometry/planes.py" not in listed
    assert expanded(listed, project) == import_closure(script, project)


def test_writing_keeps_data_and_comments_and_is_done_after_once(project):
    assert write_dependencies(project) == ["cut"]
    text = (project / "dvc.yaml").read_text()
    kept = [line for line in PIPELINE.splitlines() if "deps" not in line]
    assert [line for line in text.splitlines() if line in kept] == kept
    assert "stages/old.py" not in text
    assert text.count("data/raw/${key}") == 1
    assert "        - deblur_avatar/imaging/edge.cpp\n" in text
    assert write_dependencies(project) == []


def test_what_a_stage_really_loads_is_within_its_closure():
    """The static walk misses nothing that running the imports shows."""
    root = Path(__file__).parents[2]
    script = root / "stages/blur.py"
    show = (
        "import runpy, sys; runpy.run_path(sys.argv[1]); "
        "print('\\n'.join(m.__file__ for n, m in sys.modules.items() "
        "if n.split('.')[0] == 'deblur_avatar'))"
    )
    command = [sys.executable, "-c", show, str(script)]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True)
    loaded = {Path(line).resolve() for line in done.stdout.split()}
    assert loaded
    assert loaded <= {path.resolve() for path in import_closure(script, root)}
