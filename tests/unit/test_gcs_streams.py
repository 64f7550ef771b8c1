"""A ground station asks for telemetry as QGroundControl does, and asks again when none comes."""

from __future__ import annotations

import pytest

from skyrange.codec.mavlink import dialect as mav
from skyrange.gcs.flight.lifecycle import Flight
from skyrange.gcs.plan import plans
from skyrange.gcs.station import GroundStation
from skyrange.gcs.telemetry_streams import OPERATOR, PROFILES
from skyrange.utm.approval_service import FlightApproval
from skyrange.utm.approve_all import ApproveAll
from tests.unit.fake_autopilot import EPOCH, ORIGIN, FakeAutopilot, Loop

HOME = (5.0, 5.0, 0.0)


@pytest.mark.parametrize("name", PROFILES)
def test_the_profile_is_asked_for_and_again_in_silence(name: str) -> None:
    plan = plans.square(ORIGIN, HOME, side_m=5, alt_m=5, kind="auto")
    station = GroundStation("blue", [Flight("blue/b1", 1, plan, 60.0)], EPOCH, streams=name)
    run = Loop([station], {"blue/b1": FakeAutopilot(1, HOME)}, FlightApproval(["blue"], EPOCH, ApproveAll()))
    run.run(10.0, stop=False)
    aircraft = run.aircraft["blue/b1"]
    wanted = PROFILES[name]
    asked = [m for m in aircraft.heard if m.id == mav.MAVLINK_MSG_ID_REQUEST_DATA_STREAM]
    first = asked[: len(wanted.streams)]
    assert [(m.req_stream_id, m.req_message_rate, m.start_stop) for m in first] == [(*s, 1) for s in wanted.streams]
    assert set(aircraft.intervals) == {message for message, _ in wanted.messages}
    # the toy sends no streams: to the operator it stays silent, and is asked every few seconds
    assert len(asked) >= 2 * len(OPERATOR.streams) if name == "operator" else not asked


def test_an_operators_streams_are_the_defaults_of_qgroundcontrol() -> None:
    """APMMavlinkStreamRate.SettingsGroup.json, and the messages that `APMFirmwarePlugin` asks for by themselves."""
    stream = {name: getattr(mav, f"MAV_DATA_STREAM_{name}") for name in (
        "RAW_SENSORS", "EXTENDED_STATUS", "RC_CHANNELS", "POSITION", "EXTRA1", "EXTRA2", "EXTRA3",
    )}  # fmt: skip
    assert dict(OPERATOR.streams) == dict(zip(stream.values(), (2, 2, 2, 3, 10, 10, 3), strict=True))
    assert dict(OPERATOR.messages) == {
        mav.MAVLINK_MSG_ID_HOME_POSITION: 1.0,
        mav.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 1.0,
    }
