"""Spans of the viewer's timeline: lost links, and what defences did."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from skyrange.view.stream.events import EventTables
from skyrange.view.stream.messages import Message, Part, encode_file
from tests.tiers import examples
from tests.viewer_modules import ask_modules

END_S = 100.0
SPANS = """(store, { defenceSpans, linkLosses }) =>
  [linkLosses, defenceSpans].map((list) => list(store).map((one) => [one.title, one.from, one.until, one.text]))"""
KINDS = ("decision.link_lost", "decision.link_restored", "event.defence_act", "decision.avoid")
times = st.lists(st.integers(0, 99), min_size=1, max_size=30, unique=True).map(sorted)


@given(times, st.data())
@settings(max_examples=examples(8))
def test_spans_are_those_of_the_notes(seconds: list[int], data: st.DataObject) -> None:
    rows: list[dict[str, Any]] = []
    for t in seconds:
        kind = data.draw(st.sampled_from(KINDS))
        about = data.draw(st.sampled_from(("wall", "sieve") if "defence" in kind else ("o/v0", "o/v1")))
        rows.append(
            {"t": float(t), "table": kind.split(".")[0] + "s", "kind": kind, "about": about, "source": "x", "text": "",
             "causes": 0}
        )  # fmt: skip
    tables = EventTables()
    tables.rows["notes"] = rows
    head = {
        "version": 1, "name": "spans", "start_s": 0.0, "end_s": END_S, "arms": [{"id": "run"}],
        "operators": [{"id": "o"}], "vehicles": [{"id": f"o/v{row}", "operator": 0} for row in range(2)],
    }  # fmt: skip
    with TemporaryDirectory() as folder:
        stream = encode_file(Message("S", head, {}), [Part(0.0, END_S, [tables.encode(0, 0.0, END_S)])])
        losses, defences = ask_modules(stream, Path(folder), SPANS, "incidents.js")

    expected = []
    for place, row in enumerate(rows):
        if row["kind"] == KINDS[0]:
            later = [one for one in rows[place + 1 :] if one["about"] == row["about"]]
            ends = [one["t"] for one in later if one["kind"] in KINDS[:2]]
            restored = bool(ends) and next(one for one in later if one["kind"] in KINDS[:2])["kind"] == KINDS[1]
            expected.append([f"Link lost: {row['about']}", row["t"], ends[0] if restored else END_S, ""])
    assert losses == expected
    acts = [row for row in rows if row["kind"] == "event.defence_act"]
    assert sum(int(text.split()[0]) for *_, text in defences) == len(acts)
    for _, start, until, _ in defences:
        assert {start, until} <= {row["t"] for row in acts}
    for one in ("wall", "sieve"):
        mine = [row["t"] for row in acts if row["about"] == one]
        gaps = sum(after - before >= 3.0 for before, after in pairwise(mine))
        assert sum(title.startswith(f"Defence {one}:") for title, *_ in defences) == (gaps + 1 if mine else 0)
