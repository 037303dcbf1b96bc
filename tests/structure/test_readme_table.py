import subprocess

import pytest

from tests.structure.pipeline_files import ROOT
from tests.structure.readme_table import BEGIN, BLOCKS, END, README, with_table


def test_the_table_goes_between_its_marks_and_nothing_else_changes():
    readme = f"# Name\n\n{BEGIN}\nold\n{END}\n\nAfter.\n"
    made = with_table(readme, "| a |\n| - |\n")
    assert made == f"# Name\n\n{BEGIN}\n\n| a |\n| - |\n\n{END}\n\nAfter.\n"
    assert with_table(made, "| a |\n| - |\n") == made


@pytest.mark.parametrize("readme", ["# Name\n", BEGIN, f"{END}{BEGIN}", f"{BEGIN}{END}{END}"])
def test_missing_or_doubled_marks_are_refused(readme):
    with pytest.raises(ValueError, match="must hold"):
        with_table(readme, "| a |")


@pytest.mark.parametrize(("table", "begin", "end"), BLOCKS, ids=["results", "proof"])
def test_the_readme_shows_what_was_reported(table, begin, end):
    """What is on disk, or committed: who reruns the pipeline gets times of another machine."""
    command = ["git", "show", f"HEAD:{table.relative_to(ROOT)}"]
    committed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    tables = [table.read_text()] if table.is_file() else []
    tables += [committed.stdout] if committed.returncode == 0 else []
    if not tables:
        pytest.skip(f"no {table.name} yet: it is made by `make repro` or `make proof`")
    readme = README.read_text()
    assert readme in [with_table(readme, text, begin, end) for text in tables], "run `make readme`"
