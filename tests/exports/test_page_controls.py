"""Every control of the page does what its name says, in a real browser."""

import base64
import io
import re

import av
import numpy as np
import pytest
from PIL import Image

from deblur_avatar.avatars.kinds import avatar_from_artifact
from deblur_avatar.avatars.render import render_avatar
from deblur_avatar.geometry.cameras import Camera
from tests.exports.browser import AT_REST, at_rest, opened, silent_page

MEAN_ERROR = 8  # of 255, of 255 colours for a person of 600 random ones
NAMED = ("button", "combobox", "slider", "checkbox", "application")


@pytest.fixture
def open_page(page, page_file):
    return opened(page, page_file)


def state(page):
    return page.evaluate("structuredClone(window.page.state)")


def canvas(page):
    return page.get_by_role("application")


def picture(page) -> np.ndarray:
    """What the browser shows of the avatar, sRGB in [0, 1]."""
    at_rest(page)
    return np.asarray(Image.open(io.BytesIO(canvas(page).first.screenshot())).convert("RGB")) / 255


def pictured(page, seconds) -> np.ndarray:
    """What the page would save as a picture at a time, RGBA of 255, at a GIF's size."""
    text = page.evaluate(
        """(seconds) => {
          const state = { ...window.page.state, seconds };
          const canvas = window.page.stage.picture(state, document.createElement("canvas"));
          return canvas.toDataURL("image/png").split(",")[1];
        }""",
        seconds,
    )
    image = Image.open(io.BytesIO(base64.b64decode(text))).convert("RGBA")
    assert max(image.size) <= 480
    return np.asarray(image).astype(int)


def test_every_control_has_a_name(open_page):
    open_page.get_by_text("Turn joints").click()
    controls = [
        line.strip(" -")
        for line in open_page.locator("body").aria_snapshot().splitlines()
        if line.strip(" -").startswith(NAMED)
    ]
    assert len(controls) >= 20
    assert not [control for control in controls if not re.match(r'\w+ "\S', control)]


def test_play_goes_on_and_round_until_pause(open_page):
    open_page.get_by_role("button", name="Play").click()
    open_page.wait_for_function("window.page.state.seconds > 0")
    open_page.get_by_role("button", name="Pause").click()
    seconds = state(open_page)["seconds"]
    open_page.wait_for_timeout(200)
    assert state(open_page)["seconds"] == seconds <= 4 / 60


def test_time_scrubs_and_commas_and_full_stops_step(open_page):
    open_page.get_by_role("slider", name="Time").fill("0.05")
    assert state(open_page)["seconds"] == 0.05
    open_page.get_by_role("heading").click()
    open_page.keyboard.press(",")
    assert state(open_page)["seconds"] == pytest.approx(2 / 60, abs=1e-5)
    open_page.keyboard.press(".")
    assert state(open_page)["seconds"] == pytest.approx(3 / 60, abs=1e-5)
    open_page.keyboard.press("Space")
    assert state(open_page)["playing"]


def test_the_motion_chooser_shows_another_motion(open_page):
    before = picture(open_page)
    open_page.get_by_role("combobox", name="Motion").select_option("Jumping jacks")
    assert state(open_page)["motion"] == "jumping_jacks"
    assert np.abs(picture(open_page) - before).max() > 0.3


def test_speed_slows_the_motion_down(open_page):
    open_page.get_by_role("combobox", name="Motion").select_option("Jumping jacks")
    open_page.get_by_role("combobox", name="Speed").select_option("0.1×")
    open_page.get_by_role("button", name="Play").click()
    open_page.wait_for_timeout(1000)
    assert 0.02 < state(open_page)["seconds"] < 0.3


def test_the_shutter_blurs(open_page):
    open_page.get_by_role("slider", name="Time").fill("0.033")
    before = picture(open_page)
    open_page.get_by_role("slider", name="Shutter").fill("60")
    assert open_page.get_by_text("60 ms").is_visible()
    difference = np.abs(picture(open_page) - before)
    assert difference.max() > 0.1
    assert np.median(difference) < 0.01  # what stands still is as it was


@pytest.mark.parametrize(("name", "corner"), [("Light", 1.0), ("Dark", 0.08)])
def test_the_background_changes(open_page, name, corner):
    open_page.get_by_role("combobox", name="Background").select_option(name)
    assert picture(open_page)[-4, -4] == pytest.approx([corner] * 3, abs=0.03)


