"""Flags of a GNSS receiver: jamming by what noise leaves of a fix, spoofing at a transition alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skyrange.contracts.alerts import Alert
from skyrange.contracts.components import Sensors
from skyrange.core.time import NS_PER_S, Time
from skyrange.defence.gnss.integrity import IntegrityFlags, ReceiverFlags
from tests.unit.test_defence_gnss import made, readings

PERIOD = NS_PER_S // 5


def fixes(receiver: ReceiverFlags, count: int, first: Time, sensors: Sensors, draw: float = 0.0) -> Time:
    """Take in fixes that repeat; the time of the next one."""
    for number in range(count):
        receiver.take(first + number * PERIOD, first + number * PERIOD, lambda: draw, 0, sensors)
    return first + count * PERIOD


def said(receiver: ReceiverFlags) -> tuple[str, str]:
    """What it says of jamming and of spoofing."""
    return receiver.jamming.name, receiver.spoofing.name


def flags(**params: float) -> ReceiverFlags:
    check = made(IntegrityFlags)
    for name, value in params.items():
        setattr(check, name, value)
    return ReceiverFlags(check, 5.0)


def moved(**columns: object) -> Sensors:
    return replace(readings(), **{name: np.array([value]) for name, value in columns.items()})


STEPS = {
    "place": moved(gnss_enu_m=[60.0, 0.0, 0.0]),
    "velocity": moved(gnss_vel_enu_mps=[9.0, 0.0, 0.0]),
    "time": moved(gnss_utc_error_ns=2_000_000),
}


@pytest.mark.parametrize("what", STEPS)
def test_a_step_is_flagged_for_one_epoch_and_what_follows_is_not(what: str) -> None:
    """A receiver that follows the false signals says again that no spoofing is indicated."""
    receiver = flags()
    now = fixes(receiver, 30, 0, readings())
    assert said(receiver) == ("OK", "NONE")
    now = fixes(receiver, 1, now, STEPS[what], draw=0.69)
    assert (said(receiver)[1], receiver.score > 1.0) == ("INDICATED", True)
    now = fixes(receiver, 1, now, STEPS[what])
    assert said(receiver)[1] == "NONE"
    fixes(receiver, 1, now, readings())
    assert said(receiver)[1] == "MULTIPLE"


def test_a_step_is_missed_by_chance_and_a_new_lock_is_flagged_by_chance() -> None:
    receiver = flags()
    now = fixes(receiver, 30, 0, readings())
    fixes(receiver, 1, now, STEPS["place"], draw=0.71)
    assert said(receiver)[1] == "NONE"
    for draw, state in ((0.009, "INDICATED"), (0.011, "NONE")):
        receiver = flags()
        now = fixes(receiver, 30, 0, readings())
        fixes(receiver, 1, now + 2 * NS_PER_S, readings(), draw=draw)
        assert said(receiver)[1] == state
    receiver = flags()
    fixes(receiver, 31, 0, readings(), draw=0.0)
    assert said(receiver)[1] == "NONE"  # without a loss of lock there is no transition


def test_a_drift_that_an_aircraft_could_fly_is_never_flagged() -> None:
    """As after an aligned takeover: 0.5 m/s² off the truth, from fix to fix without a step."""
    receiver = flags(detection=1.0)
    for number in range(300):
        seconds = number * 0.2
        sensors = moved(gnss_enu_m=[0.25 * seconds**2, 0.0, 0.0], gnss_vel_enu_mps=[0.5 * seconds, 0.0, 0.0])
        receiver.take(number * PERIOD, number * PERIOD, lambda: 0.0, 0, sensors)
        assert said(receiver)[1] == "NONE"


def test_noise_is_flagged_by_what_it_leaves_of_a_fix() -> None:
    receiver = flags()
    now = fixes(receiver, 30, 0, readings())
    now = fixes(receiver, 1, now, moved(gnss_satellites=4))
    assert said(receiver)[0] == "WARNING"
    assert receiver.jam_score == pytest.approx(1.25)
    now = fixes(receiver, 1, now, moved(gnss_accuracy=[3.1, 5.0, 0.4]))
    assert said(receiver)[0] == "WARNING"
    now = fixes(receiver, 1, now, readings())
    assert said(receiver)[0] == "OK"
    receiver.miss(now + 3 * NS_PER_S)
    assert said(receiver)[0] == "OK"
    receiver.miss(now + 5 * NS_PER_S)
    assert said(receiver)[0] == "CRITICAL"


def test_hostile_numbers_are_survived() -> None:
    receiver = flags()
    now = fixes(receiver, 30, 0, readings())
    for sensors in (moved(gnss_enu_m=[np.nan] * 3), moved(gnss_accuracy=[np.nan] * 3), moved(gnss_satellites=0)):
        now = fixes(receiver, 1, now, sensors)
    receiver.take(0, 0, lambda: 0.0, 0, readings())  # a time before the last one
    assert said(receiver) == ("OK", "NONE")
    assert np.isfinite(receiver.score)


def test_an_indication_takes_fixes_away_and_jamming_does_not() -> None:
    """The check draws by vehicle and time of the fix; with a chance of 1 it flags every step."""
    check = made(IntegrityFlags)
    check.detection = 1.0
    told: list[str] = []
    for number in range(40):
        now = number * PERIOD
        sensors = readings() if number < 35 else moved(gnss_enu_m=[60.0, 0.0, 0.0])
        if number == 30:
            sensors.gnss_satellites[:] = 4
        sensors.gnss_time_ns[:] = now
        found = check.on_sensors(now, sensors)
        told += [alert.kind for alert in found if isinstance(alert, Alert)]
        assert (sensors.gnss_fix[0] == 3) == (number < 35)
    assert told == ["integrity.jamming", "integrity.spoofing"]
