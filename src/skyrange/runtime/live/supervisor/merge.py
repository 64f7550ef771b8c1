"""Merge of the nodes' records into one run's folder, with what the manifest says of the run as a live one."""

from __future__ import annotations

import shutil
from typing import Any, Final

from skyrange.core.errors import SkyrangeError
from skyrange.core.time import NS_PER_S, to_seconds
from skyrange.io.addresses import format_address
from skyrange.record.folder import PARTS
from skyrange.record.live_merge.merge import gather
from skyrange.runtime.acts import list_unstarted
from skyrange.runtime.live.config import part_of
from skyrange.runtime.live.deployment import WORLD
from skyrange.runtime.live.range import LiveRange
from skyrange.runtime.run import SCENARIO
from skyrange.scenario.model.manual_acts import ManualActTable
from skyrange.scenario.toml_files import replace_manual_acts

FELL_BEHIND_NS: Final = NS_PER_S // 2
COUNTED: Final = ("sent", "received", "unheard", "early", "dropped", "garbage", "refused")
"""The counts in the manifest, of each node's last start, as `node.Counts` has them."""


def merge_parts(live_range: LiveRange, status: str, failure: SkyrangeError | None) -> None:
    """Merge all parts into one record, close it with `status` and `failure`, and remove the parts."""
    extra: dict[str, Any] = {"timings": _timings(live_range), "live": _live(live_range)}
    if failure is not None:
        extra["error"] = str(failure)
    try:
        gathered = gather(
            [live_range.folder / part for part in _parts(live_range)], live_range.recorder, live_range.built.header
        )
    except SkyrangeError as error:
        live_range.recorder.close("failed", {"error": str(error)} | extra)
        raise
    _keep_manual_acts(live_range, extra)
    live_range.recorder.close(status, {**gathered, **extra})
    shutil.rmtree(live_range.folder / PARTS, ignore_errors=True)  # absent if nothing was started


def _keep_manual_acts(live_range: LiveRange, extra: dict[str, Any]) -> None:
    """Add to the manifest and the folder's scenario what was started and stopped by hand; warn of what was not."""
    status = live_range.members[WORLD].status if WORLD in live_range.members else {}
    unstarted, rows = list_unstarted(status.get("acts", ())), status.get("manual_acts")
    if unstarted:
        extra["warnings"] = [*live_range.built.header.get("warnings", ()), *unstarted]
    if not rows:
        return
    extra["manual_acts"] = rows
    done = [ManualActTable(**{key: row[key] for key in ManualActTable.model_fields}) for row in rows]
    newest = {(act.act, act.action): act for act in (*live_range.built.scenario.manual_acts, *done)}
    text = replace_manual_acts(live_range.built.attachments[SCENARIO].decode(), list(newest.values()))
    live_range.recorder.replace_file(SCENARIO, text.encode())


def _parts(live_range: LiveRange) -> list[str]:
    """The folders of all records, of each node one for each time that it was started."""
    starts = {name: member.starts for name, member in live_range.members.items()}
    names = [node.name for node in live_range.deployment.nodes]
    return [part_of(name, start) for name in names for start in range(1, starts.get(name, 1) + 1)]


def _timings(live_range: LiveRange) -> dict[str, Any]:
    late_ns = max((int(member.status.get("late_ns", 0)) for member in live_range.members.values()), default=0)
    reached_s = max(
        (to_seconds(int(member.status.get("now_ns", 0))) for member in live_range.members.values()), default=0.0
    )
    return {
        "wall_s": round(live_range.took_s, 3),
        "real_time_factor": round(reached_s / live_range.took_s, 3) if live_range.took_s else None,
        "max_lag_s": round(to_seconds(late_ns), 3),
    }


def _live(live_range: LiveRange) -> dict[str, Any]:
    late = {name: int(member.status.get("late_ns", 0)) for name, member in live_range.members.items()}
    return {
        "nodes": {node.name: sorted(node.endpoints) for node in live_range.deployment.nodes},
        "outside": sorted(live_range.deployment.outside),
        "links": {
            crossing.link.name: f"{crossing.transport}://{crossing.address[0]}:{crossing.address[1]}"
            for crossing in live_range.crossings
        },
        "hosts": {node.name: node.host for node in live_range.deployment.nodes} if live_range.deployment.others else {},
        "namespaces": dict(live_range.spaces.names) if live_range.spaces is not None else {},
        "clocks": live_range.clocks,
        "refused": live_range.refused,
        "viewers": {vehicle: f"tcp://{format_address((host, port))}" for vehicle, host, port in live_range.watched},
        "late_max_s": {name: round(to_seconds(ns), 3) for name, ns in late.items()},
        "fell_behind": sorted(name for name, ns in late.items() if ns > FELL_BEHIND_NS),
        "ended": {member.name: member.ended for member in live_range.members.values() if member.ended},
        "started_anew": {member.name: member.deaths for member in live_range.members.values() if member.deaths},
        "programs": {
            program["name"]: {"node": member.name, "state": program["state"], "ended": program["ended"]}
            for member in live_range.members.values()
            for program in member.status.get("programs", ())
        },
        "counts": {
            name: {key: int(member.status.get(key, 0)) for key in COUNTED}
            for name, member in live_range.members.items()
        },
    }
