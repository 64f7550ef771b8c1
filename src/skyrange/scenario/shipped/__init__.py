"""Shipped scenarios, and the file of a NAME or FILE.

Each kind of attack has an example, `attacks/KIND.toml`, and each kind of benign fault has one, `faults/KIND.toml`; its
name is that of the kind.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path

from skyrange.core.errors import InputError, nearest
from skyrange.core.files import expand_user
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.toml_files import load_file

FOLDER = Path(__file__).parent

SHIPPED: dict[str, str] = {
    "squares": "Five aircraft of two operators fly small squares, the published demonstration.",
    "survey": "Eight aircraft of two operators fly QGroundControl plans among the buildings of a downtown.",
    "chain": "An adversary that watches an aircraft forges another one in its way, and two operators nearly collide.",
    "mitm-mission": "A mission is altered during its upload, and the aircraft flies in another one's corridor.",
    "falsified-log": "A ground station with false positions turns its aircraft early, across another one's site.",
    "gcs-flood": "A flooded control link makes an aircraft return on the straight line, across another one's site.",
    "hijack": "An attacker reads a control link, then leads the aircraft across another one's track and away.",
    "jammed-corridor": "A jammer covers the Wi-Fi channel of Remote ID, and two aircraft do not avoid each other.",
    "gnss-pull-off": "A spoofer pulls an aircraft's fixes below its estimator's gates, into its neighbour's corridor.",
    "jam-then-spoof": "A jammer takes an aircraft's GNSS fix, and the aircraft then follows a weak spoofer.",
    "insider": "A program in a ground station gathers its aircraft at another operator's site and shows their plans.",
    "city-fleet": "48 aircraft of four operators make deliveries over a dense downtown; 500 with --set.",
    "corridor-rush": "60 aircraft of six operators want two corridors at once, and an authority keeps them apart.",
    "crossing": "Eight aircraft of four operators cross at a street corner, separated by height and by time.",
    "emergency-landing": "An aircraft lands on a flat place that its depth camera shows; an attacker shows it another.",
    "head-on": "Two aircraft of two operators fly towards each other on the same line and collide.",
    "gnss-drift": "A spoofer makes the GNSS fixes of an aircraft drift, and the aircraft leaves its street.",
    "rid-city": "40 aircraft of four operators avoid each other over a downtown, and avoid a forged swarm.",
    "rid-spoofing": "A forged Remote ID blocks a street, and an aircraft flies around the block.",
    "unsigned-ghost": "A forged Remote ID stops an aircraft that believes everybody, and not one that verifies.",
    "wind": "Six aircraft of three airframes hold their tracks in gusty wind.",
}
"""One-line descriptions by name; the file is `shipped/NAME.toml`."""

EXAMPLES: Mapping[str, Path] = {file.stem: file for file in sorted((FOLDER / "attacks").glob("*.toml"))}
"""Files of the examples by kind of attack."""

FAULT_EXAMPLES: Mapping[str, Path] = {file.stem: file for file in sorted((FOLDER / "faults").glob("*.toml"))}
"""Files of the examples by kind of fault."""

DEFENCE_EXAMPLES: Mapping[str, Path] = {file.stem: file for file in sorted((FOLDER / "defences").glob("*.toml"))}
"""Files of the examples by kind of defence."""


def source_of(name_or_file: str | Path) -> Path:
    """The file of a shipped scenario, by its name, or a file, by its path; names of shipped scenarios have precedence.

    Raises InputError with the most similar name if `name_or_file` is neither.
    """
    text = str(name_or_file)
    if text in SHIPPED:
        return FOLDER / f"{text}.toml"
    if text in EXAMPLES:
        return EXAMPLES[text]
    if text in FAULT_EXAMPLES:
        return FAULT_EXAMPLES[text]
    if text in DEFENCE_EXAMPLES:
        return DEFENCE_EXAMPLES[text]
    path = expand_user(text)
    if path.suffix == ".toml" or os.path.exists(path) or "/" in text or "\\" in text:
        return path
    raise InputError.one(
        "scenario",
        "name",
        text,
        "a shipped scenario or a TOML file",
        nearest(text, [*SHIPPED, *EXAMPLES, *FAULT_EXAMPLES]),
    )


def load(
    name_or_file: str | Path,
    overrides: Iterable[str] = (),
    *,
    seed: int | None = None,
    buildings: str | Path | None = None,
) -> Scenario:
    """The scenario of this name or in this file, with the changes of `toml_reader.load_file`. Raises InputError."""
    who = str(name_or_file)
    return load_file(source_of(who), overrides, seed=seed, buildings=buildings, who=who)
