"""Bases of kinds with taps on links: they act on frames in transit, or put frames of their own on links in rounds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from heapq import heappop, heappush
from typing import Annotated, Any, ClassVar, Final, Literal, cast

import numpy as np
from pydantic import Field

from skyrange.attack.bases.shams import benign_payload
from skyrange.attack.contract import Attack, AttackContext, Place
from skyrange.attack.declaration import Acting, Facts
from skyrange.attack.tapped_links import (
    CONTROL_LINKS,
    EVERY_LINK,
    MESSAGE_NUMBERS,
    Messages,
    Names,
    Repetition,
    ends_of,
    place_taps,
)
from skyrange.codec.mavlink import message_id
from skyrange.contracts.components import Floats
from skyrange.contracts.frames import Frame, FrameBlock
from skyrange.contracts.links import NetworkPlace, RadioSite, TapPlacement
from skyrange.contracts.plugins.form import param, state
from skyrange.contracts.verdicts import Direction, Inject, Verdict, Verdicts
from skyrange.core.chance import Chance
from skyrange.core.errors import InputError, nearest
from skyrange.core.ids import FrameId, hash64
from skyrange.core.time import NEVER, Time, from_seconds

MAX_INJECTS: Final = 64
"""Frames that a tap puts on its link at one time."""


@dataclass(slots=True)
class WaitingFrames:
    """Frames by the times at which they are due; those of one time in the order in which they were added."""

    most: int = 0
    """Frames that wait at most: the earliest are discarded. 0 is any number."""
    heap: list[tuple[Time, int, Inject]] = field(default_factory=list)
    """When a frame is due, its number, and the frame."""
    added: int = 0
    woken_ns: Time = -NEVER

    def add(self, due: Time, frame: Inject) -> None:
        """Put a frame on the link at `due`."""
        heappush(self.heap, (due, self.added, frame))
        self.added += 1
        if 0 < self.most < len(self.heap):
            heappop(self.heap)

    def discard_before(self, oldest: Time) -> None:
        """Discard the frames that were due before `oldest`."""
        while self.heap and self.heap[0][0] < oldest:
            heappop(self.heap)

    def next_due(self) -> Time | None:
        """When the tap has to be woken: never, if nothing waits."""
        return max(self.heap[0][0], self.woken_ns + 1) if self.heap else None

    def take(self, now: Time, again_ns: Time = 0) -> list[Inject]:
        """The frames that are due, at most `MAX_INJECTS`; with `again_ns`, each of them waits again for so long."""
        self.woken_ns = now
        taken: list[Inject] = []
        while self.heap and self.heap[0][0] <= now and len(taken) < MAX_INJECTS:
            due, _, frame = heappop(self.heap)
            taken.append(frame)
            if again_ns:
                self.add(due + again_ns, frame)
        return taken


_BLOCK_BITS: Final = 16
"""Bits of an address of chance that number the draws for one frame: a frame takes fewer than 2**16."""
_STREAM: Final = "attack.link"
LinkNames = Annotated[Names, Field(min_length=1)]
"""Names or patterns of links, one or more, each once."""


PathPlace = Literal["network", "onboard"]
"""Where what holds or alters frames may be on a control link: no radio beside it can."""


def on_path_place() -> Any:
    """The parameter `place` of a kind that holds or alters frames on control links."""
    return param(
        "Where it is on gcs links. network: in the operator's network, before the channel for frames towards the "
        "aircraft and after it for telemetry; onboard: in the companion, the other way round. Default: network for "
        "links over the air, else onboard.",
        default=None,
    )


@dataclass(frozen=True, slots=True)
class CopyForLink:
    """Makes the tap of a link: a copy of an instance."""

    prototype: LinkTap

    def __call__(self, link: str) -> LinkTap:
        """The tap of a link."""
        made = self.prototype.copy()
        made.link = link
        made.begin()
        return made


class LinkTap(Acting):
    """Has a tap on each of its links, a copy of its own: what passes is shown to `on_frame`.

    A kind with this base builds its parts from `place`.
    """

    needs: ClassVar[tuple[str, ...]] = ("on_frame",)
    shares: ClassVar[tuple[str, ...]] = ("chance",)

    link: str
    """Of a tap: the name of its link."""
    chance: Chance
    place: NetworkPlace | Literal[""] | None = ""
    """Where its taps are on control links: a parameter of attacks that have a choice."""
    radio_m: Place | None = None
    """This and the next two are parameters of attacks that may have a radio (`InAir`)."""
    power_dbm: float = 0.0
    has_key: bool = False

    def assemble(self, context: AttackContext) -> Any:
        """See `Acting`."""
        self.chance = context.chance
        return super().assemble(context)

    def make_taps(self, patterns: Sequence[str], context: AttackContext) -> list[TapPlacement]:
        """A tap on each link that matches, at its place.

        Raises `InputError` for a pattern without a link, and for a place that a link does not have.
        """
        return place_taps(patterns, context, CopyForLink(self), self.place, self.find_site(context))

    def find_site(self, context: AttackContext) -> RadioSite | None:
        """Its radio: none, unless the kind may be in the air (`InAir`)."""
        return None

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Decide on a frame that passes, in either direction."""
        raise NotImplementedError

    def begin(self) -> None:
        """Set what depends on the link; called once for each tap."""

    def next_wakeup(self) -> Time | None:
        """When it acts without a frame: never, unless a kind does."""
        return None

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        """What it does without a frame."""
        return ()

    def draw(self, frame: Frame, block: int = 0) -> tuple[float, float, float, float]:
        """Four uniforms in [0, 1) for a frame, by attack, link, direction, sender and serial; a `block` has others."""
        who = self._address(frame.link, frame.direction, frame.sender)
        return self.chance.uniform4(_STREAM, who, frame.sent_ns, frame.serial << _BLOCK_BITS | block)

    def draws(self, frames: FrameBlock) -> Floats:
        """(n, 4) What `draw` returns for each row of a block."""
        numbers, places = np.unique(frames.link_numbers, return_inverse=True)
        names = [frames.link_table.names[number] for number in numbers.tolist()]
        who = np.array([self._address(name.link, name.direction, name.src) for name in names], dtype=np.uint64)
        serials = frames.serial.astype(np.uint64) << np.uint64(_BLOCK_BITS)
        return self.chance.uniforms(_STREAM, who[places], np.full(len(frames), frames.sent_ns), serials)

    def _address(self, link: str, direction: str, sender: str) -> int:
        return hash64(f"{self.id}|{link}|{direction}|{sender}")


