"""Is a class of a defence or a detector a kind only with what its base needs, and one per run, link or aircraft?"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from skyrange.attack.contract import Aircraft, AttackContext
from skyrange.attack.declaration import Composite
from skyrange.contracts.alerts import Alert
from skyrange.contracts.frames import Ints
from skyrange.contracts.links import Schedule
from skyrange.contracts.monitors import DetectorContext, DetectorPlugin, ObservedFrames
from skyrange.contracts.plugins.form import state
from skyrange.contracts.plugins.registry import DETECTORS, kinds
from skyrange.contracts.verdicts import Verdict
from skyrange.core.chance import Chance
from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_S, Epoch, Time
from skyrange.defence.bases.link_ends import EndTap
from skyrange.defence.contract import DefencePlugin, defence
from skyrange.detect.bases import MessageDetector, TelemetryDetector
from skyrange.detect.declaration import Detector, detector
from skyrange.detect.streams import table
from tests.registered_kinds import registered

ORIGIN = Origin(40.0, -74.0)


class Deaf(Detector):
    """Hears nothing."""


class Silent(MessageDetector):
    """Says nothing."""


class Idle(TelemetryDetector):
    """Compares nothing."""


class Open(EndTap):
    """Lets all pass."""


class Nothing(Composite):
    """Does nothing."""

    def build(self, context: Any) -> Any:
        return None


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        (Deaf, "expected observe, which every Detector defines"),
        (Silent, "expected judge, which every MessageDetector defines"),
        (Idle, "expected compare, which every TelemetryDetector defines"),
        (Nothing, "bases: Composite — expected Detector or one of its bases"),
    ],
)
def test_a_class_that_is_no_detector_is_named_with_what_it_lacks(kind: Any, message: str) -> None:
    with registered(), pytest.raises(InputError, match=f"class {kind.__name__} in .*{message}"):
        detector("test.nothing")(kind)


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        (Open, "expected on_frame, which every EndTap defines"),
        (Deaf, "bases: Detector — expected Acting or one of its bases"),
    ],
)
def test_a_class_that_is_no_defence_is_named_with_what_it_lacks(kind: Any, message: str) -> None:
    with registered(), pytest.raises(InputError, match=f"class {kind.__name__} in .*{message}"):
        defence("test.nothing")(kind)


class Counts(Detector):
    """Counts services."""

    ends: Ints = table()

    def observe(self, now: Time, frames: ObservedFrames) -> Sequence[Alert]:
        self.grow(3, ends=7)
        return [self.alert(now, "gcs:blue/b1", 2.0, {"ends": int(self.ends[2])}, "end")]


def test_each_run_has_a_monitor_of_its_own() -> None:
    with registered():
        detector("test.counts")(Counts)
        plugin = DetectorPlugin.find("test.counts")
        context = DetectorContext("one", ["blue/b1"], ORIGIN, Epoch(0), Chance(1))
        one, other = (plugin.make(plugin.params(), context) for _ in range(2))
        (alert,) = one.observe(NS_PER_S, None)  # type: ignore[arg-type]
    assert alert == Alert(NS_PER_S, "blue/b1", "test.counts.end", 2.0, {"link": "gcs:blue/b1", "ends": 7})
    assert isinstance(one, Counts)
    assert isinstance(other, Counts)
    assert (len(one.ends), len(other.ends)) == (3, 0)


def test_a_detector_after_a_method_on_board_says_what_it_lacks() -> None:
    lacking = {kind for kind in kinds(DETECTORS) if DetectorPlugin.find(kind).reduced}
    assert {"motion.consistency", "navigation.cs_ema"} <= lacking
    assert "mavlink.sequence" not in lacking
    with registered():
        detector("test.counts", reduced="no motors")(Counts)
        assert DetectorPlugin.find("test.counts").reduced == "no motors"


class Marks(EndTap):
    """Marks what passes."""

    decides = "mark"
    shares = ("every",)
    every: list[str] = state(list)
    own: list[str] = state(list)

    def on_frame(self, now: Time, frame: Any) -> Sequence[Verdict]:
        self.every.append(self.vehicle)
        self.own.append(self.vehicle)
        return ()


def test_taps_are_copies_that_share_what_the_kind_says() -> None:
    vehicles = {name: Aircraft((0.0, 0.0, 0.0), name, number) for number, name in enumerate(("blue/b1", "blue/b2"), 1)}
    links = [f"gcs:{name}" for name in vehicles]
    context = AttackContext("d", vehicles, links, ORIGIN, Epoch(0), Chance(1), NS_PER_S, Schedule())
    with registered():
        defence("test.marks")(Marks)
        made = DefencePlugin.find("test.marks").make(Marks.params_model(), context)
    taps: list[Any] = [placed.make(placed.match) for placed in made.taps]
    one, other = taps
    assert [tap.schedule is context.schedule for tap in (one, other)] == [True, True]
    one.on_frame(0, None)
    other.on_frame(0, None)
    assert (one.own, other.own, one.every, other.every) == (["blue/b1"], ["blue/b2"], *2 * [["blue/b1", "blue/b2"]])
    assert [exclusive.what for exclusive in made.exclusive] == ["mark of blue/b1", "mark of blue/b2"]
