"""No report says "unknown" by accident: values that MAVLink reserves for it are sent for what is not known alone."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pymavlink.dialects.v20
import pytest
from numpy.typing import NDArray

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.builtin.engine import BuiltinFleet
from skyrange.vehicle.builtin.layout import ControlMode
from skyrange.vehicle.builtin.telemetry.table import BUILDERS, build_table
from skyrange.vehicle.contract import VehicleSpec
from tests.integration.flight_harness import EPOCH, ORIGIN

NUMBERS = {"UINT8_MAX": 255, "UINT16_MAX": 65_535, "UINT32_MAX": 2**32 - 1, "INT8_MAX": 127, "INT16_MAX": 32_767}
NUMBERS |= {"INT32_MAX": 2**31 - 1, "0xFFFF": 65_535, "MAV_LANDED_STATE_UNDEFINED": 0}
NOT_KNOWN = {
    ("ATTITUDE_QUATERNION", "repr_offset_q"): "there is no offset of the representation",
    ("BATTERY_STATUS", "temperature"): "the battery has no thermometer",
    ("BATTERY_STATUS", "voltages"): "the monitor does not measure cells",
    ("DISTANCE_SENSOR", "covariance"): "as ArduPilot sends it",
    ("DISTANCE_SENSOR", "horizontal_fov"): "as ArduPilot sends it",
    ("DISTANCE_SENSOR", "quaternion"): "used by other orientations alone",
    ("DISTANCE_SENSOR", "signal_quality"): "as ArduPilot sends it",
    ("DISTANCE_SENSOR", "vertical_fov"): "as ArduPilot sends it",
    ("GPS_RAW_INT", "yaw"): "one antenna has no yaw",
    ("MISSION_CURRENT", "mission_mode"): "no mission",
    ("MISSION_CURRENT", "mission_state"): "no mission",
    ("SCALED_IMU2", "temperature"): "not measured",
    ("SCALED_IMU3", "temperature"): "not measured",
    ("SCALED_PRESSURE", "temperature_press_diff"): "there is no airspeed sensor",
    ("SCALED_PRESSURE2", "temperature_press_diff"): "there is no airspeed sensor",
}
"""Fields that are never known, and why."""
PAIRS = {"latitude": "longitude", "longitude": "latitude"}
"""Fields of which one alone may be 0: unknown are both."""
ROWS = 400


@cache
def sentinels() -> dict[tuple[str, str], float]:
    """By message and field, the value that stands for unknown, from MAVLink's definitions."""
    found = {}
    text = (Path(pymavlink.dialects.v20.__file__).parent / "common.xml").read_text(encoding="utf-8")
    for message in ElementTree.fromstring(text).iter("message"):
        for field in message.iter("field"):
            value = re.sub(r"[\[\]:]", "", field.get("invalid", ""))
            if value:
                found[message.attrib["name"], field.attrib["name"]] = float(NUMBERS.get(value, value))
    return found


def fleet_of_extremes(seed: int) -> Any:
    """Aircraft with a fix and a battery, whose other numbers are of any magnitude, and what a sentinel stands for."""
    chance = np.random.default_rng(seed)
    specs = [VehicleSpec(f"blue/b{row}", row % 250 + 1, seed=3) for row in range(ROWS)]
    made = BuiltinFleet("x", specs, ORIGIN, EPOCH)
    fleet = made._fleet
    fleet.now = 123_456_789_000
    special = np.array([value * scale for value in set(sentinels().values()) for scale in (1.0, 0.1, 0.01, 0.001)])
    special = special[np.isfinite(special)]
    for table in (fleet.estimate, fleet.flight, fleet.battery, fleet.checks):
        for name in table.dtype.names or ():
            if table.dtype[name].names or table.dtype[name].base.kind != "f":
                continue
            shape = table[name].shape
            sizes = chance.choice([-1.0, 1.0], shape) * 10.0 ** chance.uniform(-4.0, 6.0, shape)
            table[name] = np.where(chance.random(shape) < 0.3, chance.choice(special, shape), sizes)
    e, f = fleet.estimate, fleet.flight
    e["status"], e["gnss_fix"], e["gnss_sats"], e["gnss_age_s"] = 831, 3, 9, 0.1
    e["pos"][:, :2] = np.clip(e["pos"][:, :2], -2e5, 2e5)
    f["armed"], f["landed"], f["control"] = 1, 0, ControlMode.POSITION
    fleet.battery["remaining_pct"] = 63
    return made


def unknown_rows(table: NDArray[Any], name: str, field: str) -> NDArray[np.bool_]:
    """(rows,) whether a field says unknown."""
    value = sentinels()[name, field]
    said = np.isnan(table[field]) if np.isnan(value) else table[field] == value
    if field in PAIRS:
        said = said & (table[PAIRS[field]] == 0)
    found: NDArray[np.bool_] = said.reshape(len(table), -1).any(axis=1)
    return found


def declared() -> Iterator[tuple[int, str, str]]:
    for number in BUILDERS:
        name = dialect.mavlink_map[number].msgname
        yield from ((number, name, field) for of, field in sentinels() if of == name)


def test_what_is_never_known_is_of_reports_that_are_sent() -> None:
    assert NOT_KNOWN.keys() <= {(name, field) for _, name, field in declared()}


@pytest.mark.parametrize("seed", range(3))
def test_no_report_of_what_is_known_says_unknown(seed: int) -> None:
    made = fleet_of_extremes(seed)
    rows = np.arange(ROWS, dtype=np.int64)
    said = {}
    with np.errstate(all="ignore"):
        for number, name, field in declared():
            if (name, field) not in NOT_KNOWN:
                count = int(unknown_rows(build_table(made._fleet, number, rows), name, field).sum())
                if count:
                    said[name, field] = count
    assert not said, said
