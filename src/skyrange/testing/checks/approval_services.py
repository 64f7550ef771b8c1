"""Conformance check of flight approvals as plugins: a service that is asked over its links, as ground stations ask."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from skyrange.contracts.components import Agent
from skyrange.contracts.links import Channel, LinkSpec
from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.core.chance import Chance
from skyrange.core.errors import DecodeError, SkyrangeError
from skyrange.core.geodesy import Origin
from skyrange.core.ids import APPROVAL, Port, endpoint, link_name
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.kernel import Kernel, Wiring
from skyrange.record import MemoryObserver
from skyrange.testing.checks.agents import AGENT, AgentCase
from skyrange.testing.checks.approval_policies import EPOCH, TimedIntent, check_policy, ordinary
from skyrange.testing.drivers.messages import InputMessage, MessageRecorder
from skyrange.testing.rules import Broken, RuleBook, need, same, short
from skyrange.utm.contract import ApprovalContext, ApprovalPlugin, ApprovalPolicy, ApprovalService
from skyrange.utm.messages import DecisionBody, Request, decode_response, encode

NAME = "approval.checked"
"""What the service is called while it is checked."""
ANSWERED_NS = 60 * NS_PER_S
"""By when a request has been answered."""
_CHANNEL = Channel(mode="reliable", latency_ns=25 * NS_PER_MS)

SERVICE: RuleBook[ServiceCase] = RuleBook("service")

Row = tuple[Any, ...]


@dataclass
class Asker:
    """An operator's ground station, as far as an approval sees it: sends its letters when they are due."""

    operator: str
    messages: Sequence[InputMessage]
    sent: int = 0
    service_ns: Time = 20 * NS_PER_MS
    name: str = field(init=False)
    ports: Sequence[Port] = field(init=False)

    def __post_init__(self) -> None:
        self.name = endpoint(self.operator, "gcs")
        self.ports = (Port(self.name, link_name(APPROVAL, self.operator)),)

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        """Send what is due."""
        out = Outbox()
        while self.sent < len(self.messages) and self.messages[self.sent].at <= now:
            out.send(self.ports[0], self.messages[self.sent].payload)
            self.sent += 1
        return out

    def next_wakeup(self) -> Time | None:
        """When the next letter is due."""
        return self.messages[self.sent].at if self.sent < len(self.messages) else None


@dataclass
class ServiceCase:
    """A plugin with its parameters, and what its service is asked."""

    plugin: ApprovalPlugin
    params: Mapping[str, Any]
    requests: Sequence[TimedIntent]
    extra: Sequence[tuple[str, InputMessage]] = ()
    """More letters, each with the operator that sends it."""
    _flown: list[tuple[MemoryObserver, list[MessageRecorder]]] = field(default_factory=list)

    @property
    def operators(self) -> list[str]:
        """Who asks."""
        return sorted({intent.operator for _, intent in self.requests})

    @property
    def until(self) -> Time:
        """The end of a run."""
        return max((now for now, _ in self.requests), default=0) + ANSWERED_NS

    def made(self) -> tuple[ApprovalService, ApprovalContext]:
        """A fresh service."""
        context = ApprovalContext(NAME, self.operators, Origin(40.778, -73.955), EPOCH, Chance(7))
        try:
            service = self.plugin(self.plugin.params.model_validate(dict(self.params)), context)
        except SkyrangeError:
            raise
        except Exception as error:
            raise Broken(f"raised {error!r} when it was made", "an ApprovalService", "makes") from error
        need(isinstance(service, ApprovalService), f"made {short(service)}", "an ApprovalService")
        return service, context

    def kernel(self) -> tuple[Kernel, MemoryObserver, list[MessageRecorder]]:
        """A run before its first instant: what was seen of it, and the mail of each of the service's agents."""
        service, _ = self.made()
        messages: dict[str, list[InputMessage]] = {operator: [] for operator in self.operators}
        for now, intent in self.requests:
            port = Port(endpoint(intent.operator, "gcs"), link_name(APPROVAL, intent.operator))
            messages[intent.operator].append(InputMessage(now, port, encode(Request.of(intent, EPOCH))))
        for operator, message in self.extra:
            messages[operator].append(message)
        askers = [Asker(operator, sorted(mail, key=lambda message: message.at)) for operator, mail in messages.items()]
        links = [LinkSpec(a.ports[0].link, a.name, APPROVAL, _CHANNEL) for a in askers] + list(service.links)
        observer = MemoryObserver()
        recorders = [MessageRecorder(agent.ports, links) for agent in service.agents]
        return (
            Kernel(Wiring(seed=7, links=links, agents=[*askers, *service.agents]), [observer, *recorders]),
            observer,
            recorders,
        )

    def run(self) -> tuple[MemoryObserver, list[MessageRecorder]]:
        """A whole run; it is made once."""
        if not self._flown:
            kernel, observer, recorders = self.kernel()
            self._flown.append((_finished(kernel, observer, self.until), recorders))
        return self._flown[0]


