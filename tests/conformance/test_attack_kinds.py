"""Do the shipped attacks keep their contract, and does the check find those that do not?"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, cast

import pytest
from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import TapPlacement
from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.contracts.params import Number, Params
from skyrange.contracts.verdicts import Delay, Inject
from skyrange.core.ids import Port
from skyrange.core.time import NS_PER_S, Time
from skyrange.testing import NonConformance, check_attack
from tests.hostile_kind import HOMEWARD, Homeward, Orders
from tests.hostile_kind import make as make_homeward

pytestmark = pytest.mark.rotating

JAM = AttackPlugin.find("remote_id.jam")
SPOOF = AttackPlugin.find("remote_id.spoof")
REPLAY = AttackPlugin.find("remote_id.replay")
DRIFT = AttackPlugin.find("gnss.drift")
JUMP = AttackPlugin.find("gnss.jump")

PLACE = [10.0, 5.0, 20.0]
KINDS: list[tuple[AttackPlugin, Mapping[str, Any], bool]] = [
    (SPOOF, {"at": PLACE, "velocity_mps": [1.0, 0.0, 0.0], "transports": ["bt4", "wifi_beacon"]}, True),
    (SPOOF, {"at": PLACE, "form": "position", "vehicle": "blue/b1"}, True),
    (SPOOF, {"at": PLACE, "form": "swarm", "count": 7}, True),
    (REPLAY, {"transmitter_m": PLACE, "delay_s": 1.0}, False),  # nobody is on the air here whom it could hear
    (JAM, {"transmitter_m": PLACE, "duty": 0.3}, True),
    (JUMP, {"vehicles": ["blue/b1"], "offset_m": [40.0, 0.0, 3.0]}, True),
    (DRIFT, {"vehicles": ["blue/b1", "green/g1"], "rate_mps": [2.0, 0.0, 0.0], "largest_m": 4.0}, True),
    (HOMEWARD, {"vehicle": "blue/b1"}, True),
]


@pytest.mark.catalogue
@pytest.mark.parametrize(
    ("kind", "params", "acts"), KINDS, ids=[f"{k.params.__name__}-{i}" for i, (k, *_) in enumerate(KINDS)]
)
def test_shipped_attacks_conform(kind: AttackPlugin, params: Mapping[str, Any], acts: bool) -> None:
    check_attack(kind, params, acts=acts)


@dataclass(slots=True)
class Hasty(Orders):
    """Alters frames while it is muted too, by force."""

    def on_frame(self, now: Time, frame: Frame) -> list[Any]:
        if now > 4 * NS_PER_S:
            object.__setattr__(frame, "payload", b"\\0" * len(frame.payload))
        return []


def injections(tap: Orders, now: Time) -> list[Inject]:
    return [verdict for verdict in Orders.on_wakeup(tap, now) if isinstance(verdict, Inject)]


@dataclass
class Shared:
    """What all attacks of the process share."""

    count: int = 0

    def __deepcopy__(self, memo: object) -> Shared:
        return self


SHARED = Shared()


@dataclass(slots=True)
class Sharing(Orders):
    """Counts its orders in one place with everybody else's."""

    shared: Shared = field(default_factory=lambda: SHARED)

    def on_wakeup(self, now: Time) -> Any:
        self.shared.count += 1
        self.turn = now // self.period_ns + 1
        return [
            replace(verdict, payload=verdict.payload + bytes([self.shared.count % 251]))
            for verdict in injections(self, now)
        ]


LAST: dict[str, int] = {}
"""Of the process: when an order was last given, and how many there were until then."""


@dataclass(slots=True)
class Crowded(Orders):
    """Begins to count anew where time goes back, as at the start of a run: in company it does at every turn."""

    def on_wakeup(self, now: Time) -> Any:
        LAST["count"] = LAST.get("count", 0) + 1 if now > LAST.get("at", 0) else 1
        LAST["at"] = now
        return [
            replace(verdict, payload=verdict.payload + bytes([LAST["count"] % 251]))
            for verdict in injections(self, now)
        ]


@dataclass(slots=True)
class Clocked(Orders):
    """Puts the time of day into its orders."""

    def on_wakeup(self, now: Time) -> Any:
        return [
            replace(verdict, payload=verdict.payload + time.time_ns().to_bytes(8, "little"))
            for verdict in injections(self, now)
        ]


@dataclass(slots=True)
class Uneven(Orders):
    """As a sham it says more."""

    def on_wakeup(self, now: Time) -> Any:
        return [replace(order, payload=order.payload + b"!" * self.sham) for order in injections(self, now)]


class Stranger:
    """An agent that is named as others might be."""

    name = "radio"
    service_ns = NS_PER_S
    ports: Sequence[Port] = ()

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        return Outbox()

    def next_wakeup(self) -> None:
        return None


