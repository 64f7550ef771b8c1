"""Do defences of missions and parameters, and of MAVLink's numbering, keep their contract?"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import pytest

from skyrange.testing import check_defence

pytestmark = pytest.mark.rotating

VICTIMS = {"vehicles": ["blue/b1"]}
ALTER = {"kind": "mavlink.mission_alter", "params": {**VICTIMS, "offset_m": [40, 0, 0]}}
REPLACE = {
    "kind": "mavlink.mission_replace",
    "start_s": 5.0,
    "params": {**VICTIMS, "track": [[-40, 20, 15], [-80, 20, 15]]},
}
PARAMETER: dict[str, Any] = {
    "kind": "mavlink.parameter",
    "start_s": 5.0,
    "params": {**VICTIMS, "values": {"FS_GCS_ENABLE": 5}},
}
AS_A_FILE = {**PARAMETER, "kind": "mavlink.file_write"}
BEHIND_THE_LOCK = {**PARAMETER, "params": {**PARAMETER["params"], "on": "autopilot"}}
MODE = {"kind": "mavlink.mode", "start_s": 5.0, "params": {**VICTIMS, "mode": "LAND"}}
KINDS: list[tuple[str, Mapping[str, Any], Mapping[str, Any], Collection[str]]] = [
    ("mission.hash", {}, ALTER, ()),
    ("mission.hash", {"at": "proxy"}, REPLACE, ()),
    ("mission.read_back", {"every_s": 2.0}, REPLACE, ()),
    ("parameter.watch", {}, PARAMETER, ("drop",)),
    ("parameter.watch", {"at": "companion"}, PARAMETER, ("drop",)),
    ("parameter.watch", {}, BEHIND_THE_LOCK, ()),
    ("parameter.watch", {}, AS_A_FILE, ("drop",)),
    ("mavlink.sequence", {}, MODE, ()),
    ("mavlink.sequence", {"drop": True}, MODE, ("drop",)),
    ("mavlink.signing", {}, MODE, ("drop",)),
]
"""What a defence does without an attack as well, such as the injections of all but the last, is not in the acts."""


@pytest.mark.catalogue
@pytest.mark.parametrize(("name", "params", "attack", "acts"), KINDS, ids=[f"{k[0]}-{i}" for i, k in enumerate(KINDS)])
def test_shipped_defences_conform(
    name: str, params: Mapping[str, Any], attack: Mapping[str, Any], acts: Collection[str]
) -> None:
    check_defence(name, params, attack, acts=acts, duration_s=14.0)
