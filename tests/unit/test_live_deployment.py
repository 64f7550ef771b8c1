"""Processes and addresses of a live range, on one machine and on several."""

from __future__ import annotations

import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from skyrange.assembly.build import build
from skyrange.contracts.links import LinkSpec
from skyrange.core.errors import InputError
from skyrange.runtime.live.deployment import LOOPBACK, WORLD, assign_components, usual_group
from skyrange.runtime.live.range import prepare_range
from skyrange.runtime.live.transport.addresses import KINDS, check_free, check_own_addresses, crossings
from skyrange.scenario.shipped import load


@pytest.fixture(scope="module")
def links() -> list[LinkSpec]:
    sensors = 'operators.green.vehicles.g1.sensors=[{model="d435"}]'
    return list(build(load("rid-spoofing", ["radio.receivers=[]", sensors])).wiring.links)


def test_each_component_is_a_process_and_the_world_is_one(links: list[LinkSpec]) -> None:
    made = assign_components(links, "component")
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
    alone = {one.link.name: one for one in crossings(links, assign_components(links, "component"))}
    by_operator = assign_components(links, "operator")
    assert [node.name for node in by_operator.nodes] == [WORLD, "approval", "green", "red"]
    shared = {one.link.name: one for one in crossings(links, by_operator)}
    assert shared.keys() < alone.keys()
    assert all(alone[name] == one for name, one in shared.items())
    assert list(assign_components(links, "one").crossing(links)) == []
    assert (usual_group(16, cores=2), usual_group(17, cores=2)) == ("component", "operator")


def test_ports_are_the_published_ones_ten_apart_and_can_be_moved(links: list[LinkSpec]) -> None:
    made = assign_components(links, "component")
    ports = {one.link.name: one.address[1] for one in crossings(links, made)}
    assert (ports["gcs:green/g1"], ports["gcs:red/r1"]) == (14555, 14565)
    assert (ports["log:green/g1"], ports["autopilot:red/r1"]) == (14551, 5770)
    assert (ports["rid_data:red/r1"], ports["rid_up:green/g1"], ports["rid_down:green/g1"]) == (14568, 14556, 14557)
    moved = {one.link.name: one.address[1] for one in crossings(links, made, 1000)}
    assert moved == {name: port + 1000 for name, port in ports.items()}
    with pytest.raises(InputError, match=r"gcs:green/g1: port 69555"):
        crossings(links, made, 55_000)


def test_a_component_may_be_left_to_somebody_else(links: list[LinkSpec]) -> None:
    made = assign_components(links, "component", ["red.gcs"])
    assert made.home("red.gcs") == ""
    assert "red.gcs" not in {node.name for node in made.nodes}
    assert {"gcs:red/r1", "approval:red"} <= {spec.name for spec in made.crossing(links)}
    with pytest.raises(InputError, match=r"red\.gsc.*Did you mean 'red\.gcs'"):
        assign_components(links, "component", ["red.gsc"])


@pytest.fixture
def taken() -> Iterator[tuple[int, int]]:
    with socket.socket() as tcp, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        tcp.bind(("127.0.0.1", 0))
        tcp.listen()
        udp.bind(("127.0.0.1", 0))
        yield tcp.getsockname()[1], udp.getsockname()[1]


def test_addresses_in_use_are_named_all_at_once(links: list[LinkSpec], taken: tuple[int, int]) -> None:
    made = assign_components(links, "component")
    tcp = crossings(links, made, taken[0] - KINDS["log"].port)
    udp = crossings(links, made, taken[1] - KINDS["gcs"].port)
    one = [each for each in tcp if each.link.name == "log:green/g1"]
    other = [each for each in udp if each.link.name == "gcs:green/g1"]
    with pytest.raises(InputError) as caught:
        check_free([*one, *other])
    assert [fault.where.split()[0] for fault in caught.value.problems] == ["log:green/g1", "gcs:green/g1"]
    assert all("--port-offset" in fault.hint for fault in caught.value.problems)


HOSTS = {"world": "10.9.0.1", "green.gcs": "10.9.0.2", "red/*": "10.9.0.3", "red/r1.companion": "10.9.0.2"}


