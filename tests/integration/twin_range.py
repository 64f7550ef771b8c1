"""What do two runs have in common before a moment, and what do their receptions say? For tests over a radio."""

from __future__ import annotations

from collections import Counter
from typing import Any

from skyrange.core.time import NS_PER_S
from skyrange.record import RunRecord
from skyrange.scenario.shipped import source_of

RID_SPOOFING = source_of("rid-spoofing").read_text(encoding="utf-8")
FLEET = (
    RID_SPOOFING[: RID_SPOOFING.index("[[radio.receivers]]")]
    + RID_SPOOFING[RID_SPOOFING.index("[[operators]]") : RID_SPOOFING.index("[[attacks]]")]
)
"""rid-spoofing without its attack and without receivers on the ground: green/g1 flies north between two
rows of buildings, red/r1 beside it."""

PLAIN = """
name = "plain"
seed = 5
duration_s = {duration_s}
origin = {{ lat = 40.7780, lon = -73.9550, alt_msl_m = 20, geoid_m = -32.7 }}
{radio}
[[operators]]
id = "blue"
station = [0, -30]
  [[operators.vehicles]]
  id = "b1"
  plan = {{ path = {{ points = [[0, 0], [60, 0]], alt_m = 30 }}, speed_mps = 5, end = "land" }}
  {own}
  [[operators.vehicles]]
  id = "b2"
  start = [0, 60]
  plan = {{ path = {{ points = [[0, 0], [60, 0]], alt_m = 30 }}, speed_mps = 5, end = "land" }}
  {own}
"""


def plain(duration_s: float = 40.0, radio: str = "[radio]", own: str = "", more: str = "") -> str:
    """Two aircraft 60 m apart over open ground; `own` is in each, `more` after all."""
    return PLAIN.format(duration_s=duration_s, radio=radio, own=own) + more


def before(record: RunRecord, at_ns: int) -> dict[str, list[Any]]:
    """All that happened before a moment: frames to the byte, truth, sensors, receptions, decisions and events.

    Of frames that were under way then, only what was known before it. That an attack is armed is left out.
    """
    frames = [
        (
            f.sent_ns, f.id, f.src, f.dst, f.payload, f.parent or "", f.causes,
            f.arrived_ns if f.arrived_ns is not None and f.arrived_ns < at_ns else -1,
        )
        for f in record.frames_with_payloads()
        if f.sent_ns < at_ns
    ]  # fmt: skip
    tables = {
        name: [row for row in record.table(name).to_pylist() if row["time_ns"] < at_ns]
        for name in ("truth", "sensors", "receptions", "decisions", "events")
    }
    tables["events"] = [row for row in tables["events"] if not row["kind"].startswith("event.attack_")]
    return {"frames": sorted(frames), **tables}


def onset_ns(record: RunRecord) -> int:
    """When the first hostile act was."""
    return int(min(record.table("labels").column("at_ns").to_pylist()))


def heard(record: RunRecord, from_s: float, to_s: float) -> Counter[tuple[str, str]]:
    """How many broadcasts were decoded in a stretch of time, by (owner of the sending radio, receiver)."""
    found: Counter[tuple[str, str]] = Counter()
    for row in record.table("receptions").to_pylist():
        if row["outcome"] == "decoded" and from_s * NS_PER_S <= row["time_ns"] < to_s * NS_PER_S:
            found[row["link"].partition(":")[2], row["receiver"]] += 1
    return found
