"""Each rule for agents is broken by an agent that breaks just that rule, and is found by its id."""

from __future__ import annotations

import itertools
import random
import socket
import threading
import time
import uuid
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

from skyrange.contracts.mailboxes import Arrival, Departure, Inbox, Note, Outbox
from skyrange.core.ids import FrameId, Port
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.testing import InputMessage, NonConformance, check_agent
from skyrange.testing.checks.agents import AGENT

PORT = Port("blue.clerk", "desk:blue")
MAIL = [InputMessage(k * 350 * NS_PER_MS, PORT, f"question {k}".encode()) for k in range(8)]


@dataclass
class Clerk:
    """Answers questions, notes that it did, and sends a count twice a second: keeps every rule."""

    name: str = "clerk"
    service_ns: Time = 10 * NS_PER_MS
    ports: Any = (PORT,)
    count: int = 0
    due: Time = 0
    refs: list[FrameId] = field(default_factory=list)

    def step(self, now: Time, inbox: Inbox) -> Any:
        out = Outbox()
        for arrival in inbox:
            self.refs.append(arrival.ref)
            if arrival.payload.startswith(b"question"):
                self.answer(now, arrival, out)
        if now >= self.due:
            self.count += 1
            self.due = now + 500 * NS_PER_MS
            out.send(PORT, f"count {self.count}".encode())
        return out

    def answer(self, now: Time, arrival: Arrival, out: Outbox) -> None:
        out.send(arrival.port, b"answer to " + arrival.payload, (arrival.ref,))
        out.note("decision.answered", "blue", {"size": len(arrival.payload), "kept": True, "why": None}, (arrival.ref,))

    def next_wakeup(self) -> Any:
        return self.due


def check(make: Callable[[], Any], until: Time = 3 * NS_PER_S) -> None:
    check_agent(make, mail=MAIL, until=until)


def test_the_unbroken_one_conforms() -> None:
    check(Clerk)
    check_agent(Clerk)


class Nameless(Clerk):
    def __init__(self) -> None:
        super().__init__(name="")


class FloatService(Clerk):
    def __init__(self) -> None:
        super().__init__(service_ns=0.01)  # type: ignore[arg-type]


class TwicePort(Clerk):
    def __init__(self) -> None:
        super().__init__(ports=(PORT, PORT))


class Generates(Clerk):
    def step(self, now: Time, inbox: Inbox) -> Any:
        yield from super().step(now, inbox).departures


class LazyBox(Clerk):
    def step(self, now: Time, inbox: Inbox) -> Any:
        out = super().step(now, inbox)
        out.departures = (departure for departure in out.departures)
        return out


class SameBox(Clerk):
    box: Outbox | None = None

    def step(self, now: Time, inbox: Inbox) -> Any:
        out = super().step(now, inbox)
        if self.box is None:
            self.box = out
        self.box.departures[:], self.box.notes[:] = out.departures, out.notes
        return self.box


class Insists(Clerk):
    def next_wakeup(self) -> Any:
        return 0


class FloatWakeup(Clerk):
    def next_wakeup(self) -> Any:
        return self.due + 0.0


class Impatient(Clerk):
    asked = 0

    def next_wakeup(self) -> Any:
        self.asked += 1
        return self.due + self.asked


class Creeps(Clerk):
    """Always wants the next nanosecond: no livelock at one instant, but no progress either."""

    service_ns = 0
    last = 0

    def __init__(self) -> None:
        super().__init__(service_ns=0)

    def step(self, now: Time, inbox: Inbox) -> Any:
        self.last = now
        return super().step(now, inbox)

    def next_wakeup(self) -> Any:
        return self.last + 1


class StrangePort(Clerk):
    def answer(self, now: Time, arrival: Arrival, out: Outbox) -> None:
        out.send(Port("green.clerk", "desk:green"), b"x")


class Mutable(Clerk):
    def answer(self, now: Time, arrival: Arrival, out: Outbox) -> None:
        out.departures.append(Departure(PORT, bytearray(b"x")))  # type: ignore[arg-type]