def test_a_drag_turns_and_with_shift_moves_and_the_wheel_zooms(open_page):
    box = canvas(open_page).bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

    def drag():
        open_page.mouse.move(x, y)
        open_page.mouse.down()
        open_page.mouse.move(x + 90, y + 30, steps=3)
        open_page.mouse.up()

    first = state(open_page)["view"]
    drag()
    turned = state(open_page)["view"]
    assert turned["azimuth"] < first["azimuth"]
    assert turned["elevation"] > first["elevation"]
    open_page.keyboard.down("Shift")
    drag()
    open_page.keyboard.up("Shift")
    moved = state(open_page)["view"]
    assert moved["target"] != turned["target"]
    assert moved["azimuth"] == turned["azimuth"]
    open_page.mouse.wheel(0, 300)
    open_page.wait_for_timeout(50)
    assert state(open_page)["view"]["distance"] > 1.2 * moved["distance"]
    open_page.mouse.dblclick(x, y)
    assert state(open_page)["view"] == first


def test_keys_turn_move_and_zoom(open_page):
    canvas(open_page).focus()
    first = state(open_page)["view"]
    for key, what in (("ArrowRight", "azimuth"), ("Shift+ArrowUp", "target"), ("+", "distance")):
        before = state(open_page)["view"][what]
        open_page.keyboard.press(key)
        assert state(open_page)["view"][what] != before, key
    open_page.keyboard.press("Home")
    assert state(open_page)["view"] == first


def test_two_fingers_pinch(open_page):
    first = state(open_page)["view"]
    canvas(open_page).evaluate(
        """(canvas) => {
          const touch = (type, id, x) => canvas.dispatchEvent(new PointerEvent(type,
            { pointerId: id, clientX: x, clientY: 300, pointerType: "touch", bubbles: true }));
          canvas.setPointerCapture = () => {};
          touch("pointerdown", 1, 300); touch("pointerdown", 2, 400);
          touch("pointermove", 2, 500);
          touch("pointerup", 1, 300); touch("pointerup", 2, 500);
        }"""
    )
    view = state(open_page)["view"]
    assert view["distance"] == pytest.approx(first["distance"] / 2, rel=0.01)


def test_sides_are_sides(open_page):
    front = picture(open_page)
    for name, degrees in (("Left side", 90), ("Back", 180), ("Right side", -90)):
        open_page.get_by_role("button", name=name).click()
        assert np.degrees(state(open_page)["view"]["azimuth"]) == pytest.approx(degrees)
        assert np.abs(picture(open_page) - front).max() > 0.3
    open_page.get_by_role("button", name="Front").click()
    np.testing.assert_allclose(picture(open_page), front, atol=0.01)


def test_a_saved_picture_is_the_filming_cameras(open_page, rough, fitted_run):
    run = fitted_run(rough())
    open_page.get_by_role("combobox", name="Background").select_option("Transparent")
    open_page.get_by_role("button", name="Filming camera").click()
    with open_page.expect_download() as download:
        open_page.get_by_role("button", name="Save picture").click()
    assert download.value.suggested_filename == "capsules-lean.png"
    saved = np.asarray(Image.open(download.value.path())) / 255
    height, width = saved.shape[:2]
    filmed = run.observations.camera
    scale = min(width / filmed.width, height / filmed.height)
    K = filmed.K.clone()
    K[:2] *= scale
    K[0, 2] += (width - scale * filmed.width) / 2
    K[1, 2] += (height - scale * filmed.height) / 2
    model = avatar_from_artifact(run.avatar, run.observations.body, K.device)
    seen = Camera(K, filmed.viewmat, width, height)
    ours, alpha = render_avatar(model, run.motion.centre.at([0]), seen)
    np.testing.assert_allclose(saved[..., 3], alpha[0].numpy(), atol=0.02)
    error = saved[..., :3] * saved[..., 3:] - ours[0].numpy()
    assert -10 * np.log10(np.square(error)[alpha[0].numpy() > 0.05].mean()) > 45


def test_a_clip_is_every_frame_of_the_motion(browser, page_file):
    with silent_page(browser, 480, 400) as page:
        opened(page, page_file)
        page.get_by_role("combobox", name="Motion").select_option("Jumping jacks")
        with page.expect_download(timeout=60000) as download:
            page.get_by_role("button", name="Record clip").click()
        assert download.value.suggested_filename == "capsules-lean.webm"
        with av.open(str(download.value.path())) as video:
            shown = list(video.decode(video=0))
        frames = [frame.to_ndarray(format="rgb24").astype(int) for frame in shown]
        assert len(frames) == 36
        assert [frame.time for frame in shown] == pytest.approx(np.arange(36) / 30, abs=1e-3)
        assert np.abs(frames[0] - frames[18]).max() > 60
        assert page.get_by_text("Clip saved.").is_visible()


