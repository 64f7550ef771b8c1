"""ArduPilot with its own physics: its simulation of a quadcopter, on the machine's clock.

The processes boot before time 0, faster than real time, until each one's clock shows that it has observed compass and
GNSS for long enough, and are released together. From then on `SIM_SPEEDUP` of each paces itself, and the kernel waits
for the slowest of them: a tick ends when the clocks of all have reached it. A process that is too far ahead of the
kernel is stopped until the kernel has caught up, so that a slow machine makes a run slower, and not wrong.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np

from skyrange.codec.mavlink import Message, dialect
from skyrange.contracts.components import Finished, InstanceStatus, Sensors
from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_MS, NS_PER_S, Epoch, Time
from skyrange.io.ardupilot.sitl import Sitl, wall_s
from skyrange.io.processes.program import Watchdog
from skyrange.vehicle.ardupilot import parameters
from skyrange.vehicle.ardupilot.json_backend.motion import PWM_MIN, PWM_RANGE
from skyrange.vehicle.ardupilot.options import Options
from skyrange.vehicle.ardupilot.process_fleet import PRIVATE, START_S, WARM_UP_NS, ProcessFleet
from skyrange.vehicle.contract import VehicleSpec
from skyrange.vehicle.event_detection import REPORTS
from skyrange.vehicle.reported_poses import ReportedPoses, state_from_sim_state

MODEL: Final = "x"
"""ArduPilot's own: 3 kg, 0.35 m arms, hovers at 0.39 (SIM_Frame.h)."""
SPEEDUP: Final = "SIM_SPEEDUP"
BOOT_SPEED: Final = 20.0
BOOT_FIX_NS: Final[Time] = 100 * NS_PER_MS
"""Interval of fixes during the boot. They are sent when reports arrive, which come in bunches: twice the 5 Hz that
ArduPilot needs on average."""
SLOW_DOWN_PER_S: Final = 4.0
"""Speed of a boot towards its end: the remaining time, times this."""
MAX_EXTRAPOLATION_S: Final = 0.1
"""A process's clock is extrapolated for this long after a report; it does not make up a longer delay
(SIM_Aircraft.cpp, `sync_frame_time`)."""
MAX_AHEAD_S: Final = 0.15
"""On the machine's clock: a process that is farther ahead of the tick is stopped."""
WATCHDOG_S: Final = 0.25
"""If no tick comes for this long all processes are stopped, until one does."""
MAX_SLIP_S: Final = 0.6
"""A process that is farther ahead flew on while the kernel stood still: that time is lost, and its
clock is set anew."""
MIN_WAIT_S: Final = 0.005
"""The shortest wait; ArduPilot's own is as long (SIM_Aircraft.h, `min_sleep_time`)."""


@dataclass(slots=True)
class _Clock:
    """The clock of one process."""

    reported_ns: Time = -1
    """Since its start, by its last report; negative if unknown."""
    received_s: float = 0.0
    """When that report came, on the clock of `wall_s`."""
    origin_ns: Time | None = None
    """Its time at our time 0; `None` until it is released."""
    speed: float = BOOT_SPEED
    """As requested."""
    fix_ns: Time = -BOOT_FIX_NS
    """Time of the last fix during the boot."""
    pulses: tuple[int, ...] = ()
    """Pulse widths of its motors, µs."""
    stopped: bool = False
    """Whether it is stopped for being ahead."""

    def time(self, now_s: float) -> Time | None:
        """Range time by its own clock; `None` if unknown."""
        if self.reported_ns < 0 or self.origin_ns is None:
            return None
        since_s = min(now_s - self.received_s, MAX_EXTRAPOLATION_S)
        return self.reported_ns - self.origin_ns + int(since_s * self.speed * NS_PER_S)