class OnLinks(LinkTap):
    """Acts on the frames of links while it acts, in one direction or in both: `act` answers each of them.

    What is in `waiting_frames` is put on the link when it is due.
    """

    attack_facts: ClassVar[Facts] = {
        "surface": EVERY_LINK,
        "persists": "acts",
        "position": "on the path, such as a router between ground station and aircraft",
        "equipment": "a computer that forwards the frames",
        "budget": "no frames of its own",
        "load": "none, because it adds no load",
    }

    needs: ClassVar[tuple[str, ...]] = ("act",)

    links: LinkNames = param("Links by name or pattern, such as ['gcs:blue/b1'] or ['gcs:*'].")
    direction: Literal["fwd", "rev", "both"] = param(
        "fwd: towards the aircraft on gcs, log and autopilot; rev: from it.", default="both"
    )
    numbers: frozenset[int] = frozenset()
    """Ids of the messages that it acts on; empty for all frames."""
    waiting_frames: WaitingFrames = state(WaitingFrames)
    delayed_until: dict[tuple[str, str], Time] = state(dict)
    """By link and direction: until when the last of the frames is held that are delayed in their order."""

    def build(self, context: AttackContext) -> Attack:
        """A tap on each link. Raises `InputError` for links that the scenario does not have."""
        return Attack(taps=self.make_taps(self.links, context))

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Act on the frame if it is selected and the attack acts."""
        schedule = self.schedule
        if schedule.start_ns <= now < schedule.stop_ns and self.selects(frame):
            return self.act(now, frame)
        return ()

    def selects(self, frame: Frame) -> bool:
        """Whether it acts on such a frame."""
        if self.direction not in ("both", frame.direction):
            return False
        return not self.numbers or message_id(frame.payload) in self.numbers

    def act(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """The verdicts on a selected frame; none lets it pass."""
        raise NotImplementedError

    def copy_of(self, frame: Frame) -> Inject:
        """A frame again, for its own link; that of a sham is a benign frame of the same length."""
        payload = benign_payload(frame.payload) if self.sham else frame.payload
        return Inject(payload, cast("Direction", frame.direction), frame.src, frame.dst, frame.id)

    def next_wakeup(self) -> Time | None:
        """When the next frame that waits is due."""
        return self.waiting_frames.next_due()

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        """Put on the link what is due."""
        return self.waiting_frames.take(now)


class OnPath(OnLinks):
    """Acts on selected messages on the path, such as a router between ground station and aircraft does."""

    place: PathPlace | None = on_path_place()
    messages: Messages = param("MAVLink messages to act on, such as ['COMMAND_LONG']; default: all frames.", default=())

    def assemble(self, context: AttackContext) -> Any:
        """See `Acting`."""
        self.numbers = frozenset(MESSAGE_NUMBERS[name] for name in self.messages)
        return super().assemble(context)


class RoundsOnLink(LinkTap):
    """Puts frames on its links when it begins to act, and then every `every_s`: `send` makes those of a round.

    Frames that pass are let pass, unless a kind defines `on_frame`.
    """

    needs: ClassVar[tuple[str, ...]] = ()

    every_s: float = 0.0
    """Time between two rounds, in seconds: a parameter of the kind, or set in `prepare`; 0 for no rounds."""
    times: int = 0
    """Most rounds, 0 for any number: a parameter of some kinds."""
    way: Direction = "fwd"
    """The direction of its frames."""
    ends: tuple[str, str]
    """Claimed source and destination of its frames."""
    clock: Repetition
    """When it sends; `clock.done` numbers the rounds from 1."""

    def begin(self) -> None:
        """See `LinkTap`."""
        period_ns = self.period_ns()
        self.ends = ends_of(self.link, self.way)
        self.clock = Repetition(self.schedule, period_ns, self.times, due=0 if period_ns else None)

    def period_ns(self) -> Time:
        """Time between two rounds; 0 for no rounds."""
        return from_seconds(self.every_s)

    def marks(self) -> dict[str, Place]:
        """Places to mark on a map, by label."""
        return {}

    def on_frame(self, now: Time, frame: Frame) -> Verdicts:
        """Let it pass."""
        return ()

    def next_wakeup(self) -> Time | None:
        """When the next round is due."""
        return self.clock.due

    def on_wakeup(self, now: Time) -> Verdicts:
        """Send a round, if it is due."""
        return self.send(now) if self.clock.take(now) else ()

    def send(self, now: Time) -> Verdicts:
        """The frames of a round."""
        return ()

    def inject(self, payload: bytes, parent: FrameId | None = None) -> Inject:
        """A frame of its own; `parent` is the frame that it replays, if any."""
        return Inject(payload, self.way, *self.ends, parent)


class OnControlLinks(RoundsOnLink):
    """Has a tap on each control link that the parameters name: it filters what passes, or sends in rounds, or both."""

    attack_facts: ClassVar[Facts] = {
        "surface": CONTROL_LINKS,
        "persists": "acts",
        "position": "on the path between ground station and aircraft",
    }

    place: PathPlace | None = on_path_place()
    links: LinkNames = param("Links gcs, log or autopilot by name or pattern, such as ['gcs:blue/b1'].")

    def build(self, context: AttackContext) -> Attack:
        """A tap on each link. Raises `InputError` for links that the scenario does not have, or of another role."""
        return Attack(taps=self.make_taps(find_links(self.links, context, CONTROL_LINKS), context), shown=self.marks())


def find_links(patterns: Sequence[str], context: AttackContext, roles: Sequence[str]) -> list[str]:
    """The links that match, each once.

    Raises `InputError` for a pattern without a link, and for a link of another role than `roles`.
    """
    chosen = []
    for place, pattern in enumerate(patterns):
        matching = [name for name in context.links if fnmatchcase(name, pattern)]
        others = [name for name in matching if name.partition(":")[0] not in roles]
        if not matching or others:
            usable = [name for name in context.links if name.partition(":")[0] in roles]
            expected = f"a link of the scenario: {', '.join(roles)}"
            raise InputError.one(
                context.id,
                f"links.{place}",
                others[0] if others else pattern,
                expected,
                nearest(pattern, usable),
            )
        chosen += matching
    return list(dict.fromkeys(chosen))
