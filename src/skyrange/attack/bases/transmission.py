"""Bases of kinds that transmit: a radio of the attacker's own, what it sends, and when."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, ClassVar, Final

from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, Place
from skyrange.attack.declaration import Acting, Facts
from skyrange.attack.params import place_param
from skyrange.attack.radio import SERVICE_NS, down_link, transmitter, up_link
from skyrange.codec.remote_id import link_payload
from skyrange.codec.remote_id.link_payload import RidHeader, Transport
from skyrange.codec.remote_id.noise_request import CONTINUED, NoiseRequest, pack
from skyrange.contracts.mailboxes import Arrival, Inbox, Outbox
from skyrange.contracts.params import Enu, Number, Whole
from skyrange.contracts.plugins.form import param, state
from skyrange.core.errors import DecodeError
from skyrange.core.ids import FrameId, Port
from skyrange.core.time import NS_PER_MS, NS_PER_S, NS_PER_US, Time

SILENT_CDBM: Final = -20_000
"""Power of the sham of a jammer, −200 dBm: below the noise of every receiver."""
WifiChannel = Annotated[Whole, Field(ge=1, le=13)]
MAX_WAITING: Final = 100_000
"""Most payloads that wait to be sent later; the oldest are discarded."""
MISSED_BROADCASTS: Final = {
    "missed broadcasts": "simulated: power at each receiver against noise, interference and walls"
}
"""Realism of receptions under noise."""
_PLACE: Final = place_param("Position of the attacker's transmitter")


def radiated_power(*, default: float = 20.0, le: float = 50) -> Any:
    """The parameter `power_dbm`, at least −30 and at most `le` dBm."""
    return param("Radiated power (EIRP) in dBm.", default=default, ge=-30, le=le)


class RadioAgent(Acting):
    """Is an agent with a radio of its own. A kind with this base has the parameters `transmitter_m` and `power_dbm`."""

    attack_facts: ClassVar[Facts] = {
        "surface": ("medium",),
        "persists": "acts",
        "intrudes": True,
    }

    needs: ClassVar[tuple[str, ...]] = ("step", "next_wakeup")
    listens: ClassVar[bool] = False
    """Whether it gets the broadcasts that its radio decodes."""

    transmitter_m: Place | None
    power_dbm: float
    name: str
    """That of the agent: the endpoint of its radio."""
    up: Port
    """The end of the link to its radio."""
    ports: Sequence[Port]
    service_ns: Time = SERVICE_NS

    def build(self, context: AttackContext) -> Attack:
        """The agent with its radio."""
        return self.build_radio(context)

    def build_radio(self, context: AttackContext) -> Attack:
        """The agent, its radio and the links between them, by their names in a context."""
        self.name, self.up = context.radio, Port(context.radio, context.up)
        self.ports = [self.up, *([Port(context.radio, context.down)] if self.listens else [])]
        links = [up_link(context), *([down_link(context)] if self.listens else [])]
        assert self.transmitter_m is not None  # a kind without a default has found one in `prepare`
        radio = transmitter(context, self.transmitter_m, self.power_dbm, listens=self.listens)
        return Attack(agents=[self], links=links, radios=[radio])

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        """What it sends, after the broadcasts that it was handed."""
        raise NotImplementedError

    def next_wakeup(self) -> Time | None:
        """When it is to be stepped without a broadcast."""
        raise NotImplementedError


class Transmission(RadioAgent):
    """Transmits what `transmit` returns, when it is `due`; it hears nothing."""

    needs: ClassVar[tuple[str, ...]] = ("due", "transmit")

    @property
    def due(self) -> Time:
        """When the next payload is due."""
        raise NotImplementedError

    def transmit(self, now: Time) -> Iterable[bytes]:
        """The payloads for its radio that are due at `now`."""
        raise NotImplementedError

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        """Send the payloads that are due."""
        out = Outbox()
        for payload in self.transmit(now):
            out.send(self.up, payload)
        return out

    def next_wakeup(self) -> Time | None:
        """When the next payload is due."""
        return self.due


class Reception(RadioAgent):
    """Receives broadcasts, each of which `hear` gets, and sends because of them: at once, or what it keeps `waiting`.

    A kind with a plan of its own has `send_due` and `next_wakeup` instead.
    """

    needs: ClassVar[tuple[str, ...]] = ("hear",)
    listens: ClassVar[bool] = True

    transmitter_m: Enu = _PLACE
    power_dbm: Number = radiated_power()
    waiting: deque[tuple[Time, bytes, FrameId]] = state(partial(deque, maxlen=MAX_WAITING))
    """Payloads to be sent later, in the order of their times, each with the broadcast that caused it."""

    def hear(self, now: Time, arrival: Arrival, header: RidHeader, body: bytes, out: Outbox) -> None:
        """Learn from a broadcast that was received, and send at once what answers it."""
        raise NotImplementedError

    def send_due(self, now: Time, out: Outbox) -> None:
        """Send what is due at `now`."""
        while self.waiting and self.waiting[0][0] <= now:
            _, payload, cause = self.waiting.popleft()
            out.send(self.up, payload, (cause,))

    def next_wakeup(self) -> Time | None:
        """When the next waiting payload is due."""
        return self.waiting[0][0] if self.waiting else None

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        """Hear the broadcasts that arrived, and send what is due; ignore anything else that arrived."""
        out = Outbox()
        for arrival in inbox:
            try:
                header, body = link_payload.unpack(arrival.payload)
            except DecodeError:
                continue
            self.hear(now, arrival, header, body, out)
        self.send_due(now, out)
        return out


class Periodic(Transmission):
    """Transmits once in each period, from time 0 on; what it is too late for is left out."""

    needs: ClassVar[tuple[str, ...]] = ("send",)

    transmitter_m: Enu = _PLACE
    power_dbm: Number = radiated_power()
    period_ns: Time
    turn: int = 0
    """Number of the next period."""

    @property
    def due(self) -> Time:
        """When the next period begins."""
        return self.turn * self.period_ns

    def transmit(self, now: Time) -> Iterable[bytes]:
        """See `Transmission`."""
        if self.due > now:
            return ()
        number = now // self.period_ns
        self.turn = number + 1
        return self.send(now, number)

    def send(self, now: Time, number: int) -> Iterable[bytes]:
        """The payloads of a period."""
        raise NotImplementedError

    def left_us(self, now: Time) -> int:
        """Microseconds until the attack stops; 0 while it does not act."""
        return max(0, self.schedule.stop_ns - now) // NS_PER_US if now >= self.schedule.start_ns else 0


class WifiBeacons(Transmission):
    """Transmits Wi-Fi beacons at a constant rate while it acts: `beacon` has what is in them.

    A kind with this base has the parameter `rate_hz`. The program wakes on its service grid; the radio holds a beacon
    until the time in its header, one service time later.
    """

    attack_facts: ClassVar[Facts] = {
        "technique": "T0814",
        "counterfactual": "mute",
        "placement": "the same flood on another channel or at another place",
    }

    needs: ClassVar[tuple[str, ...]] = ("beacon",)

    transmitter_m: Enu = _PLACE
    power_dbm: Number = radiated_power()
    rate_hz: float
    channel: WifiChannel = param("Wi-Fi channel.", default=6)
    phase_ns: Time = 0
    """When the first beacon is due, so that radios do not begin together."""
    turn: int = 0

    @property
    def due(self) -> Time:
        """When the next beacon is due."""
        return round(self.turn * NS_PER_S / self.rate_hz) + self.phase_ns

    def transmit(self, now: Time) -> Sequence[bytes]:
        """See `Transmission`."""
        payloads = []
        while (due := self.due) <= now:
            if self.schedule.start_ns <= now < self.schedule.stop_ns:
                address, body = self.beacon(now)
                header = RidHeader(
                    Transport.WIFI_BEACON, channel=self.channel, counter=self.turn & 0xFF, address=address,
                    time_ns=due + SERVICE_NS,
                )  # fmt: skip
                payloads.append(link_payload.pack(header, body))
            self.turn += 1
        return payloads

    def beacon(self, now: Time) -> tuple[bytes, bytes]:
        """Sender address and body of the next one."""
        raise NotImplementedError


def join(parts: Iterable[Attack]) -> Attack:
    """The agents of several attacks, with their links and radios, as one."""
    made = list(parts)
    return Attack(
        agents=[agent for part in made for agent in part.agents],
        links=[link for part in made for link in part.links],
        radios=[radio for part in made for radio in part.radios],
    )


@dataclass(frozen=True, slots=True)
class Noise:
    """Bursts of noise: one in each period, on the next of the centres each time."""

    centres_mhz: Sequence[float]
    bandwidth_mhz: float
    period_ms: float
    duty: float = 1.0
    """Share of the period that a burst takes."""


class OrdersNoise(RadioAgent):
    """Has its radio transmit noise, of which the sham orders as much at −200 dBm."""

    attack_facts: ClassVar[Facts] = {
        "counterfactual": "mute",
        "intrudes": False,  # nothing receives noise of -200 dBm
        "load": "none, because the noise is the attack; the sham has the same orders at −200 dBm",
        "content": "none, because noise has no content",
    }

    power_dbm: Number = radiated_power(default=30.0, le=60)

    @property
    def noise_cdbm(self) -> int:
        """Power of the noise, or of the sham's, in 0.01 dBm."""
        return SILENT_CDBM if self.sham else round(self.power_dbm * 100)


