"""Features of a window at each link end: rates of frames, steps of telemetry, innovations, fixes and battery.

Everything is observable at that end: no ids, addresses, keys or times since the start are among the features, because a
model would learn the scenario from them. A feature of a message that did not arrive in the window is NaN.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from skyrange.contracts.frames import Ints
from skyrange.contracts.monitors import ObservedFrames
from skyrange.core import elementwise
from skyrange.core.time import NS_PER_S, Time
from skyrange.detect.messages import MessageHeads, name_message, read_heads
from skyrange.detect.sensor_values import pressure_altitude_m
from skyrange.detect.series import Floats, Series, Steps, grown, offset_m, step_errors

_RATED: Final = (
    "HEARTBEAT",
    "COMMAND_ACK",
    "PARAM_VALUE",
    "STATUSTEXT",
    "MISSION_ACK",
    "MISSION_REQUEST",
    "GLOBAL_POSITION_INT",
)
"""Messages whose rates are features, with those whose names begin with one of these."""
_MODE: Final = ("custom_mode", "base_mode", "system_status")
_POSITION: Final = ("lat", "lon", "alt", "relative_alt", "vx", "vy", "vz")
_FIX: Final = ("lat", "lon", "vel", "fix_type", "satellites_visible", "eph")
_RATIOS: Final = ("velocity_variance", "pos_horiz_variance", "pos_vert_variance", "compass_variance")
_STATUS: Final = ("battery_remaining", "voltage_battery", "current_battery")


class Feature(NamedTuple):
    """One feature of a window."""

    name: str
    about: str


FEATURES: Final = (
    Feature("received_hz", "frames that arrived, per second"),
    Feature("sent_hz", "frames that were sent, per second"),
    Feature("received_bytes_hz", "bytes that arrived, per second"),
    Feature("invalid_hz", "frames that arrived and are not whole, valid MAVLink, per second"),
    Feature("longest_silence_s", "longest time between two frames that arrived, from the last one before on"),
    Feature("senders", "different pairs of system and component in frames that arrived"),
    Feature("missing_hz", "sequence numbers left out, per second"),
    Feature("repeated_hz", "frames with the sender, sequence number and checksum of an earlier one, per second"),
    *(Feature(f"{name.lower()}_hz", f"messages {name} that arrived, per second") for name in _RATED),
    Feature("mode_changes", "changes of mode or state from one HEARTBEAT to the next"),
    Feature("clock_error_s", "largest difference between the steps of time_boot_ms and of arrival"),
    Feature("position_error_m", "largest horizontal step of the position less its mean velocity times the time"),
    Feature("climb_error_m", "the same in height"),
    Feature("acceleration_mps2", "largest change of the velocity over the time"),
    Feature("speed_mps", "mean horizontal speed"),
    Feature("climb_mps", "mean vertical speed, up positive"),
    Feature("lean_rad", "largest roll or pitch"),
    Feature("turn_rad", "largest change of roll, pitch or yaw from one ATTITUDE to the next"),
    Feature("fix_error_m", "largest step from fix to fix, less the mean speed of both times the time"),
    Feature("fix_offset_m", "distance of the last fix from the last position"),
    Feature("fix_type", "least fix type"),
    Feature("satellites", "least number of satellites"),
    Feature("eph", "largest horizontal dilution of a fix, as sent"),
    *(Feature(f"ekf_{name}", f"largest {name} of EKF_STATUS_REPORT, a test ratio") for name in _RATIOS),
    Feature("battery_change", "largest change of the remaining charge, in percent"),
    Feature("voltage_change_v", "largest change of the voltage"),
    Feature("current_a", "mean current"),
    Feature("throttle", "mean throttle, in percent"),
    Feature("cross_track_m", "largest distance from the track"),
    Feature("height_error_m", "change of the pressure altitude less that of the height, over the window"),
)
"""The features in the order of the columns."""
NAMES: Final = tuple(feature.name for feature in FEATURES)


class WindowFeatures:
    """The features of each window of the frames at link ends. Its state is the last message of each kind and end."""

    def __init__(self, window_ns: Time) -> None:
        self._seconds = window_ns / NS_PER_S
        self._last_ns = np.full(0, -1, dtype=np.int64)
        self._heights: Floats = np.zeros((0, 2))
        """Of each end: pressure altitude and height at the end of the last window."""
        self._mode = Series("HEARTBEAT", _MODE, timed=False)
        self._position = Series("GLOBAL_POSITION_INT", _POSITION)
        self._attitude = Series("ATTITUDE", ("roll", "pitch", "yaw"))
        self._fix = Series("GPS_RAW_INT", _FIX, timed=False)
        self._ratios = Series("EKF_STATUS_REPORT", _RATIOS, timed=False)
        self._status = Series("SYS_STATUS", _STATUS, timed=False)
        self._throttle = Series("VFR_HUD", ("throttle",), timed=False)
        self._track = Series("NAV_CONTROLLER_OUTPUT", ("xtrack_error",), timed=False)
        self._pressure = Series("SCALED_PRESSURE", ("press_abs",))

    def read(self, frames: ObservedFrames) -> Floats:
        """The (ends, features) of a window, from all frames that were observed in it."""
        count = len(frames.ports)
        arrived = frames.take(frames.received)
        features: dict[str, Floats] = {}
        self._read_frames(frames, arrived, features)
        self._read_heads(read_heads(arrived), count, features)
        self._read_motion(arrived, count, features)
        self._read_fixes(arrived, count, features)
        self._read_systems(arrived, count, features)
        return np.column_stack([features[name] for name in NAMES])

    def _read_frames(self, frames: ObservedFrames, arrived: ObservedFrames, features: dict[str, Floats]) -> None:
        count = len(frames.ports)
        features["sent_hz"] = np.bincount(frames.places[~frames.received], minlength=count) / self._seconds
        features["received_hz"] = np.bincount(arrived.places, minlength=count) / self._seconds
        sizes = arrived.payloads.sizes.astype(np.float64)
        features["received_bytes_hz"] = np.bincount(arrived.places, sizes, minlength=count) / self._seconds
        missing = count - len(self._last_ns)
        self._last_ns = np.concatenate([self._last_ns, np.full(missing, -1, dtype=np.int64)])
        order = np.argsort(arrived.places, kind="stable")
        places, at_ns = arrived.places[order], arrived.at_ns[order]
        before = np.empty_like(at_ns)
        before[1:] = at_ns[:-1]
        first = np.flatnonzero(np.diff(places, prepend=-1))
        before[first] = self._last_ns[places[first]]
        gaps = np.where(before < 0, np.nan, (at_ns - before) / NS_PER_S)
        features["longest_silence_s"] = largest(places, gaps, count)
        np.maximum.at(self._last_ns, places, at_ns)

    def _read_heads(self, heads: MessageHeads, count: int, features: dict[str, Floats]) -> None:
        valid = np.bincount(heads.places, minlength=count) / self._seconds
        features["invalid_hz"] = features["received_hz"] - valid
        senders = heads.senders
        known = np.unique(np.column_stack([heads.places, senders]), axis=0)
        features["senders"] = np.bincount(known[:, 0], minlength=count).astype(np.float64)
        order = np.argsort(senders, kind="stable")
        same = senders[order][1:] == senders[order][:-1]
        skipped = (np.diff(heads.sequences[order]) - 1) % 256
        ahead = same & (skipped < 128)  # a number from before is late or repeated, not missing
        features["missing_hz"] = (
            np.bincount(heads.places[order][1:][ahead], skipped[ahead], minlength=count) / self._seconds
        )
        keys = (senders << 8 | heads.sequences) << 16 | heads.checksums
        chosen = np.ones(len(keys), dtype=np.bool_)
        chosen[np.unique(keys, return_index=True)[1]] = False
        features["repeated_hz"] = np.bincount(heads.places[chosen], minlength=count) / self._seconds
        for name in _RATED:
            rows = np.isin(heads.messages, _numbers(heads.messages, name))
            features[f"{name.lower()}_hz"] = np.bincount(heads.places[rows], minlength=count) / self._seconds

    def _read_motion(self, frames: ObservedFrames, count: int, features: dict[str, Floats]) -> None:
        steps = self._position.read(frames)
        errors, _ = step_errors(steps.before, steps.after, steps.seconds)
        change = elementwise.length(steps.after[:, 4:] - steps.before[:, 4:]) * 1e-2
        with np.errstate(divide="ignore", invalid="ignore"):
            acceleration = np.where(steps.seconds > 0.0, change / steps.seconds, np.nan)
        features["position_error_m"] = largest(steps.places, elementwise.hypot(errors[:, 0], errors[:, 1]), count)
        features["climb_error_m"] = largest(steps.places, np.abs(errors[:, 2]), count)
        features["acceleration_mps2"] = largest(steps.places, acceleration, count)
        features["speed_mps"] = mean(
            steps.places, elementwise.hypot(steps.after[:, 4], steps.after[:, 5]) * 1e-2, count
        )
        features["climb_mps"] = mean(steps.places, steps.after[:, 6] * -1e-2, count)
        features["clock_error_s"] = self._clock_error(steps, count)
        turns = self._attitude.read(frames)
        features["lean_rad"] = largest(turns.places, np.abs(turns.after[:, :2]).max(axis=1, initial=0.0), count)
        difference = (turns.after - turns.before + np.pi) % (2.0 * np.pi) - np.pi
        features["turn_rad"] = largest(turns.places, np.abs(difference).max(axis=1, initial=0.0), count)

    def _clock_error(self, steps: Steps, count: int) -> Floats:
        """Between messages of this window: by the sender's clock against the time of arrival."""
        same = np.flatnonzero(np.diff(steps.places) == 0)
        error = np.abs(np.diff(steps.time_s) - np.diff(steps.at_ns) / NS_PER_S)
        return largest(steps.places[same], error[same], count)

    def _read_fixes(self, frames: ObservedFrames, count: int, features: dict[str, Floats]) -> None:
        steps = self._fix.read(frames)
        east, north = offset_m(steps.before[:, 0], steps.before[:, 1], steps.after[:, 0], steps.after[:, 1])
        flown = 0.5 * (steps.before[:, 2] + steps.after[:, 2]) * 1e-2 * steps.seconds
        features["fix_error_m"] = largest(steps.places, np.abs(elementwise.hypot(east, north) - flown), count)
        features["fix_type"] = -largest(steps.places, -steps.after[:, 3], count)
        features["satellites"] = -largest(steps.places, -steps.after[:, 4], count)
        features["eph"] = largest(steps.places, steps.after[:, 5], count)
        fix, fused = self._fix.values, self._position.values
        east, north = offset_m(fix[:, 0], fix[:, 1], fused[:, 0], fused[:, 1])
        fresh = np.isfinite(features["fix_type"]) & np.isfinite(features["speed_mps"])
        features["fix_offset_m"] = np.where(fresh, elementwise.hypot(east, north), np.nan)

    def _read_systems(self, frames: ObservedFrames, count: int, features: dict[str, Floats]) -> None:
        modes = self._mode.read(frames)
        changed = np.isfinite(modes.before[:, 0]) & (modes.before != modes.after).any(axis=1)
        features["mode_changes"] = np.bincount(modes.places[changed], minlength=count).astype(np.float64)
        ratios = self._ratios.read(frames)
        for column, name in enumerate(_RATIOS):
            features[f"ekf_{name}"] = largest(ratios.places, ratios.after[:, column], count)
        status = self._status.read(frames)
        change = np.abs(status.after - status.before)
        features["battery_change"] = largest(status.places, change[:, 0], count)
        features["voltage_change_v"] = largest(status.places, change[:, 1] * 1e-3, count)
        features["current_a"] = mean(status.places, status.after[:, 2] * 1e-2, count)
        throttle = self._throttle.read(frames)
        features["throttle"] = mean(throttle.places, throttle.after[:, 0], count)
        track = self._track.read(frames)
        features["cross_track_m"] = largest(track.places, np.abs(track.after[:, 0]), count)
        pressures = self._pressure.read(frames)
        altitude = pressure_altitude_m(self._pressure.values[:, 0])
        heights = np.column_stack([altitude, self._position.values[:, 3] * 1e-3])
        moved = heights - grown(self._heights, count, np.nan)
        fresh = np.bincount(pressures.places, minlength=count) > 0
        features["height_error_m"] = np.where(fresh, np.abs(moved[:, 0] - moved[:, 1]), np.nan)
        self._heights = heights


def largest(places: Ints, values: Floats, count: int) -> Floats:
    """(count,) the largest of the (n,) values at each place; NaN without any."""
    maxima = np.full(count, np.nan)
    np.fmax.at(maxima, places, values)
    return maxima


def mean(places: Ints, values: Floats, count: int) -> Floats:
    """(count,) the mean of the (n,) values at each place; NaN without any."""
    numbers = np.bincount(places, minlength=count)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.bincount(places, values, minlength=count) / numbers)


def _numbers(messages: Ints, name: str) -> Ints:
    """Those of the message ids whose names begin with `name`."""
    ids = [number for number in np.unique(messages).tolist() if name_message(number).startswith(name)]
    return np.array(ids, dtype=np.int64)
