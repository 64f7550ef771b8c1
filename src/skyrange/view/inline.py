"""The viewer inside a page that is one file: its modules as one script, its style, and a stream as text."""

from __future__ import annotations

import base64
import re
from functools import cache
from importlib.resources import files
from typing import Final

ENTRY: Final = "viewer.js"
"""The module that mounts the viewer."""
STREAM_ID: Final = "viewer-stream"
"""The id of the element whose text is a file of the stream in base64."""
HOST_ID: Final = "viewer"
"""The id of the element in which the viewer is mounted."""

_IMPORT: Final = re.compile(r'^import \{ ([\w, ]+) \} from "\./([\w-]+\.js)";$', re.MULTILINE)
_EXPORT: Final = re.compile(r"^export ((?:const|class|(?:async )?function\*?) (\w+))", re.MULTILINE)
_START: Final = """
const text = document.getElementById("%s").textContent;
window.skyrangeViewer = modules["%s"].mount(document.getElementById("%s"), {
  kind: "file", bytes: Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)),
});
"""


@cache
def viewer_script() -> str:
    """All modules as one script, each in a scope of its own, in the order of their imports."""
    done: dict[str, str] = {}
    _bundle(ENTRY, done)
    start = _START % (STREAM_ID, ENTRY, HOST_ID)
    return "".join(['"use strict";(() => {\nconst modules = {};\n', *done.values(), start, "})();"])


@cache
def viewer_style() -> str:
    """The style sheet."""
    return _read("viewer.css")


def encode_text(stream: bytes) -> str:
    """A file of the stream as the text of the element `STREAM_ID`."""
    return base64.b64encode(stream).decode()


def _read(name: str) -> str:
    return files("skyrange.view").joinpath("assets", name).read_text(encoding="utf-8")


def _bundle(name: str, done: dict[str, str], way: tuple[str, ...] = ()) -> None:
    """Add a module after those that it imports."""
    if name in done:
        return
    if name in way:
        raise ValueError(f"modules of the viewer import each other: {' → '.join((*way, name))}")
    text = _read(name)
    for _, other in _IMPORT.findall(text):
        _bundle(other, done, (*way, name))
    exported = ", ".join(found for _, found in _EXPORT.findall(text))
    text = _IMPORT.sub(r'const { \1 } = modules["\2"];', text)
    text = _EXPORT.sub(r"\1", text)
    done[name] = f'modules["{name}"] = (() => {{\n{text}\nreturn {{ {exported} }};\n}})();\n'
