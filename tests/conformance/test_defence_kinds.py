"""Do the shipped defences keep their contract, and does the check find those that do not?"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import pytest

from skyrange.attack.bases.mavlink.orders import read
from skyrange.attack.tapped_links import TapMaker
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.frames import Frame
from skyrange.contracts.plugins.registry import NoParams
from skyrange.contracts.verdicts import Drop, Verdict
from skyrange.core.time import NS_PER_S, Time
from skyrange.defence.contract import Defence, DefenceContext, DefencePlugin
from skyrange.defence.placement import Alarm, DefenceTap, place_taps
from skyrange.testing import NonConformance, check_defence
from tests.registered_kinds import registered

pytestmark = pytest.mark.rotating

TERMINATE = {
    "kind": "mavlink.command",
    "start_s": 5.0,
    "params": {"vehicles": ["blue/b1"], "command": "DO_FLIGHTTERMINATION", "values": [1]},
}
KINDS: list[tuple[str, Mapping[str, Any], Mapping[str, Any], Collection[str]]] = [
    ("mavlink.firewall", {}, TERMINATE, ("drop",)),
    ("mavlink.firewall", {"at": "proxy"}, TERMINATE, ("drop",)),
]


@pytest.mark.catalogue
@pytest.mark.parametrize(("name", "params", "attack", "acts"), KINDS, ids=[f"{k[0]}-{i}" for i, k in enumerate(KINDS)])
def test_shipped_defences_conform(
    name: str, params: Mapping[str, Any], attack: Mapping[str, Any], acts: Collection[str]
) -> None:
    check_defence(name, params, attack, acts=acts)


@dataclass(slots=True)
class Nervous(DefenceTap):
    """Drops every tenth frame, attacked or not."""

    alarm: Alarm
    count: int = 0

    def on_frame(self, now: Time, frame: Frame) -> list[Verdict]:
        self.count += 1
        return [Drop()] if self.count % 10 == 0 else []


@dataclass(slots=True)
class Anxious(DefenceTap):
    """Raises an alarm, attacked or not."""

    alarm: Alarm

    def on_frame(self, now: Time, frame: Frame) -> list[Verdict]:
        return [*self.alarm.raise_at(now, "told", 1.0)] if now > 6 * NS_PER_S else []


@dataclass(slots=True)
class Shouting(DefenceTap):
    """Drops the attack's command, and raises an alarm that its kind does not declare."""

    alarm: Alarm

    def on_frame(self, now: Time, frame: Frame) -> list[Verdict]:
        message = read(frame.payload)
        if message is None or getattr(message, "command", 0) != mav.MAV_CMD_DO_FLIGHTTERMINATION:
            return []
        return [Drop(), *self.alarm.raise_at(now, "shout", 1.0)]


def _plugin(tap: type[DefenceTap]) -> DefencePlugin:
    def make(params: NoParams, context: DefenceContext) -> Defence:
        vehicles = list(context.vehicles)
        return Defence(taps=place_taps("gcs", "companion", vehicles, context, TapMaker(tap, (Alarm("blue/b1"),))))

    phrase = "something"
    said: dict[str, Any] = {"place": phrase, "effect": phrase, "evasion": phrase, "cost": phrase}
    return DefencePlugin(NoParams, make, "Is wrong.", ("gcs",), alerts=("told",), against=("*",), **said)


@pytest.mark.parametrize(("tap", "rule"), [(Nervous, "nominal"), (Anxious, "nominal"), (Shouting, "acts")])
def test_defences_that_break_a_rule_are_found(tap: type[DefenceTap], rule: str) -> None:
    with registered(("test.wrong", _plugin(tap))), pytest.raises(NonConformance, match=rf"breaks defence\.{rule}:"):
        check_defence("test.wrong", {}, TERMINATE)
