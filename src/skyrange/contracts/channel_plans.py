"""Channel plans of Wi-Fi control links: what each end of a link knows, and the orders by which it changes channel.

A defence contributes policies, one for each access point and one for each aircraft. A policy sees the reports of its
own end only. The kernel passes its orders to the links if the defence takes effect, and discards them if it is muted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

from skyrange.contracts.alerts import Alert
from skyrange.contracts.links import VariableChannel
from skyrange.contracts.mailboxes import ChannelOrder
from skyrange.core.time import Time


class FrameOutcome(NamedTuple):
    """What one end knows of a frame that it sent, or that the other end sent to it."""

    at: Time
    """When it knew."""
    own: bool
    """Whether it sent the frame; else it received it, or would have."""
    ok: bool
    """Of an own frame: whether it was acknowledged. Of another: whether it was decoded."""
    failures: int
    """Of another's frame: how many transmissions failed their check although their preamble was received with the SNIR
    that their rate needs; 0 for an own frame."""


class EndReport(NamedTuple):
    """What one end of a link knows at an instant."""

    link: str
    channel: int
    """The channel of its own radio."""
    associated: bool
    snr_db: float
    """Power of the last frame whose preamble was decoded, less the thermal noise of its own receiver; −inf before."""
    outcomes: Sequence[FrameOutcome]
    """Those known since the last report, in order of time. An own frame that was not acknowledged is left out if the
    other end was not received with the SNIR that the frame's rate needs: distance explains its loss."""


class ChannelPolicy(Protocol):
    """Decides on the channel of one radio. Deep-copyable."""

    def step(self, now: Time, reports: Sequence[EndReport]) -> Sequence[ChannelOrder | Alert]:
        """Decide every 20 ms; `reports` has one entry for each link of the radio, in order of their names."""
        ...


@dataclass(frozen=True, slots=True)
class ChannelPlan:
    """The policies of both ends of some links that share one access point, or of one."""

    links: Sequence[str]
    """Their names. A plan has all links of its access point."""
    make_station: Callable[[Sequence[str]], ChannelPolicy]
    """Called with the names of the links."""
    make_aircraft: Callable[[str], ChannelPolicy]
    """Called with the name of each."""


@runtime_checkable
class TunableChannel(VariableChannel, Protocol):
    """A variable channel whose ends can change their radio channel."""

    def retune(self, order: ChannelOrder) -> None:
        """Take an order, which is carried out at the next update of the channel's conditions."""
        ...
