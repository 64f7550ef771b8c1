"""A scenario as TOML with every value that the run used, so that this file is enough to repeat the run."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC

import tomli_w

from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.named_files import rename_files


def to_toml(scenario: Scenario, files: Mapping[str, str] | None = None) -> str:
    """TOML text from which `load_text` builds an equal scenario.

    `files` maps the names of files in the scenario to the names of their copies, relative to the folder of the text.
    """
    data = scenario.data()
    data["start_utc"] = data["start_utc"].astimezone(UTC)  # TOML has no offsets of seconds
    for operator in data["operators"]:
        for key in ("params", "fleets"):
            if not operator[key]:  # in a built scenario the vehicles contain them
                del operator[key]
        for vehicle in operator["vehicles"]:
            if not vehicle["params"]:
                del vehicle["params"]
    for key in ("links", "processing", "attacks", "detectors", "approvals", "hosts"):
        if not data[key]:
            del data[key]
    if "radio" in data and not data["radio"]["params"]:
        del data["radio"]["params"]
    return tomli_w.dumps(rename_files(data, files) if files else data, indent=2)
