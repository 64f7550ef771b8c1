"""Bases of kinds that act on frames in transit: a tap on each link that the parameters name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Final, Literal, cast

import numpy as np
from pydantic import Field

from skyrange.attack.bases.shams import benign_payload
from skyrange.attack.bases.waiting_frames import WaitingFrames
from skyrange.attack.contract import Attack, AttackContext, Place
from skyrange.attack.declaration import Acting, Facts
from skyrange.attack.tapped_links import EVERY_LINK, MESSAGE_NUMBERS, Messages, Names, place_taps
from skyrange.codec.mavlink import message_id
from skyrange.contracts.components import Floats
from skyrange.contracts.frames import Frame, FrameBlock
from skyrange.contracts.links import NetworkPlace, RadioSite, TapPlacement
from skyrange.contracts.plugins.form import param, state
from skyrange.contracts.verdicts import Direction, Inject, Verdict
from skyrange.core.chance import Chance
from skyrange.core.ids import hash64
from skyrange.core.time import Time

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
