"""Each rule for taps is broken by a tap that breaks just that rule, and is found by its id."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import pytest

from skyrange.contracts.frames import Fate, Frame
from skyrange.contracts.verdicts import Delay, Drop, Inject, Pass, Replace
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.testing import NonConformance, check_tap
from skyrange.testing.checks.taps import TAP

TRAFFIC = [f"frame {k}".encode() for k in range(60)]


@dataclass
class Warden:
    """Drops, delays, replaces and replays by turns; injects on its own twice a second: keeps every rule."""

    link: str
    seen: int = 0
    due: Time | None = 250 * NS_PER_MS
    frames: list[Frame] = field(default_factory=list)

    def on_frame(self, now: Time, frame: Frame) -> Any:
        self.seen += 1
        self.frames.append(frame)
        return [
            [],
            [Pass()],
            [Drop()],
            [Delay(now + NS_PER_MS)],
            [Replace(b"forged"), Delay(now)],
            (self.replay(frame), Drop()),
        ][self.seen % 6]

    def replay(self, frame: Frame) -> Inject:
        return Inject(frame.payload, "fwd", frame.src, frame.dst, self.frames[0].id)

    def next_wakeup(self) -> Any:
        return self.due

    def on_wakeup(self, now: Time) -> Any:
        self.due = now + 500 * NS_PER_MS
        return [Inject(f"{self.seen}".encode(), "rev", "a", "b")]


def check(make: Any) -> None:
    check_tap(make, payloads=TRAFFIC, until=3 * NS_PER_S)


def test_the_unbroken_one_conforms() -> None:
    check(Warden)
    check_tap(Warden)


def answering(verdicts: Any) -> type[Warden]:
    """Says the same of every frame."""

    class Answers(Warden):
        def on_frame(self, now: Time, frame: Frame) -> Any:
            return verdicts(now, frame) if callable(verdicts) else verdicts

    return Answers


class Generates(Warden):
    def on_frame(self, now: Time, frame: Frame) -> Iterator[Drop]:
        yield Drop()


class DropsAwake(Warden):
    def on_wakeup(self, now: Time) -> Any:
        self.due = now + NS_PER_S
        return [Drop()]


class Overdue(Warden):
    def on_wakeup(self, now: Time) -> Any:
        return []


class HearsNothing(Warden):
    """Replays the first frame it heard, before it heard one."""

    due = 10

    def on_wakeup(self, now: Time) -> Any:
        self.due = now + NS_PER_S
        return [self.replay(self.frames[0])]


class Prophet(Warden):
    def replay(self, frame: Frame) -> Inject:
        return replace(super().replay(frame), parent=frame.id._replace(serial=frame.serial + 1))


class Tampers(Warden):
    def on_frame(self, now: Time, frame: Frame) -> Any:
        frame.payload += b"!"
        return []


class Kills(Warden):
    def on_frame(self, now: Time, frame: Frame) -> Any:
        frame.fate = Fate.LOST
        return []


class Counts(Warden):
    total = 0

    def on_frame(self, now: Time, frame: Frame) -> Any:
        Counts.total += 1
        return [Replace(f"{Counts.total}".encode())]


class Watches(Warden):
    """Learns whether its attack is muted by what became of the frames that it dropped."""

    def on_frame(self, now: Time, frame: Frame) -> Any:
        self.frames.append(frame)
        dropped = sum(frame.fate is Fate.DROPPED for frame in self.frames)
        return [Drop()] if dropped < 3 else [Pass()]


class Clocked(Warden):
    def on_frame(self, now: Time, frame: Frame) -> Any:
        time.perf_counter()
        return []


class Punctual(Warden):
    def on_wakeup(self, now: Time) -> Any:
        assert now == self.due
        return super().on_wakeup(now)


class Shares(Warden):
    """Its copy remembers in the same list."""

    def __deepcopy__(self, memo: object) -> Shares:
        twin = type(self)(self.link, self.seen, self.due)
        twin.frames = self.frames
        return twin

    def on_frame(self, now: Time, frame: Frame) -> Any:
        self.frames.append(frame)
        return [Replace(f"{len(self.frames)}".encode())]


class Trusting(Warden):
    def on_frame(self, now: Time, frame: Frame) -> Any:
        return [Drop()] if frame.payload.decode("ascii") == "drop me" else []


BREAKING: list[tuple[str, Any]] = [
    ("verdicts", Generates),
    ("verdicts", answering(Drop())),
    ("verdicts", answering(None)),
    ("verdicts", answering(["drop"])),
    ("verdicts", DropsAwake),
    ("one-fate", answering([Drop(), Replace(b"")])),
    ("one-fate", answering([Pass(), Drop()])),
    ("one-fate", answering([Replace(b"a"), Replace(b"b")])),
    ("values", answering(lambda now, frame: [Delay(now - 1)])),
    ("values", answering(lambda now, frame: [Delay(now + 0.5)])),
    ("values", answering([Replace("text")])),  # type: ignore[arg-type]
    ("values", answering([Inject(b"", "up", "a", "b")])),  # type: ignore[arg-type]
    ("values", answering([Inject(bytes(2_000_000), "fwd", "a", "b")])),
    ("values", answering([Inject(b"", "fwd", "", "b")])),
    ("parents", Prophet),
    ("wakeups", Overdue),
    ("wakeups", HearsNothing),
    ("hands-off", Tampers),
    ("hands-off", Kills),
    ("repeatable", Counts),
    ("muted", Watches),
    ("pure", Clocked),
    ("late", Punctual),
    ("copies", Shares),
    ("hostile", Trusting),
    ("modest", answering([Inject(b"x", "fwd", "a", "b")] * 65)),
]


@pytest.mark.parametrize(("rule", "broken"), BREAKING, ids=[f"{rule}-{made.__name__}" for rule, made in BREAKING])
def test_a_broken_rule_is_found(rule: str, broken: Any) -> None:
    with pytest.raises(NonConformance) as found:
        check(broken)
    assert found.value.rule == f"tap.{rule}", str(found.value)


def test_every_rule_is_shown_to_fail() -> None:
    assert {f"tap.{rule}" for rule, _ in BREAKING} == {rule.id for rule in TAP.rules}
