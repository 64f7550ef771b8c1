"""What do attacks on receivers and sensors do to an aircraft in flight?"""

from __future__ import annotations

import numpy as np
import pytest

from skyrange.assembly.build import build
from skyrange.attack.contract import AttackPlugin
from skyrange.contracts.plugins import registry as plugins
from skyrange.core.time import NS_PER_S, from_seconds
from skyrange.kernel import Kernel
from skyrange.record import MemoryObserver
from skyrange.scenario.toml_files import load_text

pytestmark = pytest.mark.rotating

CAPTURE = AttackPlugin.find("gnss.capture")
GNSS_JAM = AttackPlugin.find("gnss.jam")
BAROMETER = AttackPlugin.find("sensor.barometer")
GYRO = AttackPlugin.find("sensor.gyro")

SQUARE = """
name = "s"
duration_s = 45
origin = [40.778, -73.955]
[[operators]]
id = "blue"
  [[operators.vehicles]]
  id = "b1"
  plan.square = { side_m = 40, alt_m = 20 }
[[attacks]]
id = "x"
kind = "test.kind"
start_s = 20
"""


def flown(kind: AttackPlugin, params: str, monkeypatch: pytest.MonkeyPatch) -> MemoryObserver:
    plugins.register(plugins.ATTACKS, "test.kind", kind)
    seen = MemoryObserver()
    kernel = Kernel(build(load_text(f"{SQUARE}params = {{ {params} }}\n")).wiring, [seen])
    kernel.advance(from_seconds(45.0))
    kernel.finish()
    return seen


def height_m(seen: MemoryObserver, at_s: float) -> float:
    return float(
        np.mean([row.columns["up_m"][0] for row in seen.truth if abs(row.time_ns - at_s * NS_PER_S) < NS_PER_S])
    )


def modes(seen: MemoryObserver) -> list[tuple[str, str]]:
    told = [note.note for note in seen.notes if note.note.kind == "event.mode" and note.time_ns > 20 * NS_PER_S]
    return [(str(one.data["mode"]), str(one.data["reason"])) for one in told]


def test_a_false_pressure_moves_the_aircraft_by_its_error(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = flown(BAROMETER, 'vehicles = ["blue/b1"], offset_m = 8, rise_s = 12', monkeypatch)
    assert height_m(seen, 19.0) - height_m(seen, 40.0) == pytest.approx(8.0, abs=1.5)
    assert modes(seen) == [], "the estimator passes a slow shift"


def test_without_a_fix_the_aircraft_lands(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = flown(GNSS_JAM, "transmitter_m = [0, -30, 2]", monkeypatch)
    assert modes(seen) == [("LAND", "ekf_failsafe")]
    # EKF3 gives up position 7 s after the last fix; ekf_check needs another second
    (when,) = [note.time_ns for note in seen.notes if note.note.kind == "event.mode" and note.time_ns > 20 * NS_PER_S]
    assert when / NS_PER_S == pytest.approx(28.0, abs=1.0)


def test_a_captured_aircraft_fails_safe(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = flown(CAPTURE, "transmitter_m = [0, -30, 2], at = [300, 0, 20]", monkeypatch)
    assert modes(seen)[0] == ("LAND", "ekf_failsafe")
    assert {label.frame.link for label in seen.labels} == {"gnss:blue/b1"}
    assert len(seen.labels) == 2, "loss of lock, then capture"


def test_false_rotation_crashes_the_aircraft(monkeypatch: pytest.MonkeyPatch) -> None:
    sound = 'vehicles = ["blue/b1"], amplitude_dps = [1000, 1000, 0], frequency_hz = 20'
    seen = flown(GYRO, sound, monkeypatch)
    assert any(note.note.kind in ("event.crash", "event.collision") for note in seen.notes)
