"""Analysis: open what runs and pairs have left, compare it, draw it, export it.

What is exported here is public; the modules that it comes from are private and may change.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from skyrange.core.lazy_exports import export_lazily

if TYPE_CHECKING:
    from skyrange.codec.f3411 import decode as decode_remote_id
    from skyrange.codec.f3411 import faults as find_remote_id_faults
    from skyrange.codec.mavlink import decode as decode_mavlink
    from skyrange.codec.mavlink import message_name as name_mavlink
    from skyrange.record import RunRecord, load, replay_monitor
    from skyrange.study.agreement import Agreement
    from skyrange.study.agreement import agreement as compare_outcomes
    from skyrange.study.diff import Difference
    from skyrange.study.diff import diff as compare_runs
    from skyrange.study.export import Capture
    from skyrange.study.export import mavlink as export_mavlink
    from skyrange.study.export import remote_id as export_remote_id
    from skyrange.study.figures import altitude, plan_view, track_deviation, trajectories_3d
    from skyrange.study.overheard import overheard, receivers_of
    from skyrange.study.pairing import Pair, load_pair
    from skyrange.study.parity import Parity, compare_rates
    from skyrange.study.parity import compare as compare_autopilots
    from skyrange.study.receptions import hearings, who_heard_whom
    from skyrange.study.report import write_report
    from skyrange.study.spread import Interval
    from skyrange.study.summary import summary

__all__ = [
    "Agreement",
    "Capture",
    "Difference",
    "Interval",
    "Pair",
    "Parity",
    "RunRecord",
    "altitude",
    "compare_autopilots",
    "compare_outcomes",
    "compare_rates",
    "compare_runs",
    "decode_mavlink",
    "decode_remote_id",
    "export_mavlink",
    "export_remote_id",
    "find_remote_id_faults",
    "hearings",
    "load",
    "load_pair",
    "name_mavlink",
    "overheard",
    "plan_view",
    "receivers_of",
    "replay_monitor",
    "summary",
    "track_deviation",
    "trajectories_3d",
    "who_heard_whom",
    "write_report",
]

if not TYPE_CHECKING:
    __getattr__ = export_lazily(__name__)


def __dir__() -> list[str]:
    return sorted(__all__)
