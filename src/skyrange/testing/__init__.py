"""Conformance checks for plugin authors: of agents, taps, engines, approvals, attacks, faults, defences and more.

Each `check_…` makes fresh components, drives them alone as a kernel would, and raises `NonConformance`
at the first rule that is broken. `python -m skyrange.testing` prints the rules.

What is exported here is public; the modules below are private and may change.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from skyrange.core.lazy_exports import export_lazily

if TYPE_CHECKING:
    from skyrange.testing.checks.agents import check_agent
    from skyrange.testing.checks.approval_services import check_approval
    from skyrange.testing.checks.attacks import check_attack, check_fault
    from skyrange.testing.checks.avoidance import check_avoidance
    from skyrange.testing.checks.defences import check_defence
    from skyrange.testing.checks.engines import check_engine
    from skyrange.testing.checks.media import check_medium
    from skyrange.testing.checks.monitors import check_monitor
    from skyrange.testing.checks.taps import check_tap
    from skyrange.testing.drivers.messages import InputMessage, MessageRecorder
    from skyrange.testing.rules import NonConformance

__all__ = [
    "InputMessage",
    "MessageRecorder",
    "NonConformance",
    "check_agent",
    "check_approval",
    "check_attack",
    "check_avoidance",
    "check_defence",
    "check_engine",
    "check_fault",
    "check_medium",
    "check_monitor",
    "check_tap",
]

if not TYPE_CHECKING:
    __getattr__ = export_lazily(
        __name__,
        {
            "skyrange.testing.checks.agents": "check_agent",
            "skyrange.testing.checks.approval_services": "check_approval",
            "skyrange.testing.checks.attacks": "check_attack check_fault",
            "skyrange.testing.checks.avoidance": "check_avoidance",
            "skyrange.testing.checks.defences": "check_defence",
            "skyrange.testing.checks.engines": "check_engine",
            "skyrange.testing.checks.media": "check_medium",
            "skyrange.testing.checks.monitors": "check_monitor",
            "skyrange.testing.checks.taps": "check_tap",
            "skyrange.testing.drivers.messages": "InputMessage MessageRecorder",
            "skyrange.testing.rules": "NonConformance",
        },
    )


def __dir__() -> list[str]:
    return sorted(__all__)
