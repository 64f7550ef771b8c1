"""The folder of a run as a log: every frame at the ends of its links, as the monitors of the run were handed them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import pyarrow as pa

from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin
from skyrange.core.ids import Port
from skyrange.core.time import from_seconds
from skyrange.log_detection.observed_log import ROWS, LogLink, ObservedLog, Remark
from skyrange.record import load
from skyrange.record.manifest import epoch_of, fleet_of, origin_of
from skyrange.record.read.time_order import sort_by_time
from skyrange.record.replay import TIES, LinkEnds, read_observed


class RunLog(ObservedLog):
    """A run, which has all ends of all links."""

    format = "run"
    side = ""

    def __init__(self, folder: Path) -> None:
        """Open a run's folder. Raises `InputError` for another folder, and for a run without frames."""
        self._record = load(folder)
        self._record.tables.require("frames")
        manifest, who = self._record.manifest, str(self._record.path)
        self.path = self._record.path
        self.links = [LogLink(str(row["name"]), str(row["a"]), str(row["b"])) for row in manifest.get("links") or []]
        if not self.links:
            raise InputError.one(who, "links", "none", "a run with links", "The run ended before it began.")
        ports = {Port(end, link.name) for link in self.links for end in (link.a, link.b)}
        self.ends = sorted(ports, key=_link_first)
        self.vehicles = fleet_of(manifest, who)
        self.origin = origin_of(manifest) or Origin(0.0, 0.0)
        self.epoch = epoch_of(manifest)
        self.until_ns = from_seconds(self._record.duration)
        self.seed = int(manifest.get("seed") or 0)
        self.declared = [dict(row) for row in manifest.get("detectors") or []]

    @property
    def remarks(self) -> Sequence[Remark]:
        """What a user has to know of the run."""
        remarks = []
        if self._record.status != "complete":
            remarks.append(Remark("run", f"the run is {self._record.status}: what is on record is read"))
        if self._record.manifest.get("live"):
            text = "the run was live: its processes wrote times of their own, so alerts may differ from those raised"
            remarks.append(Remark("clock", text))
        return remarks

    def rows(self, ends: Sequence[Port]) -> Iterator[pa.Table]:
        """See `ObservedLog`. Frames are read twice; memory is bounded."""
        links = {link.name: (link.a, link.b) for link in self.links}
        observed = LinkEnds(ends, links)
        for table in sort_by_time(lambda: read_observed(self._record, observed), "at_ns", TIES):
            yield table.select(ROWS.names)


def _link_first(port: Port) -> tuple[str, str]:
    return port.link, port.endpoint
