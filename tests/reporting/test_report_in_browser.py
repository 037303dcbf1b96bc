"""The committed report, as a browser shows it."""

from pathlib import Path

import pytest

from tests.exports.browser import silent_page

REPORT = Path(__file__).parents[2] / "reports/index.html"


@pytest.mark.parametrize("width", [390, 1280])
def test_the_report_loads_nothing_shows_every_picture_and_never_scrolls_sideways(browser, width):
    with silent_page(browser, width, 844) as page:
        page.goto(REPORT.as_uri())
        page.wait_for_load_state("load")
        pictures = page.evaluate(
            "[...document.images].map((image) => image.complete && image.naturalWidth > 0)"
        )
        assert pictures
        assert all(pictures)
        assert page.evaluate("document.documentElement.scrollWidth") == width
        assert page.evaluate("[...document.images].every((image) => image.alt)")