@pytest.mark.parametrize("background", ["Dark", "Transparent"])
def test_a_gif_is_every_frame_of_the_motion_in_nearly_its_colours(browser, page_file, background):
    with silent_page(browser, 480, 400) as page:
        opened(page, page_file)
        page.get_by_role("combobox", name="Motion", exact=True).select_option("Jumping jacks")
        page.get_by_role("combobox", name="Background").select_option(background)
        with page.expect_download(timeout=60000) as download:
            page.get_by_role("button", name="Record GIF").click()
        assert download.value.suggested_filename == "capsules-lean.gif"
        page.get_by_text("GIF saved.").wait_for()
        shown = pictured(page, 10 / 25)
        with Image.open(download.value.path()) as gif:
            assert gif.format == "GIF"
            assert gif.n_frames == 30  # 1.2 s at 25 a second
            assert gif.info["loop"] == 0
            frames, durations = [], []
            for number in range(gif.n_frames):
                gif.seek(number)
                durations.append(gif.info["duration"])
                frames.append(np.asarray(gif.convert("RGBA")).astype(int))
        assert durations == [40] * 30
    assert frames[0].shape == shown.shape
    assert np.abs(frames[0] - frames[13])[..., :3].max() > 60
    error = np.abs(frames[10] - shown)[..., :3]
    person = (frames[10][..., 3] == 255) & (np.abs(shown - shown[2, 2]).max(-1) > 20)
    assert person.mean() > 0.02
    assert error[person].mean() < MEAN_ERROR
    assert (frames[10][..., 3] == 255).all() == (background == "Dark")
    np.testing.assert_array_equal(frames[10][..., 3] == 255, shown[..., 3] >= 128)


def test_a_link_keeps_motion_time_and_view(open_page, page_file):
    open_page.get_by_role("combobox", name="Motion").select_option("Jumping jacks")
    open_page.get_by_role("slider", name="Time").fill("0.4")
    open_page.get_by_role("button", name="Left side").click()
    before, shown = picture(open_page), state(open_page)
    assert shown["seconds"] == 0.4
    open_page.get_by_role("button", name="Copy link").click()
    assert "motion=jumping_jacks&t=0.400" in open_page.url
    again = opened(open_page, page_file, "#" + open_page.url.partition("#")[2])
    assert state(again)["seconds"] == shown["seconds"]
    for name, value in shown["view"].items():
        assert state(again)["view"][name] == pytest.approx(value, abs=1e-4), name
    np.testing.assert_allclose(picture(again), before, atol=0.02)


def test_a_link_that_makes_no_sense_is_as_none(page, page_file):
    first = state(opened(page, page_file))
    other = opened(page, page_file, "#motion=no&t=x&view=1,2&bend=99,1,2,3&background=red&speed=")
    assert state(other)["view"] == first["view"]
    assert state(other)["motion"] == first["motion"]
    assert state(other)["bends"] == {}


def test_joints_are_turned_and_reset(open_page):
    straight = picture(open_page)
    open_page.get_by_text("Turn joints").click()
    open_page.get_by_role("combobox", name="Joint").select_option("left shoulder")
    open_page.get_by_role("slider", name="About z").fill("50")
    assert state(open_page)["bends"] == {"16": [0, 0, 50]}
    assert np.abs(picture(open_page) - straight).max() > 0.3
    open_page.get_by_role("button", name="Reset joints").click()
    np.testing.assert_allclose(picture(open_page), straight, atol=0.01)


def test_the_filmed_frame_is_matched(open_page, observations):
    frame = open_page.get_by_role("img", name="The blurred frame")
    assert not frame.is_visible()
    open_page.get_by_role("slider", name="Time").fill("0.04")
    open_page.get_by_role("button", name="Match the filmed frame").click()
    assert frame.is_visible()
    assert open_page.get_by_text("Filmed frame 2, 0.033 s").is_visible()
    shown = state(open_page)
    assert shown["view"]["filmed"]
    assert shown["shutter"] == pytest.approx(observations.exposure)
    assert frame.evaluate("(image) => image.decode().then(() => image.naturalWidth)") == 24
    open_page.get_by_role("checkbox", name="Show the filmed frame").uncheck()
    assert not frame.is_visible()


def corner(image) -> float:
    """Brightness of the first pixel of a picture on the page, of 255."""
    return image.evaluate(
        """(image) => image.decode().then(() => {
          const canvas = document.createElement("canvas");
          [canvas.width, canvas.height] = [image.naturalWidth, image.naturalHeight];
          const context = canvas.getContext("2d");
          context.drawImage(image, 0, 0);
          return context.getImageData(0, 0, 1, 1).data[1];
        })"""
    )


