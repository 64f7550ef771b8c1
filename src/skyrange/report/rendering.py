"""Template environment of the reports: Jinja2 with autoescape, and the style and script files of the pages."""

from __future__ import annotations

import base64
import hashlib
import json
import zlib
from functools import cache
from importlib.resources import files
from typing import Any, Final, NamedTuple

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from skyrange.report import quantities

MAX_ROWS_WHOLE: Final = 150
"""A table of at most so many rows is whole as the page opens, and on paper."""
MAX_ROWS_READY: Final = 40
"""Rows of a longer table that are elements as the page opens; the others become elements as they are looked at."""


class FoldedRows(NamedTuple):
    """Rows of a table: those that are elements, and the others as `pack_text` packs them."""

    ready: Markup
    rest: str
    kept: int
    total: int


@cache
def environment() -> Environment:
    """The Jinja2 environment. It escapes all values except markup that one of its templates or a drawing made."""
    made = Environment(
        loader=PackageLoader("skyrange.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.policies["json.dumps_kwargs"] = {"separators": (",", ":"), "allow_nan": False}
    made.filters["thousands"] = quantities.count
    made.filters["scalar"] = quantities.scalar
    made.filters["fold"] = fold_rows
    made.filters["packed"] = pack_json
    return made


def render(template: str, **values: Any) -> Markup:
    """Render a template of the folder `templates`; the result is markup that another template does not escape."""
    return Markup(environment().get_template(template).render(values))  # noqa: S704 - the template has escaped


def fold_rows(rows: Markup, end: str = "</tr>", ready: int | None = None) -> FoldedRows:
    """Rows that a template has rendered, each with `end` at its end, which no text in them contains.

    `ready` is how many of them are elements of the page as it opens; without it all, or `MAX_ROWS_READY` of many.
    """
    parts = [f"{part}{end}" for part in str(rows).split(end)[:-1]]
    kept = MAX_ROWS_READY if ready is None else min(ready, MAX_ROWS_WHOLE)
    if len(parts) <= (MAX_ROWS_WHOLE if ready is None else kept):
        return FoldedRows(rows, "", len(parts), len(parts))
    first = Markup("".join(parts[:kept]))  # noqa: S704 - the template has escaped
    return FoldedRows(first, pack_text("".join(parts[kept:])), kept, len(parts))


def pack_json(value: Any) -> str:
    """A value as JSON, as `pack_text`; numbers are finite."""
    return pack_text(json.dumps(value, separators=(",", ":"), allow_nan=False))


def pack_text(text: str) -> str:
    """A text compressed with zlib, in base64, which the page's script unpacks."""
    return base64.b64encode(zlib.compress(text.encode(), 9)).decode()


def asset(name: str) -> Markup:
    """The text of a style or script file of the folder `assets`."""
    text = files("skyrange.report").joinpath("assets", name).read_text(encoding="utf-8")
    return Markup(text)  # noqa: S704 - a file of this package


def table_script() -> Markup:
    """The script of a page without a viewer: its long tables."""
    return Markup('"use strict";(() => {\n') + asset("packed.js") + asset("rows.js") + Markup("\n})();")


def content_policy(style: str, script: str | None = None) -> str:
    """A Content-Security-Policy that forbids all requests and admits only this style and script, by their hashes."""
    allowed = f" script-src '{_digest(script)}';" if script is not None else ""
    return f"default-src 'none'; style-src '{_digest(style)}';{allowed} base-uri 'none'; form-action 'none'"


def _digest(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
