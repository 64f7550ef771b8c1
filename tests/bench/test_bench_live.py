"""The bench of the live range measures what it says. No figure is asserted: figures belong to machines."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from skyrange.bench.live import measure
from skyrange.bench.transports import TRANSPORTS, frame, sent_at
from skyrange.bench.transports import measure as measure_transport
from skyrange.io.http.frames import read_request
from skyrange.runtime.live.range import LiveRange
from skyrange.runtime.live.transport.addresses import KINDS, TransportKind
from tests.ports import OFFSET


def test_every_transport_of_the_range_is_measured() -> None:
    assert set(TRANSPORTS) == {kind.transport for kind in KINDS.values()}


@pytest.mark.parametrize("transport", TRANSPORTS)
def test_what_is_sent_is_what_such_a_link_carries_with_its_time_in_it(transport: TransportKind) -> None:
    at_ns = 123_456_789_012_345
    made = frame(transport, at_ns, 7)
    assert sent_at(transport, made) == at_ns
    if transport == "http":
        assert read_request(made).path.startswith("/")
    else:
        (message,) = mavlink.MAVLink(None).parse_buffer(made)
        assert (message.get_type(), message.tc1, message.ts1) == ("TIMESYNC", at_ns, 7)


@pytest.mark.realtime
@pytest.mark.parametrize("transport", ["udp", "http"])
def test_a_row_of_a_transport(transport: TransportKind) -> None:
    row = measure_transport(transport, 300)
    assert row["frames"] == (600 if transport == "http" else 300)
    assert row["frames_per_s"] > 0
    assert row["frames_per_core_s"] > 0
    assert 0.0 < row["added_ms"] <= row["added_p99_ms"]
    assert row["links"] == (["approval"] if transport == "http" else ["gcs"])


@pytest.mark.realtime
def test_a_row_of_a_range() -> None:
    looks: list[float] = []
    crossing: set[str] = set()

    def look(flown: LiveRange) -> None:
        looks.append(flown.now_s)
        crossing.update(one.link.name.partition(":")[0] for one in flown.crossings)

    row = measure(2, 2.0, "operator", OFFSET, look)
    assert (row["vehicles"], row["flying"], row["processes"]) == (2, 2, 3)
    assert row["held"] is (not row["fell_behind"])
    assert row["cores"] > 0.0
    assert row["aircraft_per_core"] == pytest.approx(2 / row["cores"], rel=0.02)
    assert set(row["added_ms"]) == crossing == {"autopilot", "approval"}  # the rest is within the operator's process
    assert all(0.0 < own["median"] <= own["p99"] for own in row["added_ms"].values())
    # eight telemetry frames of each aircraft in a second go over one socket and three hops
    assert 8 <= row["crossings_per_s"] <= row["frames_per_s"] / 3
    assert max(looks) > 0.0
