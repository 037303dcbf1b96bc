"""A real browser for tests of pages: Debian's Chromium, driven by playwright, without a network."""

import base64
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from deblur_avatar.geometry.cameras import Camera
from tests.exports.requirement import missing

FLAGS = [
    "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-quic",
    "--no-first-run", "--disable-background-networking", "--disable-component-update",
    "--disable-sync",
]  # fmt: skip
NAMES = ("chromium", "chromium-browser", "google-chrome")
AT_REST = "!window.page.asked && window.page.ticked === undefined"


@contextmanager
def chromium() -> Iterator[Any]:
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        missing("no playwright; pip install playwright")
    binary = next(filter(None, map(shutil.which, NAMES)), None)
    if binary is None:
        missing("no Chromium; apt-get install chromium")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=binary, args=FLAGS)
        yield browser
        browser.close()


@contextmanager
def silent_page(browser: Any, width: int, height: int) -> Iterator[Any]:
    """A page without a network; whatever goes wrong in it fails the test."""
    context = browser.new_context(
        viewport={"width": width, "height": height}, offline=True, accept_downloads=True
    )
    page, wrong = context.new_page(), []
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("console", lambda said: wrong.append(said.text) if said.type != "log" else None)

    def requested(request: Any) -> None:
        if not request.url.startswith(("file:", "data:", "blob:")):
            wrong.append(request.url)

    page.on("request", requested)
    yield page
    context.close()
    assert not wrong, wrong


def opened(page: Any, path: Path, fragment: str = "") -> Any:
    """The page once it is ready."""
    page.goto("about:blank")  # so that another fragment is another page
    page.goto(path.as_uri() + fragment)
    page.wait_for_function("window.page || window.failed")
    assert page.evaluate("window.failed") is None
    return page


def pixels(page: Any, camera: Camera, **shown: Any) -> np.ndarray:
    """What the page draws for a camera of ours, RGBA in [0, 1]."""
    K, viewmat = camera.K.double(), camera.viewmat.double()
    asked = {
        "camera": {
            "rotation": viewmat[:3, :3].flatten().tolist(),
            "translation": viewmat[:3, 3].tolist(),
            "fx": float(K[0, 0]),
            "fy": float(K[1, 1]),
            "cx": float(K[0, 2]),
            "cy": float(K[1, 2]),
            "width": camera.width,
            "height": camera.height,
        },
        "instants": 1,
        "shutter": 0,
        "bends": {},
    } | shown
    text = page.evaluate("(asked) => window.page.pixels(asked)", asked)
    rgba = np.frombuffer(base64.b64decode(text), np.uint8)
    return rgba.reshape(camera.height, camera.width, 4) / 255


def at_rest(page: Any) -> None:
    """Let the time pass after which the page draws sharply and its link says what is shown."""
    page.evaluate("window.page.changed = -Infinity")
    page.wait_for_function(AT_REST)
