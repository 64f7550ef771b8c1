"""Conformance check of agents (`skyrange.contracts.components.Agent`)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

from skyrange.contracts.components import Agent, OriginatingRouter
from skyrange.contracts.mailboxes import Arrival
from skyrange.core.ids import Port
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.testing.drivers.agent_driver import Step, copied, drive, rows
from skyrange.testing.drivers.hostile_input import (
    Volume,
    address_to_ports,
    check_modest,
    forged,
    garbage,
    short_garbage,
    spoiled,
)
from skyrange.testing.drivers.messages import InputMessage, make_arrivals
from skyrange.testing.drivers.outbox_form import check_causes, check_departures, check_notes, said
from skyrange.testing.drivers.purity import watched
from skyrange.testing.rules import RuleBook, need, same, short

LATE_NS = 1_300 * NS_PER_MS
"""How late an overloaded kernel steps an agent in the check."""
_BEFORE = -1
"""Nothing has happened yet, not even the instant 0."""

AGENT: RuleBook[AgentCase] = RuleBook("agent")


@dataclass
class AgentCase:
    """An agent to be checked: how a fresh one is made, its friendly mail, how long it is driven."""

    make: Callable[[], Agent]
    messages: Sequence[InputMessage]
    until: Time

    @cached_property
    def arrivals(self) -> list[Arrival]:
        """The friendly mail."""
        return make_arrivals(self.messages)

    @cached_property
    def friendly(self) -> list[Step]:
        """What a fresh one does with it."""
        return drive(self.make(), self.arrivals, _BEFORE, self.until)

    def drive_with_payloads(self, payloads: Sequence[bytes]) -> tuple[list[Arrival], list[Step]]:
        """The friendly mail with hostile payloads on every port in between, and what a fresh one does with it."""
        agent = self.make()
        begin = self.until // 10
        spacing = max(NS_PER_MS, (self.until - 2 * begin) // (len(payloads) // 16 + 1))
        arrivals = make_arrivals([*self.messages, *address_to_ports(payloads, agent.ports, begin, spacing, 16)])
        return arrivals, drive(agent, arrivals, _BEFORE, self.until)


def check_agent(
    make: Callable[[], Agent],
    *,
    mail: Sequence[InputMessage] = (),
    until: Time = 10 * NS_PER_S,
    name: str | None = None,
) -> None:
    """Check that the agents which `make` returns keep every rule of `AGENT`.

    Each call of `make` returns a fresh agent, all alike. `mail` is what a friendly peer would send it,
    at times from 0 to `until` (ns); the better it is, the more of the agent is checked (`MessageRecorder`
    collects it from a run). Raises `NonConformance` at the first broken rule; `name` stands in it for
    the agent's own.
    """
    AGENT.check(f"agent {name or getattr(make(), 'name', make)}", AgentCase(make, mail, until))


@AGENT.rule("declares", "Has a name, a service time of at least 0 ns, and each port once.")
def _declares(case: AgentCase) -> None:
    agent = case.make()
    need(isinstance(agent.name, str) and bool(agent.name), f"name is {agent.name!r}", "text")
    service = agent.service_ns
    whole = isinstance(service, int) and not isinstance(service, bool) and service >= 0
    need(whole, f"service_ns is {service!r}", "an int of 0 or more nanoseconds")
    ports = tuple(agent.ports)
    need(all(isinstance(port, Port) for port in ports), f"ports are {short(ports)}", "a sequence of Port")
    need(len(set(ports)) == len(ports), f"ports are {short(ports)}", "each port once")
    wrong = [message for message in case.messages if message.port not in ports]
    need(not wrong, f"the mail of this check is for {wrong[0].port if wrong else None}", "mail for the agent's ports")


@AGENT.rule("outbox", "Answers every step with an Outbox, never a generator, and does not change it later.")
def _outbox(case: AgentCase) -> None:
    steps = case.friendly
    ports = tuple(case.make().ports)
    for step in steps:
        again = said(step.outbox, ports)
        same(step.said, again, f"the outbox of {step.now} ns, handed over and now", "a new Outbox each step")


@AGENT.rule("wakeups", "Asks for no wake-up, or for one after now, in whole ns. Asking twice changes nothing.")
def _wakeups(case: AgentCase) -> None:
    drive(case.make(), (), _BEFORE, case.until)


def _ends(case: AgentCase) -> tuple[Port, ...]:
    """Where it may send from: its ports, and those where it only speaks (`contracts.components.OriginatingRouter`)."""
    agent = case.make()
    return (*agent.ports, *(agent.originates if isinstance(agent, OriginatingRouter) else ()))


@AGENT.rule("departures", "Sends bytes, at most 1 MiB in a frame, from its declared ports.")
def _departures(case: AgentCase) -> None:
    ports = _ends(case)
    for step in case.friendly:
        check_departures(step.said, ports)


@AGENT.rule(
    "notes", "Notes `decision.…` or `event.…` about an id, with finite scalars and texts of at most 4096 characters."
)
def _notes(case: AgentCase) -> None:
    for step in case.friendly:
        check_notes(step.said)


@AGENT.rule("causes", "Names as causes only frames that it received.")
def _causes(case: AgentCase) -> None:
    _check_causes(case.arrivals, case.friendly)


@AGENT.rule("repeatable", "Two new instances with the same mail send the same bytes at the same times.")
def _repeatable(case: AgentCase) -> None:
    again = drive(case.make(), case.arrivals, _BEFORE, case.until)
    same(rows(case.friendly), rows(again), "two instances differ", "the same from the same inputs")


@AGENT.rule(
    "pure", "Reads no clock, draws no random numbers of its own, never sleeps, and opens no file, socket or thread."
)
def _pure(case: AgentCase) -> None:
    _ = case.friendly  # imports and compiles what a first run must
    drive(case.make(), case.arrivals, _BEFORE, case.until, call=watched)


@AGENT.rule("late", "Survives a step 1.3 s late, with all mail since in one box.")
def _late(case: AgentCase) -> None:
    for step in drive(case.make(), case.arrivals, _BEFORE, case.until, lag_ns=LATE_NS):
        check_departures(step.said, _ends(case))
        check_notes(step.said)


@AGENT.rule("copies", "A copy or fork made midway continues like the original, and shares no state with it.")
def _copies(case: AgentCase) -> None:
    straight = case.friendly
    fork_at = straight[len(straight) // 2].now if straight else case.until // 2
    rest = rows([step for step in straight if step.now > fork_at])
    trunk = case.make()
    drive(trunk, case.arrivals, _BEFORE, fork_at)
    branch = copied(trunk)
    expected = "a copy that goes on alike, and an original that does not notice"
    same(
        rest, rows(drive(branch, case.arrivals, fork_at, case.until)), "the straight run and the copy differ", expected
    )
    same(
        rest, rows(drive(trunk, case.arrivals, fork_at, case.until)), "the copy's life shows in the original", expected
    )


@AGENT.rule("hostile", "Survives any bytes on any port, and keeps its form.")
def _hostile(case: AgentCase) -> None:
    ports = _ends(case)
    for payloads in ([*garbage(), *spoiled(case.messages)], list(forged())):
        arrivals, steps = case.drive_with_payloads(payloads)
        for step in steps:
            check_departures(step.said, ports)
            check_notes(step.said)
        _check_causes(arrivals, steps)


@AGENT.rule("modest", "Answers each frame of garbage with at most 1 departure, at most 2 KiB longer, and 1 note.")
def _modest(case: AgentCase) -> None:
    payloads, ports = short_garbage(), case.make().ports
    check_modest(_volume(case.friendly), _volume(case.drive_with_payloads(payloads)[1]), payloads, len(ports))


def _volume(steps: Sequence[Step]) -> Volume:
    departures = [departure for step in steps for departure in step.said[0]]
    return len(departures), sum(len(step.said[1]) for step in steps), sum(len(d.payload) for d in departures)


def _check_causes(arrivals: Sequence[Arrival], steps: Sequence[Step]) -> None:
    received = set()
    handed = 0
    for step in steps:
        received |= {arrival.ref for arrival in arrivals[handed : handed + step.arrivals]}
        handed += step.arrivals
        check_causes(step.said, received)
