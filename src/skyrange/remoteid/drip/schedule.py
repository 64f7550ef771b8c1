"""Times of DRIP's messages: what an aircraft has to send at least, and the recommended schedule."""

from __future__ import annotations

from enum import StrEnum
from typing import Final, NamedTuple

from skyrange.codec.drip import RECOMMENDED_HASHES
from skyrange.core.time import NS_PER_MS, Time

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

    __slots__ = ("_due_s", "rates")

    def __init__(self, rates: Rates = REQUIRED, start_s: float = 0.0) -> None:
        self.rates = rates
        self._due_s = {
            kind: start_s
            for kind, period_s in (
                (Kind.HDA_UA, rates.hda_ua_s), (Kind.MANIFEST, rates.evidence_s), (Kind.RAA_HDA, rates.raa_hda_s),
                (Kind.APEX_RAA, rates.apex_raa_s),
            )
            if period_s != float("inf")
        }  # fmt: skip

    def due(self, now_s: float, pending: int) -> tuple[Kind, ...]:
        """Kinds whose time has come, the longest overdue first.

        A Manifest is due with any of the `pending` messages that none has covered yet, and early where these fill it.
        """
        ready = [
            (due_s, order, kind)
            for order, (kind, due_s) in enumerate(self._due_s.items())
            if (due_s <= now_s and (kind != Kind.MANIFEST or pending > 0))
            or (kind == Kind.MANIFEST and pending >= RECOMMENDED_HASHES)
        ]
        return tuple(kind for _, _, kind in sorted(ready))

    def done(self, kind: Kind, now_s: float) -> None:
        """A message of `kind` was sent."""
        if kind in self._due_s:
            self._due_s[kind] = now_s + self._period_s(kind)

    def _period_s(self, kind: Kind) -> float:
        rates = self.rates
        if kind == Kind.HDA_UA:
            return rates.hda_ua_s
        if kind == Kind.RAA_HDA:
            return rates.raa_hda_s
        return rates.apex_raa_s if kind == Kind.APEX_RAA else rates.evidence_s
