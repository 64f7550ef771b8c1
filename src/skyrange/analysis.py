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
    from skyrange.dataset.audit.classifier import LeakFinding, require_no_leak
    from skyrange.dataset.audit.comparisons import audit_dataset
    from skyrange.dataset.build import build_dataset
    from skyrange.dataset.frame_views import Place as SensorPlace
    from skyrange.dataset.members import HeldOut, assign_splits, check_held_out
    from skyrange.dataset.members import Member as DatasetMember
    from skyrange.dataset.members import read_members as read_dataset_members
    from skyrange.dataset.views import ViewSettings
    from skyrange.export import Export
    from skyrange.export.csv_tables import write_tables as export_tables
    from skyrange.export.dataflash_file import LogExport
    from skyrange.export.dataflash_file import write_dataflash as export_dataflash
    from skyrange.export.kml_file import write_kml as export_kml
    from skyrange.export.mcap_file import write_mcap as export_mcap
    from skyrange.export.packet_captures import Capture, ReceivedBroadcast, received_broadcasts, receivers_of
    from skyrange.export.packet_captures import mavlink as export_mavlink
    from skyrange.export.packet_captures import remote_id as export_remote_id
    from skyrange.figures import Figure, altitude, plan_view, track_deviation, trajectories_3d
    from skyrange.metrics.agreement import Agreement
    from skyrange.metrics.agreement import agreement as compare_outcomes
    from skyrange.metrics.defences import TrustPair, TrustSummary, remote_id_trust
    from skyrange.metrics.exact_difference import Difference
    from skyrange.metrics.exact_difference import diff as compare_runs
    from skyrange.metrics.links import ReceptionSummary, reception_summaries, summarise_receptions
    from skyrange.metrics.scans import Scan, read_received_scans, read_scans
    from skyrange.metrics.summary import summary
    from skyrange.parity.flights import Parity, compare_rates
    from skyrange.parity.flights import compare as compare_autopilots
    from skyrange.record import RaisedAlert, RecordedFrame, RunRecord, load, replay_monitor
    from skyrange.report import write_report
    from skyrange.report.pair.page import draw_pair_plan as pair_plan_view
    from skyrange.scoring.leaderboard import LeaderboardRow, rank_detectors
    from skyrange.scoring.result_file import ScoreFile, ScoreSettings, read_scores, write_scores
    from skyrange.statistics.means import Interval, estimate_mean
    from skyrange.study.dataset_members import list_dataset_members
    from skyrange.study.design.factors import Factor
    from skyrange.study.design.model import LearnedTable, Study, StudyArm, read_study
    from skyrange.study.page import write_study_report
    from skyrange.study.results import read_results as read_study_results
    from skyrange.study.score_tables import score_study
    from skyrange.study.study_run import StudyResult, run_study
    from skyrange.twins.pair_folder import Pair, load_pair

__all__ = [
    "Agreement",
    "Capture",
    "DatasetMember",
    "Difference",
    "Export",
    "Factor",
    "Figure",
    "HeldOut",
    "Interval",
    "LeaderboardRow",
    "LeakFinding",
    "LearnedTable",
    "LogExport",
    "Pair",
    "Parity",
    "RaisedAlert",
    "ReceivedBroadcast",
    "ReceptionSummary",
    "RecordedFrame",
    "RunRecord",
    "Scan",
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
    "export_dataflash",
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
    "pair_plan_view",
    "plan_view",
    "rank_detectors",
    "read_dataset_members",
    "read_received_scans",
    "read_scans",
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
    __getattr__ = export_lazily(
        __name__,
        {
            "skyrange.codec.f3411": "decode=decode_remote_id",
            "skyrange.codec.f3411.conformance": "deviations=find_remote_id_deviations",
            "skyrange.codec.mavlink": "decode_anew=decode_mavlink message_name=name_mavlink",
            "skyrange.dataset.audit.classifier": "LeakFinding require_no_leak",
            "skyrange.dataset.audit.comparisons": "audit_dataset",
            "skyrange.dataset.build": "build_dataset",
            "skyrange.dataset.frame_views": "Place=SensorPlace",
            "skyrange.dataset.members": (
                "HeldOut assign_splits check_held_out Member=DatasetMember read_members=read_dataset_members"
            ),
            "skyrange.dataset.views": "ViewSettings",
            "skyrange.export": "Export",
            "skyrange.export.csv_tables": "write_tables=export_tables",
            "skyrange.export.dataflash_file": "LogExport write_dataflash=export_dataflash",
            "skyrange.export.kml_file": "write_kml=export_kml",
            "skyrange.export.mcap_file": "write_mcap=export_mcap",
            "skyrange.export.packet_captures": (
                "Capture ReceivedBroadcast received_broadcasts receivers_of mavlink=export_mavlink "
                "remote_id=export_remote_id"
            ),
            "skyrange.figures": "Figure altitude plan_view track_deviation trajectories_3d",
            "skyrange.metrics.agreement": "Agreement agreement=compare_outcomes",
            "skyrange.metrics.defences": "TrustPair TrustSummary remote_id_trust",
            "skyrange.metrics.exact_difference": "Difference diff=compare_runs",
            "skyrange.metrics.links": "ReceptionSummary reception_summaries summarise_receptions",
            "skyrange.metrics.scans": "Scan read_received_scans read_scans",
            "skyrange.metrics.summary": "summary",
            "skyrange.parity.flights": "Parity compare_rates compare=compare_autopilots",
            "skyrange.record": "RaisedAlert RecordedFrame RunRecord load replay_monitor",
            "skyrange.report": "write_report",
            "skyrange.report.pair.page": "draw_pair_plan=pair_plan_view",
            "skyrange.scoring.leaderboard": "LeaderboardRow rank_detectors",
            "skyrange.scoring.result_file": "ScoreFile ScoreSettings read_scores write_scores",
            "skyrange.statistics.means": "Interval estimate_mean",
            "skyrange.study.dataset_members": "list_dataset_members",
            "skyrange.study.design.factors": "Factor",
            "skyrange.study.design.model": "LearnedTable Study StudyArm read_study",
            "skyrange.study.study_run": "StudyResult run_study",
            "skyrange.study.page": "write_study_report",
            "skyrange.study.results": "read_results=read_study_results",
            "skyrange.study.score_tables": "score_study",
            "skyrange.twins.pair_folder": "Pair load_pair",
        },
    )


def __dir__() -> list[str]:
    return sorted(__all__)
