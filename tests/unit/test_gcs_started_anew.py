"""A ground station that was started anew, in the middle: it leaves what flies to fly, and goes on watching."""

from __future__ import annotations

import pytest

from skyrange.codec.mavlink import dialect as mav
from skyrange.gcs.flight.lifecycle import Flight, FlightState
from skyrange.gcs.plan import plans
from skyrange.gcs.plan.plans import FlightPlan
from skyrange.gcs.station import GroundStation
from skyrange.utm.approval_service import FlightApproval
from skyrange.utm.approve_all import ApproveAll
from tests.unit.fake_autopilot import EPOCH, ORIGIN, FakeAutopilot, Loop

HOME = (5.0, 5.0, 0.0)
COMMAND, COUNT = 76, 44


def square(kind: plans.Kind = "auto") -> FlightPlan:
    return plans.square(ORIGIN, HOME, side_m=5, alt_m=5, kind=kind)


def station(plan: FlightPlan) -> GroundStation:
    return GroundStation("blue", [Flight("blue/b1", 1, plan, 0.0)], EPOCH)


def anew(at_s: float, plan: FlightPlan) -> Loop:
    """A flight whose station is another one from `at_s` on."""
    run = Loop([station(plan)], {"blue/b1": FakeAutopilot(1, HOME)}, FlightApproval(["blue"], EPOCH, ApproveAll()))
    run.run(at_s, stop=False)
    run.stations[:] = [station(plan)]
    run.notes.clear()
    run.commands.clear()
    return run


def test_a_mission_that_flies_is_watched_to_its_end_and_left_alone() -> None:
    run = anew(4.0, square())
    assert run.aircraft["blue/b1"].running
    run.run(120.0)
    assert run.stations[0].outcomes["blue/b1"].state == FlightState.COMPLETE
    kinds = run.kinds("blue/b1")
    assert kinds[1] == "decision.resumed"
    assert "decision.progress" in kinds
    assert "decision.complete" in kinds
    assert run.sent("blue/b1", COUNT) == []
    assert {message.command for message in run.sent("blue/b1", COMMAND)} <= {mav.MAV_CMD_SET_MESSAGE_INTERVAL}
    assert len(run.sent("blue/b1", 0)) > 5


def test_a_guided_aircraft_is_brought_home() -> None:
    run = anew(8.0, square("guided"))
    run.run(120.0)
    found = run.stations[0].outcomes["blue/b1"]
    assert found.state == FlightState.FAILED
    assert "started anew" in found.reason
    assert [message.command for message in run.sent("blue/b1", COMMAND)] == [mav.MAV_CMD_DO_SET_MODE]
    assert not run.aircraft["blue/b1"].armed


def test_what_has_flown_is_not_flown_again_and_its_outcome_is_left_to_who_saw_it() -> None:
    run = anew(100.0, square())
    assert not run.aircraft["blue/b1"].armed
    run.run(130.0)
    assert run.stations[0].states["blue/b1"] == FlightState.LEFT
    assert run.kinds("blue/b1")[-1] == "decision.left"
    assert "event.outcome" not in run.kinds("blue/b1")
    assert run.sent("blue/b1", COUNT) == run.sent("blue/b1", COMMAND) == []


@pytest.mark.parametrize("at_s", [0.1, 0.6])
def test_what_waits_is_flown(at_s: float) -> None:
    run = anew(at_s, square())
    assert not run.aircraft["blue/b1"].armed
    run.run(120.0)
    assert run.stations[0].outcomes["blue/b1"].state == FlightState.COMPLETE
    assert run.stations[0].bad_approvals == 0


def test_an_aircraft_that_is_never_heard_is_given_up() -> None:
    run = anew(8.0, square())
    run.blocked.add("gcs:blue/b1")
    run.run(200.0)
    assert run.stations[0].outcomes["blue/b1"].reason == "listening for too long"
