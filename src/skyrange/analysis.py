"""Analysis: open what runs and pairs have left, compare it, draw it, export it.

What is exported here is public; the modules that it comes from are private and may change.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from skyrange.core.lazy_exports import export_lazily

if TYPE_CHECKING:
    from skyrange.codec.f3411 import decode as decode_remote_id
    from skyrange.codec.f3411.conformance import deviations as find_remote_id_deviations
    from skyrange.codec.mavlink import decode_anew as decode_mavlink
    from skyrange.codec.mavlink import message_name as name_mavlink
    from skyrange.record import RunRecord, load, replay_monitor
    from skyrange.study.captures.packet_captures import Capture
    from skyrange.study.captures.packet_captures import mavlink as export_mavlink
    from skyrange.study.captures.packet_captures import remote_id as export_remote_id
    from skyrange.study.captures.received_broadcasts import received_broadcasts, receivers_of
    from skyrange.study.compare.agreement import Agreement
    from skyrange.study.compare.agreement import agreement as compare_outcomes
    from skyrange.study.compare.autopilot_parity import Parity, compare_rates
    from skyrange.study.compare.autopilot_parity import compare as compare_autopilots
    from skyrange.study.compare.exact import Difference
    from skyrange.study.compare.exact import diff as compare_runs
    from skyrange.study.dataset.audit.classifier import LeakFinding, require_no_leak
    from skyrange.study.dataset.audit.comparisons import audit_dataset
    from skyrange.study.dataset.build import build_dataset
    from skyrange.study.dataset.members import Member as DatasetMember
    from skyrange.study.dataset.members import read_members as read_dataset_members
    from skyrange.study.dataset.run_views import ViewSettings
    from skyrange.study.dataset.splits import HeldOut, assign_splits, check_held_out
    from skyrange.study.dataset.views.observed import Place as SensorPlace
    from skyrange.study.exports.csv_tables import write_tables as export_tables
    from skyrange.study.exports.exported import Export
    from skyrange.study.exports.kml_file import write_kml as export_kml
    from skyrange.study.exports.mcap_file import write_mcap as export_mcap
    from skyrange.study.figures import altitude, plan_view, track_deviation, trajectories_3d
    from skyrange.study.inference.means import Interval, estimate_mean
    from skyrange.study.measures.receptions import reception_summaries, summarise_receptions
    from skyrange.study.measures.trust import TrustPair, TrustSummary, remote_id_trust
    from skyrange.study.report import write_report
    from skyrange.study.scoring.leaderboard import LeaderboardRow, rank_detectors
    from skyrange.study.scoring.result_file import ScoreFile, ScoreSettings, read_scores, write_scores
    from skyrange.study.summary import summary
    from skyrange.study.sweep.dataset_members import list_dataset_members
    from skyrange.study.sweep.design.factors import Factor
    from skyrange.study.sweep.design.model import LearnedTable, Study, StudyArm, read_study
    from skyrange.study.sweep.execution.study_run import StudyResult, run_study
    from skyrange.study.sweep.report.page import write_study_report
    from skyrange.study.sweep.results import read_results as read_study_results
    from skyrange.study.sweep.scores.score_tables import score_study
    from skyrange.study.twins.pair_folder import Pair, load_pair

__all__ = [
    "Agreement",
    "Capture",
    "DatasetMember",
    "Difference",
    "Export",
    "Factor",
    "HeldOut",
    "Interval",
    "LeaderboardRow",
    "LeakFinding",
    "LearnedTable",
    "Pair",
    "Parity",
    "RunRecord",
    "ScoreFile",
    "ScoreSettings",
    "SensorPlace",
    "Study",
    "StudyArm",
    "StudyResult",
    "TrustPair",
    "TrustSummary",
    "ViewSettings",
    "altitude",
    "assign_splits",
    "audit_dataset",
    "build_dataset",
    "check_held_out",
    "compare_autopilots",
    "compare_outcomes",
    "compare_rates",
    "compare_runs",
    "decode_mavlink",
    "decode_remote_id",
    "estimate_mean",
    "export_kml",
    "export_mavlink",
    "export_mcap",
    "export_remote_id",
    "export_tables",
    "find_remote_id_deviations",
    "list_dataset_members",
    "load",
    "load_pair",
    "name_mavlink",
    "plan_view",
    "rank_detectors",
    "read_dataset_members",
    "read_scores",
    "read_study",
    "read_study_results",
    "received_broadcasts",
    "receivers_of",
    "reception_summaries",
    "remote_id_trust",
    "replay_monitor",
    "require_no_leak",
    "run_study",
    "score_study",
    "summarise_receptions",
    "summary",
    "track_deviation",
    "trajectories_3d",
    "write_report",
    "write_scores",
    "write_study_report",
]

if not TYPE_CHECKING:
    __getattr__ = export_lazily(__name__)


def __dir__() -> list[str]:
    return sorted(__all__)
