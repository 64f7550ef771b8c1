"""Mechanism families of attack kinds: kinds that act by the same mechanism are held out of training together."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from skyrange.core.errors import InputError, nearest

FAMILIES: Final[dict[str, tuple[str, ...]]] = {
    "gnss_false_position": (
        "gnss.capture", "gnss.drift", "gnss.jump", "gnss.meacon", "gnss.pull_off", "gnss.time",
    ),
    "gnss_denial": ("gnss.jam",),
    "inertial_sensor": ("sensor.accelerometer", "sensor.barometer", "sensor.bus", "sensor.compass", "sensor.gyro"),
    "light_injection": ("depth.project", "lidar.relay"),
    "light_denial": ("lidar.blind", "lidar.remove"),
    "command_injection": (
        "mavlink.command", "mavlink.guided", "mavlink.home", "mavlink.mode", "mavlink.rc_override",
        "signing.setup_key", "signing.stolen_key", "companion.takeover", "ground.insider",
    ),
    "configuration_change": (
        "mavlink.fence", "mavlink.mission_alter", "mavlink.mission_clear", "mavlink.mission_replace",
        "mavlink.parameter", "mavlink.file_write", "ground.geo_zones", "ground.plan_file",
    ),
    "malformed_input": ("mavlink.malformed",),
    "data_access": ("link.eavesdrop", "mavlink.exfiltrate", "mavlink.file_read"),
    "false_telemetry": (
        "telemetry.attitude", "telemetry.battery", "telemetry.false_alarm", "telemetry.hide_failures", "telemetry.home",
        "telemetry.mode", "telemetry.position", "time.system_time",
    ),
    "identity": ("identity.keep_alive", "identity.second_vehicle", "identity.silence_station"),
    "replay": ("link.duplicate", "link.replay", "signing.replay"),
    "link_timing": ("link.delay", "link.reorder", "link.throttle"),
    "link_denial": (
        "link.break", "link.corrupt", "link.drop", "link.flood", "control_link.deauthenticate",
        "control_link.reactive_jam",
    ),
    "remote_id_forgery": ("remote_id.replay", "remote_id.signed_ghost", "remote_id.spoof"),
    "remote_id_denial": (
        "remote_id.flood", "remote_id.jam", "remote_id.suppress_pages", "remote_id.sweep_jam",
        "remote_id.verification_flood",
    ),
    "avoidance_logic": ("companion.false_avoidance", "companion.no_avoidance"),
    "approval_forgery": (
        "approval.equivocate", "approval.false_contingency", "approval.false_details", "approval.forged_decision",
        "approval.poisoned_constraint", "approval.squat", "approval.stolen_token",
    ),
    "approval_denial": ("approval.eclipse", "approval.slow_gossip", "approval.suppress_notifications"),
    "campaign": ("campaign",),
}  # fmt: skip
"""By family, its kinds. Each shipped kind is in exactly one."""

TIMING_KINDS: Final = frozenset(
    {
        "link.break", "link.delay", "link.drop", "link.duplicate", "link.flood", "link.reorder", "link.replay",
        "link.throttle", "control_link.deauthenticate", "control_link.reactive_jam", "identity.silence_station",
        "remote_id.flood", "remote_id.jam", "remote_id.sweep_jam", "remote_id.suppress_pages",
        "remote_id.verification_flood", "approval.eclipse", "approval.slow_gossip", "approval.suppress_notifications",
    }
)  # fmt: skip
"""Kinds that are changes of timing or load: the audit exempts them from comparisons of timing with their shams."""

_FAMILY_OF: Final = {kind: family for family, kinds in FAMILIES.items() for kind in kinds}


def find_family(attack: Mapping[str, Any]) -> str | None:
    """The family of an attack, a row of a run's manifest: that of a shipped kind, or the one that the kind declares."""
    return _FAMILY_OF.get(str(attack["kind"])) or attack.get("family")


def family_of(attack: Mapping[str, Any]) -> str:
    """As `find_family`. Raises `InputError` for a kind without a family: a guess could put one mechanism on both sides
    of a split.
    """
    family = find_family(attack)
    if family is None:
        kind = str(attack["kind"])
        expected = "an attack kind with a mechanism family"
        hint = nearest(kind, _FAMILY_OF) or 'Declare family="…" in the kind\'s decorator, and fly the runs again.'
        raise InputError.one("dataset", "attack kind", kind, expected, hint)
    return family
