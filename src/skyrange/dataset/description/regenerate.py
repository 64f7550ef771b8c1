"""What flies each run of a data set again: scenario, seed, arm, versions, and the fingerprint to expect."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any, Final

from skyrange.core.files import atomic_write
from skyrange.dataset.description.contents import Contents
from skyrange.record.folder import GIVEN_FILES

REGENERATE: Final = "regenerate.json"


def write_regenerate(folder: Path, contents: Contents) -> None:
    """Write `regenerate.json`: the text of each scenario once, and the runs that refer to it by its SHA-256."""
    scenarios: dict[str, str] = {}
    runs: dict[str, Any] = {}
    for member, record in zip(contents.members, contents.records, strict=True):
        manifest = record.manifest
        digest = hashlib.sha256(member.scenario.encode()).hexdigest()
        scenarios[digest] = member.scenario
        inputs = {
            name: entry
            for name, entry in (manifest.get("files") or {}).items()
            if name.startswith(("missions/given/", f"{GIVEN_FILES}/", "plugins/", "city.", "radio/"))
        }
        runs[member.run] = {
            "block": member.block, "arm": member.arm, "split": member.split, "seed": member.seed,
            "factors": dict(member.factors), "scenario": digest, "versions": manifest.get("versions", {}),
            "numeric": (manifest.get("platform") or {}).get("numeric", ""), "engines": manifest.get("engines", {}),
            "fingerprint": (manifest.get("digests") or {}).get("fingerprint", ""), "input_files": inputs,
        }  # fmt: skip
    value = {
        "format": "skyrange.dataset/1",
        "how": "Write a scenario's text to scenario.toml and fly it with `skyrange run scenario.toml` in the same "
        "versions. The scenario has the arm's attacks muted or sham already, and the seed. The run's fingerprint is "
        "that given here on a platform with the same `numeric`.",
        "views": {
            "places": [{"links": place.links, "side": place.side} for place in contents.settings.places],
            "rate_hz": contents.settings.rate_hz,
        },
        "scenarios": scenarios,
        "runs": runs,
    }
    with atomic_write(folder / REGENERATE) as file:
        file.write((json.dumps(value, indent=1, ensure_ascii=False, sort_keys=True) + "\n").encode())
