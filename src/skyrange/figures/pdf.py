"""Figures as PDF, for papers."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

from skyrange.core.errors import InputError
from skyrange.core.files import atomic_write
from skyrange.figures.svg import Figure


def save_pdf(figure: Figure, path: Path) -> Path:
    """Write a figure as a PDF of one page of its size, 1 px as 0.75 pt, and return its path. Text stays text.

    Raises `InputError` if CairoSVG or the library cairo is not installed.
    """
    converter = load_converter()
    with atomic_write(path) as file:
        file.write(converter.svg2pdf(bytestring=figure.svg.encode()))
    return path


def load_converter() -> Any:
    """The module `cairosvg`. Raises `InputError` if it or the library cairo is not installed."""
    try:
        return import_module("cairosvg")
    except (ImportError, OSError) as error:  # OSError: the system has no library cairo
        found = str(error).splitlines()[0]
        hint = "Install it with: pip install 'skyrange[study]', and cairo by the system's packages (libcairo2)."
        raise InputError.one("study", "pdf", found, "the packages CairoSVG and cairo", hint) from error