class NativeFleet(ProcessFleet):
    """A fleet moved by ArduPilot's own physics (contract: `contracts.components.Engine`)."""

    physics: Literal["shared", "native"] = "native"
    clock: Literal["lockstep", "wall"] = "wall"
    repeatable: Literal["bytes", "outcome"] = "outcome"
    preroll_ns: Time = 0
    reports: Mapping[int, float] = REPORTS | {
        dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 50.0,  # the clock
        dialect.MAVLINK_MSG_ID_SIM_STATE: 50.0,
        dialect.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: 10.0,
    }

    def __init__(self, name: str, specs: Sequence[VehicleSpec], origin: Origin, epoch: Epoch, options: Options) -> None:
        """As `ProcessFleet`."""
        super().__init__(name, specs, origin, epoch, options)
        self.pace = options.speedup
        self.moves = self.vehicles
        self._clocks = [_Clock() for _ in specs]
        self._poses = ReportedPoses(len(specs))
        self._began: Time = 0
        """The first tick."""
        self._slipped_ns: Time = 0
        self._flying = False
        """Whether all have booted."""
        self._watchdog: Watchdog | None = None

    @property
    def manifest(self) -> dict[str, Any]:
        """As `ProcessFleet`, and the pace."""
        return {**super().manifest, "speedup": self.pace, "slipped_s": round(self._slipped_ns / NS_PER_S, 3)}

    def _values(self, spec: VehicleSpec, gnss_lag_ms: int) -> dict[str, float]:
        values = parameters.native_values(spec, self._listed, gnss_lag_ms, self._options.rates)
        values[SPEEDUP] = BOOT_SPEED
        return values

    def _start_process(self, **arguments: Any) -> Sitl:
        return Sitl(model=MODEL, **arguments)

    # ---------------------------------------------------------------- until time 0

    def _boot(self, tick: Time, sensors: Sensors) -> None:
        """Start all processes, let each finish its warm-up at its own speed, and release all at once."""
        self._start(tick, sensors)
        self._began = tick
        outbox, now_s = Outbox(), wall_s()
        for clock in self._clocks:
            clock.received_s = now_s
        while not all(clock.stopped for clock in self._clocks):
            self._read_ports(-1, outbox, MIN_WAIT_S)
            for row, (instance, clock) in enumerate(zip(self._instances, self._clocks, strict=True)):
                if clock.stopped:
                    continue
                if wall_s() - clock.received_s > START_S or not instance.sitl.program.running:
                    raise instance.sitl.lost("did not come up")
                if clock.reported_ns >= clock.fix_ns + BOOT_FIX_NS:
                    clock.fix_ns = clock.reported_ns
                    self._send_boot_fix(row, tick + clock.reported_ns - WARM_UP_NS, sensors)
                self._slow_down(row)
                if clock.reported_ns >= WARM_UP_NS:
                    self._set_stopped(row, stopped=True)
                    clock.origin_ns = clock.reported_ns
        for row in range(len(self._clocks)):
            self._set_stopped(row, stopped=False)
        self._flying = True
        self._watchdog = Watchdog([instance.sitl.program for instance in self._instances], WATCHDOG_S)

    def _send_boot_fix(self, row: int, now: Time, sensors: Sensors) -> None:
        """Send the fix of the first tick, repeatedly, while it boots."""
        lag_ns = self._began - sensors.gnss_time_ns
        instance = self._instances[row]
        if sensors.gnss_fix[row] > 0:
            again = replace(sensors, gnss_time_ns=now - lag_ns)
            instance.sitl.write(PRIVATE, instance.onboard.pack(self._receivers.message(again, row)))

    def _slow_down(self, row: int) -> None:
        """Slow down towards the end of the warm-up."""
        clock = self._clocks[row]
        left_s = (WARM_UP_NS - clock.reported_ns) / NS_PER_S
        wanted = min(max(left_s * SLOW_DOWN_PER_S, self.pace), BOOT_SPEED)
        if wanted <= 0.5 * clock.speed or (wanted == self.pace and clock.speed != wanted):
            self._speed(row, wanted)

    def _set_stopped(self, row: int, *, stopped: bool) -> None:
        """Stop a process's time, or let it continue."""
        clock = self._clocks[row]
        clock.stopped, clock.received_s = stopped, wall_s()
        self._instances[row].sitl.program.set_stopped(stopped=stopped)

    def _speed(self, row: int, speed: float) -> None:
        instance = self._instances[row]
        ask = dialect.MAVLink_param_set_message(
            instance.spec.system_id, 1, SPEEDUP.encode(), speed, dialect.MAV_PARAM_TYPE_REAL32
        )
        if instance.sitl.write(PRIVATE, instance.onboard.pack(ask)):
            self._clocks[row].speed = speed

    def close(self) -> None:
        """As `ProcessFleet`."""
        if self._watchdog is not None:
            self._watchdog.close()
        super().close()

    # ---------------------------------------------------------------- a tick

    def begin(self, tick: Time, sensors: Sensors, inbox: Inbox) -> None:
        """Give each process its frames and its fix."""
        if not self._instances:
            self._boot(tick, sensors)
        self._kick_watchdog()
        self._deliver_inputs(sensors, inbox)

    def finish(self, tick: Time, wall_deadline_s: float) -> Finished:
        """Wait until the clocks of all have reached the tick, and read what they send meanwhile."""
        outbox = Outbox()
        for instance in self._instances:
            if instance.status is InstanceStatus.SILENT:
                instance.status = InstanceStatus.DEAD  # its process was ended, so its aircraft falls
        deadline = wall_s() + wall_deadline_s
        self._read_ports(tick, outbox)
        self._throttle(tick - self._began)
        self._kick_watchdog()
        while (wait_s := self._lag_s(tick - self._began)) > 0.0:
            if wall_s() > deadline:
                self._give_up(tick - self._began, outbox)
            self._kick_watchdog()
            self._mark_ended(outbox)
            self._read_ports(tick, outbox, max(wait_s, MIN_WAIT_S))
            self._throttle(tick - self._began)
        poses = self._poses.take_new()
        for row, (instance, clock) in enumerate(zip(self._instances, self._clocks, strict=True)):
            if not instance.alive:
                self._commands[row] = 0.0
                if poses is not None:
                    poses.fresh[row] = False
            elif clock.pulses:
                self._commands[row] = np.clip((np.array(clock.pulses) - PWM_MIN) / PWM_RANGE, 0.0, 1.0)
        return Finished(self._commands, outbox, [instance.status for instance in self._instances], poses)

    def _kick_watchdog(self) -> None:
        """Report that the kernel is alive, and continue processes that were stopped because it was not."""
        if self._watchdog is not None and self._watchdog.kick():
            for row, (instance, clock) in enumerate(zip(self._instances, self._clocks, strict=True)):
                if instance.alive and not clock.stopped:
                    self._set_stopped(row, stopped=False)

    def _lag_s(self, tick: Time) -> float:
        """Time on the machine's clock until the slowest process will have reached the tick."""
        now_s, most = wall_s(), 0.0
        for instance, clock in zip(self._instances, self._clocks, strict=True):
            if instance.alive and not clock.stopped:
                time = clock.time(now_s)
                if time is not None and time < tick:
                    most = max(most, (tick - time) / NS_PER_S / self.pace)
        return most

    def _throttle(self, tick: Time) -> None:
        """Stop the processes that are too far ahead of the tick, and continue those that no longer are."""
        for row, (instance, clock) in enumerate(zip(self._instances, self._clocks, strict=True)):
            if not instance.alive or clock.origin_ns is None:
                continue
            ahead_s = (clock.reported_ns - clock.origin_ns - tick) / NS_PER_S / self.pace
            if clock.stopped:
                if ahead_s <= -MAX_EXTRAPOLATION_S:  # it makes up this much when it continues
                    self._set_stopped(row, stopped=False)
            elif ahead_s > MAX_SLIP_S:
                self._slipped_ns += clock.reported_ns - clock.origin_ns - tick
                clock.origin_ns = clock.reported_ns - tick
            elif ahead_s > MAX_AHEAD_S:
                self._set_stopped(row, stopped=True)

    def _mark_ended(self, outbox: Outbox) -> None:
        for row, instance in enumerate(self._instances):
            if instance.alive and not instance.sitl.program.running:
                instance.lose(InstanceStatus.DEAD, outbox)
                self._clock_offsets.forget(row)

    def _give_up(self, tick: Time, outbox: Outbox) -> None:
        """Give up processes that have sent nothing for too long."""
        now_s = wall_s()
        for row, (instance, clock) in enumerate(zip(self._instances, self._clocks, strict=True)):
            time = clock.time(now_s)
            if instance.alive and time is not None and time < tick and now_s - clock.received_s > MAX_EXTRAPOLATION_S:
                instance.lose(InstanceStatus.SILENT, outbox)
                self._clock_offsets.forget(row)

    def _connected(self, row: int, place: int, outbox: Outbox) -> None:
        clock = self._clocks[row]
        if self._flying and place == PRIVATE:  # it has rebooted, as on MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN
            self._instances[row].restarted(outbox)
            clock.reported_ns, clock.origin_ns = -1, None
            self._clock_offsets.forget(row)

    def _on_report(self, tick: Time, row: int, message: Message, outbox: Outbox) -> None:
        kind, clock = message.get_type(), self._clocks[row]
        if kind == "GLOBAL_POSITION_INT":
            reported_ns = message.time_boot_ms * NS_PER_MS
            clock.reported_ns, clock.received_s = reported_ns, wall_s()
            if self._flying and clock.origin_ns is None:
                clock.origin_ns = reported_ns - (tick - self._began)
            if clock.origin_ns is not None:
                self._clock_offsets.record(row, reported_ns - clock.origin_ns - (tick - self._began))
        elif kind == "SIM_STATE" and clock.origin_ns is not None:
            state = state_from_sim_state(message, self._origin)
            if state.is_valid:
                self._poses.update(row, state, tick - self._began - (clock.reported_ns - clock.origin_ns))
        elif kind == "SERVO_OUTPUT_RAW":
            clock.pulses = (message.servo1_raw, message.servo2_raw, message.servo3_raw, message.servo4_raw)
