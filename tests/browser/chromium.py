"""Chromium for tests and screenshots: pages opened by Playwright, with their console messages and requests."""

from __future__ import annotations

import base64
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from playwright.sync_api import Browser, Locator, Page, Playwright

FLAGS: Final = (
    "--disable-dev-shm-usage",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--force-color-profile=srgb",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-domain-reliability",
    "--disable-sync",
    "--no-first-run",
)
"""SwiftShader draws WebGL, so that pictures do not depend on a graphics card; the browser itself fetches nothing."""

WITHOUT_WEBGL: Final = ("--disable-3d-apis",)

TIMEOUT_S: Final = 120.0
"""Limit of each action and wait, wide enough for a busy machine."""


def find_program() -> str | None:
    """The path of Chromium: `SKYRANGE_CHROMIUM`, else Debian's, else `None`."""
    return os.environ.get("SKYRANGE_CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")


def missing() -> str:
    """Why no page can be opened here; "" if one can."""
    if find_spec("playwright") is None:
        return "playwright is not installed (pip install playwright)"
    return "" if find_program() else "Chromium is not installed (apt-get install chromium)"


@contextmanager
def launched(driver: Playwright, *flags: str) -> Iterator[Browser]:
    """A browser, closed at the end."""
    root = ["--no-sandbox"] if os.geteuid() == 0 else []  # Chromium refuses to run as root with its sandbox
    browser = driver.chromium.launch(executable_path=find_program(), args=[*FLAGS, *root, *flags])
    try:
        yield browser
    finally:
        browser.close()


@dataclass
class Opened:
    """An open page, its console messages and uncaught errors, the addresses it requested, and the dialogs it showed."""

    page: Page
    messages: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)
    dialogs: list[str] = field(default_factory=list)

    @property
    def now_s(self) -> float:
        """The time that the page's clock shows."""
        return float(self.page.locator("#clock").input_value())

    def settle(self) -> None:
        """Wait until what has changed is drawn."""
        self.page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def pixels(self, part: Locator | None = None) -> NDArray[np.int64]:
        """(height, width, 3) sRGB values of the visible page, or of a part of it."""
        self.settle()
        return decode(self.page, (part or self.page).screenshot())

    def close(self) -> None:
        """Close it."""
        self.page.context.close()


def visit(browser: Browser, path: Path | str, at: str = "", script: str = "", **context: Any) -> Opened:
    """Open a file or an address in a context of its own; `at` is the fragment, `context` goes to `Browser.new_context`.

    `script` runs in the page before its own.
    """
    page = browser.new_context(**{"viewport": {"width": 1280, "height": 900}} | context).new_page()
    page.set_default_timeout(TIMEOUT_S * 1000)
    opened = Opened(page)

    def answer(dialog: Any) -> None:
        opened.dialogs.append(dialog.message)
        dialog.dismiss()

    page.on("console", lambda message: opened.messages.append(f"{message.type}: {message.text}"))
    page.on("pageerror", lambda error: opened.messages.append(f"error: {error}"))
    page.on("request", lambda request: opened.requests.append(request.url))
    page.on("dialog", answer)
    if script:
        page.add_init_script(script)
    page.goto((path if isinstance(path, str) else path.resolve().as_uri()) + at)
    opened.settle()
    return opened


def decode(page: Page, png: bytes) -> NDArray[np.int64]:
    """(height, width, 3) values of a PNG, decoded by the browser that made it."""
    helper = page.context.new_page()
    try:
        width, height, values = helper.evaluate(
            """async (text) => {
              const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
              const image = await createImageBitmap(new Blob([bytes], { type: "image/png" }));
              const canvas = new OffscreenCanvas(image.width, image.height), context = canvas.getContext("2d");
              context.drawImage(image, 0, 0);
              const data = context.getImageData(0, 0, image.width, image.height).data;
              let out = "";
              for (let k = 0; k < data.length; k += 32768) out += String.fromCharCode(...data.subarray(k, k + 32768));
              return [image.width, image.height, btoa(out)];
            }""",
            base64.b64encode(png).decode(),
        )
    finally:
        helper.close()
    flat = np.frombuffer(base64.b64decode(values), dtype=np.uint8)
    return flat.reshape(height, width, 4)[:, :, :3].astype(np.int64)
