import subprocess

import pytest

from tests.structure.pipeline_files import ROOT
from tests.structure.readme_table import BEGIN, END, README, TABLE, with_table


def test_the_table_goes_between_its_marks_and_nothing_else_changes():
    readme = f"# Name\n\n{BEGIN}\nold\n{END}\n\nAfter.\n"
    made = with_table(readme, "| a |\n| - |\n")
    assert made == f"# Name\n\n{BEGIN}\n\n| a |\n| - |\n\n{END}\n\nAfter.\n"
    assert with_table(made, "| a |\n| - |\n") == made


@pytest.mark.parametrize("readme", ["# Name\n", BEGIN, f"{END}{BEGIN}", f"{BEGIN}{END}{END}"])
def test_missing_or_doubled_marks_are_refused(readme):
    with pytest.raises(ValueError, match="must hold"):
        with_table(readme, "| a |")


def test_the_readme_shows_the_results_of_the_report():
    """Those on disk, or those committed: who reruns the pipeline gets times of another machine."""
    command = ["git", "show", f"HEAD:{TABLE.relative_to(ROOT)}"]
    committed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    tables = [TABLE.read_text()] if TABLE.is_file() else []
    tables += [committed.stdout] if committed.returncode == 0 else []
    if not tables:
        pytest.skip("no results yet: reports/table.md is made by `make repro`")
    readme = README.read_text()
    assert readme in [with_table(readme, table) for table in tables], "run `make readme`"
