"""Template environment of the reports: Jinja2 with autoescape, and the style and script files of the pages."""

from __future__ import annotations

import base64
import hashlib
from functools import cache
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from skyrange.report import quantities


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
    return made


def render(template: str, **values: Any) -> Markup:
    """Render a template of the folder `templates`; the result is markup that another template does not escape."""
    return Markup(environment().get_template(template).render(values))  # noqa: S704 - the template has escaped


def asset(name: str) -> Markup:
    """The text of a style or script file of the folder `assets`."""
    text = files("skyrange.report").joinpath("assets", name).read_text(encoding="utf-8")
    return Markup(text)  # noqa: S704 - a file of this package


def content_policy(style: str, script: str | None = None) -> str:
    """A Content-Security-Policy that forbids all requests and admits only this style and script, by their hashes."""
    allowed = f" script-src '{_digest(script)}';" if script is not None else ""
    return f"default-src 'none'; style-src '{_digest(style)}';{allowed} base-uri 'none'; form-action 'none'"


def _digest(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