def _finished(kernel: Kernel, observer: MemoryObserver, until: Time) -> MemoryObserver:
    try:
        kernel.advance(until)
    except Exception as error:
        raise Broken(f"raised {error!r}", "no error, whatever it was asked") from error
    kernel.finish()
    return observer


def check_approval(
    approval: ApprovalPlugin | Callable[[], ApprovalPolicy],
    params: Mapping[str, Any] | None = None,
    *,
    requests: Sequence[TimedIntent] | None = None,
    name: str | None = None,
) -> None:
    """Check a plugin with `params`, or what decides alone.

    The policy of a plugin, if it has one, is held to every rule of `APPROVAL`, its service to every rule of `SERVICE`,
    and each of its agents to those of `check_agent`. A function that returns a fresh policy at each call is held to the
    first alone. `requests` are (now, intent) in order of arrival, from two operators at least; by default
    `ordinary()`. Raises `NonConformance` at the first broken rule; `name` stands in it for the policy's class.
    """
    submitted = ordinary() if requests is None else requests
    if not isinstance(approval, ApprovalPlugin):
        check_policy(approval, submitted, name)
        return
    settings = dict(params or {})
    if approval.policy is not None:
        parsed, policy = approval.params.model_validate(settings), approval.policy
        check_policy(lambda: policy(parsed), submitted, name)
    case = ServiceCase(approval, settings, submitted)
    SERVICE.check(f"approval {name or NAME}", case)
    for number, recorder in enumerate(case.run()[1]):
        AGENT.check(f"agent of approval {name or NAME}", AgentCase(_Fresh(case, number), recorder.messages, case.until))


@dataclass(frozen=True)
class _Fresh:
    """Makes one agent of a service anew."""

    case: ServiceCase
    number: int

    def __call__(self) -> Agent:
        return self.case.made()[0].agents[self.number]


def _frames(observer: MemoryObserver) -> list[Row]:
    """What was said, in canonical order."""
    rows = [(f.sent_ns, *f.id, f.src, f.dst, f.arrived_ns, str(f.fate), f.payload) for f in observer.frames]
    return sorted(rows, key=lambda row: row[:5])


def _answers(observer: MemoryObserver) -> list[tuple[str, Time, bytes]]:
    """(operator, arrival, payload) of all that came back over the approval links, in order."""
    answers = [f for f in observer.frames if f.src == APPROVAL and f.direction == "rev"]
    return [(f.link.partition(":")[2], f.arrived_ns, f.payload) for f in sorted(answers, key=lambda f: f.arrived_ns)]


@SERVICE.rule("described", "Describes each of its parameters, and in one sentence what it does.")
def _described(case: ServiceCase) -> None:
    for name, info in case.plugin.params.model_fields.items():
        need(bool(info.description), f"says nothing about its parameter {name}", "a description of each")
    need(case.plugin.about.endswith("."), f"says {case.plugin.about!r}", "a sentence")


@SERVICE.rule("makes", "Makes a service from its parameters and a context. Two services share no agent.")
def _makes(case: ServiceCase) -> None:
    (first, _), (second, _) = case.made(), case.made()
    for first_agent, second_agent in zip(first.agents, second.agents, strict=True):
        need(first_agent is not second_agent, f"gave {first_agent.name} to two services", "agents of its own for each")


