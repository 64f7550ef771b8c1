"""Tables of receptions: sender, receiver, number decoded and signal strength."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup

from skyrange.metrics.receptions import MAX_AIRCRAFT, ReceptionSummary
from skyrange.report import quantities
from skyrange.report.rendering import render

MAX_PAIRS = 300
"""Rows of one table."""


def render_receptions(rows: Sequence[ReceptionSummary]) -> Markup:
    """Render the receptions of a pair's attacked run, decoded or not, by sender and receiver."""
    return render(
        "receptions.html.jinja",
        texts=["sender", "receiver"],
        numbers=["decoded", "of", "median", "strongest"],
        rows=[
            {
                "first": row.sender,
                "second": row.receiver,
                "numbers": (
                    quantities.count(row.decoded),
                    quantities.count(row.of) if row.of is not None else quantities.MISSING,
                    quantities.quantity(row.median_dbm, "dBm", 0),
                    quantities.quantity(row.most_dbm, "dBm", 0),
                ),
            }
            for row in rows[:MAX_PAIRS]
        ],
        total=len(rows),
    )


def reception_section(rows: Sequence[ReceptionSummary], fleet: int, end_s: float) -> Mapping[str, Any] | None:
    """Table of the senders that each receiver of a run decoded, and which receivers it lists; `None` if there is none.

    `fleet` is the number of aircraft; the age of the last reception is taken at `end_s`.
    """
    if not rows:
        return None
    table = render(
        "receptions.html.jinja",
        texts=["receiver", "hears"],
        numbers=["decoded", "median", "strongest", "longest silence", "age at the end"],
        rows=[
            {
                "first": row.receiver,
                "second": row.sender,
                "numbers": (
                    quantities.count(row.decoded),
                    quantities.quantity(row.median_dbm, "dBm", 0),
                    quantities.quantity(row.most_dbm, "dBm", 0),
                    quantities.quantity(row.silence_s, "s", 1),
                    quantities.quantity(None if row.last_s is None else max(end_s - row.last_s, 0.0), "s", 1),
                ),
            }
            for row in rows[:MAX_PAIRS]
        ],
        total=len(rows),
    )
    whose = "each receiver on the ground and each aircraft" if fleet <= MAX_AIRCRAFT else "each receiver on the ground"
    return {"receivers": whose, "table": table}
