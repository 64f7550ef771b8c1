"""What does a wrong GNSS time do to a receiver's fixes, to the clock of an autopilot, and to signatures?"""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
import pytest

from skyrange.attack.contract import AttackPlugin
from skyrange.attack.gnss.time import ROLLOVER_S
from skyrange.codec.mavlink import Packer, dialect
from skyrange.codec.mavlink.signing import SignatureRefusal, Signer, SigningKey, signing_timestamp
from skyrange.contracts.components import SensorAct, Sensors
from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_S, Epoch, Time
from skyrange.vehicle.ardupilot.gps_input import GnssReceivers
from skyrange.vehicle.builtin.utc_clocks import UtcClocks
from tests.unit.test_attack_gnss import S, context, fault, readings

GNSS_TIME = AttackPlugin.find("gnss.time")

EPOCH = Epoch(1_767_268_800 * NS_PER_S)  # 2026-01-01T12:00:00Z


def told(which: Any, measured: list[Time], now: Time = 90 * S) -> tuple[Sensors, list[SensorAct]]:
    sensors = readings()
    sensors.gnss_time_ns[:] = measured
    return sensors, list(which.on_sensors(now, sensors))


def test_an_offset_and_its_growth_by_the_time_of_the_measurement_and_nothing_else() -> None:
    spoofed = fault(GNSS_TIME, offset_s=20, drift_s_per_s=-0.5)
    sensors, acts = told(spoofed, [2 * S - 1, 6 * S])
    assert sensors.gnss_utc_error_ns.tolist() == [0, 18 * S]
    assert acts == [SensorAct("blue/b2", "gnss")]
    true = readings()
    true.gnss_time_ns[:] = [2 * S - 1, 6 * S]
    for column in fields(Sensors):
        same = getattr(sensors, column.name).tobytes() == getattr(true, column.name).tobytes()
        assert same == (column.name != "gnss_utc_error_ns"), column.name
    assert told(spoofed, [7 * S, 6 * S])[1] == [SensorAct("blue/b1", "gnss")]


def test_a_sham_acts_and_shifts_nothing() -> None:
    sensors, acts = told(fault(GNSS_TIME, context(sham=True), offset_s=20), [6 * S, 6 * S])
    assert not sensors.gnss_utc_error_ns.any()
    assert len(acts) == 2


def test_a_receiver_without_a_fix_reports_no_time() -> None:
    sensors = readings()
    sensors.gnss_time_ns[:], sensors.gnss_fix[:] = 6 * S, [1, 2]
    fault(GNSS_TIME, offset_s=1).on_sensors(6 * S, sensors)
    assert sensors.gnss_utc_error_ns.tolist() == [0, S]


@pytest.mark.parametrize("params", [{}, {"offset_s": 0}, {"offset_s": ROLLOVER_S + 1}, {"drift_s_per_s": 101}])
def test_bad_numbers_are_refused(params: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"offset_s|drift_s_per_s"):
        fault(GNSS_TIME, **params)


def test_an_aircraft_that_is_not_there_is_named() -> None:
    with pytest.raises(InputError, match="blue/b9"):
        fault(GNSS_TIME, vehicles=["blue/b9"], offset_s=1)


def clocks(count: int = 1) -> UtcClocks:
    """Clocks that were set to UTC."""
    found = UtcClocks(count, EPOCH)
    found.update(*_state([0] * count))
    return found


def _state(error_s: list[float], armed: int = 0, fix: int = 3) -> tuple[Any, Any, Any]:
    errors = np.array([round(one * S) for one in error_s], dtype=np.int64)
    return errors, np.full(len(errors), fix), np.full(len(errors), armed)


def test_a_clock_is_set_forward_while_disarmed_and_never_back() -> None:
    one = clocks()
    assert one.update(*_state([0.0])).tolist() == []
    assert one.update(*_state([20.0], fix=2)).tolist() == []
    assert one.update(*_state([20.0], armed=1)).tolist() == []
    assert one.utc_us(np.array([0]), S).tolist() == [EPOCH.utc_us(S)]
    assert one.update(*_state([20.0])).tolist() == [0]
    assert one.utc_us(np.array([0]), S).tolist() == [EPOCH.utc_us(21 * S)]
    assert one.update(*_state([-5.0])).tolist() == []
    assert one.error_ns.tolist() == [20 * S]
    assert one.receiver_error_ns.tolist() == [-5 * S]


def test_a_clock_that_was_never_set_is_unknown_and_set_by_the_first_fix_even_armed_and_back() -> None:
    one = UtcClocks(1, EPOCH)
    assert one.update(*_state([0.0], fix=1)).tolist() == []
    assert one.utc_us(np.array([0]), S).tolist() == [0]
    assert one.update(*_state([-5.0], armed=1)).tolist() == [0]
    assert one.utc_us(np.array([0]), 6 * S).tolist() == [EPOCH.utc_us(S)]


def test_a_reboot_lets_a_clock_go_back() -> None:
    one = clocks()
    one.update(*_state([20.0]))
    one.update(*_state([0.0]))
    one.restart(0, fix=3)
    assert one.error_ns.tolist() == [0]
    one.restart(0, fix=1)
    assert one.utc_us(np.array([0]), S).tolist() == [0]


@pytest.mark.parametrize(("error_s", "week", "ms"), [(0, 2399, 388_818_000), (220_000, 2400, 4_018_000)])
def test_gps_input_has_the_time_of_the_receiver(error_s: int, week: int, ms: int) -> None:
    sensors = readings()
    sensors.gnss_time_ns[:], sensors.gnss_utc_error_ns[:] = 0, error_s * S
    made = GnssReceivers(2, Origin(40.0, -73.0), EPOCH).message(sensors, 0)
    assert (made.time_week, made.time_week_ms) == (week, ms)


def test_after_a_jump_a_new_stream_is_refused_until_its_sender_has_heard_the_aircraft() -> None:
    """The rule of a minute (mavlink.io, "Timestamp Handling"), and the receiver's own timestamp that follows frames."""
    key = SigningKey(bytes(range(32)), signing_timestamp(EPOCH.unix_ns))
    aircraft, station, known = Signer(key, 1), Signer(key, 0), Signer(key, 2)
    for signer in (aircraft, station, known):
        signer.start(0)
    gcs, autopilot = Packer(255, 190), Packer(1, 1)
    ping = dialect.MAVLink_ping_message(0, 0, 0, 0)
    assert aircraft.check(known.sign(gcs.pack(ping))) is None
    aircraft.set_clock(EPOCH.unix_ns + 120 * S)
    assert aircraft.check(known.sign(gcs.pack(ping))) is None
    assert aircraft.check(station.sign(gcs.pack(ping))) is SignatureRefusal.OLD
    assert station.check(aircraft.sign(autopilot.pack(ping))) is None
    assert aircraft.check(station.sign(gcs.pack(ping))) is None
    before = aircraft.timestamp
    aircraft.set_clock(EPOCH.unix_ns)
    assert aircraft.timestamp == before
