"""Links that an attacker has a tap on: their names, the end where the tap is, and when it acts on its own.

An attacker has a place on a control link (`contracts.links.NetworkPlace`). `onboard` its tap is on the receiving
computer's side (`companion` of a `gcs` link), so what it does comes after the channel for frames towards the aircraft,
and before it for telemetry. In the operator's `network` it is on the station's side, and the other way round. In the
`air` it is on neither: it hears and sends by a radio of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Annotated, Any, Final, Literal

from pydantic import AfterValidator, BeforeValidator

from skyrange.attack.contract import AttackContext
from skyrange.codec.mavlink import dialect
from skyrange.contracts.components import Tap
from skyrange.contracts.links import AIR, NetworkPlace, RadioSite, Schedule, TapPlacement
from skyrange.contracts.params import items, refuse
from skyrange.contracts.verdicts import Direction
from skyrange.core.errors import InputError, Problem, nearest
from skyrange.core.ids import APPROVAL, endpoint, operator_of
from skyrange.core.time import NEVER, NS_PER_MS, Time

MESSAGE_NUMBERS: Final = {message.msgname: number for number, message in dialect.mavlink_map.items()}
_POLL_NS: Final = 100 * NS_PER_MS
LEARNED: Final = "event.learned"
"""Kind of the notes on what an attacker has learnt from a frame."""
USS: Final = "uss"
"""Role of the links between services of a flight approval: `uss:dss~blue`."""
SIDES: Final = {"gcs": "companion", "log": "proxy", "autopilot": "proxy", "rid_data": "companion", "approval": "gcs",
                "rid_up": "companion", "rid_down": "companion", "oracle": "gcs", "scan": "companion"}  # fmt: skip
"""By role of a link: the end at which an attacker's tap is."""
_ON_BOARD: Final = ("companion", "proxy")
STATION_SIDE: Final = "gcs"
"""The end of a gcs link at which the tap of an attacker in the operator's network is."""
CONTROL_LINKS: Final = ("gcs", "log", "autopilot")
"""The roles of the links that a control link consists of, from ground station to autopilot."""
EVERY_LINK: Final = ("gcs", "log", "autopilot", "rid_data", "approval", USS, "rid_up", "rid_down", "oracle", "scan")
"""The roles of all links: the surface of what acts on any of them."""


def side_of(link: str) -> str:
    """The end of a link at which an attacker's tap is; of a link between two services the first one's."""
    role, _, owner = link.partition(":")
    return owner.partition("~")[0] if role == USS else SIDES[role]


def _known_messages(names: tuple[str, ...]) -> tuple[str, ...]:
    for place, name in enumerate(names):
        if name not in MESSAGE_NUMBERS:
            raise refuse(
                Problem(str(place), name, "a MAVLink message such as 'COMMAND_LONG'", nearest(name, MESSAGE_NUMBERS))
            )
    return names


def _once(names: tuple[str, ...]) -> tuple[str, ...]:
    if len(set(names)) < len(names):
        raise refuse(Problem("", repr(list(names)), "each name once"))
    return names


Names = Annotated[tuple[str, ...], BeforeValidator(items, json_schema_input_type=list[str]), AfterValidator(_once)]
Messages = Annotated[Names, AfterValidator(_known_messages)]
"""Names of MAVLink messages, each once; empty for all frames."""


@dataclass(frozen=True, slots=True)
class TapMaker:
    """Makes the tap of each link: `kind(link, *arguments)`. A class, because all state must be deep-copyable."""

    kind: Callable[..., Tap]
    arguments: tuple[Any, ...] = ()

    def __call__(self, link: str) -> Tap:
        """The tap of a link."""
        return self.kind(link, *self.arguments)


