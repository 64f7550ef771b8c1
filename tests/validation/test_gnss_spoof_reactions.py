"""Reactions of the builtin to false GNSS, compared with ArduCopter's: `gnss_spoofs`, flown and read from the record.

What happened is taken from what a run records: notes, STATUSTEXT and EKF_STATUS_REPORT, and the true position.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from skyrange.attack.contract import Aircraft, AttackContext, AttackPlugin
from skyrange.codec.mavlink import dialect
from skyrange.contracts.components import SensorHook, Sensors
from skyrange.contracts.links import Schedule
from skyrange.core.chance import Chance
from skyrange.core.time import NS_PER_MS, NS_PER_S
from skyrange.vehicle.contract import VehicleSpec
from tests.integration.flight_harness import EPOCH, ORIGIN, Range
from tests.validation.gnss_spoofs import FINE, MOVED, RATIO, RESET, SECONDS, SPOOFS, TIME_S, USUAL, Spoof

pytestmark = pytest.mark.rotating

DRIFT = AttackPlugin.find("gnss.drift")
JUMP = AttackPlugin.find("gnss.jump")

ME = "blue/b1"
KINDS = {"gnss.jump": JUMP, "gnss.drift": DRIFT}
FIX_NS = 200 * NS_PER_MS
BARO_NS = 100 * NS_PER_MS
"""Copter.cpp reads the barometer at 10 Hz (`update_altitude`); how far a false climb rate carries depends on it."""
GLITCHING = 1 << 15


@dataclass
class Receiver:
    """A receiver of 5 Hz and a barometer of 10 Hz without error, and the fault between them and the autopilot."""

    accuracy: tuple[float, float, float]
    fault: SensorHook | None = None
    held: list[np.ndarray] = field(default_factory=list)
    height: list[np.ndarray] = field(default_factory=list)

    def __call__(self, now: int, sensors: Sensors) -> None:
        shown = (sensors.gnss_enu_m, sensors.gnss_vel_enu_mps, sensors.gnss_time_ns)
        if now % FIX_NS == 0 or not self.held:
            self.held = [array.copy() for array in shown]
        for array, kept in zip(shown, self.held, strict=True):
            array[:] = kept
        sensors.gnss_accuracy[:], sensors.gnss_fix[:], sensors.gnss_satellites[:] = self.accuracy, 3, 12
        if now % BARO_NS == 0 or not self.height:
            self.height = [sensors.baro_up_m.copy()]
        sensors.baro_up_m[:] = self.height[0]
        if self.fault is not None:
            self.fault.on_sensors(now, sensors)


def hover(accuracy: tuple[float, float, float]) -> Range:
    """In GUIDED, 20 m up, for 15 s, and more than 30 s after boot: earlier "EKF variance" is not said."""
    fly = Range([VehicleSpec(vehicle=ME, system_id=1, airframe="iris")])
    fly.tamper = Receiver(accuracy)
    fly.take_off(ME, 20.0)
    fly.run(15.0)
    fly.run(max(31.0 - fly.seconds, 0.0))
    fly.run((-fly.now % FIX_NS) / NS_PER_S)
    return fly


@pytest.fixture(scope="module")
def hovering() -> dict[tuple[float, float, float], Range]:
    return {accuracy: hover(accuracy) for accuracy in (FINE, USUAL)}


@dataclass
class Seen:
    """What a run showed, seconds after the first false fix."""

    notes: list[tuple[float, str, dict[str, Any]]]
    texts: list[tuple[float, str]]
    reports: list[tuple[float, Any]]
    moved_m: np.ndarray

    def noted(self, kind: str, **data: Any) -> list[float]:
        """When a note of a kind came that says so."""
        return [at for at, name, told in self.notes if name == kind and data.items() <= told.items()]

    def said(self, text: str) -> list[float]:
        return [at for at, words in self.texts if words == text]

    def flagged(self, flag: int, up: bool) -> float | None:
        """When a flag of EKF_STATUS_REPORT first was up, or first went down again."""
        raised = False
        for at, report in self.reports:
            if up and report.flags & flag:
                return at
            if not up and raised and not report.flags & flag:
                return at
            raised = raised or bool(report.flags & flag)
        return None


def flown(trunk: Range, spoof: Spoof) -> Seen:
    fly = copy.deepcopy(trunk)
    if spoof.at_place:
        fly.go_to(ME, *fly.positions()[0].tolist())
        fly.run(2.0)
    fly.command(ME, dialect.MAV_CMD_SET_MESSAGE_INTERVAL, dialect.MAVLINK_MSG_ID_EKF_STATUS_REPORT, 50_000)
    fly.run((-fly.now % FIX_NS) / NS_PER_S)
    began, start = fly.now / NS_PER_S, fly.positions()[0]
    notes, said = len(fly.notes), len(fly.said)
    context = AttackContext(
        "lie", {ME: Aircraft((0.0, 0.0, 0.0), "")}, [], ORIGIN, EPOCH, Chance(0), 10**12, Schedule(fly.now)
    )
    kind = KINDS[spoof.kind]
    (fault,) = kind(kind.params.model_validate({"vehicles": [ME], **spoof.params}), context).sensor_hooks
    assert isinstance(fly.tamper, Receiver)
    fly.tamper.fault = fault
    fly.run(SECONDS)
    heard = [(one.at_s - began, one.message) for one in fly.said[said:]]
    return Seen(
        [(at - began, note.kind, dict(note.data)) for at, note in fly.notes[notes:]],
        [(at, str(message.text)) for at, message in heard if message.get_type() == "STATUSTEXT"],
        [(at, message) for at, message in heard if message.get_type() == "EKF_STATUS_REPORT"],
        fly.positions()[0] - start,
    )


def once(times: list[float]) -> float | None:
    """The only time of something, or never."""
    assert len(times) <= 1
    return times[0] if times else None


@pytest.mark.catalogue
@pytest.mark.parametrize("spoof", SPOOFS, ids=[spoof.name for spoof in SPOOFS])
def test_it_reacts_as_arducopter_does(hovering: dict[tuple[float, float, float], Range], spoof: Spoof) -> None:
    seen, want = flown(hovering[spoof.accuracy], spoof), spoof.seen

    def near(time: float | None) -> Any:
        return None if time is None else pytest.approx(time, abs=TIME_S)

    for name, expected in (("pos_horiz_variance", want.pos_ratio), ("velocity_variance", want.vel_ratio)):
        largest = max(getattr(report, name) for _, report in seen.reports)
        assert largest == pytest.approx(expected, abs=RATIO, rel=RATIO), name

    assert once(seen.noted("event.glitch", on=True)) == near(want.glitch_s)
    assert once(seen.said("GPS Glitch or Compass error")) == near(want.glitch_s)
    assert seen.flagged(GLITCHING, up=True) == near(want.glitch_s)
    assert once(seen.noted("event.glitch", on=False)) == near(want.cleared_s)
    assert once(seen.said("Glitch cleared")) == near(want.cleared_s)
    assert seen.flagged(GLITCHING, up=False) == near(want.cleared_s)

    resets = [(at, told["east_m"]) for at, kind, told in seen.notes if kind == "event.estimator" and "reset" in told]
    assert [at for at, _ in resets] == [near(at) for at in want.resets]
    assert [by for _, by in resets] == [pytest.approx(by, rel=RESET) for by in want.resets.values()]

    assert once(seen.noted("event.mode", mode="LAND", reason="ekf_failsafe")) == near(want.land_s)
    assert once(seen.said("EKF variance")) == near(want.land_s)
    assert once(seen.said("EKF Failsafe: changed to LAND Mode")) == near(want.land_s)
    assert once(seen.noted("event.ekf_failsafe", on=True)) == near(want.land_s)

    if want.moved_m is not None:
        assert seen.moved_m[spoof.axis] == pytest.approx(want.moved_m, abs=0.5, rel=MOVED)
