"""Conformance check of taps (`skyrange.contracts.components.Tap`), driven alone as a kernel drives them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import FrozenInstanceError, dataclass
from typing import Literal

from skyrange.contracts.components import Tap
from skyrange.contracts.frames import Fate, Frame, end_journey
from skyrange.contracts.mailboxes import Note
from skyrange.contracts.verdicts import Delay, Drop, Inject, Pass, Replace, Verdict
from skyrange.core.ids import FrameId
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.testing.drivers.agent_driver import MAX_WAKEUPS_PER_S, copied, wakeup
from skyrange.testing.drivers.hostile_input import forged, garbage
from skyrange.testing.drivers.outbox_form import MAX_PAYLOAD_BYTES
from skyrange.testing.drivers.purity import Call, plainly, watched
from skyrange.testing.rules import Broken, RuleBook, need, same, short

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
    requested_ns = wakeup(tap, None, call)
    due = _due(requested_ns, None, None, now)
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
        before, requested_ns = requested_ns, wakeup(tap, None if frame is not None else now, call)
        due = _due(requested_ns, before, due, now)
        moments.append((now, None if frame is None else frame.id, verdicts, requested_ns))
        if frame is not None and fate is not None:
            end_journey(frame, fate, now)


def _due(requested_ns: Time | None, before: Time | None, due: Time | None, now: Time) -> Time | None:
    """When to wake it next: an unchanged request stays due when it was, a new one comes after now."""
    if requested_ns is None:
        return None
    return due if due is not None and requested_ns == before else max(requested_ns, now + 1)


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


LATE_NS = 1_300 * NS_PER_MS
MAX_INJECTS = 64
"""Frames that a tap may put on its link in answer to one frame or one wake-up."""
LINK = "gcs:blue/b1"
"""The link instance that a tap is checked on, unless told otherwise."""
_ENDS = ("blue.gcs", "blue/b1.companion")

TAP: RuleBook[TapCase] = RuleBook("tap")


@dataclass
class TapCase:
    """A tap to be checked: how a fresh one is made for a link, what passes there, how long it is driven."""

    make: Callable[[str], Tap]
    link: str
    payloads: Sequence[bytes]
    until: Time

    def frames(self, payloads: Sequence[bytes] | None = None) -> list[Frame]:
        """Fresh frames in both directions by turns, spread evenly over the time."""
        chosen = self.payloads if payloads is None else payloads
        made = []
        for number, payload in enumerate(chosen):
            direction, (src, dst) = ("fwd", _ENDS) if number % 2 == 0 else ("rev", _ENDS[::-1])
            sent = number * self.until // max(1, len(chosen))
            made.append(Frame(self.link, direction, src, number // 2, src, dst, sent_ns=sent, payload=payload))
        return made


def check_tap(
    make: Callable[[str], Tap],
    *,
    link: str = LINK,
    payloads: Sequence[bytes] = (),
    until: Time = 10 * NS_PER_S,
    name: str | None = None,
) -> None:
    """Check that the taps which `make(link)` returns keep every rule of `TAP`.

    Each call of `make` returns a fresh tap, all alike. `payloads` pass it in both directions by turns,
    evenly over 0…`until` (ns); without any, well-formed MAVLink of every message does. Raises
    `NonConformance` at the first broken rule; `name` stands in it for the tap's class.
    """
    case = TapCase(make, link, payloads or list(forged())[::3], until)
    TAP.check(f"tap {name or type(make(link)).__name__}", case)


@TAP.rule(
    "verdicts", "Answers a frame with a sequence of verdicts, never a generator, and a wake-up with Injects alone."
)
def _verdicts(case: TapCase) -> None:
    watch(case.make(case.link), case.frames(), case.until)


@TAP.rule("one-fate", "Decides at most once on a frame: Pass, Drop, Replace, Delay, or Delay with Replace.")
def _one_fate(case: TapCase) -> None:
    allowed = [{Pass}, {Drop}, {Replace}, {Delay}, {Delay, Replace}, set()]
    for now, frame, verdicts, _ in watch(case.make(case.link), case.frames(), case.until):
        kinds = Counter(type(verdict) for verdict in verdicts if not isinstance(verdict, Inject | Note))
        once = max(kinds.values(), default=0) <= 1 and set(kinds) in allowed
        need(once, f"said {short(verdicts)} of {frame} at {now}", "at most one fate")


@TAP.rule(
    "values", "Delays to a time in whole ns not before now, sends bytes of at most 1 MiB, and injects fwd or rev."
)
def _values(case: TapCase) -> None:
    for now, _, verdicts, _ in watch(case.make(case.link), case.frames(), case.until):
        for verdict in verdicts:
            _check_values(now, verdict)


@TAP.rule("parents", "Names as an Inject's parent only a frame that it received.")
def _parents(case: TapCase) -> None:
    seen: set[FrameId] = set()
    for now, frame, verdicts, _ in watch(case.make(case.link), case.frames(), case.until):
        if frame is not None:
            seen.add(frame)
        for verdict in verdicts:
            parent = verdict.parent if isinstance(verdict, Inject) else None
            need(parent is None or parent in seen, f"replayed {parent} at {now}", "a frame that it has seen")


@TAP.rule("wakeups", "Asks for no wake-up, or for one after now, in whole ns. Asking twice changes nothing.")
def _wakeups(case: TapCase) -> None:
    watch(case.make(case.link), [], case.until)


@TAP.rule("hands-off", "Does not change frames: its verdicts say what is to change.")
def _hands_off(case: TapCase) -> None:
    watch(case.make(case.link), case.frames(), case.until)


@TAP.rule("repeatable", "Two new instances with the same frames at the same times give the same verdicts.")
def _repeatable(case: TapCase) -> None:
    first, second = (watch(case.make(case.link), case.frames(), case.until) for _ in range(2))
    _same(first, second, "two instances differ", "the same from the same inputs")


@TAP.rule("muted", "Acts in the same way whether its verdicts take effect or not.")
def _muted(case: TapCase) -> None:
    alone = watch(case.make(case.link), case.frames(), case.until)
    muted = watch(case.make(case.link), case.frames(), case.until, fate=Fate.DELIVERED)
    effective = watch(case.make(case.link), case.frames(), case.until, fate=Fate.DROPPED)
    for other in (muted, effective):
        _same(alone, other, "verdicts depend on what becomes of earlier frames", "the same acts, muted or not")


@TAP.rule(
    "pure", "Reads no clock, draws no random numbers of its own, never sleeps, and opens no file, socket or thread."
)
def _pure(case: TapCase) -> None:
    watch(case.make(case.link), case.frames(), case.until)
    watch(case.make(case.link), case.frames(), case.until, call=watched)


@TAP.rule("late", "Survives a wake-up 1.3 s late.")
def _late(case: TapCase) -> None:
    watch(case.make(case.link), case.frames(), case.until, lag_ns=LATE_NS)


@TAP.rule("copies", "A copy or fork made midway continues like the original, and shares no state with it.")
def _copies(case: TapCase) -> None:
    frames, middle = case.frames(), case.until // 2
    straight = watch(case.make(case.link), case.frames(), case.until)
    rest = [moment for moment in straight if moment[0] > middle]
    trunk = case.make(case.link)
    watch(trunk, [frame for frame in frames if frame.sent_ns <= middle], middle)
    branch = copied(trunk)
    later = [frame for frame in frames if frame.sent_ns > middle]
    expected = "a copy that goes on alike, and an original that does not notice"
    _same(rest, watch(branch, later, case.until, begin=middle), "the straight run and the copy differ", expected)
    _same(rest, watch(trunk, later, case.until, begin=middle), "the copy's life shows in the original", expected)


@TAP.rule("hostile", "Survives any bytes in a frame, and keeps the form of its verdicts.")
def _hostile(case: TapCase) -> None:
    for now, _, verdicts, _ in watch(case.make(case.link), case.frames([*garbage(), *forged()]), case.until):
        for verdict in verdicts:
            _check_values(now, verdict)


@TAP.rule("modest", "Injects at most 64 frames for one frame or wake-up.")
def _modest(case: TapCase) -> None:
    for now, _, verdicts, _ in watch(case.make(case.link), case.frames(), case.until):
        count = sum(isinstance(verdict, Inject) for verdict in verdicts)
        need(count <= MAX_INJECTS, f"injected {count} frames at {now}", f"at most {MAX_INJECTS}")


def _check_values(now: Time, verdict: Verdict) -> None:
    if isinstance(verdict, Delay):
        until = verdict.until
        is_time = isinstance(until, int) and not isinstance(until, bool) and until >= now
        need(is_time, f"delayed to {until!r} at {now}", "a Python int of nanoseconds, not before now")
    if isinstance(verdict, Replace | Inject):
        payload = verdict.payload
        need(type(payload) is bytes, f"put a payload of {type(payload).__name__} on the link", "bytes")
        need(len(payload) <= MAX_PAYLOAD_BYTES, f"sent {len(payload)} bytes at once", f"at most {MAX_PAYLOAD_BYTES}")
    if isinstance(verdict, Inject):
        need(verdict.direction in ("fwd", "rev"), f"injected {verdict.direction!r}", "fwd or rev")
        claims = all(isinstance(claim, str) and claim for claim in (verdict.src, verdict.dst))
        need(claims, f"claims {verdict.src!r} to {verdict.dst!r}", "endpoint names")
        parent = verdict.parent
        need(parent is None or isinstance(parent, FrameId), f"names the parent {short(parent)}", "a FrameId or None")


def _same(first: Sequence[Moment], second: Sequence[Moment], what: str, expected: str) -> None:
    same(first, second, what, expected)
