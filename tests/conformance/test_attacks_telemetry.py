"""Do the attacks on telemetry, identities and signatures keep their contract?"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any

import pytest

from skyrange.attack.contract import AttackPlugin
from skyrange.scenario.model.scenario import Radio, Scenario
from skyrange.testing import check_attack
from skyrange.testing.checks.attacks import two_squares

pytestmark = pytest.mark.rotating

KEEP_ALIVE = AttackPlugin.find("identity.keep_alive")
SECOND_VEHICLE = AttackPlugin.find("identity.second_vehicle")
SILENCE_STATION = AttackPlugin.find("identity.silence_station")
REPLAY = AttackPlugin.find("signing.replay")
SETUP_KEY = AttackPlugin.find("signing.setup_key")
STOLEN_KEY = AttackPlugin.find("signing.stolen_key")
ATTITUDE = AttackPlugin.find("telemetry.attitude")
BATTERY = AttackPlugin.find("telemetry.battery")
FALSE_ALARM = AttackPlugin.find("telemetry.false_alarm")
HIDE_FAILURES = AttackPlugin.find("telemetry.hide_failures")
HOME = AttackPlugin.find("telemetry.home")
MODE = AttackPlugin.find("telemetry.mode")
POSITION = AttackPlugin.find("telemetry.position")
SYSTEM_TIME = AttackPlugin.find("time.system_time")

GCS = ["gcs:blue/b1"]
PLACE = [200.0, 5.0, 20.0]


def signed_squares(duration_s: float) -> Scenario:
    """The two squares of the check, with signed links."""
    squares = two_squares(duration_s)
    signed = tuple(operator.model_copy(update={"signing": "on"}) for operator in squares.operators)
    return squares.model_copy(update={"operators": signed})


def broadcasting_squares(duration_s: float) -> Scenario:
    """The two squares of the check, with Remote ID: companions request home and time."""
    return two_squares(duration_s).model_copy(update={"radio": Radio()})


KINDS: list[tuple[AttackPlugin, Mapping[str, Any], Collection[str], Callable[[float], Scenario]]] = [
    (POSITION, {"links": GCS, "offset_m": [40.0, 0.0, 3.0]}, {"replace"}, two_squares),
    (POSITION, {"links": ["autopilot:*"], "drift_mps": [1.0, 2.0, 0.0]}, {"replace"}, two_squares),
    (
        POSITION,
        {"links": ["log:blue/b1"], "form": "track", "at": PLACE, "velocity_mps": [1.0, 0.0, 0.0]},
        {"replace"},
        two_squares,
    ),
    (POSITION, {"links": GCS, "offset_m": [40.0, 0.0, 3.0]}, {"replace"}, signed_squares),
    (MODE, {"links": GCS, "mode": "LAND", "armed": False, "mission": "complete"}, {"replace"}, two_squares),
    (MODE, {"links": ["rid_data:*"], "mode": "LOITER"}, {"replace"}, two_squares),
    (BATTERY, {"links": GCS, "remaining_percent": 20.0, "voltage_v": 9.5}, {"replace"}, two_squares),
    (HIDE_FAILURES, {"links": ["autopilot:*"]}, {"replace"}, two_squares),
    (FALSE_ALARM, {"links": ["rid_data:*", "gcs:*"]}, {"replace"}, two_squares),
    (ATTITUDE, {"links": GCS, "roll_deg": 20.0, "yaw_deg": 90.0}, {"replace"}, two_squares),
    (HOME, {"links": ["rid_data:blue/b1"], "offset_m": [0.0, 100.0, 0.0]}, {"replace"}, broadcasting_squares),
    (SYSTEM_TIME, {"links": ["rid_data:*"], "offset_s": -300.0}, {"replace"}, broadcasting_squares),
    (SECOND_VEHICLE, {"links": GCS, "at": PLACE, "armed": False, "mode": "LAND"}, {"inject"}, two_squares),
    (SILENCE_STATION, {"links": GCS}, {"drop"}, two_squares),
    (SILENCE_STATION, {"links": ["gcs:*"], "towards": "station"}, {"drop"}, two_squares),
    (KEEP_ALIVE, {"links": GCS}, {"drop", "inject"}, two_squares),
    (KEEP_ALIVE, {"links": GCS, "cut": False}, {"inject"}, two_squares),
    (STOLEN_KEY, {"links": GCS}, {"inject"}, signed_squares),
    (STOLEN_KEY, {"links": GCS, "passphrase": "guessed", "order": "disarm"}, {"inject"}, signed_squares),
    (STOLEN_KEY, {"links": GCS, "order": "take_off"}, {"inject"}, signed_squares),
    (REPLAY, {"links": GCS}, {"inject"}, signed_squares),
    (SETUP_KEY, {"vehicles": ["blue/b1"], "times": 0}, {"inject"}, two_squares),
    (SETUP_KEY, {"vehicles": ["blue/b1"], "form": "remove", "on": "log"}, {"inject"}, signed_squares),
]


@pytest.mark.catalogue
@pytest.mark.parametrize(
    ("kind", "params", "acts", "scenario"), KINDS, ids=[f"{k.params.__name__}-{i}" for i, (k, *_) in enumerate(KINDS)]
)
def test_attacks_on_telemetry_conform(
    kind: AttackPlugin, params: Mapping[str, Any], acts: Collection[str], scenario: Callable[[float], Scenario]
) -> None:
    # home and time are reported every few seconds
    start_s, stop_s = (0.5, 9.0) if kind in (HOME, SYSTEM_TIME) else (3.0, 7.0)
    check_attack(kind, params, acts=acts, scenario=scenario, start_s=start_s, stop_s=stop_s)
