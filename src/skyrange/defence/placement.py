"""Places of defences: the aircraft they protect, taps at the ends of their links, and limits of alarms."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from skyrange.attack.declaration import Acting
from skyrange.attack.params import Vehicles, check_vehicles
from skyrange.contracts.alerts import Alert
from skyrange.contracts.components import Tap
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import TapPlacement
from skyrange.contracts.plugins.form import param
from skyrange.contracts.verdicts import Verdict
from skyrange.core.errors import InputError
from skyrange.core.ids import link_name
from skyrange.core.time import NS_PER_S, Time
from skyrange.defence.contract import DefenceContext


class Protection(Acting):
    """Protects aircraft of the scenario."""

    vehicles: Vehicles = param("Aircraft that it protects, such as ['blue/b1']; default: all.", default=())

    def find_protected(self, context: DefenceContext) -> list[str]:
        """The aircraft that it protects. Raises `InputError` for those that are not in the scenario."""
        check_vehicles(context, self.vehicles)
        return list(self.vehicles or context.vehicles)


def place_taps(
    role: str,
    side: str,
    vehicles: Sequence[str],
    context: DefenceContext,
    make: Callable[[str], Tap],
    inspects: Callable[[Frame], bool] | None = None,
) -> list[TapPlacement]:
    """A tap at the `side` end of the link of this role of each aircraft; `make` is called with the link's name.

    `inspects` says for which frames it needs its endpoint's processor; `None` for all.

    Raises `InputError` where none of the aircraft has such a link, as without a radio medium for `rid_data`.
    """
    return [TapPlacement(name, side, make, inspects=inspects) for name in find_links(role, vehicles, context)]


def find_links(role: str, vehicles: Sequence[str], context: DefenceContext) -> dict[str, str]:
    """The links of this role of aircraft, and whose each is. Raises `InputError` where none has such a link."""
    every = {link_name(role, vehicle): vehicle for vehicle in vehicles}
    links = {name: vehicle for name, vehicle in every.items() if name in context.links}
    if not links:
        hint = "Add a table [radio]." if role.startswith("rid") else ""
        raise InputError.one(context.id, "vehicles", f"no link {role}:…", f"aircraft with a link of role {role}", hint)
    return links


def inspects_forward(frame: Frame) -> bool:
    """Whether a frame goes from the link's first end to its second, such as towards an aircraft."""
    return frame.direction == "fwd"


def inspects_none(frame: Frame) -> bool:
    """No frame: a tap that listens to its own component, whose work is not that of the defence."""
    return False


@dataclass(slots=True)
class DefenceTap:
    """A tap of a defence that decides on frames, and never acts on its own."""

    link: str

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Decide on a frame."""
        raise NotImplementedError

    def next_wakeup(self) -> Time | None:
        """Never."""
        return None

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        """Nothing."""
        return ()


@dataclass(slots=True)
class Alarm:
    """Alerts of one place: of each kind the first at once, then at most one every `period_ns`, with a count."""

    subject: str
    """The vehicle or link that they are about."""
    period_ns: Time = NS_PER_S
    _last: dict[str, Time] = field(default_factory=dict)
    _held: dict[str, int] = field(default_factory=dict)

    def raise_at(self, now: Time, kind: str, score: float, **data: str | float | int | bool) -> list[Alert]:
        """The alert, or none where one of its kind was raised less than a period ago.

        `score` is at least 1 where the defence acts. `count` in the data is how many findings an alert stands for.
        """
        count = self._held.get(kind, 0) + 1
        last = self._last.get(kind)
        if last is not None and now < last + self.period_ns:
            self._held[kind] = count
            return []
        self._last[kind], self._held[kind] = now, 0
        return [Alert(now, self.subject, kind, score, {"count": count, **data})]
