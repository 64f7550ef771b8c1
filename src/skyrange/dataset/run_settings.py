"""Setting of a run: what its scenario declares, but for which of its attacks and faults act."""

from __future__ import annotations

import json
import tomllib
from hashlib import blake2b
from typing import Final

_STATES: Final = ("muted", "sham", "honest")
_ACTS: Final = ("attacks", "faults")


def identify_setting(scenario: str) -> str:
    """16 hex digits over a scenario's text: equal for arms that differ in the states of attacks and faults alone.

    An arm with a defence or a change of its own has another one: it differs from the others from its beginning on.
    """
    data = tomllib.loads(scenario)
    for name in _ACTS:
        tables = data.get(name)
        if isinstance(tables, list):
            data[name] = [{key: value for key, value in one.items() if key not in _STATES} for one in tables]
    return blake2b(json.dumps(data, sort_keys=True, default=str).encode(), digest_size=8).hexdigest()