def test_the_sharp_truth_is_matched(page, page_with_truth):
    opened(page, page_with_truth)
    truth = page.get_by_role("img", name="The sharp frame at this instant")
    frame = page.get_by_role("img", name="The blurred frame")
    assert not truth.is_visible()
    page.get_by_role("slider", name="Time").fill("0.04")
    page.get_by_role("slider", name="Shutter").fill("30")
    page.get_by_role("button", name="Match the sharp truth").click()
    assert page.get_by_text("Sharp truth, 0.033 s").is_visible()
    assert state(page)["view"]["filmed"]
    assert state(page)["shutter"] == 0  # as the sharp frame has none
    assert not frame.is_visible()
    page.get_by_role("checkbox", name="Show the filmed frame").check()
    assert corner(truth) > corner(frame) + 30
    left = [part.bounding_box()["x"] for part in (frame, *canvas(page).all(), truth)]
    assert left == sorted(left)
    at_rest(page)
    opened(page, page_with_truth, "#" + page.url.partition("#")[2])
    assert truth.is_visible()
    with page.expect_download() as download:
        page.get_by_role("button", name="Save picture").click()
    saved = np.asarray(Image.open(download.value.path())).astype(int)
    assert saved[-1, -1, :3] == pytest.approx([60] * 3, abs=9)  # the truth, last of all
    assert saved[-1, 0, :3] == pytest.approx([0] * 3, abs=9)
    page.get_by_role("checkbox", name="Show the sharp truth").uncheck()
    assert not truth.is_visible()


def test_where_no_truth_is_known_nothing_offers_it(page, page_file):
    opened(page, page_file, "#truth=1")
    assert not state(page)["truth"]
    for offer in ("Show the sharp truth", "Match the sharp truth"):
        assert not page.get_by_text(offer).is_visible()


def test_on_a_phone_more_than_two_pictures_take_two_rows(browser, page_with_truth):
    with silent_page(browser, 390, 844) as page:
        opened(page, page_with_truth, "#truth=1&frame=1")
        assert page.evaluate("document.documentElement.scrollWidth") == 390
        boxes = [figure.bounding_box() for figure in page.locator("figure").all()]
        assert len(boxes) == 4
        assert all(box["width"] > 190 and box["height"] > 150 for box in boxes)
        assert len({round(box["y"]) for box in boxes}) == 2
        page.get_by_role("checkbox", name="Show the filmed frame").uncheck()
        page.get_by_role("checkbox", name="Show capsules-agnostic beside it").uncheck()
        boxes = [f.bounding_box() for f in page.locator("figure:not([hidden])").all()]
        assert [round(box["y"]) for box in boxes] == [round(boxes[0]["y"])] * 2
        assert all(box["height"] > 300 for box in boxes)


def test_two_avatars_share_one_camera(page, page_of_two):
    opened(page, page_of_two)
    first, second = (canvas(page).nth(i).bounding_box() for i in range(2))
    assert first["width"] == pytest.approx(second["width"], abs=2)
    assert page.get_by_text("capsules-agnostic", exact=True).first.is_visible()
    before = [np.asarray(Image.open(io.BytesIO(c.screenshot()))) for c in canvas(page).all()]
    page.get_by_role("button", name="Back").click()
    at_rest(page)
    after = [np.asarray(Image.open(io.BytesIO(c.screenshot()))) for c in canvas(page).all()]
    for was, now in zip(before, after, strict=True):
        assert np.abs(was.astype(int) - now).max() > 60
    page.get_by_role("checkbox", name="Show capsules-agnostic beside it").uncheck()
    at_rest(page)
    assert canvas(page).nth(0).bounding_box()["width"] > 1.9 * first["width"]


def test_slow_frames_are_drawn_coarsely_until_all_rests(open_page):
    whole = canvas(open_page).evaluate("(canvas) => canvas.clientWidth")
    open_page.get_by_role("button", name="Play").click()
    # In one go: quick frames of the page's own would make it finer again.
    coarse = canvas(open_page).evaluate(
        """(canvas) => {
          for (let i = 0; i < 9; i++) window.page.stage.adapt(400);
          window.page.stage.drawMoving(window.page.state);
          return canvas.width;
        }"""
    )
    assert coarse < 0.3 * whole
    open_page.get_by_role("button", name="Pause").click()
    open_page.wait_for_function(AT_REST)
    assert canvas(open_page).evaluate("(canvas) => canvas.width") == whole


def test_a_phone_shows_person_and_controls_without_scrolling_sideways(browser, page_file):
    with silent_page(browser, 390, 844) as page:
        opened(page, page_file)
        assert page.evaluate("document.documentElement.scrollWidth") == 390
        box = canvas(page).bounding_box()
        assert box["width"] == 390
        assert box["height"] > 300
        assert page.get_by_role("button", name="Play").is_visible()
        shown = picture(page)
        assert (np.abs(shown - shown[-4, -4]).max(-1) > 0.2).mean() > 0.03