def bad(tap: type[Orders]) -> AttackPlugin:
    def make(params: Homeward, context: AttackContext) -> Attack:
        (placement,) = make_homeward(params, context).taps

        def orders(link: str) -> Orders:
            one = placement.make(link)
            assert isinstance(one, Orders)
            return tap(one.src, one.dst, one.period_ns, one.sham, one.schedule, one.packer)

        return Attack(taps=[TapPlacement(placement.match, placement.side, orders)])

    return AttackPlugin(Homeward, make, "A bad one.")


@pytest.mark.parametrize(
    ("kind", "rule"),
    [
        (bad(Hasty), "attack.muted"),
        (bad(Sharing), "attack.repeatable"),
        (bad(Crowded), "attack.repeatable"),
        (bad(Clocked), "attack.repeatable"),
        (bad(Uneven), "attack.sham"),
        (AttackPlugin(Homeward, lambda params, context: Attack(agents=[Stranger()]), "A stranger."), "attack.named"),
        (AttackPlugin(Homeward, lambda params, context: Attack(), "Idle."), "attack.acts"),
        (AttackPlugin(Homeward, lambda params, context: cast(Attack, None), "Nothing."), "attack.makes"),
        (AttackPlugin(Homeward, lambda params, context: Attack(), "no sentence"), "attack.described"),
    ],
    ids=["hasty", "sharing", "crowded", "clocked", "uneven", "stranger", "idle", "nothing", "mute"],
)  # fmt: skip
def test_broken_attacks_are_found(kind: AttackPlugin, rule: str) -> None:
    with pytest.raises(NonConformance) as caught:
        check_attack(kind, {"vehicle": "blue/b1", "every_s": 0.25}, duration_s=8.0)
    assert caught.value.rule == rule


class Lag(Params):
    """Delays the frames to an aircraft."""

    vehicle: str = Field(description="The aircraft.")
    by_s: Number = Field(default=2.0, description="Delay in seconds.")


@dataclass(slots=True)
class Holder:
    by_ns: Time

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Any]:
        return [Delay(now + self.by_ns)] if frame.direction == "fwd" else []

    def next_wakeup(self) -> Time | None:
        return None

    def on_wakeup(self, now: Time) -> Sequence[Any]:
        return []


@dataclass(frozen=True, slots=True)
class MakeHolder:
    by_ns: Time

    def __call__(self, link: str) -> Holder:
        return Holder(self.by_ns)


def make_lag(params: Lag, context: AttackContext) -> Attack:
    by_ns = 1_000 if context.sham else round(params.by_s * NS_PER_S)
    return Attack(taps=[TapPlacement(f"gcs:{params.vehicle}", "companion", MakeHolder(by_ns))])


LAG = AttackPlugin(Lag, make_lag, "Delays commands to the aircraft.", technique="T0814")


@pytest.mark.catalogue
@pytest.mark.parametrize(("start_s", "stop_s"), [(0.0, 3.0), (0.5, 2.0), (1.0, 9.0), (3.0, 7.0), (4.3, 12.0)])
def test_an_attack_to_which_others_react_conforms_in_any_window(start_s: float, stop_s: float) -> None:
    """A delayed upload is repeated, so the attack has more to delay than its sham has."""
    check_attack(LAG, {"vehicle": "blue/b1"}, start_s=start_s, stop_s=stop_s, acts={"delay"})


def test_the_expected_acts_are_checked() -> None:
    with pytest.raises(NonConformance, match=r"did delay.*drop"):
        check_attack(LAG, {"vehicle": "blue/b1"}, start_s=1.0, stop_s=2.0, acts={"drop"})
    with pytest.raises(ValueError, match="expected True, False or some of body, delay, drop"):
        check_attack(LAG, {"vehicle": "blue/b1"}, acts="delay")
    with pytest.raises(ValueError, match="start_s 7"):
        check_attack(LAG, {"vehicle": "blue/b1"}, start_s=7.0)


def test_a_sham_that_acts_otherwise_from_its_first_act_on_does_not_conform() -> None:
    def make_late(params: Lag, context: AttackContext) -> Attack:
        if not context.sham:
            return make_lag(params, context)
        return Attack(taps=[TapPlacement(f"gcs:{params.vehicle}", "companion", MakeNone())])

    late = AttackPlugin(Lag, make_late, "Delays commands to the aircraft.", technique="T0814")
    with pytest.raises(NonConformance, match="sham"):
        check_attack(late, {"vehicle": "blue/b1"}, start_s=1.0, stop_s=5.0)


def test_a_sham_that_alters_readings_is_no_nominal_run() -> None:
    def make_lying(params: Any, context: AttackContext) -> Attack:
        return DRIFT.make(params, replace(context, sham=False))

    lying = replace(DRIFT, make=make_lying)
    with pytest.raises(NonConformance, match=r"attack\.silent"):
        check_attack(lying, {"vehicles": ["blue/b1"], "rate_mps": [2.0, 0.0, 0.0]})


@dataclass(slots=True)
class Idle(Holder):
    def on_frame(self, now: Time, frame: Frame) -> Sequence[Any]:
        return []


@dataclass(frozen=True, slots=True)
class MakeNone:
    def __call__(self, link: str) -> Idle:
        return Idle(0)
