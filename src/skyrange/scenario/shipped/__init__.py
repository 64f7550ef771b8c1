"""Shipped scenarios, and the file that a NAME or FILE means."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from skyrange.core.errors import InputError, nearest
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.toml_reader import load_file

FOLDER = Path(__file__).parent

SHIPPED: dict[str, str] = {
    "squares": "Five aircraft of two operators fly small squares: the published demonstration.",
    "survey": "Eight aircraft of two operators fly QGroundControl plans among the buildings of a downtown.",
    "city-fleet": "48 aircraft of four operators deliver over a dense downtown, one after another; 500 with --set.",
    "crossing": "Eight aircraft of four operators cross at a street corner, kept apart by height and by time.",
    "head-on": "Two aircraft of two operators fly the same line towards each other, and collide.",
    "gnss-drift": "False GNSS slides away from the truth, and an aircraft follows it out of its street.",
    "rid-city": "40 aircraft of four operators hear each other over a downtown, and a swarm that is not there.",
    "rid-spoofing": "A forged Remote ID stands in a passage between buildings, and an aircraft believes it.",
    "wind": "Six aircraft of three airframes hold their tracks in a gusty wind.",
}
"""One-line descriptions by name; each is `shipped/NAME.toml`."""


def source_of(name_or_file: str | Path) -> Path:
    """The file that a shipped scenario's name or a file's name means; a name goes first.

    Raises InputError with the nearest name for what is neither.
    """
    text = str(name_or_file)
    if text in SHIPPED:
        return FOLDER / f"{text}.toml"
    path = Path(text).expanduser()
    if path.suffix or path.exists() or "/" in text or "\\" in text:
        return path
    raise InputError.one("scenario", "name", text, "a shipped scenario or a TOML file", nearest(text, SHIPPED))


def load(
    name_or_file: str | Path,
    overrides: Iterable[str] = (),
    *,
    seed: int | None = None,
    buildings: str | Path | None = None,
) -> Scenario:
    """The scenario of this name or in this file, with `toml_reader.load_file`'s changes. Raises InputError."""
    who = str(name_or_file)
    return load_file(source_of(who), overrides, seed=seed, buildings=buildings, who=who)
