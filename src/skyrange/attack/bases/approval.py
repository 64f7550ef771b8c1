"""Base of kinds that act on flight approval: taps on the links of operators and of services, and checks of both."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Sequence
from typing import Any, ClassVar

from skyrange.attack.bases.on_path import CopyForLink, LinkTap
from skyrange.attack.contract import Attack, AttackContext
from skyrange.attack.declaration import Facts
from skyrange.attack.exclusive import Exclusive
from skyrange.attack.tapped_links import SIDES, USS, Repetition, ends_of
from skyrange.attack.victims import check_vehicles
from skyrange.contracts.components import Tap
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.links import TapPlacement
from skyrange.contracts.verdicts import Direction, Inject, Replace, Verdicts
from skyrange.core.errors import InputError, nearest
from skyrange.core.ids import APPROVAL, link_name, operator_of
from skyrange.core.time import Time
from skyrange.utm.federated.names import AIRSPACE, DSS


class OnApproval(LinkTap):
    """Acts on links of flight approval: `act` answers frames that pass, and `send` makes messages of its own.

    A kind defines one of them or both, and builds its parts from `at_service` or `approval_taps`.
    """

    attack_facts: ClassVar[Facts] = {
        "surface": ("uss",),
        "persists": "flight",
        "equipment": "a computer that forwards the frames",
        "budget": "no frames of its own",
    }

    needs: ClassVar[tuple[str, ...]] = ()

    when: Repetition | None = None
    """When it sends; `None` for never."""
    way: Direction = "fwd"
    """The direction in which it sends."""

    def at_service(
        self, service: str, context: AttackContext, *, alters: str, others: Collection[str] | None = None
    ) -> Attack:
        """The attack by taps at a service's end of its links, or of those to some `others`.

        It is the only one that may alter what `alters` names.
        """
        pairs = [pair for pair in _pairs(context) if service in pair]
        own = [pair for pair in pairs if others is None or not set(pair).isdisjoint(others)]
        make = CopyForLink(self)
        taps = [TapPlacement(f"{USS}:{one}~{other}", service, make) for one, other in own]
        return Attack(taps=taps, exclusive=[Exclusive(alters)])

    def on_frame(self, now: Time, frame: Frame) -> Verdicts:
        """Answer the frame if the attack acts now."""
        schedule = self.schedule
        return self.act(now, frame) if schedule.start_ns <= now < schedule.stop_ns else ()

    def next_wakeup(self) -> Time | None:
        """When it sends."""
        return None if self.when is None else self.when.due

    def on_wakeup(self, now: Time) -> Verdicts:
        """Send what is due, in the name of the link's own end."""
        if self.when is None or not self.when.take(now):
            return ()
        payload = self.send(now, self.when.done)
        return () if payload is None else (Inject(payload, self.way, *ends_of(self.link, self.way)),)

    def act(self, now: Time, frame: Frame) -> Verdicts:
        """The verdicts on a frame; none lets it pass."""
        return ()

    def send(self, now: Time, turn: int) -> bytes | None:
        """The message of a turn, counted from 1; `None` for none."""
        return None

    def replace_message(self, payload: bytes, message: Any) -> Verdicts:
        """Replace a message of services by a false one."""
        false = json.dumps(message, sort_keys=True, separators=(",", ":")).encode()
        return (replace_json(payload, false, self.sham),)


def replace_json(payload: bytes, false: bytes, sham: bool) -> Replace:
    """Replace JSON by false JSON; a sham replaces it by itself, with as many bytes. JSON may end with spaces."""
    return Replace((payload if sham else false).ljust(max(len(false), len(payload))))


def approval_taps(vehicles: Sequence[str], context: AttackContext, make: Callable[[str], Tap]) -> list[TapPlacement]:
    """A tap at the station on the approval link of each operator of aircraft.

    Raises `InputError` for aircraft that are not in the scenario.
    """
    check_vehicles(context, vehicles)
    operators = dict.fromkeys(operator_of(vehicle) for vehicle in vehicles)
    return [TapPlacement(link_name(APPROVAL, operator), SIDES[APPROVAL], make) for operator in operators]


def _pairs(context: AttackContext) -> list[tuple[str, str]]:
    names = [name.partition(":")[2] for name in context.links if name.startswith(f"{USS}:")]
    return [(one, other) for one, _, other in (name.partition("~") for name in names)]


def list_peers(service: str, context: AttackContext) -> list[str]:
    """The services to which one has links, in order."""
    return sorted(one for pair in _pairs(context) if service in pair for one in pair if one != service)


def check_uss(uss: str, context: AttackContext) -> None:
    """Raise `InputError` for a USS that the scenario does not have."""
    known = sorted({other for one, other in _pairs(context) if one == DSS and other != AIRSPACE})
    if uss not in known:
        hint = nearest(uss, known) or 'Set approval = "federated" for its operator.'
        raise InputError.one(context.id, "uss", repr(uss), "a USS of the scenario", hint)


def check_member(operator: str, context: AttackContext) -> None:
    """Raise `InputError` for an operator without a node of a hashgraph of three members at least."""
    peers = list_peers(operator, context)
    if len(peers) < 2 or DSS in (operator, *peers):
        expected = "an operator whose approval is hashgraph, with two others at least"
        raise InputError.one(context.id, "operator", repr(operator), expected)


def check_others(names: Sequence[str], key: str, operator: str, context: AttackContext) -> None:
    """Raise `InputError` for a name, of those of the parameter `key`, that is no other member of the hashgraph."""
    peers = list_peers(operator, context)
    for place, name in enumerate(names):
        if name not in peers:
            hint = nearest(name, peers)
            raise InputError.one(context.id, f"{key}.{place}", repr(name), "another member of the hashgraph", hint)


def check_constraint_manager(context: AttackContext) -> None:
    """Raise `InputError` for a scenario without a constraint manager."""
    if (DSS, AIRSPACE) not in _pairs(context):
        hint = 'Add [[constraints]], and set approval = "federated" for an operator.'
        raise InputError.one(context.id, "kind", "approval.poisoned_constraint", "a scenario with constraints", hint)