class Bulky(Clerk):
    def answer(self, now: Time, arrival: Arrival, out: Outbox) -> None:
        out.send(PORT, bytes(2_000_000))


def noting(kind: Any, about: Any, data: Any) -> type[Clerk]:
    class Notes(Clerk):
        def answer(self, now: Time, arrival: Arrival, out: Outbox) -> None:
            out.notes.append(Note(kind, about, data))

    return Notes


class Prophet(Clerk):
    def answer(self, now: Time, arrival: Arrival, out: Outbox) -> None:
        out.send(PORT, b"x", (arrival.ref._replace(serial=arrival.ref.serial + 1),))


class ListedCauses(Clerk):
    def answer(self, now: Time, arrival: Arrival, out: Outbox) -> None:
        out.send(PORT, b"x", [arrival.ref])  # type: ignore[arg-type]


TICKETS = itertools.count()


class SharedCounter(Clerk):
    def answer(self, now: Time, arrival: Arrival, out: Outbox) -> None:
        out.send(PORT, f"ticket {next(TICKETS)}".encode())


KEPT: list[object] = []
"""Alive, so that no two of them ever share an address."""


class Draws(Clerk):
    def answer(self, now: Time, arrival: Arrival, out: Outbox) -> None:
        KEPT.append(object())
        out.send(PORT, str(hash(KEPT[-1])).encode())


def reaching(reach: Callable[[], object]) -> type[Clerk]:
    """Reaches outside, hides it in an `except`, and lets nothing show in what it says."""

    class Reaches(Clerk):
        def answer(self, now: Time, arrival: Arrival, out: Outbox) -> None:
            try:
                reach()
            except Exception:
                out.note("event.hidden", "blue")

    return Reaches


def a_thread() -> None:
    threading.Thread(target=int).start()


def a_file() -> None:
    Path("/dev/null").read_bytes()


def a_socket() -> None:
    socket.socket(socket.AF_INET, socket.SOCK_DGRAM).close()


class Punctual(Clerk):
    def step(self, now: Time, inbox: Inbox) -> Any:
        assert all(now - arrival.at <= self.service_ns for arrival in inbox), "an overloaded kernel comes later"
        return super().step(now, inbox)


class Handle(Clerk):
    def __init__(self) -> None:
        super().__init__()
        self.lock = threading.Lock()


class Generator(Clerk):
    def __init__(self) -> None:
        super().__init__()
        self.numbers = (number for number in range(9))


class Closure(Clerk):
    """Keeps state in a closure, which a deep copy shares with its original."""

    def __init__(self) -> None:
        super().__init__()
        total = 0

        def add() -> int:
            nonlocal total
            total += 1
            return total

        self.add = add

    def answer(self, now: Time, arrival: Arrival, out: Outbox) -> None:
        out.send(PORT, f"{self.add()}".encode())


class Trusting(Clerk):
    def step(self, now: Time, inbox: Inbox) -> Any:
        for arrival in inbox:
            arrival.payload.decode()
        return super().step(now, inbox)


class Quoting(Clerk):
    """Writes whatever arrives into the record, whole."""

    def step(self, now: Time, inbox: Inbox) -> Any:
        out = super().step(now, inbox)
        for arrival in inbox:
            out.note("event.heard", "blue", {"text": arrival.payload.decode("latin-1")})
        return out


class Chatty(Clerk):
    def step(self, now: Time, inbox: Inbox) -> Any:
        out = super().step(now, inbox)
        for arrival in inbox:
            if not arrival.payload.startswith(b"question"):
                out.send(PORT, b"what?")
                out.send(PORT, b"what??")
        return out


class Verbose(Clerk):
    def step(self, now: Time, inbox: Inbox) -> Any:
        out = super().step(now, inbox)
        for arrival in inbox:
            if not arrival.payload.startswith(b"question"):
                out.send(PORT, b"?" * 5_000)
        return out


