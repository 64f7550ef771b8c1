"""Does my plugin keep skyrange's contracts? Checks for agents, taps, monitors, autopilot engines, approvals, attacks
and media.

Each `check_…` makes fresh components, drives them alone as a kernel would, and raises `NonConformance`
at the first rule that is broken. `python -m skyrange.testing` prints the rules.
"""

from __future__ import annotations

from skyrange.testing.agents import check_agent
from skyrange.testing.approvals import check_approval
from skyrange.testing.attacks import check_attack
from skyrange.testing.engines import check_engine
from skyrange.testing.mail import Letter, Postbag
from skyrange.testing.media import check_medium
from skyrange.testing.monitors import check_monitor
from skyrange.testing.rules import NonConformance
from skyrange.testing.taps import check_tap

__all__ = [
    "Letter",
    "NonConformance",
    "Postbag",
    "check_agent",
    "check_approval",
    "check_attack",
    "check_engine",
    "check_medium",
    "check_monitor",
    "check_tap",
]
