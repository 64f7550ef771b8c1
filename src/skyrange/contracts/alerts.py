"""Alerts: what detectors and defences report, their details, and what is wrong with one that breaks its contract."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from skyrange.core.time import Time

Scalar = str | int | float | bool | None


class Alert(NamedTuple):
    """What a monitor reports."""

    at: Time
    """The moment that it is about, not after the service time at which it is raised."""
    subject: str
    """The subject: a vehicle, an operator, an endpoint or a link."""
    kind: str
    """What was found: lower-case words, dotted, such as `heartbeat.gap`."""
    score: float
    """How strong the evidence is, finite; what 1 means is for the detector to say."""
    data: Mapping[str, Scalar] = {}
    """Details: scalars by name."""


def find_problem(now: Time, alert: object) -> str:
    """What is wrong with an alert raised at `now`, as the end of a sentence that begins with its detector; or ""."""
    if not isinstance(alert, Alert):
        return f"raised {alert!r:.160}; an Alert was expected"
    for name, text in (("subject", alert.subject), ("kind", alert.kind)):
        if not isinstance(text, str) or not text:
            return f"raised an alert with the {name} {text!r:.160}; text was expected"
    if isinstance(alert.at, bool) or not isinstance(alert.at, int) or alert.at > now:
        return f"raised {alert.kind} at {now} about {alert.at!r:.160}; a whole number of ns, not later, was expected"
    if not isinstance(alert.score, (int, float)) or not math.isfinite(alert.score):
        return f"raised {alert.kind} with the score {alert.score!r:.160}; a finite number was expected"
    if not isinstance(alert.data, Mapping):
        return f"raised {alert.kind} with the data {alert.data!r:.160}; a mapping was expected"
    return ""
