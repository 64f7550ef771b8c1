"""Everything that is shipped, and every toy that the probes use, keeps its contract."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import pytest

from skyrange.contracts.components import Agent, Tap
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import LinkSpec
from skyrange.contracts.plugins import registry as plugins
from skyrange.contracts.plugins.registry import APPROVALS, AUTOPILOTS, DETECTORS, MEDIA, kinds
from skyrange.contracts.verdicts import Pass, Verdict
from skyrange.core.chance import Chance
from skyrange.core.geodesy import Origin
from skyrange.core.ids import Port
from skyrange.core.time import NS_PER_S, Epoch, Time
from skyrange.gcs.flight.lifecycle import Flight
from skyrange.gcs.plan import paths, plans
from skyrange.gcs.station import GroundStation
from skyrange.kernel import EngineMount, Kernel, Wiring
from skyrange.testing import InputMessage, MessageRecorder, check_agent, check_approval, check_engine, check_tap
from skyrange.testing.checks.approval_policies import EPOCH, ordinary
from skyrange.testing.drivers.engine_driver import FLEET, ORIGIN, open_field
from skyrange.utm.approval_service import FlightApproval
from skyrange.utm.approve_all import ApproveAll
from skyrange.utm.contract import ApprovalPlugin
from skyrange.utm.messages import Request, encode
from skyrange.vehicle.builtin.engine import BuiltinFleet
from skyrange.vehicle.contract import AutopilotPlugin, VehicleSpec
from tests.probes.test_taps import Flooder, Meddler
from tests.probes.toys import Bodies, Climber, Fleet, Station, onboard

BLUE = FLEET[:2]


def test_what_is_checked_here_is_all_that_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plugins, "_registered", {})
    assert set(kinds(APPROVALS)) == {
        "approve-all",
        "authority",
        "federated",
        "hashgraph",
    }  # test_broken_approval_services
    assert set(kinds(MEDIA)) == {"builtin", "ns3", "omnetpp"}  # test_radio_media, test_network_simulators
    assert set(kinds(DETECTORS)) == {
        "approval.conformance",
        "heartbeat.gap",
        "learned.windows",  # test_learned_detectors
        "mavlink.commands",
        "mavlink.rate",
        "mavlink.sequence",
        "mavlink.source",
        "mavlink.timing",
        "motion.consistency",
        "motion.fleet",
        "navigation.cs_ema",
        "navigation.gnss_innovation",
        "navigation.multi_sensor",
        "remote_id.plausibility",
    }  # test_detectors
    assert set(kinds(AUTOPILOTS)) == {
        "ardupilot",
        "builtin",
        "external",
        "gazebo",
    }  # test_ardupilot_conforms, test_external_conforms, test_gazebo_conforms


# ---------------------------------------------------------------- what is shipped


def test_approve_all() -> None:
    check_approval(ApprovalPlugin.find("approve-all"))


@pytest.mark.rotating
def test_builtin_autopilot() -> None:
    check_engine(AutopilotPlugin.find("builtin"))


def test_flight_approval() -> None:
    mail = [
        InputMessage(now, Port("approval", f"approval:{intent.operator}"), encode(Request.of(intent, EPOCH)))
        for now, intent in ordinary()
    ]
    check_agent(lambda: FlightApproval(["blue", "green"], EPOCH, ApproveAll()), mail=mail)


def ground_station(kind: plans.Kind) -> GroundStation:
    flights = []
    for spec in BLUE:
        plan = plans.path(ORIGIN, spec.home_enu_m, paths.square(4.0, 5.0), kind=kind, cruise_mps=5.0)
        flights.append(Flight(vehicle=spec.vehicle, system_id=spec.system_id, plan=plan))
    return GroundStation("blue", flights, EPOCH)


def conversation(kind: plans.Kind, until: Time) -> list[InputMessage]:
    """What the ground station is told in a whole flight with the builtin autopilot."""
    links = [LinkSpec("approval:blue", "blue.gcs", "approval")]
    relays = []
    for spec in BLUE:
        some_links, some_routes = onboard(spec.vehicle)
        links += some_links
        relays += some_routes
    station = ground_station(kind)
    recorder = MessageRecorder(station.ports, links)
    wiring = Wiring(
        seed=1,
        links=links,
        routes=relays,
        agents=[station, FlightApproval(["blue"], EPOCH, ApproveAll())],
        world=open_field(BLUE),
        engines=[EngineMount(BuiltinFleet("builtin", list(BLUE), ORIGIN, EPOCH), slice(None))],
    )
    kernel = Kernel(wiring, [recorder])
    kernel.advance(until)
    assert station.finished, station.states
    assert all(outcome.state == "complete" for outcome in station.outcomes.values()), station.outcomes
    return recorder.messages


@pytest.mark.parametrize("kind", ["auto", "guided"])
@pytest.mark.rotating
def test_ground_station(kind: plans.Kind) -> None:
    until = 75 * NS_PER_S
    check_agent(lambda: ground_station(kind), mail=conversation(kind, until), until=until)


def test_a_ground_station_that_nobody_answers() -> None:
    check_agent(lambda: ground_station("auto"), until=60 * NS_PER_S)


# ---------------------------------------------------------------- toys


@pytest.mark.parametrize(
    "make",
    [
        lambda: Fleet("fleet", ["blue/b1", "green/g1"]),
        lambda: Station("blue", ["blue/b1", "blue/b2"]),
        lambda: Flooder(ports=[Port("blue/b1.proxy", "autopilot:blue/b1")]),
    ],
    ids=["fleet", "station", "flooder"],
)
def test_toy_agents(make: Callable[[], Agent]) -> None:
    check_agent(make)


@dataclass
class Lull(Meddler):
    """The probes' meddler, which replays what it has heard, on a link that may be silent."""

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        if self.heard:
            return super().on_wakeup(now)
        self.due = now + NS_PER_S
        return []


@dataclass
class Witness:
    """A defender's tap: it looks and lets pass."""

    link: str

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        return [Pass()]

    def next_wakeup(self) -> Time | None:
        return None

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        return ()


@pytest.mark.parametrize("make", [Lull, Witness])
@pytest.mark.parametrize("payloads", [(), tuple(f"ask {k}".encode() for k in range(50))], ids=["mavlink", "text"])
def test_toy_taps(make: Callable[[str], Tap], payloads: Sequence[bytes]) -> None:
    check_tap(make, payloads=payloads)


@pytest.mark.rotating
def test_toy_engine() -> None:
    """One at a time: the probes' world takes 1 m/s for each place in the row, beyond what a motor takes."""

    def climber(name: str, specs: Sequence[VehicleSpec], origin: Origin, epoch: Epoch, chance: Chance) -> Climber:
        return Climber(name, [spec.vehicle for spec in specs])

    check_engine(
        climber,
        specs=FLEET[:1],
        world=lambda specs: Bodies([spec.vehicle for spec in specs]),
        mail=(),
        until=2 * NS_PER_S,
    )
