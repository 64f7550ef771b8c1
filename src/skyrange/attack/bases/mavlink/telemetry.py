"""Bases of kinds that alter telemetry: fields of MAVLink 2 frames of an aircraft's autopilot, and its estimator.

Where a tap is decides who is deceived. On `autopilot` it is all receivers, on `log` and `gcs` the ground station, on
`rid_data` the companion computer: its Remote ID broadcasts and its avoidance. A tap of the attacker has no key: a
signed frame keeps its signature, which no longer fits, so receivers with a key refuse it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, ClassVar, Final

from skyrange.attack.bases.links import LinkNames, LinkTap, PathPlace, find_links, on_path_place
from skyrange.attack.bases.mavlink.message_fields import Fields, put, read_fields, write_alteration
from skyrange.attack.contract import Attack, AttackContext, Place
from skyrange.attack.declaration import Facts
from skyrange.attack.exclusive import Exclusive
from skyrange.attack.tapped_links import MESSAGE_NUMBERS
from skyrange.codec.mavlink import dialect, message_id
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.frames import Frame
from skyrange.contracts.plugins.form import param
from skyrange.contracts.verdicts import Direction, Replace, Verdict
from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin
from skyrange.core.ids import link_name
from skyrange.core.time import Time

FROM_AIRCRAFT: Final[Mapping[str, Direction]] = {"gcs": "rev", "log": "rev", "autopilot": "rev", "rid_data": "fwd"}
"""By role of a link that carries telemetry: the direction in which it does."""
AUTOPILOT: Final = int(dialect.MAV_COMP_ID_AUTOPILOT1)
"""Component id of an autopilot."""
_CHAINS: Final = (("autopilot", "log"), ("autopilot", "gcs"), ("autopilot", "rid_data"), ("log", "gcs"))
"""Roles of links that one frame of an aircraft passes, one after the other."""


class AlteredTelemetry(LinkTap):
    """Alters messages of an aircraft's autopilot on each of its links, while it acts.

    A kind names the messages in `sees`, and `alter` writes into their fields. The sham replaces the same messages by
    themselves, with as many bytes.
    """

    attack_facts: ClassVar[Facts] = {
        "technique": "T0856",
        "surface": ("gcs", "log", "autopilot", "rid_data"),
        "persists": "acts",
        "position": "on the path between autopilot and receiver: a router, the companion computer or its proxy",
        "equipment": "a computer that decodes and rewrites MAVLink frames",
        "budget": "no frames of its own; each altered frame is at most some bytes longer",
        "load": "the sham: the same frames are replaced by themselves, with as many bytes",
        "content": "none, because the sham has the true content",
        "placement": "the same alteration on another link: rid_data instead of gcs",
    }

    needs: ClassVar[tuple[str, ...]] = ("alter",)
    sees: ClassVar[tuple[str, ...]] = ()
    """The messages that it alters, by name."""

    links: LinkNames = param(
        "Links by name or pattern, such as ['gcs:blue/b1']. gcs and log: the ground station is deceived; rid_data: "
        "Remote ID broadcasts and avoidance on board; autopilot: all of them."
    )
    place: PathPlace | None = on_path_place()
    origin: Origin
    names: dict[int, str]
    """By number: the messages that it alters."""
    systems: dict[str, int]
    """System ids of the aircraft."""
    way: Direction
    """Of a tap: the direction of telemetry."""
    system: int
    """Of a tap: the system id of its aircraft."""

    def assemble(self, context: AttackContext) -> Any:
        """See `Acting`."""
        self.origin = context.origin
        self.names = {MESSAGE_NUMBERS[name]: name for name in self.find_messages()}
        self.systems = {name: aircraft.system_id for name, aircraft in context.vehicles.items()}
        return super().assemble(context)

    def build(self, context: AttackContext) -> Attack:
        """A tap on each link that matches.

        Raises `InputError` as `find_links` does, and for two links that the same frame passes: it would be altered
        twice.
        """
        links = find_links(self.links, context, list(FROM_AIRCRAFT))
        for first, later in _CHAINS:
            for name in links:
                role, _, vehicle = name.partition(":")
                second = link_name(later, vehicle)
                if role == first and second in links:
                    expected = f"{name} or {second}, not both"
                    raise InputError.one(context.id, "links", f"{name}, {second}", expected, "One frame passes both.")
        return Attack(
            taps=self.make_taps(links, context),
            shown=self.marks(),
            exclusive=[
                exclusive_messages(name, FROM_AIRCRAFT[name.partition(":")[0]], self.names.values()) for name in links
            ],
        )

    def marks(self) -> dict[str, Place]:
        """Places to mark on a map, by label."""
        return {}

    def begin(self) -> None:
        """Take direction and system id of the link."""
        role, _, vehicle = self.link.partition(":")
        self.way, self.system = FROM_AIRCRAFT[role], self.systems[vehicle]

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Alter it, or let it pass."""
        if frame.direction != self.way:
            return ()
        payload = frame.payload
        number = message_id(payload)
        if number is None or number not in self.names:
            return ()
        fields = read_fields(payload, number)
        if fields is None or payload[5] != self.system or payload[6] != AUTOPILOT:
            return ()
        since_ns = now - self.schedule.start_ns
        if since_ns < 0:
            self.learn(self.names[number], fields)
            return ()
        true = fields.copy()
        if not self.alter(self.names[number], fields, since_ns):
            return ()
        return (Replace(write_alteration(payload, number, true, fields, sham=self.sham)),)

    def find_messages(self) -> Iterable[str]:
        """The messages that it alters with its parameters."""
        return self.sees

    def learn(self, message: str, fields: Fields) -> None:
        """Read the fields of a message before the start; no kind has to."""

    def alter(self, message: str, fields: Fields, since_ns: Time) -> bool:
        """Write into the fields of a message, named as in MAVLink; returns whether it is one to replace.

        `since_ns` counts from the start.
        """
        raise NotImplementedError


