"""Times of DRIP's messages: what an aircraft has to send at least, and the recommended schedule."""

from __future__ import annotations

from enum import StrEnum
from math import inf
from typing import Final, NamedTuple

from skyrange.codec.drip import RECOMMENDED_HASHES
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time

PAGE_NS: Final[Time] = 35 * NS_PER_MS
"""Time between two frames with authentication pages of one aircraft: three times the longest message, eleven pages,
takes 1.2 s."""


class Kind(StrEnum):
    """An authentication message by its content."""

    HDA_UA = "link: HDA on UA"
    MANIFEST = "manifest"
    WRAPPER = "wrapper"
    RAA_HDA = "link: RAA on HDA"
    APEX_RAA = "link: apex on RAA"


class Rates(NamedTuple):
    """Longest times between two messages of a kind, s; `inf` leaves a kind out."""

    hda_ua_s: float = 60.0
    evidence_s: float = 5.0
    """Of messages with something that was signed now: Manifests here."""
    raa_hda_s: float = 300.0
    apex_raa_s: float = 300.0


REQUIRED: Final = Rates()
"""The longest times that RFC 9575, section 6.3, allows."""
RECOMMENDED: Final = Rates(hda_ua_s=16.0, evidence_s=1.0, raa_hda_s=32.0, apex_raa_s=64.0)
"""About as often as in appendix B.2, without its order: a Manifest every second, a Link every 8 s."""


class Schedule:
    """What is due. It sends and signs nothing: `done` says that a message went out."""

    __slots__ = ("_due_ns", "_period_ns")

    def __init__(self, rates: Rates = REQUIRED, start_ns: Time = 0) -> None:
        periods_s = {
            Kind.HDA_UA: rates.hda_ua_s,
            Kind.MANIFEST: rates.evidence_s,
            Kind.RAA_HDA: rates.raa_hda_s,
            Kind.APEX_RAA: rates.apex_raa_s,
        }
        self._period_ns = {kind: round(each * NS_PER_S) for kind, each in periods_s.items() if each != inf}
        self._due_ns = dict.fromkeys(self._period_ns, start_ns)

    def due(self, next_ns: Time, pending: int) -> tuple[Kind, ...]:
        """Kinds whose longest time ends before `next_ns`, the next time at which they could be sent; the longest
        overdue first.

        A Manifest is due with any of the `pending` messages that none has covered yet, and early where these fill it.
        """
        ready = [
            (due_ns, order, kind)
            for order, (kind, due_ns) in enumerate(self._due_ns.items())
            if (due_ns < next_ns and (kind != Kind.MANIFEST or pending > 0))
            or (kind == Kind.MANIFEST and pending >= RECOMMENDED_HASHES)
        ]
        return tuple(kind for _, _, kind in sorted(ready))

    def done(self, kind: Kind, at_ns: Time) -> None:
        """A message of `kind` was sent."""
        if kind in self._due_ns:
            self._due_ns[kind] = at_ns + self._period_ns[kind]
