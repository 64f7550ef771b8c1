"""Proxy and companion: what is forwarded where, and over which links."""

from __future__ import annotations

from skyrange.codec.mavlink import Packer, dialect
from skyrange.contracts.links import Channel
from skyrange.vehicle.onboard_network import (
    CHANNELS,
    for_remote_id,
    onboard_links,
    onboard_routes,
    oracle_links,
    scan_link,
)


def test_every_route_enters_and_leaves_by_links_of_its_endpoint() -> None:
    ends = {spec.name: {spec.a, spec.b} for spec in onboard_links("blue/b1", "blue")}
    for route in onboard_routes("blue/b1"):
        assert route.endpoint in ends[route.source]
        assert route.endpoint in ends[route.target]


def test_autopilot_and_ground_station_are_joined_both_ways() -> None:
    hops = {(r.endpoint, r.source): r.target for r in onboard_routes("blue/b1") if r.select is None}
    assert hops["blue/b1.proxy", "autopilot:blue/b1"] == "log:blue/b1"
    assert hops["blue/b1.companion", "log:blue/b1"] == "gcs:blue/b1"
    assert hops["blue/b1.companion", "gcs:blue/b1"] == "log:blue/b1"
    assert hops["blue/b1.proxy", "log:blue/b1"] == "autopilot:blue/b1"


def test_links_follow_the_naming_and_defaults() -> None:
    specs = {
        spec.name: spec for spec in (*onboard_links("blue/b1", "blue"), *oracle_links("blue/b1"), scan_link("blue/b1"))
    }
    assert set(specs) == {f"{kind}:blue/b1" for kind in CHANNELS}
    assert (specs["rid_up:blue/b1"].a, specs["rid_up:blue/b1"].b) == ("blue/b1.companion", "oracle")
    assert (specs["rid_down:blue/b1"].a, specs["rid_down:blue/b1"].b) == ("oracle", "blue/b1.companion")
    assert (specs["gcs:blue/b1"].a, specs["gcs:blue/b1"].b) == ("blue.gcs", "blue/b1.companion")
    assert specs["gcs:blue/b1"].channel.latency_ns == 20_000_000
    rid_data = specs["rid_data:blue/b1"].channel
    assert isinstance(rid_data, Channel)
    assert rid_data.mode == "reliable"


def test_remote_id_gets_positions_and_nothing_unparseable() -> None:
    packer = Packer(1, 1)
    position = dialect.MAVLink_global_position_int_message(0, 0, 0, 0, 0, 0, 0, 0, 0)
    attitude = dialect.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0)
    assert for_remote_id(packer.pack(position))
    assert not for_remote_id(packer.pack(attitude))
    assert not for_remote_id(b"")
    assert not for_remote_id(b"garbage that is long enough to have a header")