class Jamming(OrdersNoise, Periodic):
    """Transmits the bursts of `noise` while it acts; a burst ends when the attack stops.

    The sham transmits the same bursts with −200 dBm.
    """

    attack_facts: ClassVar[Facts] = {
        "technique": "T0814",
        "position": "within some hundred metres of the receivers, by power and walls",
        "load": "none, because the noise is the attack; the sham has the same bursts at −200 dBm",
        "realism": MISSED_BROADCASTS,
    }

    needs: ClassVar[tuple[str, ...]] = ("noise",)

    centres_khz: Sequence[int]
    burst: NoiseRequest
    """A burst of whole length; its centre is replaced."""
    continuous: bool
    """Whether each burst lasts until the next one in the same band."""

    def noise(self) -> Noise:
        """The bursts."""
        raise NotImplementedError

    def assemble(self, context: AttackContext) -> Any:
        """See `Acting`."""
        self.sham, noise = context.sham, self.noise()
        self.period_ns = round(noise.period_ms * NS_PER_MS)
        self.centres_khz = [round(centre * 1000) for centre in noise.centres_mhz]
        length_us = max(1, round(self.period_ns * noise.duty) // NS_PER_US)
        self.burst = NoiseRequest(self.noise_cdbm, 0, round(noise.bandwidth_mhz * 1000), length_us)
        self.continuous = noise.duty == 1.0 and len(self.centres_khz) == 1
        return super().assemble(context)

    def send(self, now: Time, number: int) -> Iterable[bytes]:
        """The burst of a period, if the attack acts."""
        left_us = self.left_us(now)
        if not left_us:
            return ()
        length_us = min(self.burst.duration_us, left_us)
        order = self.burst._replace(
            centre_khz=self.centres_khz[number % len(self.centres_khz)], duration_us=length_us, time_ns=now,
            turnaround_us=CONTINUED if self.continuous and left_us > length_us else 0,
        )  # fmt: skip
        return (pack(order),)