def test_components_are_where_the_hosts_say_the_last_one_that_fits(links: list[LinkSpec]) -> None:
    made = assign_components(links, "component", [], HOSTS)
    homes = {node.name: node.host for node in made.nodes}
    assert homes == {
        "world": "10.9.0.1", "approval": "10.9.0.1", "red.gcs": "10.9.0.1",
        "green/g1.companion": "10.9.0.1", "green/g1.proxy": "10.9.0.1",
        "green.gcs": "10.9.0.2", "red/r1.companion": "10.9.0.2", "red/r1.proxy": "10.9.0.3",
    }  # fmt: skip
    assert (made.base, made.others) == ("10.9.0.1", ("10.9.0.2", "10.9.0.3"))


def test_links_leave_the_loopback_only_between_machines(links: list[LinkSpec]) -> None:
    made = assign_components(links, "component", [], HOSTS)
    at = {one.link.name: one.address for one in crossings(links, made)}
    assert at["gcs:green/g1"] == ("10.9.0.2", 14555)  # the ground station listens, and the aircraft is elsewhere
    assert at["gcs:red/r1"] == ("10.9.0.1", 14565)
    assert at["log:red/r1"] == ("10.9.0.3", 14561)
    assert at["autopilot:red/r1"] == ("10.9.0.1", 5770)
    assert at["rid_up:red/r1"] == ("10.9.0.1", 14566)
    assert at["approval:green"] == ("10.9.0.1", 18080)
    assert {at[name][0] for name in ("log:green/g1", "autopilot:green/g1", "approval:red")} == {LOOPBACK}


def test_no_process_is_on_two_machines(links: list[LinkSpec]) -> None:
    assert {node.name: node.host for node in assign_components(links, "host", [], HOSTS).nodes} == {
        "world": "10.9.0.1", "10.9.0.2": "10.9.0.2", "10.9.0.3": "10.9.0.3",
    }  # fmt: skip
    assert [node.name for node in assign_components(links, "operator", [], HOSTS).nodes] == [
        "world", "approval", "green@10.9.0.2", "green", "red", "red@10.9.0.2", "red@10.9.0.3",
    ]  # fmt: skip
    with pytest.raises(InputError, match=r"--group host"):
        assign_components(links, "one", [], HOSTS)


def test_hosts_that_make_no_sense_are_named(links: list[LinkSpec]) -> None:
    with pytest.raises(InputError) as caught:
        assign_components(links, "component", [], {"green.gsc": "10.9.0.2", "red.gcs": "10.9.0.2"})
    assert [fault.where for fault in caught.value.problems] == ["hosts", "hosts.world"]
    assert "'green.gcs'" in caught.value.problems[0].hint
    with pytest.raises(InputError, match=r"hosts\.red\.gcs.*an IP address"):
        load("rid-spoofing", ["hosts={'red.gcs' = 'lab2'}"])
    with pytest.raises(InputError, match="skyrange keys"):
        prepare_range(load("rid-spoofing", ["hosts={world = '127.0.0.2', 'red.gcs' = '127.0.0.3'}"]))


@pytest.mark.parametrize("base", ["192.0.2.1", "2001:db8::1"])
def test_a_range_starts_on_the_machine_that_its_hosts_name(base: str, tmp_path: Path) -> None:
    check_own_addresses("127.0.0.1")
    with pytest.raises(InputError, match=r"hosts\.world: .*expected an address of this machine"):
        check_own_addresses(base)
    scenario = load("squares", [f'hosts={{"*" = "{base}"}}'])
    with pytest.raises(InputError, match=r"hosts\.world"):
        prepare_range(scenario, tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_loopback_interface_that_is_down_is_named_at_once() -> None:
    code = "from skyrange.runtime.live.transport.addresses import check_own_addresses as c; c('127.0.0.1')"
    if subprocess.run(["unshare", "-n", "true"], capture_output=True, check=False).returncode:
        pytest.skip("no network namespace can be made here")
    done = subprocess.run(["unshare", "-n", sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "a loopback interface that is up" in done.stderr