def place_taps(
    patterns: Sequence[str],
    context: AttackContext,
    make: Callable[[str], Tap],
    place: NetworkPlace | Literal[""] | None = None,
    site: RadioSite | None = None,
) -> list[TapPlacement]:
    """A tap on each link that matches, at a place; by default in the network of links over the air, else `side_of`.

    `""` is `side_of` for all links, of what has no place; `site` is the radio of one in the air. Raises `InputError`
    for a pattern without a link, and for a place that a link does not have.
    """
    chosen = []
    for number, pattern in enumerate(patterns):
        matches = [name for name in context.links if fnmatchcase(name, pattern)]
        if not matches:
            hint = nearest(pattern, context.links)
            raise InputError.one(context.id, f"links.{number}", pattern, "a link of the scenario", hint)
        chosen += matches
    return [_place_tap(name, context, make, place, site) for name in dict.fromkeys(chosen)]


def _place_tap(
    link: str,
    context: AttackContext,
    make: Callable[[str], Tap],
    place: NetworkPlace | Literal[""] | None,
    site: RadioSite | None,
) -> TapPlacement:
    over_air = context.over_air.get(link)
    if place is None and over_air is not None:
        place = "network"
    if not place:
        return TapPlacement(link, side_of(link), make)
    if place == "onboard":
        if side_of(link) not in _ON_BOARD:
            expected = "a link with an end in an aircraft: gcs, log, autopilot, rid_data, rid_up, rid_down or scan"
            raise InputError.one(context.id, "place", f"onboard, for {link}", expected)
        return TapPlacement(link, side_of(link), make, place=place)
    if not link.startswith(f"{CONTROL_LINKS[0]}:"):
        raise InputError.one(context.id, "place", f"{place}, for {link}", "onboard: only gcs links leave the aircraft")
    if place == "network":
        return TapPlacement(link, STATION_SIDE, make, place=place)
    if over_air is None:
        expected = "network or onboard: the link has a fixed channel, which has no radio that anyone could hear"
        hint = 'Give [[links]] channel = "wifi" for that link.'
        raise InputError.one(context.id, "place", f"air, for {link}", expected, hint)
    if over_air.kind == "sik":
        expected = "network or onboard: skyrange has no radio of an attacker that follows the frequencies of SiK radios"
        raise InputError.one(context.id, "place", f"air, for the SiK link {link}", expected)
    if over_air.kind != "wifi":
        expected = "network or onboard: data are encrypted between aircraft and base station (TS 33.401, 5.1.3)"
        raise InputError.one(context.id, "place", f"air, for the {over_air.kind} link {link}", expected)
    return TapPlacement(link, AIR, make, place=place, site=site)


def ends_of(link: str, direction: Direction) -> tuple[str, str]:
    """Claimed source and destination of a frame injected on a `gcs`, `log`, `autopilot`, `approval` or `uss` link."""
    role, _, owner = link.partition(":")
    service, _, peer = owner.partition("~")
    first, second = {
        "gcs": (endpoint(operator_of(owner), "gcs"), endpoint(owner, "companion")),
        "log": (endpoint(owner, "companion"), endpoint(owner, "proxy")),
        "autopilot": (endpoint(owner, "proxy"), endpoint(owner, "autopilot")),
        APPROVAL: (endpoint(owner, "gcs"), APPROVAL),
        USS: (endpoint(APPROVAL, service), endpoint(APPROVAL, peer)),
    }[role]
    return (first, second) if direction == "fwd" else (second, first)


@dataclass(slots=True)
class Repetition:
    """Times of something that is done when an attack starts and then every `period_ns`, at most `times` times.

    The schedule is filled in during the run, and a trigger or a campaign may set the start: while that is not known,
    this looks at it ten times a second.
    """

    schedule: Schedule
    period_ns: Time
    times: int = 0
    """0 for until the attack stops."""
    due: Time | None = 0
    done: int = 0

    def take(self, now: Time) -> bool:
        """Whether it is to be done now; sets the next time."""
        if self.due is None or now < self.due:
            return False
        start = self.schedule.start_ns
        if now < start:
            self.due = now + _POLL_NS if start == NEVER else start
            return False
        if now >= self.schedule.stop_ns:
            self.due = None
            return False
        self.done += 1
        self.due = None if self.done == self.times else now + self.period_ns
        return True
