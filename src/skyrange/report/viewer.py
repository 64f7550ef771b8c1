"""The viewer in a report: a stream that fits into the page, the viewer's style and script, and links to moments."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final
from urllib.parse import quote

from markupsafe import Markup

from skyrange.report.quantities import Linked, Quantity, Shown
from skyrange.report.rendering import asset
from skyrange.view.inline import encode_text, viewer_script, viewer_style
from skyrange.view.stream.recorded import RecordedArms

MAX_STREAM_BYTES: Final = 950_000
"""A larger stream is thinned, and left out of the page where that is not enough; in base64 it is a third larger."""


@dataclass(frozen=True)
class EmbeddedViewer:
    """What a page has of the viewer; all texts are empty where the stream does not fit."""

    stream: str
    style: Markup
    script: Markup


def embed_viewer(arms: RecordedArms) -> EmbeddedViewer:
    """The viewer of some arms, in the largest detail that fits into a page."""
    stream = arms.encode_within(MAX_STREAM_BYTES)
    if stream is None:
        return EmbeddedViewer("", Markup(), Markup())
    style, script = Markup(viewer_style()), Markup(viewer_script())  # noqa: S704 - files of the package
    return EmbeddedViewer(encode_text(stream), style, script)


def join_scripts(embedded: EmbeddedViewer, *names: str) -> Markup:
    """The page's script: the viewer, and files of the folder `assets` in a scope of their own."""
    own = Markup("\n").join(asset(name) for name in names)
    return embedded.script + Markup('\n"use strict";(async () => {\n') + own + Markup("\n})();")


def link_moment(time_s: float, vehicle: str = "", arm: str = "") -> str:
    """The address within the page at which the viewer shows a time, an aircraft selected, of one arm alone."""
    parts = [f"t={time_s:.2f}", *([f"select={quote(vehicle)}"] if vehicle else []), *([f"arms={arm}"] if arm else [])]
    return f"#{'&'.join(parts)}"


def at_moment(shown: str | Quantity, time_s: float | None, vehicle: str = "") -> Shown:
    """A number that leads to its moment; as it is where the time is not known, or nothing is shown."""
    return shown if time_s is None or not shown else Linked(shown, link_moment(time_s, vehicle))
