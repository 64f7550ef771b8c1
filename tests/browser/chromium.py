"""Pages opened in Debian's Chromium by Playwright, drawn in software, with what they said and what they asked for."""

from __future__ import annotations

import base64
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from playwright.sync_api import Browser, Locator, Page, Playwright

FLAGS: Final = (
    "--no-sandbox",  # of a container's root
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
"""WebGL by SwiftShader, so that a picture depends on no graphics card; nothing fetched by the browser itself."""

WITHOUT_WEBGL: Final = ("--disable-3d-apis",)


def find() -> str | None:
    """Chromium's program: `SKYRANGE_CHROMIUM`, else that of Debian, else none."""
    return os.environ.get("SKYRANGE_CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")


def missing() -> str:
    """Why no page can be opened here, "" where one can."""
    try:
        import playwright.sync_api  # noqa: F401
    except ImportError:
        return "playwright is not installed (pip install playwright)"
    return "" if find() else "Chromium is not installed (apt-get install chromium)"


@contextmanager
def launched(driver: Playwright, *flags: str) -> Iterator[Browser]:
    """A browser, closed at the end."""
    browser = driver.chromium.launch(executable_path=find(), args=[*FLAGS, *flags])
    try:
        yield browser
    finally:
        browser.close()


@dataclass
class Opened:
    """A page, what it wrote to the console or threw, the addresses it asked for, and dialogs it showed."""

    page: Page
    said: list[str] = field(default_factory=list)
    asked: list[str] = field(default_factory=list)
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


def visit(browser: Browser, path: Path, at: str = "", script: str = "", **context: Any) -> Opened:
    """Open a file in a context of its own; `at` is the address's fragment, `context` goes to `Browser.new_context`.

    `script` runs in the page before its own.
    """
    page = browser.new_context(**{"viewport": {"width": 1280, "height": 900}} | context).new_page()
    opened = Opened(page)

    def answer(dialog: Any) -> None:
        opened.dialogs.append(dialog.message)
        dialog.dismiss()

    page.on("console", lambda message: opened.said.append(f"{message.type}: {message.text}"))
    page.on("pageerror", lambda error: opened.said.append(f"error: {error}"))
    page.on("request", lambda request: opened.asked.append(request.url))
    page.on("dialog", answer)
    if script:
        page.add_init_script(script)
    page.goto(path.resolve().as_uri() + at)
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
