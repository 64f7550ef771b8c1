"""Do the attacks that speak MAVLink keep their contract, and do they put on the link what they say?"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from skyrange.attack.contract import AttackPlugin
from skyrange.testing import check_attack

COMMAND = AttackPlugin.find("mavlink.command")
FILE_READ = AttackPlugin.find("mavlink.file_read")
FILE_WRITE = AttackPlugin.find("mavlink.file_write")
EXFILTRATE = AttackPlugin.find("mavlink.exfiltrate")
FENCE = AttackPlugin.find("mavlink.fence")
GUIDED = AttackPlugin.find("mavlink.guided")
HOME = AttackPlugin.find("mavlink.home")
MALFORMED = AttackPlugin.find("mavlink.malformed")
MISSION_ALTER = AttackPlugin.find("mavlink.mission_alter")
MISSION_CLEAR = AttackPlugin.find("mavlink.mission_clear")
MISSION_REPLACE = AttackPlugin.find("mavlink.mission_replace")
MODE = AttackPlugin.find("mavlink.mode")
PARAMETER = AttackPlugin.find("mavlink.parameter")
RC_OVERRIDE = AttackPlugin.find("mavlink.rc_override")

B1 = {"vehicles": ["blue/b1"]}
BOTH = {"vehicles": ["blue/b1", "green/g1"]}
UPLOAD = {"start_s": 0.1, "stop_s": 5.0}
"""When the operator uploads the mission and reads it back."""
INJECT, REPLACE = {"inject"}, {"replace"}
KINDS: list[tuple[AttackPlugin, Mapping[str, Any], set[str], Mapping[str, float]]] = [
    (COMMAND, {**BOTH, "command": "NAV_RETURN_TO_LAUNCH", "times": 0, "every_s": 0.5}, INJECT, {}),
    (COMMAND, {**B1, "command": "MAV_CMD_DO_SET_ROI", "at": [5, 5, 0], "on": "log", "sender": "own"}, INJECT, {}),
    (MODE, {**B1, "mode": "BRAKE"}, INJECT, {}),
    (GUIDED, {**B1, "track": [[30, 0, 20], [30, 30, 20]], "then": "land"}, INJECT, {}),
    (RC_OVERRIDE, {**B1, "forward": 0.5}, INJECT, {}),
    (RC_OVERRIDE, {**B1, "message": "MANUAL_CONTROL", "mode": "none", "on": "autopilot"}, INJECT, {}),
    (MISSION_REPLACE, {**B1, "track": [[50, 0, 20], [50, 50, 20]]}, INJECT, {}),
    (MISSION_ALTER, {**B1, "offset_m": [0, 40, 5]}, REPLACE, UPLOAD),
    (MISSION_ALTER, {**B1, "form": "insert", "item": 2, "at": [60, 60, 20]}, REPLACE, UPLOAD),
    (MISSION_ALTER, {**B1, "form": "swap", "item": 2, "other": 4}, REPLACE, UPLOAD),
    (MISSION_ALTER, {**B1, "form": "delete", "item": 3, "on": "autopilot"}, REPLACE, UPLOAD),
    (MISSION_ALTER, {**B1, "form": "jump", "item": 5, "other": 2}, REPLACE, UPLOAD),
    (MISSION_CLEAR, B1, INJECT, {}),
    (MISSION_CLEAR, {**B1, "by": "MISSION_CLEAR_ALL", "sender": "own"}, INJECT, {}),
    (HOME, {**B1, "at": [50, 0, 0], "then_rtl": True}, INJECT, {}),
    (HOME, {**B1, "at": [50, 0, 20], "point": "rally"}, INJECT, {}),
    (FENCE, B1, INJECT, {}),
    (FENCE, {**B1, "form": "move", "at": [200, 0, 0], "radius_m": 50}, INJECT, {}),
    (PARAMETER, {**B1, "values": {"WPNAV_SPEED": 1500}, "shown": {"WPNAV_SPEED": 1000}}, INJECT | REPLACE, {}),
    (FILE_READ, B1, INJECT, {}),
    (FILE_WRITE, {**B1, "values": {"WPNAV_SPEED": 1500}, "track": [[60, 0, 10]]}, INJECT, {}),
    (EXFILTRATE, {**B1, "what": ["parameters", "mission", "fence", "rally", "logs"]}, INJECT, {}),
    (MALFORMED, {**B1, "rate_hz": 40}, INJECT, {}),
    (MALFORMED, {**B1, "rate_hz": 40, "towards": "station", "on": "log"}, INJECT, {}),
]


@pytest.mark.catalogue
@pytest.mark.parametrize(
    ("kind", "params", "acts", "times"), KINDS, ids=[f"{k.params.__name__}-{i}" for i, (k, *_) in enumerate(KINDS)]
)
def test_mavlink_attacks_conform(
    kind: AttackPlugin, params: Mapping[str, Any], acts: set[str], times: Mapping[str, Any]
) -> None:
    check_attack(kind, params, acts=acts, **times)
