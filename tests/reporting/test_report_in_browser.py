"""The committed report, as a browser shows it."""

from pathlib import Path

import pytest

from tests.exports.browser import silent_page

REPORT = Path(__file__).parents[2] / "reports/index.html"
WIDTHS = pytest.mark.parametrize("width", [390, 1280])
# The share of an avatar's picture that is not background, as the page draws it.
SHARE = """() => {
  const canvas = window.page.stage.picture(window.page.state, document.createElement("canvas"));
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  let person = 0;
  for (let k = 0; k < data.length; k += 4) person += Math.abs(data[k] - data[0]) > 16;
  return (4 * person) / data.length;
}"""
COLUMN = """([table, column]) => [...table.tBodies[0].rows]
  .map((row) => row.cells[column].textContent.trim())"""


def table_of(page, caption):
    return page.locator("table", has=page.locator("caption", has_text=caption)).first


def column(table, index):
    return table.evaluate(f"(table) => ({COLUMN})([table, {index}])")


@WIDTHS
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


@WIDTHS
def test_every_scene_that_may_be_shown_has_an_avatar_to_turn(browser, width):
    with silent_page(browser, width, 844) as page:
        page.goto(REPORT.as_uri())
        assert {frame.url for frame in page.frames[1:]} == {"about:blank"}  # before anybody asks
        shown = page.locator("details.turned")
        assert page.locator("section:has(details.turned)").evaluate_all(
            "(scenes) => scenes.map((scene) => scene.id)"
        ) == ["studio", "courtyard_mono", "courtyard_two"]  # not skater_17's
        for index in range(shown.count()):
            shown.nth(index).locator("summary").press("Enter")
            frame = shown.nth(index).locator("iframe").element_handle().content_frame()
            frame.wait_for_url("**/*-lean.html*")
            frame.wait_for_function("window.page || window.failed")
            assert frame.evaluate("window.failed") is None
            assert 0.02 < frame.evaluate(SHARE) < 0.5
        assert page.evaluate("document.documentElement.scrollWidth") == width


def test_a_heading_orders_its_table_by_hand_and_by_keyboard(browser):
    with silent_page(browser, 1280, 844) as page:
        page.goto(REPORT.as_uri())
        table = table_of(page, "Novel views")
        written, psnr = column(table, 0), table.get_by_role("button", name="PSNR").first
        heading = psnr.locator("..")
        psnr.click()  # larger is better
        assert heading.get_attribute("aria-sort") == "descending"
        numbers = [float(text) for text in column(table, 1)]
        assert numbers == sorted(numbers, reverse=True)
        psnr.press("Enter")
        assert heading.get_attribute("aria-sort") == "ascending"
        assert [float(text) for text in column(table, 1)] == numbers[::-1]
        psnr.press("Space")
        assert heading.get_attribute("aria-sort") is None
        assert column(table, 0) == written
        flip = table.get_by_role("button", name="FLIP").first
        flip.click()  # smaller is better
        assert flip.locator("..").get_attribute("aria-sort") == "ascending"
        table.get_by_role("button", name="method").click()
        assert column(table, 0) == sorted(written)
        assert table.locator("[aria-sort]").count() == 1


def test_rows_without_a_number_stay_last_and_signs_and_gaps_are_read(browser):
    with silent_page(browser, 1280, 844) as page:
        page.goto(REPORT.as_uri())
        table = table_of(page, "Novel views")
        cells = ["not measured", "−0.16", "7 494", "25.00 ± 1.00", "0.40"]
        table.evaluate(
            "(table, texts) => [...table.tBodies[0].rows].forEach("
            "(row, k) => (row.cells[1].textContent = texts[k]))",
            cells,
        )
        button = table.get_by_role("button", name="PSNR").first
        button.click()
        assert column(table, 1) == [cells[k] for k in (2, 3, 4, 1, 0)]
        button.click()
        assert column(table, 1) == [cells[k] for k in (1, 4, 3, 2, 0)]
