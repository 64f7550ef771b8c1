"""An aircraft with DRIP signatures and an observer of it, second by second."""

from __future__ import annotations

from skyrange.codec.drip import session_id
from skyrange.codec.f3411 import BasicId, IdType, Location, encode
from skyrange.core.time import NS_PER_S
from skyrange.remoteid.drip.registry import Registration, Registry
from skyrange.remoteid.drip.sender import (
    REQUIRED,
    Kind,
    Rates,
    Sender,
)
from skyrange.remoteid.drip.verification.observer import Observer
from skyrange.remoteid.drip.verification.verdicts import Judged, Policy, Trust, Verified

T0 = 220_000_000.0
REGISTRY = Registry.of_seed(7, int(T0) - 10, int(T0) + 86_400)
OWN, OTHER = 0xC0FFEE, 0xBAD


def location(step: int, east: float = 0.0) -> bytes:
    return encode(Location(2, 47.0 + step * 1e-5, 8.0 + east, 100.0, speed_mps=5.0, timestamp_s=step / 10))


def identity(tag: bytes) -> bytes:
    return encode(BasicId(IdType.SPECIFIC_SESSION, 2, session_id(tag)))


class Air:
    """One aircraft at 1 Hz that sends what is due, and an observer; frames can be lost or added."""

    def __init__(
        self, registration: Registration | None = None, *, rates: Rates = REQUIRED, policy: Policy | None = None,
        observer: Observer | None = None,
    ) -> None:  # fmt: skip
        self.registration = registration or REGISTRY.register("alpha")
        self.tag = self.registration.identity.tag
        self.sender = Sender(self.registration, legacy=True, rates=rates, start_ns=round(T0 * NS_PER_S))
        self.observer = observer or Observer(REGISTRY.anchors, policy or Policy())
        self.counter = 0
        self.sent: list[tuple[float, int, bytes]] = []
        self.verified: list[Verified] = []

    def second(self, step: int, *, lose: frozenset[Kind] = frozenset(), address: int = OWN) -> None:
        now_s = T0 + step
        for body in (identity(self.tag), location(step)):
            self.sender.sent(body)
            self.frame(body, now_s, address)
        for kind in self.sender.due(round((now_s + 1.5) * NS_PER_S)):
            pages = self.sender.make(kind, now_s + 0.5)
            if kind not in lose:
                self.counter = (self.counter + 1) % 256
                for page in pages:
                    self.frame(encode(page), now_s + 0.6, address, self.counter)

    def frame(self, body: bytes, now_s: float, address: int = OWN, counter: int = 0) -> Judged:
        self.sent.append((now_s, counter, body))
        judged = self.observer.receive(address, counter, body, now_s)
        self.verified += judged.verified
        return judged

    def state(self, step: float, address: int = OWN) -> Trust:
        track = self.observer.track(address, T0 + step)
        assert track is not None
        return track.state
