"""Rendering of pages: one Jinja2 environment that escapes all text, and the style and script files beside it."""

from __future__ import annotations

import base64
import hashlib
from functools import cache
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from skyrange.study.report import words


@cache
def environment() -> Environment:
    """The templates of the reports. What a template is given is escaped, unless a template or a drawing made it."""
    made = Environment(
        loader=PackageLoader("skyrange.study.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.policies["json.dumps_kwargs"] = {"separators": (",", ":"), "allow_nan": False}
    made.filters["thousands"] = words.count
    made.filters["scalar"] = words.scalar
    return made


def render(template: str, **values: Any) -> Markup:
    """The text of a template of the folder `templates`, ready to stand in another one."""
    return Markup(environment().get_template(template).render(values))  # noqa: S704 - the template has escaped


def asset(name: str) -> Markup:
    """A style or script file of the folder `assets`, as it is."""
    text = files("skyrange.study.report").joinpath("assets", name).read_text(encoding="utf-8")
    return Markup(text)  # noqa: S704 - a file of this package


def content_policy(style: str, script: str | None = None) -> str:
    """A Content-Security-Policy under which nothing may be fetched and only this very style and script count."""
    allowed = f" script-src '{_digest(script)}';" if script is not None else ""
    return f"default-src 'none'; style-src '{_digest(style)}';{allowed} base-uri 'none'; form-action 'none'"


def _digest(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
