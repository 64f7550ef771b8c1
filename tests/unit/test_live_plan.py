"""Who runs what at which address in a live range, and what nodes and supervisor say to each other."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyrange.agent.links import LinkSpec
from skyrange.core.errors import InputError
from skyrange.runtime.live.addresses import KINDS, check_free, crossings
from skyrange.runtime.live.control import MOST_BYTES, Desk, Phone, packed, unpacked
from skyrange.runtime.live.node import Orders
from skyrange.runtime.live.plan import WORLD, plan, usual_group
from skyrange.scenario.catalogue import load
from skyrange.scenario.wire import wire


@pytest.fixture(scope="module")
def links() -> list[LinkSpec]:
    return list(wire(load("rid-spoofing")).wiring.links)


def test_each_component_is_a_process_and_the_world_is_one(links: list[LinkSpec]) -> None:
    made = plan(links, "component")
    assert made.nodes[0].name == WORLD
    assert {node.name for node in made.nodes} == {
        WORLD, "approval", "green.gcs", "red.gcs",
        "green/g1.companion", "green/g1.proxy", "red/r1.companion", "red/r1.proxy",
    }  # fmt: skip
    world = made.nodes[0].endpoints
    assert {"oracle", "green/g1.autopilot", "red/r1.autopilot"} <= world
    assert all(made.home(end) for spec in links for end in (spec.a, spec.b))
    assert {spec.name.partition(":")[0] for spec in made.crossing(links)} == set(KINDS) - {"oracle"}


def test_fewer_processes_have_fewer_sockets_at_the_same_ports(links: list[LinkSpec]) -> None:
    alone = {one.link.name: one for one in crossings(links, plan(links, "component").crossing(links))}
    by_operator = plan(links, "operator")
    assert [node.name for node in by_operator.nodes] == [WORLD, "approval", "green", "red"]
    shared = {one.link.name: one for one in crossings(links, by_operator.crossing(links))}
    assert shared.keys() < alone.keys()
    assert all(alone[name] == one for name, one in shared.items())
    assert list(plan(links, "one").crossing(links)) == []
    assert (usual_group(16, cores=2), usual_group(17, cores=2)) == ("component", "operator")


def test_ports_are_the_published_ones_ten_apart_and_can_be_moved(links: list[LinkSpec]) -> None:
    made = plan(links, "component")
    ports = {one.link.name: one.address[1] for one in crossings(links, made.crossing(links))}
    assert (ports["gcs:green/g1"], ports["gcs:red/r1"]) == (14555, 14565)
    assert (ports["log:green/g1"], ports["autopilot:red/r1"]) == (14551, 5770)
    assert (ports["rid_data:red/r1"], ports["rid_up:green/g1"], ports["rid_down:green/g1"]) == (14568, 14556, 14557)
    moved = {one.link.name: one.address[1] for one in crossings(links, made.crossing(links), 1000)}
    assert moved == {name: port + 1000 for name, port in ports.items()}
    with pytest.raises(InputError, match=r"gcs:green/g1: port 69555"):
        crossings(links, made.crossing(links), 55_000)


def test_a_component_may_be_left_to_somebody_else(links: list[LinkSpec]) -> None:
    made = plan(links, "component", ["red.gcs"])
    assert made.home("red.gcs") == ""
    assert "red.gcs" not in {node.name for node in made.nodes}
    assert {"gcs:red/r1", "approval:red"} <= {spec.name for spec in made.crossing(links)}
    with pytest.raises(InputError, match=r"red\.gsc.*Did you mean 'red\.gcs'"):
        plan(links, "component", ["red.gsc"])


@pytest.fixture
def taken() -> Iterator[tuple[int, int]]:
    with socket.socket() as tcp, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        tcp.bind(("127.0.0.1", 0))
        tcp.listen()
        udp.bind(("127.0.0.1", 0))
        yield tcp.getsockname()[1], udp.getsockname()[1]


def test_addresses_in_use_are_named_all_at_once(links: list[LinkSpec], taken: tuple[int, int]) -> None:
    made = plan(links, "component")
    tcp = crossings(links, made.crossing(links), taken[0] - KINDS["log"].port)
    udp = crossings(links, made.crossing(links), taken[1] - KINDS["gcs"].port)
    one = [each for each in tcp if each.link.name == "log:green/g1"]
    other = [each for each in udp if each.link.name == "gcs:green/g1"]
    with pytest.raises(InputError) as caught:
        check_free([*one, *other])
    assert [fault.where.split()[0] for fault in caught.value.faults] == ["log:green/g1", "gcs:green/g1"]
    assert all("--port-offset" in fault.hint for fault in caught.value.faults)


def test_orders_survive_their_file(links: list[LinkSpec]) -> None:
    places = crossings(links, plan(links, "component").crossing(links))
    orders = Orders("world", ("oracle",), "s.toml", "parts/world", "tcp://127.0.0.1:1", tuple(places))
    assert Orders.from_json(orders.to_json()) == orders


@given(st.binary(max_size=200))
def test_control_survives_any_bytes(data: bytes) -> None:
    said = unpacked(data)
    assert said is None or isinstance(said["kind"], str)


def test_control_takes_objects_of_a_kind_and_nothing_else() -> None:
    assert unpacked(packed("status", now_ns=5)) == {"kind": "status", "now_ns": 5}
    for wrong in (b"[]", b'{"kind": 3}', b"{}", b"nonsense", b"[" * 5000, packed("x", y="z" * MOST_BYTES)):
        assert unpacked(wrong) is None


def test_supervisor_and_node_hear_each_other() -> None:
    async def talk() -> tuple[str, object, object, int]:
        desk = Desk()
        desk.open()
        phone = Phone("blue.gcs", desk.address)
        phone.open()
        try:
            await phone._socket.send(b"no message")
            await phone.tell("hello")
            name, said = await desk.hear()
            await desk.tell("nobody", "stop")
            await desk.tell(name, "start", zero_ns=7)
            return name, said, await phone.hear(), desk.strange
        finally:
            phone.close()
            desk.close()

    async def within() -> tuple[str, object, object, int]:
        async with asyncio.timeout(5.0):
            return await talk()

    assert asyncio.run(within()) == ("blue.gcs", {"kind": "hello"}, {"kind": "start", "zero_ns": 7}, 1)
