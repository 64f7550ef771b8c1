"""Driver of a single tap, as a kernel drives it: frames when they are sent, wake-ups when due."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import FrozenInstanceError
from typing import Literal

from skyrange.contracts.components import Tap
from skyrange.contracts.frames import Fate, Frame, end_journey
from skyrange.contracts.verdicts import Inject, Verdict
from skyrange.core.ids import FrameId
from skyrange.core.time import NS_PER_S, Time
from skyrange.testing.drivers.agent_driver import MAX_WAKEUPS_PER_S, wakeup
from skyrange.testing.drivers.purity import Call, plainly
from skyrange.testing.rules import Broken, short

Moment = tuple[Time, FrameId | None, tuple[Verdict, ...], Time | None]
"""When, on which frame (`None`: a wake-up), the verdicts, the next wake-up."""


def watch(
    tap: Tap,
    frames: Sequence[Frame],
    until: Time,
    *,
    begin: Time = -1,
    call: Call = plainly,
    lag_ns: Time = 0,
    fate: Fate | None = None,
) -> list[Moment]:
    """Show `frames` to a tap at the times they were sent, and wake it when it asks, after `begin` up to `until`.

    With a `fate`, each frame meets it once it has been judged, as in a kernel.
    """
    moments: list[Moment] = []
    now, shown, woken = begin, 0, 0
    allowed = MAX_WAKEUPS_PER_S * (1 + (until - begin) // NS_PER_S)
    wish = wakeup(tap, None, call)
    due = _due(wish, None, None, now)
    while True:
        frame = frames[shown] if shown < len(frames) else None
        if frame is not None and (due is None or max(frame.sent_ns, now) <= due + lag_ns):
            now = max(frame.sent_ns, now)
            verdicts = _answer(call, "on_frame", tap.on_frame, now, frame)
            shown += 1
        elif due is not None and due + lag_ns <= until:
            now, due, frame = due + lag_ns, None, None
            verdicts = _answer(call, "on_wakeup", tap.on_wakeup, now)
            woken += 1
            if woken > allowed:
                raise Broken(f"woke {woken} times by {now} ns", f"at most {MAX_WAKEUPS_PER_S} a second", "wakeups")
        else:
            return moments
        before, wish = wish, wakeup(tap, None if frame is not None else now, call)
        due = _due(wish, before, due, now)
        moments.append((now, None if frame is None else frame.id, verdicts, wish))
        if frame is not None and fate is not None:
            end_journey(frame, fate, now)


def _due(wish: Time | None, before: Time | None, due: Time | None, now: Time) -> Time | None:
    """When to wake it next: an unchanged wish stays due when it was, a new one comes after now."""
    if wish is None:
        return None
    return due if due is not None and wish == before else max(wish, now + 1)


def _answer(
    call: Call, what: Literal["on_frame", "on_wakeup"], method: Callable[..., Sequence[Verdict]], *args: object
) -> tuple[Verdict, ...]:
    """The verdicts, checked to be a sequence of them."""
    shown = short(args)
    try:
        verdicts = call(method, *args)
    except Broken:
        raise
    except FrozenInstanceError as error:
        expected = "verdicts that say what it wants changed"
        raise Broken(f"{what}{shown} raised {error!r}", expected, "hands-off") from error
    except Exception as error:
        raise Broken(f"{what}{shown} raised {error!r}", "verdicts, whatever passes") from error
    if not isinstance(verdicts, list | tuple) or isinstance(verdicts, Verdict):
        raise Broken(f"answered {what} with {short(verdicts)}", "a list or tuple of verdicts", "verdicts")
    for verdict in verdicts:
        fits = isinstance(verdict, Inject if what == "on_wakeup" else Verdict)
        if not fits:
            expected = "Injects only" if what == "on_wakeup" else "Pass, Drop, Delay, Replace, Inject or Note"
            raise Broken(f"answered {what} with {short(verdict)}", expected, "verdicts")
    return tuple(verdicts)
