import subprocess
from contextlib import suppress

import pytest

from deblur_avatar.config.proof import cells_of
from deblur_avatar.evaluation.proof_grid import read_cells
from tests.proof_results import small_plan, write_cell
from tests.structure.pipeline_files import ROOT
from tests.structure.proof_headline import proof_tables
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
def test_documents_show_what_was_reported(block, tmp_path):
    """What is on disk, or committed: who reruns the pipeline gets times of another machine."""
    command = ["git", "archive", "HEAD", *block.read]
    committed = subprocess.run(command, cwd=ROOT, capture_output=True, check=False)
    if committed.returncode == 0:
        subprocess.run(["tar", "-x"], cwd=tmp_path, input=committed.stdout, check=True)
    made = []
    for root in (ROOT, tmp_path):
        with suppress(FileNotFoundError):
            made.append(copied(block, root))
    if not made:
        pytest.skip(f"no {block.read[-1]} yet: it is made by `make repro` or `make proof`")
    assert block.document.read_text() in made, "run `make readme`"


@pytest.fixture
def three_fits(tmp_path):
    """The small proof's two scenes, one of them fitted with two seeds, the second far brighter."""
    plan = small_plan(windows={})
    for cell in cells_of(plan, ["grid", "seeds"]).values():
        quality = {"agnostic": 15.0, "oracle": 17.0}.get(cell.motion, 16.0)
        write_cell(tmp_path, cell, quality + 5.0 * cell.seed)
    return plan, read_cells(plan, tmp_path)


def test_no_table_of_the_proof_mixes_seeds_but_the_one_of_seeds(three_fits):
    plan, found = three_fits
    tables = proof_tables(plan, found)
    alone = proof_tables(plan, [one for one in found if one.cell.seed == 0])
    assert [t.title for t in tables] == [*(t.title for t in alone), "leaping: 2 seeds"]
    assert [t.rows for t in tables[:-1]] == [t.rows for t in alone]
    assert "All of seed 0." in tables[0].note
    plain = dict(tables[1].rows)["plain"]
    assert [cell.text for cell in plain if cell.text != "\u2013"] == ["15.00", "16.00", "17.00"]


def test_each_seed_has_its_own_recovery_and_the_spread_stands_behind_the_mean(three_fits):
    *_, seeds = proof_tables(*three_fits)
    rows = {name: [cell.text for cell in cells] for name, cells in seeds.rows}
    assert rows.keys() == {"plain, agnostic", "plain, clip", "plain, oracle"}, "fitted twice"
    spread = ["18.50 \u00b1 3.54", "0.50 \u00b1 0.00"]
    assert rows["plain, clip"] == ["16.00", "0.50", "21.00", "0.50", *spread]
