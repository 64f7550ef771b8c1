"""Do shams of injections send what has the same length, reaches the aircraft, is answered and changes nothing?"""

from __future__ import annotations

from typing import Any

import pytest

from skyrange.attack.bases.mavlink.orders import ModeKeeper, Order, Sender, mode_order, stick_message
from skyrange.attack.bases.shams import harmless_message
from skyrange.codec.mavlink import Packer, decode
from skyrange.codec.mavlink import dialect as mav

PLACE = (47.0, 8.0, 500.0)


@pytest.mark.parametrize(
    ("message", "name"),
    [
        (mode_order(mav.COPTER_MODE_LAND).message(7), "COMMAND_LONG"),
        (Order(mav.MAV_CMD_DO_SET_HOME, place=PLACE).message(7), "COMMAND_INT"),
        (stick_message(7, 1, (0.2, 0.3, 0.5, 1.0), manual=False), "RC_CHANNELS_OVERRIDE"),
        (stick_message(7, 1, (0.2, 0.3, 0.5, 1.0), manual=True), "MANUAL_CONTROL"),
        (mav.MAVLink_mission_count_message(7, 1, 5, mav.MAV_MISSION_TYPE_FENCE), "MISSION_REQUEST_INT"),
        (mav.MAVLink_mission_count_message(7, 1, 0), "MISSION_REQUEST_INT"),
        (mav.MAVLink_mission_clear_all_message(7, 1, mav.MAV_MISSION_TYPE_RALLY), "MISSION_REQUEST_LIST"),
    ],
)
def test_a_harmless_message_has_the_receiver_and_the_length(message: Any, name: str) -> None:
    harmless: Any = harmless_message(message)
    assert harmless.get_type() == name
    assert getattr(harmless, "target_system", getattr(harmless, "target", 0)) == 7
    frames = [bytes(Packer(255, 190).pack(one)) for one in (message, harmless)]
    assert len(frames[0]) == len(frames[1])
    assert frames[0] != frames[1]


def test_a_sender_of_a_sham_sends_no_order() -> None:
    sent = [
        decode(Sender(Packer(255, 190), 7, claims_station=True, is_sham=sham).pack(mode_order(9)))
        for sham in (False, True)
    ]
    assert [(one.target_system, one.command) for one in sent] == [
        (7, mav.MAV_CMD_DO_SET_MODE), (7, mav.MAV_CMD_REQUEST_MESSAGE),
    ]  # fmt: skip
    target = mav.MAVLink_mission_item_int_message(7, 1, 0, 0, 16, 0, 1, 0, 0, 0, 0, 1, 2, 3.0)
    item, unread = (
        Sender(Packer(255, 190), 7, claims_station=True, is_sham=sham).pack(target) for sham in (False, True)
    )
    assert (len(item), decode(unread).get_type()) == (len(unread), "ENCAPSULATED_DATA")


def test_the_mode_counts_as_changed_where_a_sham_has_commanded_one() -> None:
    def beat(mode: int) -> Any:
        return decode(Packer(7, 1).pack(mav.MAVLink_heartbeat_message(2, 3, 81, mode, 4, 3)))

    for pretends in (False, True):
        keeper = ModeKeeper(mav.COPTER_MODE_LAND, 0, pretends)
        keeper.learn(beat(mav.COPTER_MODE_AUTO))
        assert len(keeper.orders(0)) == 1
        keeper.learn(beat(mav.COPTER_MODE_AUTO))
        assert len(keeper.orders(1)) == (0 if pretends else 1)
        keeper.learn(beat(mav.COPTER_MODE_LOITER))
        assert len(keeper.orders(2)) == 1, "it was changed again"
