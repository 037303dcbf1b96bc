from pathlib import Path

import jinja2
import pytest

from deblur_avatar.pipeline.code import import_closure
from deblur_avatar.reporting.page import render_page
from deblur_avatar.reporting.results_table import Cell, Column, Table

ROOT = Path(__file__).resolve().parents[2]
PAGES = {
    "stages/report.py": "deblur_avatar/pipeline/report.html.jinja",
    "stages/ablations.py": "deblur_avatar/pipeline/ablations.html.jinja",
    "stages/check.py": "deblur_avatar/reporting/check.html.jinja",
    "benchmarks/stress/stages/stability_report.py": "benchmarks/stress/report.html.jinja",
}


@pytest.fixture
def shown(tmp_path):
    """A page that holds one table."""

    def show(table, **content):
        template = tmp_path / "page_of_one_table.jinja"
        template.write_text(
            '{% extends "page.html.jinja" %}{% from "page.html.jinja" import table %}'
            "{% block main %}{{ table(given, quiet) }}{{ word }}{% endblock %}"
        )
        return render_page(template, given=table, quiet=("?",), **content)

    return show


TABLE = Table(
    columns=(Column((), "PSNR", "dB", better=1), Column((), "what", kind="text")),
    rows=(("paper", (Cell("25.00", rank=1), Cell("<b>", kind="text"))),
          ("oracle", (Cell("?"), Cell("fine", kind="text")))),
    bounds=("oracle",), of="method", title="Views", note="Means.",
)  # fmt: skip


@pytest.mark.parametrize(
    "part",
    [
        "<caption>Views</caption>", '<th scope="col">method</th>', "↑", "<small>dB</small>",
        '<td class="rank1">25.00</td>', '<td class="none">?</td>', '<tr class="bound">',
        '<td class="text">&lt;b&gt;</td>', '<p class="note">Means.</p>', "main { max-width",
    ],
)  # fmt: skip
def test_a_table_shows(shown, part):
    assert part in shown(TABLE, word="")


def test_a_name_that_a_page_lacks_is_an_error(shown):
    with pytest.raises(jinja2.UndefinedError, match="'word' is undefined"):
        shown(TABLE)


@pytest.mark.parametrize("script", PAGES)
def test_the_fingerprint_of_a_stage_covers_its_page_and_the_frame_of_all_pages(script):
    files = {path.relative_to(ROOT).as_posix() for path in import_closure(ROOT / script, ROOT)}
    assert {PAGES[script], "deblur_avatar/reporting/page.html.jinja"} <= files