class Loud(Clerk):
    def step(self, now: Time, inbox: Inbox) -> Any:
        out = super().step(now, inbox)
        for arrival in inbox:
            if not arrival.payload.startswith(b"question"):
                out.notes += [Note("event.odd", "blue", {}), Note("event.very_odd", "blue", {})]
        return out


BREAKING: list[tuple[str, type[Clerk]]] = [
    ("declares", Nameless),
    ("declares", FloatService),
    ("declares", TwicePort),
    ("outbox", Generates),
    ("outbox", LazyBox),
    ("outbox", SameBox),
    ("wakeups", Insists),
    ("wakeups", FloatWakeup),
    ("wakeups", Impatient),
    ("wakeups", Creeps),
    ("departures", StrangePort),
    ("departures", Mutable),
    ("departures", Bulky),
    ("notes", noting("answered", "blue", {})),
    ("notes", noting("event.Answered", "blue", {})),
    ("notes", noting("event.answered", "", {})),
    ("notes", noting("event.answered", "blue", {"sizes": [1, 2]})),
    ("notes", noting("event.answered", "blue", {1: 2})),
    ("notes", noting("event.answered", "blue", {"size": float("inf")})),
    ("notes", noting("event.answered", "blue", {"text": "x" * 5_000})),
    ("notes", noting("event.answered", "blue", None)),
    ("causes", Prophet),
    ("causes", ListedCauses),
    ("repeatable", SharedCounter),
    ("repeatable", Draws),
    ("pure", reaching(time.monotonic)),
    ("pure", reaching(lambda: time.sleep(0.0))),
    ("pure", reaching(datetime.now)),
    ("pure", reaching(random.random)),
    ("pure", reaching(lambda: random.choice("ab"))),
    ("pure", reaching(uuid.uuid4)),
    ("pure", reaching(a_thread)),
    ("pure", reaching(a_file)),
    ("pure", reaching(a_socket)),
    ("late", Punctual),
    ("copies", Handle),
    ("copies", Generator),
    ("copies", Closure),
    ("hostile", Trusting),
    ("hostile", Quoting),
    ("modest", Chatty),
    ("modest", Verbose),
    ("modest", Loud),
]


@pytest.mark.parametrize(("rule", "broken"), BREAKING, ids=[f"{rule}-{made.__name__}" for rule, made in BREAKING])
def test_a_broken_rule_is_found(rule: str, broken: type[Clerk]) -> None:
    with pytest.raises(NonConformance) as found:
        check(broken, NS_PER_S // 2 if broken is Creeps else 3 * NS_PER_S)  # it takes all steps that are allowed
    assert found.value.rule == f"agent.{rule}", str(found.value)
    assert found.value.who.startswith("agent ")
    assert found.value.seen
    assert found.value.expected
    assert found.value.exit_code == 3


def test_every_rule_is_shown_to_fail() -> None:
    assert {f"agent.{rule}" for rule, _ in BREAKING} == {rule.id for rule in AGENT.rules}


def test_a_raising_agent_is_quoted() -> None:
    class Raises(Clerk):
        def answer(self, now: Time, arrival: Arrival, out: Outbox) -> None:
            raise KeyError("seven")

    with pytest.raises(NonConformance, match=r"agent clerk breaks agent\.outbox: step\(0\).*question 0.*seven"):
        check(Raises)


def test_what_reaches_outside_is_named_with_its_place() -> None:
    with pytest.raises(NonConformance, match=r"the clock: .*monotonic called at .*test_broken_agents\.py:\d+"):
        check(reaching(lambda: time.monotonic()))


def test_the_watch_is_off_afterwards() -> None:
    with pytest.raises(NonConformance):
        check(reaching(time.monotonic))
    assert time.monotonic() > 0.0
    assert random.random() < 1.0


def test_mail_for_another_port_is_the_callers_mistake_and_is_said() -> None:
    with pytest.raises(NonConformance, match="mail of this check"):
        check_agent(Clerk, mail=[InputMessage(0, Port("x", "y:z"), b"")])
