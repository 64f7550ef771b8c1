"""Each rule for monitors is broken by a monitor that breaks just that rule, and is found by its id."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import pytest

from skyrange.contracts.alerts import Alert
from skyrange.contracts.monitors import ObservedFrame, ObservedFrames
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.detect.heartbeat.gap import HeartbeatGap
from skyrange.testing import NonConformance, check_monitor
from skyrange.testing.checks.monitors import MONITOR

SEEN = [f"frame {k}".encode() for k in range(60)]


@dataclass
class Counter:
    """Alerts of every tenth frame: keeps every rule."""

    service_ns: Any = 250 * NS_PER_MS
    seen: int = 0
    frames: list[ObservedFrame] = field(default_factory=list)

    def observe(self, now: Time, frames: ObservedFrames) -> Any:
        alerts = []
        for frame in frames:
            self.seen += 1
            self.frames = [*self.frames[-3:], frame]
            if self.seen % 10 == 0:
                alerts.append(self.alert(now, frame))
        return alerts

    def alert(self, now: Time, frame: ObservedFrame) -> Any:
        return Alert(frame.at, frame.port.link, "count.tenth", self.seen / 10, {"from": frame.src})


def check(make: Any) -> None:
    check_monitor(make, payloads=SEEN, until=3 * NS_PER_S)


def test_the_unbroken_ones_conform() -> None:
    check(Counter)
    check_monitor(Counter)
    check_monitor(HeartbeatGap, until=20 * NS_PER_S)


def raising(alert: Any) -> type[Counter]:
    """Raises the same of every tenth frame."""

    class Raises(Counter):
        def alert(self, now: Time, frame: ObservedFrame) -> Any:
            return alert(now) if callable(alert) else alert

    return Raises


class Generates(Counter):
    def observe(self, now: Time, frames: ObservedFrames) -> Iterator[Alert]:
        yield from super().observe(now, frames)


class Single(Counter):
    def observe(self, now: Time, frames: ObservedFrames) -> Any:
        return Alert(now, "all", "count", 1.0)


class Hurries(Counter):
    def observe(self, now: Time, frames: ObservedFrames) -> Any:
        self.service_ns = 100 * NS_PER_MS
        return []


class Tampers(Counter):
    def observe(self, now: Time, frames: ObservedFrames) -> Any:
        frames.at_ns[:] = 0
        return []


class Needy(Counter):
    def observe(self, now: Time, frames: ObservedFrames) -> Any:
        frames[0]
        return []


class Counts(Counter):
    total = 0

    def alert(self, now: Time, frame: ObservedFrame) -> Any:
        Counts.total += 1
        return Alert(now, "all", "count", Counts.total)


class Numbers(Counter):
    """Takes the number of a name for the name."""

    def observe(self, now: Time, frames: ObservedFrames) -> Any:
        return [Alert(now, "all", "count", float(src)) for src in frames.src[:1]]


class Clocked(Counter):
    def observe(self, now: Time, frames: ObservedFrames) -> Any:
        time.perf_counter()
        return []


class Punctual(Counter):
    last: Time | None = None

    def observe(self, now: Time, frames: ObservedFrames) -> Any:
        assert self.last is None or now == self.last + self.service_ns
        self.last = now
        return []


class Shares(Counter):
    """Its copy remembers in the same list."""

    def __deepcopy__(self, memo: object) -> Shares:
        twin = type(self)(self.service_ns, self.seen)
        twin.frames = self.frames
        return twin

    def observe(self, now: Time, frames: ObservedFrames) -> Any:
        self.frames.extend(frames)
        return [Alert(now, "all", "count", len(self.frames))]


class Trusting(Counter):
    def observe(self, now: Time, frames: ObservedFrames) -> Any:
        return [Alert(now, frame.payload.decode("ascii"), "heard", 1.0) for frame in frames if b"frame" in frame.payload
                or frame.payload[:1] > b"\x7f"]  # fmt: skip


class Chatty(Counter):
    def observe(self, now: Time, frames: ObservedFrames) -> Any:
        return [Alert(now, "all", "heard", 1.0) for _ in range(2 * len(frames))]


BREAKING: list[tuple[str, Any]] = [
    ("declares", lambda: Counter(0)),
    ("declares", lambda: Counter(0.5)),
    ("declares", Hurries),
    ("alerts", Generates),
    ("alerts", Single),
    ("alerts", raising("alert")),
    ("alerts", raising(lambda now: Alert(now + 1, "all", "late", 1.0))),
    ("alerts", raising(lambda now: Alert(now / 2, "all", "half", 1.0))),
    ("alerts", raising(Alert(0, "", "empty", 1.0))),
    ("alerts", raising(Alert(0, "all", "Two Words", 1.0))),
    ("alerts", raising(Alert(0, "all", "score", float("nan")))),
    ("alerts", raising(Alert(0, "all", "data", 1.0, {"list": [1]}))),  # type: ignore[dict-item]
    ("alerts", raising(Alert(0, "all", "data", 1.0, {"inf": float("inf")}))),
    ("alerts", raising(Alert(0, "all", "data", 1.0, {"text": "x" * 5_000}))),
    ("alerts", raising(Alert(0, "all", "data", 1.0, None))),  # type: ignore[arg-type]
    ("hands-off", Tampers),
    ("idle", Needy),
    ("repeatable", Counts),
    ("names", Numbers),
    ("pure", Clocked),
    ("late", Punctual),
    ("copies", Shares),
    ("hostile", Trusting),
    ("modest", Chatty),
]


@pytest.mark.parametrize(
    ("rule", "broken"), BREAKING, ids=[f"{rule}-{getattr(made, '__name__', made)}" for rule, made in BREAKING]
)
def test_a_broken_rule_is_found(rule: str, broken: Any) -> None:
    with pytest.raises(NonConformance) as found:
        check(broken)
    assert found.value.rule == f"monitor.{rule}", str(found.value)


def test_every_rule_is_shown_to_fail() -> None:
    assert {f"monitor.{rule}" for rule, _ in BREAKING} == {rule.id for rule in MONITOR.rules}
