"""All views of one run, in batches as the data set stores them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from skyrange.dataset.labels import read_acts, trace_frames
from skyrange.dataset.views.aircraft import describe_aircraft
from skyrange.dataset.views.approval import describe_approval
from skyrange.dataset.views.episodes import describe_episodes
from skyrange.dataset.views.flows import FlowCounter
from skyrange.dataset.views.mavlink import describe_mavlink
from skyrange.dataset.views.observed import Place, SeenActs, ports_of, seen_frames
from skyrange.dataset.views.remote_id import describe_receptions
from skyrange.dataset.views.window_labels import WindowLabeller
from skyrange.record.read.run import RunRecord

_APPROVAL: Final = Place("approval:*", "gcs")
"""Where approval messages are seen."""


@dataclass(frozen=True, slots=True)
class ViewSettings:
    """Where the sensors of a data set are, and at what rate it samples."""

    places: Sequence[Place] = (Place(),)
    """Where MAVLink frames and flows are seen: by default the ground station's end of the gcs links."""
    rate_hz: float = 2.0
    """Rows of `aircraft` a second, 1 to 4."""
    families: Mapping[str, str] = field(default_factory=dict)
    """The mechanism families of attack kinds that are not shipped."""


def run_views(
    record: RunRecord, settings: ViewSettings, effects_s: Mapping[str, float | None] | None = None
) -> Iterator[tuple[str, pa.Table]]:
    """The views of a run by name, each in one table or several, without the columns of the run and the window's hash.

    The tables of a view of frames have whole windows. Raises `InputError` for a record that does not keep frames.
    """
    labels = trace_frames(record, acts := read_acts(record, settings.families))
    labeller, seen = WindowLabeller(acts, effects_s), SeenActs()
    ports, stations = ports_of(record, settings.places), ports_of(record, (_APPROVAL,))
    both = ports_of(record, (*settings.places, _APPROVAL))
    is_place, is_station = (np.array([port in own for port in both]) for own in (ports, stations))
    flows = FlowCounter(record, ports)
    for port, frames in seen_frames(record, both, labels, seen):
        described = describe_mavlink(_where(frames, is_place[port]))
        flows.add(described)
        yield "mavlink", described
        yield "approval", describe_approval(_where(frames, is_station[port]))
    times = {port: seen.at(port) for port in ports}
    for table in flows.tables(labeller, times):
        yield "flows", table
    for table in describe_aircraft(record, settings.rate_hz, labeller, times):
        yield "aircraft", table
    for table in describe_receptions(record, labels):
        yield "remote_id", table
    yield "episodes", describe_episodes(record, labeller, seen)


def _where(table: pa.Table, chosen: NDArray[np.bool_]) -> pa.Table:
    return table if chosen.all() else table.filter(pa.array(chosen))
