"""Bases of kinds that act on frames in transit: a tap on each link that the parameters name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Final, Literal, cast

from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext
from skyrange.attack.declaration import Acting, Facts
from skyrange.attack.tapped_links import EVERY_LINK, MESSAGE_NUMBERS, Messages, Names, place_taps
from skyrange.codec.mavlink import message_id
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.links import TapPlacement
from skyrange.contracts.plugins.fields import param
from skyrange.contracts.verdicts import Direction, Inject, Verdict
from skyrange.core.chance import Chance
from skyrange.core.ids import hash64
from skyrange.core.time import Time

MAX_INJECTS: Final = 64
"""Frames that a tap puts on its link at one time."""
_BLOCK_BITS: Final = 16
"""Bits of an address of chance that number the draws for one frame: a frame takes fewer than 2**16."""
_STREAM: Final = "attack.link"
LinkNames = Annotated[Names, Field(min_length=1)]
"""Names or patterns of links, one or more, each once."""


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

    def assemble(self, context: AttackContext) -> Any:
        """See `Acting`."""
        self.chance = context.chance
        return super().assemble(context)

    def place(self, patterns: Sequence[str], context: AttackContext) -> list[TapPlacement]:
        """A tap on each link that matches. Raises `InputError` for a pattern without a link."""
        return place_taps(patterns, context, CopyForLink(self))

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
        who = hash64(f"{self.id}|{frame.link}|{frame.direction}|{frame.sender}")
        return self.chance.uniform4(_STREAM, who, frame.sent_ns, frame.serial << _BLOCK_BITS | block)


class OnLinks(LinkTap):
    """Acts on the frames of links while it acts, in one direction or in both: `act` answers each of them."""

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

    def build(self, context: AttackContext) -> Attack:
        """A tap on each link. Raises `InputError` for links that the scenario does not have."""
        return Attack(taps=self.place(self.links, context))

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


class OnPath(OnLinks):
    """Acts on selected messages on the path, such as a router between ground station and aircraft does."""

    messages: Messages = param("MAVLink messages to act on, such as ['COMMAND_LONG']; default: all frames.", default=())

    def assemble(self, context: AttackContext) -> Any:
        """See `Acting`."""
        self.numbers = frozenset(MESSAGE_NUMBERS[name] for name in self.messages)
        return super().assemble(context)


def inject_again(frame: Frame, payload: bytes) -> Inject:
    """A copy of a frame on its own link, with `payload`."""
    return Inject(payload, cast("Direction", frame.direction), frame.src, frame.dst, frame.id)