@SERVICE.rule("named", "Names its agents after its context's name.")
def _named(case: ServiceCase) -> None:
    for agent in case.made()[0].agents:
        known = agent.name == NAME or agent.name.startswith(f"{NAME}.")
        need(known, f"has an agent {agent.name!r}", f"{NAME!r}, or {NAME + '.'!r} and more")


@SERVICE.rule("ports", "Has one agent at each operator's port, and all others at endpoints `approval.…` of its own.")
def _ports(case: ServiceCase) -> None:
    service, context = case.made()
    ports = [port for agent in service.agents for port in agent.ports]
    for operator in context.operators:
        port = context.port(operator)
        need(ports.count(port) == 1, f"{ports.count(port)} agents have {port}", "exactly one")
    brought = {Port(end, spec.name) for spec in service.links for end in (spec.a, spec.b)}
    for port in brought:
        need(port.endpoint.startswith(f"{APPROVAL}."), f"has a link that ends at {port.endpoint}", "approval.…")
        need(ports.count(port) == 1, f"{ports.count(port)} agents have {port}", "exactly one")
    strange = set(ports) - brought - {context.port(operator) for operator in context.operators}
    need(not strange, f"has ports {short(sorted(strange))}", "ports of its operators and of links that it brings along")


@SERVICE.rule("answers", "Answers every valid request with a decision about it, within a minute, over its own link.")
def _answered(case: ServiceCase) -> None:
    decided: dict[tuple[str, str], Time] = {}
    for operator, at, payload in _answers(case.run()[0]):
        try:
            body = decode_response(payload).body
        except DecodeError as error:
            raise Broken(f"answered {operator} with {short(payload)}: {error}", "a Response of utm.messages") from error
        if isinstance(body, DecisionBody):
            decided.setdefault((operator, body.id), at)
    for now, intent in case.requests:
        at = decided.get((intent.operator, intent.id), now + ANSWERED_NS + 1)
        need(at <= now + ANSWERED_NS, f"had nothing to say of {short(intent)}", "a decision within a minute")


@SERVICE.rule("owners", "Accepts no request that an operator makes in another's name.")
def _owners(case: ServiceCase) -> None:
    thieves = [operator for operator in case.operators if operator != case.requests[0][1].operator]
    need(bool(thieves), f"is asked by {case.operators}", "requests of two operators, to check this")
    now, stolen = case.requests[0]
    port = Port(endpoint(thieves[0], "gcs"), link_name(APPROVAL, thieves[0]))
    theft = InputMessage(now, port, encode(Request.of(stolen, EPOCH)))
    kernel, observer, _ = ServiceCase(case.plugin, case.params, case.requests[1:], [(thieves[0], theft)]).kernel()
    for operator, _, payload in _answers(_finished(kernel, observer, case.until)):
        body = decode_response(payload).body
        if operator == thieves[0] and isinstance(body, DecisionBody) and body.id == stolen.id:
            need(body.decision != "Accepted", f"accepted {short(stolen)} for {operator}", "a refusal")


@SERVICE.rule("repeatable", "Two new runs send the same bytes at the same times.")
def _repeatable(case: ServiceCase) -> None:
    kernel, observer, _ = case.kernel()
    same(
        _frames(case.run()[0]),
        _frames(_finished(kernel, observer, case.until)),
        "two runs differ",
        "the same to the byte",
    )


@SERVICE.rule("copies", "A copy or fork made midway continues like the original, and shares no state with it.")
def _copies(case: ServiceCase) -> None:
    straight = _frames(case.run()[0])
    kernel, trunk, _ = case.kernel()
    kernel.advance(case.requests[len(case.requests) // 2][0] + NS_PER_S // 7)
    try:
        branch = copy.deepcopy(trunk)
        twin = kernel.fork([branch])
    except Exception as error:
        raise Broken(f"cannot be deep-copied: {error!r}", "state without generators, closures and handles") from error
    expected = "a copy that goes on alike, and an original that does not notice"
    same(straight, _frames(_finished(twin, branch, case.until)), "the straight run and the fork differ", expected)
    same(straight, _frames(_finished(kernel, trunk, case.until)), "the fork shows in the original", expected)
