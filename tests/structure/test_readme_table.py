import subprocess

import pytest

from tests.structure.pipeline_files import ROOT
from tests.structure.readme_table import BEGIN, BLOCKS, END, copied, first_section, with_table


def test_the_table_goes_between_its_marks_and_nothing_else_changes():
    readme = f"# Name\n\n{BEGIN}\nold\n{END}\n\nAfter.\n"
    made = with_table(readme, "| a |\n| - |\n")
    assert made == f"# Name\n\n{BEGIN}\n\n| a |\n| - |\n\n{END}\n\nAfter.\n"
    assert with_table(made, "| a |\n| - |\n") == made


@pytest.mark.parametrize("readme", ["# Name\n", BEGIN, f"{END}{BEGIN}", f"{BEGIN}{END}{END}"])
def test_missing_or_doubled_marks_are_refused(readme):
    with pytest.raises(ValueError, match="must hold"):
        with_table(readme, "| a |")


def test_the_first_section_ends_where_the_second_begins():
    assert first_section("### Mean\n\n| a |\n\n### One\n\n| b |\n") == "### Mean\n\n| a |\n"
    assert first_section("words\n\n### Mean\n\n| a |\n\n### One\n") == (
        "words\n\n### Mean\n\n| a |\n"
    )
    assert first_section("words\n") == "words\n"


@pytest.mark.parametrize("block", BLOCKS, ids=["readme: proof", "proof", "results"])
def test_documents_show_what_was_reported(block):
    """What is on disk, or committed: who reruns the pipeline gets times of another machine."""
    command = ["git", "show", f"HEAD:{block.report.relative_to(ROOT)}"]
    committed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    reports = [block.report.read_text()] if block.report.is_file() else []
    reports += [committed.stdout] if committed.returncode == 0 else []
    if not reports:
        pytest.skip(f"no {block.report.name} yet: it is made by `make repro` or `make proof`")
    document = block.document.read_text()
    assert document in [copied(block, text) for text in reports], "run `make readme`"
