"""Probe (a): taps delay, replace and inject on their own initiative; labels and causes are in the record.

Probe (b): an attack muted equals the same attack removed, to the byte, on everybody else's links.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import pytest

from skyrange.contracts.components import Agent
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import Act, Channel, TapPlacement
from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.contracts.verdicts import Delay, Drop, Inject, Pass, Replace, Verdict
from skyrange.core.errors import ComponentError, InputError
from skyrange.core.ids import FrameId, Port
from skyrange.core.time import NS_PER_S, Time
from skyrange.kernel import Kernel, Wiring
from tests.probes.toys import MS, ROUGH, Fleet, Log, Station, onboard

VEHICLES = ["blue/b1", "blue/b2"]
END = 2 * NS_PER_S


@dataclass
class Meddler:
    """Delays asks, replaces telemetry that holds a 3, drops every tenth frame, injects every 300 ms by itself."""

    link: str
    seen: int = 0
    due: Time = 300 * MS
    heard: list[FrameId] = field(default_factory=list)

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        self.seen += 1
        self.heard.append(frame.id)
        if self.seen % 10 == 0:
            return [Drop()]
        if frame.payload.startswith(b"ask"):
            return [Delay(now + 33 * MS)]
        if b"3" in frame.payload:
            return [Replace(frame.payload.replace(b"3", b"X"))]
        return [Pass()]

    def next_wakeup(self) -> Time | None:
        return self.due

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        self.due = now + 300 * MS
        vehicle = self.link.split(":")[1]
        return [
            Inject(b"forged ask", "fwd", f"{vehicle.split('/')[0]}.gcs", f"{vehicle}.companion", self.heard[0]),
            Inject(b"forged telemetry", "rev", f"{vehicle}.companion", f"{vehicle.split('/')[0]}.gcs"),
        ]


@dataclass
class Flooder:
    """A hostile node of its own, on a link of its own into the companion."""

    name: str = "mitm.node"
    service_ns: Time = 10 * MS
    due: Time = 0
    ports: Sequence[Port] = ()

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        out = Outbox()
        if now < self.due:
            return out
        self.due = now + 100 * MS
        for port in self.ports:
            out.send(port, b"flood")
        return out

    def next_wakeup(self) -> Time | None:
        return self.due


def run(
    *,
    attack: Act | None,
    side: str = "companion",
    gcs: Channel | None = None,
    fuse: bool = True,
    match: str = "gcs:blue/b1",
) -> tuple[Log, Station]:
    links, routes = [], []
    for vehicle in VEHICLES:
        some_links, some_routes = onboard(vehicle, gcs)
        links += some_links
        routes += some_routes
    station = Station("blue", VEHICLES)
    log = Log()
    taps = [] if attack is None else [TapPlacement(match, side, Meddler, attack.id)]
    kernel = Kernel(
        Wiring(
            seed=11,
            links=links,
            routes=routes,
            agents=[station, Fleet("fleet", VEHICLES)],
            taps=taps,
            acts=[] if attack is None else [attack],
            fuse=fuse,
        ),
        [log],
    )
    kernel.advance(END)
    kernel.finish()
    return log, station


@pytest.mark.parametrize("side", ["gcs", "companion"])
def test_each_verdict_does_what_it_says_and_is_labelled(side: str) -> None:
    log, station = run(attack=Act("mitm"), side=side)
    by_action = {
        action: [label for label in log.labels if label.action == action]
        for action in ("delay", "replace", "inject", "drop")
    }
    assert all(by_action.values()), {action: len(rows) for action, rows in by_action.items()}
    assert {label.attack for label in log.labels} == {"mitm"}
    assert {label.actor for label in log.labels} == {f"mitm@gcs:blue/b1.{side}"}
    rows = {(row[1], row[2], row[3], row[4]): row for row in log.frames}
    for label in by_action["drop"]:
        assert rows[label.frame][8] == "dropped"
    for label in by_action["replace"]:
        assert rows[label.frame][8] == "replaced"
        assert label.child is not None
        child = rows[label.child]
        assert child[10] == str(label.frame)
        assert child[3] == label.actor
        assert b"X" in child[9]
    for label in by_action["delay"]:
        row = rows[label.frame]
        assert label.until_ns == label.at_ns + 33 * MS
        assert row[8] in ("delivered", "in_flight", "dropped")
        if row[8] == "delivered":
            assert row[7] >= label.until_ns
    for label in by_action["inject"]:
        row = rows[label.frame]
        assert row[3] == label.actor
        assert row[5] != row[3], "the claimed source is not the true sender"
    assert any(payload == b"forged telemetry" for _, payload in station.heard)
    assert any(payload == b"ack forged ask" for _, payload in station.heard), "the aircraft obeyed the forged ask"


def test_a_decision_names_the_forged_frame_that_caused_it() -> None:
    log, _ = run(attack=Act("mitm"))
    parents = {(row[1], row[2], row[3], row[4]): row[10] for row in log.frames}
    forged = {str(label.frame) for label in log.labels if label.action == "inject" and label.frame.direction == "fwd"}
    traced = 0
    for _, _, kind, _, _, causes in log.notes:
        if kind != "decision.answer":
            continue
        (cause,) = causes
        chain = [str(cause)]
        while chain[-1] != "None":
            chain.append(parents[FrameId.parse(chain[-1])])
        if forged & set(chain):
            traced += 1
    assert traced == 6, "the six forged asks that arrived before the end are each traced from a decision"


def test_an_injected_frame_meets_only_the_taps_after_its_own() -> None:
    @dataclass
    class Witness:
        link: str
        saw: list[bytes] = field(default_factory=list)

        def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
            self.saw.append(frame.payload)
            return ()

        def next_wakeup(self) -> Time | None:
            return None

        def on_wakeup(self, now: Time) -> Sequence[Verdict]:
            return ()

    witnesses: dict[str, Witness] = {}

    def witness(name: str) -> Callable[[str], Witness]:
        def make(link: str) -> Witness:
            witnesses[name] = Witness(link)
            return witnesses[name]

        return make

    links, routes = onboard("blue/b1")
    kernel = Kernel(
        Wiring(
            seed=1,
            links=links,
            routes=routes,
            agents=[Station("blue", ["blue/b1"]), Fleet("fleet", ["blue/b1"])],
            taps=[
                TapPlacement("gcs:*", "gcs", witness("gcs outer")),
                TapPlacement("gcs:*", "gcs", Meddler, "mitm"),
                TapPlacement("gcs:*", "gcs", witness("gcs inner")),
                TapPlacement("gcs:*", "companion", witness("companion")),
            ],
            acts=[Act("mitm")],
        ),
        [Log()],
    )
    kernel.advance(NS_PER_S)
    saw = {name: set(tap.saw) for name, tap in witnesses.items()}
    assert b"forged ask" in saw["gcs inner"]
    assert b"forged ask" in saw["companion"]
    assert b"forged ask" not in saw["gcs outer"]
    assert b"forged telemetry" in saw["gcs outer"]
    assert b"forged telemetry" not in saw["gcs inner"]


@pytest.mark.parametrize(("state", "intruding"), [
    ({"sham": True, "intrudes": True}, {"inject"}), ({"sham": True}, set()), ({"intrudes": True}, set()),
    ({"honest": True, "intrudes": True}, set()),
])  # fmt: skip
def test_what_a_sham_puts_on_a_link_is_a_harmless_intrusion(state: dict[str, bool], intruding: set[str]) -> None:
    log, _ = run(attack=Act("mitm", **state))  # type: ignore[arg-type]
    assert {label.action for label in log.labels if label.harmless_intrusion} == intruding
    assert {label.benign for label in log.labels} == {"sham" in state or "honest" in state}
    assert {label.action for label in log.labels} == {"delay", "replace", "inject", "drop"}


def test_what_an_agent_of_a_sham_sends_is_a_harmless_intrusion() -> None:
    log = Log()
    agents = [Flooder(ports=[Port("blue/b1.proxy", "autopilot:blue/b1")])]
    plan = Act("mitm", sham=True, intrudes=True, agents=agents)
    links = onboard("blue/b1")[0]
    Kernel(Wiring(seed=1, links=links, agents=[Fleet("fleet", ["blue/b1"])], acts=[plan]), [log]).advance(500 * MS)
    assert {(label.action, label.harmless_intrusion) for label in log.labels} == {("send", True)}


def others(log: Log) -> list[tuple[Any, ...]]:
    return [row for row in log.table() if row[1].startswith(("gcs", "log", "autopilot"))]


@pytest.mark.parametrize("side", ["gcs", "companion"])
@pytest.mark.parametrize("gcs", [None, ROUGH], ids=["fixed", "rough"])
def test_muted_equals_removed(side: str, gcs: Channel | None) -> None:
    removed, _ = run(attack=None, gcs=gcs)
    muted, _ = run(attack=Act("mitm", muted=True), side=side, gcs=gcs)
    live, _ = run(attack=Act("mitm"), side=side, gcs=gcs)
    assert others(muted) == others(removed)
    assert muted.notes == removed.notes
    assert muted.labels == []
    assert live.on("gcs:blue/b1") != removed.on("gcs:blue/b1")
    assert live.on("gcs:blue/b2", "log:blue/b2", "autopilot:blue/b2") == removed.on(
        "gcs:blue/b2", "log:blue/b2", "autopilot:blue/b2"
    ), "a live attack on one aircraft's link changes nothing on another's"


def test_a_hostile_node_muted_sends_nothing() -> None:
    flooder_links = onboard("blue/b1")[0]
    counts = {}
    for muted in (True, False):
        log = Log()
        plan = Act("mitm", muted=muted, agents=[Flooder(ports=[Port("blue/b1.proxy", "autopilot:blue/b1")])])
        kernel = Kernel(Wiring(seed=1, links=flooder_links, agents=[Fleet("fleet", ["blue/b1"])], acts=[plan]), [log])
        kernel.advance(NS_PER_S)
        kernel.finish()
        counts[muted] = (len([row for row in log.frames if row[9] == b"flood"]), len(log.labels))
    assert counts[True] == (0, 0)
    assert counts[False] == (11, 11), "one at 0 and every 100 ms to the end"


def test_an_attack_acts_only_between_start_and_stop() -> None:
    log, _ = run(attack=Act("mitm", start_ns=700 * MS, stop_ns=1400 * MS))
    assert log.labels
    assert all(700 * MS <= label.at_ns < 1400 * MS for label in log.labels)
    before, _ = run(attack=Act("mitm", muted=True))
    early = [row for row in log.table() if row[7] != -1 and row[7] < 700 * MS]
    assert early == [row for row in before.table() if row[7] != -1 and row[7] < 700 * MS]


@pytest.mark.parametrize("gcs", [None, ROUGH], ids=["fixed", "rough"])
def test_fusing_cannot_be_told_from_the_record(gcs: Channel | None) -> None:
    fused, heard = run(attack=None, gcs=gcs)
    single, heard_single = run(attack=None, gcs=gcs, fuse=False)
    assert fused.table() == single.table()
    assert heard.heard == heard_single.heard
    assert {row[8] for row in fused.frames} >= ({"delivered", "lost", "overflow"} if gcs else {"delivered"})


def test_a_tap_on_no_link_or_no_side_is_refused() -> None:
    with pytest.raises(InputError, match=r"gsc:\*.*link"):
        run(attack=Act("mitm"), match="gsc:*")
    with pytest.raises(InputError, match="one end of"):
        run(attack=Act("mitm"), side="proxy")


def test_a_tap_that_breaks_its_contract_is_blamed_by_name() -> None:
    @dataclass
    class Rogue:
        link: str

        def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
            return [Drop(), Replace(b"")]

        def next_wakeup(self) -> Time | None:
            return None

        def on_wakeup(self, now: Time) -> Sequence[Verdict]:
            return ()

    links, routes = onboard("blue/b1")
    kernel = Kernel(
        Wiring(
            seed=1,
            links=links,
            routes=routes,
            agents=[Station("blue", ["blue/b1"])],
            taps=[TapPlacement("gcs:*", "gcs", Rogue)],
        ),
        [Log()],
    )
    with pytest.raises(ComponentError, match=r"tap tap@gcs:blue/b1\.gcs"):
        kernel.advance(NS_PER_S)


@pytest.mark.parametrize(
    ("answer", "expected"),
    [(Drop(), "a list of verdicts was expected"), (["drop"], "which is no verdict"), (None, ""), ([], "")],
)
def test_an_answer_that_is_no_list_of_verdicts(answer: object, expected: str) -> None:
    @dataclass
    class Odd:
        link: str

        def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
            return answer  # type: ignore[return-value]

        def next_wakeup(self) -> Time | None:
            return None

        def on_wakeup(self, now: Time) -> Sequence[Verdict]:
            return ()

    links, routes = onboard("blue/b1")
    agents: list[Agent] = [Station("blue", ["blue/b1"])]
    kernel = Kernel(
        Wiring(seed=1, links=links, routes=routes, agents=agents, taps=[TapPlacement("gcs:*", "gcs", Odd)]), [Log()]
    )
    if expected:
        with pytest.raises(ComponentError, match=expected):
            kernel.advance(NS_PER_S)
    else:
        kernel.advance(NS_PER_S)


def test_a_taps_latest_wish_counts() -> None:
    @dataclass
    class Fickle:
        link: str
        wish: Time | None = 500 * MS
        woken: list[Time] = field(default_factory=list)

        def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
            self.wish = 805 * MS if now < 805 * MS else None
            return ()

        def next_wakeup(self) -> Time | None:
            return self.wish

        def on_wakeup(self, now: Time) -> Sequence[Verdict]:
            self.woken.append(now)
            self.wish = None
            return ()

    made: list[Fickle] = []

    def make(link: str) -> Fickle:
        made.append(Fickle(link))
        return made[0]

    links, routes = onboard("blue/b1")
    agents: list[Agent] = [Station("blue", ["blue/b1"])]
    wiring = Wiring(seed=1, links=links, routes=routes, agents=agents, taps=[TapPlacement("gcs:*", "gcs", make)])
    Kernel(wiring, [Log()]).advance(NS_PER_S)
    assert made[0].woken == [805 * MS]


@pytest.mark.parametrize(
    ("ids", "expected"), [(["a", "a"], "ids that differ"), (["tap"], "not 'tap'"), (["a|b"], "letters, digits")]
)
def test_attacks_have_names_of_their_own(ids: list[str], expected: str) -> None:
    links, routes = onboard("blue/b1")
    with pytest.raises(InputError, match=expected):
        Kernel(Wiring(seed=1, links=links, routes=routes, acts=[Act(each) for each in ids]))