def exclusive_messages(link: str, direction: Direction, messages: Iterable[str]) -> Exclusive:
    """Messages of one direction of a link, by name, as something that one attack alone may alter."""
    return Exclusive(f"{link} ({direction})", frozenset(messages))


VARIANCES: Final = ("velocity_variance", "pos_horiz_variance", "pos_vert_variance", "compass_variance")
"""Fields with variances (normalised innovations)."""
HEALTHY_VARIANCE: Final = 0.1
"""Largest variance of a healthy estimator; ground stations warn from 0.5 (Mission Planner)."""
HEALTHY_FLAGS: Final = (
    mav.EKF_ATTITUDE | mav.EKF_VELOCITY_HORIZ | mav.EKF_VELOCITY_VERT | mav.EKF_POS_HORIZ_REL | mav.EKF_POS_HORIZ_ABS
    | mav.EKF_POS_VERT_ABS | mav.EKF_PRED_POS_HORIZ_REL | mav.EKF_PRED_POS_HORIZ_ABS
)  # fmt: skip
"""Flags of an estimator with a position."""
LOST_VARIANCE: Final = 1.0
"""Least variance of a lost estimator: at 1 it would reject the measurement."""
LOST_FLAGS: Final = mav.EKF_ATTITUDE | mav.EKF_CONST_POS_MODE
"""Flags of an estimator without a position."""


def report_healthy(fields: Fields) -> None:
    """Make the report one of an estimator with a position."""
    put(fields, "flags", HEALTHY_FLAGS)
    for name in VARIANCES:
        put(fields, name, min(float(fields[name]), HEALTHY_VARIANCE))


def report_lost(fields: Fields) -> None:
    """Make the report one of an estimator that has lost its position."""
    put(fields, "flags", LOST_FLAGS)
    for name in VARIANCES:
        put(fields, name, max(float(fields[name]), LOST_VARIANCE))
