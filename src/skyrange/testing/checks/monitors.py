"""Conformance of a monitor, the contract of detectors (`skyrange.contracts.monitors.Monitor`)."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from skyrange.contracts.alerts import Alert, find_problem
from skyrange.contracts.frames import Payloads
from skyrange.contracts.monitors import DetectorContext, DetectorPlugin, Monitor, ObservedFrame, ObservedFrames
from skyrange.core.chance import Chance
from skyrange.core.geodesy import Origin
from skyrange.core.ids import Port
from skyrange.core.time import NS_PER_MS, NS_PER_S, Epoch, Time, ceil_to
from skyrange.testing.drivers.agent_driver import copied
from skyrange.testing.drivers.hostile_input import forged, garbage
from skyrange.testing.drivers.outbox_form import MAX_TEXT
from skyrange.testing.drivers.purity import Call, plainly, watched
from skyrange.testing.rules import Broken, RuleBook, need, same, short

PORTS = (Port("blue.gcs", "gcs:blue/b1"), Port("blue.gcs", "gcs:blue/b2"))
"""The link ends at which a monitor listens while it is checked, unless told otherwise."""
LATE_NS = 1_300 * NS_PER_MS
MAX_ALERTS = 1
"""Alerts that one frame of garbage may cause."""
ALERT_KIND = re.compile(r"[a-z0-9_-]+(\.[a-z0-9_-]+)*")

MONITOR: RuleBook[MonitorCase] = RuleBook("monitor")

Served = tuple[Time, int, tuple[Alert, ...]]
"""When, with how many frames, and the alerts."""


@dataclass
class MonitorCase:
    """A monitor to be checked: how a new one is made, where it listens, what is seen there, how long it is served."""

    make: Callable[[], Monitor]
    ports: Sequence[Port]
    payloads: Sequence[bytes]
    until: Time

    def frames(self, payloads: Sequence[bytes] | None = None) -> list[ObservedFrame]:
        """Frames at all ports in turn, received and sent by turns, spread evenly over the time."""
        chosen = self.payloads if payloads is None else payloads
        frames = []
        for number, payload in enumerate(chosen):
            port = self.ports[number // 2 % len(self.ports)]
            at = number * self.until // max(1, len(chosen))
            src, dst = ("peer", port.endpoint) if number % 2 == 0 else (port.endpoint, "peer")
            frames.append(ObservedFrame(port, number % 2 == 0, at, payload, src, dst))
        return frames


def check_monitor(
    monitor: DetectorPlugin | Callable[[], Monitor],
    params: Mapping[str, Any] | None = None,
    *,
    ports: Sequence[Port] = PORTS,
    payloads: Sequence[bytes] = (),
    until: Time = 10 * NS_PER_S,
    name: str | None = None,
) -> None:
    """Check that the monitors of a plugin with `params`, or those that a function makes, keep every rule of `MONITOR`.

    A function returns a new monitor at each call, all alike. `payloads` are seen at `ports`, received and sent by
    turns, evenly over 0…`until` (ns); without any, well-formed MAVLink of every message is. Raises `NonConformance`
    at the first broken rule; `name` stands in it for the monitor's class.
    """
    if isinstance(monitor, DetectorPlugin):
        vehicles = sorted({port.link.partition(":")[2] for port in ports})
        context = DetectorContext("checked", vehicles, Origin(40.778, -73.955), Epoch(0), Chance(7))
        make: Callable[[], Monitor] = partial(monitor, monitor.params.model_validate(dict(params or {})), context)
    else:
        make = monitor
    case = MonitorCase(make, tuple(ports), payloads or list(forged())[::3], until)
    MONITOR.check(f"monitor {name or type(make()).__name__}", case)


def collect_frames(
    ports: Sequence[Port], frames: Sequence[ObservedFrame], names: Sequence[str] | None = None
) -> ObservedFrames:
    """Frames, in order, as a kernel hands them over; `names` are the endpoints, in the order that numbers them."""
    known = sorted({name for frame in frames for name in (frame.src, frame.dst)}) if names is None else names
    number = {name: place for place, name in enumerate(known)}
    place = {port: at for at, port in enumerate(ports)}
    return ObservedFrames(
        ports,
        np.array([place[frame.port] for frame in frames], dtype=np.int64),
        np.array([frame.received for frame in frames], dtype=np.bool_),
        np.array([frame.at for frame in frames], dtype=np.int64),
        payloads=Payloads.of([frame.payload for frame in frames]),
        names=known,
        src=np.array([number[frame.src] for frame in frames], dtype=np.int64),
        dst=np.array([number[frame.dst] for frame in frames], dtype=np.int64),
    )


def serve(
    monitor: Monitor,
    ports: Sequence[Port],
    frames: Sequence[ObservedFrame],
    until: Time,
    *,
    begin: Time = -1,
    call: Call = plainly,
    paused: tuple[Time, Time] | None = None,
    shown: Callable[[ObservedFrames], ObservedFrames] | None = None,
) -> list[Served]:
    """Serve a monitor at every multiple of its service time after `begin` up to `until`, but while it is `paused`.

    Raises `Broken` where it raises an exception or answers with something else than alerts.
    """
    moments: list[Served] = []
    waiting = [frame for frame in frames if frame.at > begin]
    step = monitor.service_ns
    now, taken = ceil_to(begin + 1, step), 0
    while now <= until:
        if paused is None or not paused[0] <= now < paused[1]:
            first = taken
            while taken < len(waiting) and waiting[taken].at <= now:
                taken += 1
            batch = collect_frames(ports, waiting[first:taken])
            alerts = _observe(monitor, now, batch if shown is None else shown(batch), call)
            moments.append((now, taken - first, alerts))
        now += step
    return moments


def _observe(monitor: Monitor, now: Time, frames: ObservedFrames, call: Call) -> tuple[Alert, ...]:
    try:
        alerts = call(monitor.observe, now, frames)
    except Broken:
        raise
    except Exception as error:
        what = f"observe({now}) of frames {short(list(frames.payloads))} raised {error!r}"
        if isinstance(error, ValueError) and "read-only" in str(error):  # numpy's word for a write into what is handed
            raise Broken(what, "no write into what it is handed", "hands-off") from error
        raise Broken(what, "alerts, whatever was seen") from error
    if not isinstance(alerts, list | tuple) or isinstance(alerts, Alert):
        raise Broken(f"answered observe with {short(alerts)}", "a list or tuple of alerts", "alerts")
    for alert in alerts:
        _check_alert(now, alert)
    return tuple(alerts)


def _check_alert(now: Time, alert: Alert) -> None:
    problem = find_problem(now, alert)
    if problem:
        what, _, expected = problem.rpartition("; ")
        raise Broken(what, expected, "alerts")
    kind = alert.kind
    if ALERT_KIND.fullmatch(kind) is None:
        raise Broken(f"raised the kind {short(kind)}", "lower-case words, dotted", "alerts")
    texts = {"subject": alert.subject, "kind": kind, **{str(k): v for k, v in _scalars(alert).items()}}
    for name, text in texts.items():
        if isinstance(text, str) and len(text) > MAX_TEXT:
            raise Broken(f"{kind} has {name} of {len(text)} characters", f"at most {MAX_TEXT}", "alerts")


def _scalars(alert: Alert) -> Mapping[str, object]:
    for key, value in alert.data.items():
        if not isinstance(key, str) or not (value is None or isinstance(value, str | int | float)):
            raise Broken(f"{alert.kind} carries {short(key)}: {short(value)}", "scalars by name", "alerts")
        if isinstance(value, float) and not math.isfinite(value):
            raise Broken(f"{alert.kind} carries {short(key)}: {value}", "a finite number", "alerts")
    return alert.data


@MONITOR.rule("declares", "Has a constant service time above 0 ns.")
def _declares(case: MonitorCase) -> None:
    monitor = case.make()
    service = monitor.service_ns
    proper = isinstance(service, int) and not isinstance(service, bool) and service > 0
    need(proper, f"service_ns is {service!r}", "an int of nanoseconds above 0")
    serve(monitor, case.ports, case.frames(), case.until)
    need(monitor.service_ns == service, f"service_ns was {service} and became {monitor.service_ns}", "no change")


@MONITOR.rule(
    "alerts",
    "Answers with a list or tuple of Alerts: not about the future, of a dotted kind, with a finite score, "
    "finite scalars and texts of at most 4096 characters.",
)
def _alerts(case: MonitorCase) -> None:
    serve(case.make(), case.ports, case.frames(), case.until)


@MONITOR.rule("hands-off", "Does not change its input.")
def _hands_off(case: MonitorCase) -> None:
    handed: list[tuple[ObservedFrames, list[ObservedFrame]]] = []

    def keep(frames: ObservedFrames) -> ObservedFrames:
        handed.append((frames, list(frames.take(np.arange(len(frames))))))
        return frames

    serve(case.make(), case.ports, case.frames(), case.until, shown=keep)
    for frames, before in handed:
        same(before, list(frames.take(np.arange(len(before)))), "what it was handed, before and after", "no change")


@MONITOR.rule("idle", "Survives service without any frames.")
def _idle(case: MonitorCase) -> None:
    serve(case.make(), case.ports, [], case.until)


@MONITOR.rule("repeatable", "Two new instances with the same input raise the same alerts.")
def _repeatable(case: MonitorCase) -> None:
    first, second = (serve(case.make(), case.ports, case.frames(), case.until) for _ in range(2))
    same(first, second, "two instances differ", "the same from the same frames")


@MONITOR.rule("names", "Uses claimed names, not their numbers, which hold for one batch alone.")
def _names(case: MonitorCase) -> None:
    def renumbered(frames: ObservedFrames) -> ObservedFrames:
        return collect_frames(frames.ports, list(frames), ["unseen", *reversed(frames.names)])

    straight = serve(case.make(), case.ports, case.frames(), case.until)
    other = serve(case.make(), case.ports, case.frames(), case.until, shown=renumbered)
    same(straight, other, "other numbers for the same names change its alerts", "the same alerts")


@MONITOR.rule(
    "pure", "Reads no clock, draws no random numbers of its own, never sleeps, and opens no file, socket or thread."
)
def _pure(case: MonitorCase) -> None:
    serve(case.make(), case.ports, case.frames(), case.until)
    serve(case.make(), case.ports, case.frames(), case.until, call=watched)


@MONITOR.rule("late", "Survives service 1.3 s late, with all frames since in one batch.")
def _late(case: MonitorCase) -> None:
    middle = case.until // 2
    pause = (middle, middle + max(LATE_NS, 2 * case.make().service_ns))
    serve(case.make(), case.ports, case.frames(), case.until, paused=pause)


@MONITOR.rule("copies", "A copy or fork made midway continues like the original, and shares no state with it.")
def _copies(case: MonitorCase) -> None:
    frames, middle = case.frames(), case.until // 2
    rest = [moment for moment in serve(case.make(), case.ports, frames, case.until) if moment[0] > middle]
    trunk = case.make()
    last = max((now for now, *_ in serve(trunk, case.ports, frames, middle)), default=-1)
    branch = copied(trunk)
    expected = "a copy that goes on alike, and an original that does not notice"
    for monitor, what in ((branch, "the straight run and the copy differ"), (trunk, "the copy's life shows in it")):
        same(rest, serve(monitor, case.ports, frames, case.until, begin=last), what, expected)


@MONITOR.rule("hostile", "Survives any bytes in a frame, and keeps the form of its alerts.")
def _hostile(case: MonitorCase) -> None:
    serve(case.make(), case.ports, case.frames([*garbage(), *forged()]), case.until)


@MONITOR.rule("modest", "Raises at most 1 alert for each frame of garbage, beyond those that it raises without it.")
def _modest(case: MonitorCase) -> None:
    payloads = garbage()
    quiet, loud = (
        sum(len(alerts) for *_, alerts in serve(case.make(), case.ports, frames, case.until))
        for frames in ([], case.frames(payloads))
    )
    most = MAX_ALERTS * len(payloads)
    need(loud - quiet <= most, f"{loud - quiet} alerts more for {len(payloads)} frames of garbage", f"at most {most}")
