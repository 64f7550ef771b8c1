"""Events of an ArduPilot that its STATUSTEXT messages report: fence, battery, estimator.

Texts of ArduCopter 4.6 and 4.7: AC_Fence.cpp (`get_fence_names`, `print_fence_message`), ArduCopter/fence.cpp
(`fence_checks_async`), AP_BattMonitor.cpp (`check_failsafes`), ArduCopter/ekf_check.cpp, AP_NavEKF3_Control.cpp. None
of them is longer than a STATUSTEXT, so none comes in chunks.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Final

from skyrange.codec.mavlink import Message, dialect

Event = tuple[str, Mapping[str, str | int | float | bool]]
"""Kind and data of a note about the aircraft."""

_TEXTS: Final[Mapping[str, Event]] = {
    "EKF variance": ("event.ekf_failsafe", {"on": True}),
    "EKF Failsafe Cleared": ("event.ekf_failsafe", {"on": False}),
    "EKF3 IMU0 stopped aiding": ("event.estimator", {"aiding": "none"}),
    "EKF3 IMU0 is using GPS": ("event.estimator", {"aiding": "gnss"}),
}
_BREACHED: Final = re.compile(r"((?:Max Alt|Min Alt|Circle|Polygon)\b.* fences?) breached")
_CLEARED: Final = "Fence breach cleared"
_BATTERY: Final = re.compile(r"Battery (\d+) is (low|critical|missing)(?:, last:)? (-?\d+\.\d+)V used (-?\d+) mAh")
_BREACH_NAMES: Final[Mapping[int, str]] = {
    dialect.FENCE_BREACH_MINALT: "Min Alt fence",
    dialect.FENCE_BREACH_MAXALT: "Max Alt fence",
    dialect.FENCE_BREACH_BOUNDARY: "Circle or Polygon fence",
}


class FenceState:
    """What is known of a fence: a text reports a breach and its end, except on the ground; FENCE_STATUS always.

    The two come in any order, and one breach is one event, with the names of the text where it comes first.
    """

    def __init__(self) -> None:
        self._known = ""
        """What said last that the fence is breached, "text" or "status"; "cleared" if FENCE_STATUS said that it is
        over and the text has not, "" if it is not breached."""
        self._reports = 0
        """Consecutive FENCE_STATUS with a breach of which no text was received."""

    def on_breach_text(self, fences: str) -> Iterator[Event]:
        """A breach, or one 20 m farther out, of the types that the text names."""
        if self._known != "status":
            yield "event.fence_breach", {"fence": fences}
        self._known, self._reports = "text", 0

    def on_cleared_text(self) -> Iterator[Event]:
        """The end of a breach."""
        if self._known != "cleared":
            yield "event.fence_cleared", {}
        self._known, self._reports = "", 0

    def on_status(self, message: Message, armed: bool, landed: bool) -> Iterator[Event]:
        """FENCE_STATUS: what the texts do not report. A text in the air may still come, so one report there waits."""
        breached = self._known in ("text", "status")
        if not message.breach_status:
            self._reports = 0
            if breached:
                self._known = "cleared"
                yield "event.fence_cleared", {}
        elif armed and not breached:
            self._reports += 1
            if landed or self._reports > 1:
                self._known, self._reports = "status", 0
                yield "event.fence_breach", {"fence": _BREACH_NAMES.get(message.breach_type, "")}


def read_status_text(text: str, fence: FenceState) -> Iterator[Event]:
    """The events that a text reports."""
    if text in _TEXTS:
        yield _TEXTS[text]
    elif text == _CLEARED:
        yield from fence.on_cleared_text()
    elif breach := _BREACHED.fullmatch(text):
        yield from fence.on_breach_text(breach[1])
    elif power := _BATTERY.fullmatch(text):
        number, level, volts, used = power.groups()
        yield (
            "event.battery",
            {"level": level, "voltage_v": float(volts), "used_mah": float(used), "battery": int(number)},
        )
