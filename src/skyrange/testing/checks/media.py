"""Conformance check of radio media (`skyrange.contracts.medium.Medium`)."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from skyrange.contracts.medium import (
    ANY_CHANNEL,
    Medium,
    OnAir,
    RadioSpec,
    RadioTable,
    ReceptionOutcome,
    ScanSchedule,
    ScanStep,
    TransmissionFate,
    TxBatch,
    Waveform,
)
from skyrange.core.chance import Chance
from skyrange.core.errors import ComponentError
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.radio.contract import MediumContext, MediumPlugin
from skyrange.testing.drivers.agent_driver import copied
from skyrange.testing.drivers.purity import Call, plainly, watched
from skyrange.testing.rules import Broken, RuleBook, need, same, short

TICK_NS = 10 * NS_PER_MS
"""How often places change, however the time is cut."""
UNTIL_NS = 3 * NS_PER_S
TOLD_NS = 2 * NS_PER_S
"""By when everything about a frame has been told."""
_WIFI = (Waveform.DSSS_1M, Waveform.OFDM_6M)
_EARS = (
    ScanSchedule((ScanStep(6, _WIFI),)),
    ScanSchedule(
        tuple(ScanStep(37 + k % 3, (Waveform.BLE_1M, Waveform.BLE_CODED)[k // 3 :][:1]) for k in range(6)),
        30 * NS_PER_MS,
        30 * NS_PER_MS,
    ),
)

MEDIUM: RuleBook[MediumCase] = RuleBook("medium")

Request = tuple[str, Time, int, int, int]
"""Radio, time, waveform, size, key."""
Row = tuple[object, ...]


@dataclass
class MediumCase:
    """A medium to be checked: how a fresh one is made of radios."""

    factory: Callable[[Sequence[RadioSpec]], Medium]
    _open: list[Medium] = field(default_factory=list)

    def make(self, of: Sequence[RadioSpec]) -> Medium:
        """A fresh medium, which is closed after the check."""
        return self.add(self.factory(of))

    def add(self, medium: Medium) -> Medium:
        """One more to be closed after the check."""
        self._open.append(medium)
        return medium

    def close(self) -> None:
        """Close every medium that was made."""
        while self._open:
            with suppress(Exception):  # that it may be closed is a rule of its own
                self._open.pop().close()

    @property
    def repeats(self) -> bool:
        """Whether the medium says that it repeats to the byte."""
        return self.make(radios()).repeatable == "bytes"

    @property
    def runs_programs(self) -> bool:
        """Whether the medium says that it runs programs: these need sockets and files, and need not be copied."""
        return self.make(radios()).runs_programs


def check_medium(
    medium: MediumPlugin | Callable[[Sequence[RadioSpec]], Medium],
    params: Mapping[str, Any] | None = None,
    *,
    name: str | None = None,
) -> None:
    """Check that the media of a plugin with `params`, or those that a function makes, keep every rule of `MEDIUM`.

    A function is called with radios, and returns a fresh medium of them at each call, all alike, over open ground. Of a
    medium that does not repeat to the byte, nothing is asked that compares two of them; of one that runs programs,
    nothing that only code within this process can keep. Raises `NonConformance` at the first broken
    rule; `name` stands in it for the medium's class.
    """
    if isinstance(medium, MediumPlugin):
        plugin, settings = medium, medium.params.model_validate(dict(params or {}))
        case = MediumCase(lambda of: plugin(settings, MediumContext(of, Chance(7))))
    else:
        case = MediumCase(medium)
    try:
        MEDIUM.check(f"medium {name or type(case.make(radios())).__name__}", case)
    finally:
        case.close()


def radios(*, far: bool = False) -> list[RadioSpec]:
    """Six that move and one that stands; with `far` two more, 90 km off, before and after them by name."""
    near = [RadioSpec(f"blue/b{k}", listening=_EARS) for k in range(6)]
    near.append(RadioSpec("mast", (0.0, 0.0, 10.0), _EARS))
    if far:
        near += [RadioSpec(name, (9e4, 9e4, 10.0), _EARS) for name in ("aaa", "zzz")]
    return near


def requests() -> list[Request]:
    """What the six send: all waveforms, at all phases, some at once."""
    offered: list[Request] = []
    for second in range(2):
        for k in range(6):
            for waveform in Waveform:
                at = second * NS_PER_S + 1 + k % 5 * 170 * NS_PER_MS + 3_331 * int(waveform)
                size = 37 if waveform == Waveform.BLE_1M else 180
                offered.append((f"blue/b{k}", at, int(waveform), size, len(offered)))
    return offered


def live(
    medium: Medium, offered: Sequence[Request], begin: Time = 0, until: Time = UNTIL_NS, cut: Time = TICK_NS,
    call: Call = plainly,
) -> list[OnAir]:  # fmt: skip
    """Let a medium live from `begin` to `until`, in steps of `cut`."""
    row = {radio.name: k for k, radio in enumerate(medium.radios)}
    base = np.array([radio.place_enu_m or (0.0, 0.0, 0.0) for radio in medium.radios])
    moving = np.array([radio.place_enu_m is None for radio in medium.radios])
    number = np.array([int(radio.name[-1]) if radio.place_enu_m is None else 0 for radio in medium.radios])
    answers = []
    for now in range(begin + cut, until + 1, cut):
        tick = (now - 1) // TICK_NS * TICK_NS
        pos, vel = base.copy(), np.zeros_like(base)
        pos[moving] = np.stack((60.0 * number, 20.0 + 8.0 * tick / NS_PER_S + 0.0 * number, 40.0 + number), 1)[moving]
        vel[moving] = (0.0, 8.0, 0.0)
        due = [request for request in offered if now - cut < request[1] <= now]
        if due:
            names, *columns = zip(*due, strict=True)
            at, waveform, size, key = (np.array(column, dtype=np.int64) for column in columns)
            radio = np.array([row[name] for name in names], dtype=np.int64)
            free = np.full(len(due), ANY_CHANNEL, dtype=np.int64)
            call(medium.offer, now, TxBatch(radio, at, waveform, free, np.full(len(due), np.nan), size, key))
        answer = call(medium.advance, now, RadioTable(tick, pos, vel))
        need(isinstance(answer, OnAir), f"advance({now}) answered {short(answer)}", "an OnAir")
        answers.append(answer)
    return answers


def list_rows(medium: Medium, answers: Sequence[OnAir]) -> tuple[list[Row], list[Row]]:
    """Answers as rows that can be compared: sent, and heard, with radios by name."""
    names = [radio.name for radio in medium.radios]
    rows: tuple[list[Row], list[Row]] = ([], [])
    for answer in answers:
        for table_rows, table in zip(rows, answer, strict=True):
            for key, radio, *rest in zip(*(column.tolist() for column in table), strict=True):
                table_rows.append((key, names[radio], *rest))
    return sorted(rows[0], key=repr), rows[1]


@MEDIUM.rule(
    "declares", "Has its radios sorted by name, each once, a look-ahead of at least 0 ns, and a repeatability."
)
def _declares(case: MediumCase) -> None:
    medium = case.make(radios()[::-1])
    names = [radio.name for radio in medium.radios]
    need(names == sorted(radio.name for radio in radios()), f"radios are {names}", "those it was made of, by name")
    need(medium.lookahead_ns >= 0, f"lookahead_ns is {medium.lookahead_ns}", "0 or more")
    need(
        medium.losses.shape == (len(names), len(ReceptionOutcome)),
        f"losses of {medium.losses.shape}",
        "(radios, outcomes)",
    )
    need(medium.repeatable in ("bytes", "outcome"), f"repeatable is {medium.repeatable!r}", "bytes or outcome")
    programs = [program.name for program in medium.programs]
    need(medium.runs_programs or not programs, f"runs {programs} and no programs", "runs_programs, if it runs any")
    need(isinstance(medium.manifest, Mapping), f"manifest is {short(medium.manifest)}", "a mapping")


@MEDIUM.rule("answers", "Reports what happened in each step: existing rows, with ends in the step, in order.")
def _answers(case: MediumCase) -> None:
    medium = case.make(radios())
    begin = 0
    for answer in live(medium, requests()):
        end = begin + TICK_NS
        sizes = {len(column) for column in answer.sent}, {len(column) for column in answer.heard}
        need(all(len(size) == 1 for size in sizes), f"columns of {sizes} rows", "columns of one length")
        for table in (answer.sent, answer.heard):
            for ended in table.ended_ns.tolist():
                need(begin < ended <= end, f"an end at {ended} in ({begin}, {end}]", "ends within the step")
            need(bool((table.radio >= 0).all() and (table.radio < len(medium.radios)).all()), "no such row", "radios")
        order = list(zip(*(answer.heard[k].tolist() for k in (3, 0, 1)), strict=True))
        need(order == sorted(order), f"receptions in the order {short(order)}", "by end, key, receiver")
        need(bool(np.isfinite(answer.heard.rssi_dbm).all()), "a strength that is no number", "dBm")
        begin = end


@MEDIUM.rule("tells", "Reports the fate of every frame within two seconds, and nothing after it.")
def _tells(case: MediumCase) -> None:
    medium = case.make(radios())
    offered_ns = {request[4]: request[1] for request in requests()}
    ended_keys: set[int] = set()
    for answer in live(medium, requests(), until=UNTIL_NS + TOLD_NS):
        for key, ended in zip(answer.sent.key.tolist(), answer.sent.ended_ns.tolist(), strict=True):
            need(key in offered_ns, f"told of {key}", "keys that were offered")
            need(
                ended <= offered_ns[key] + TOLD_NS,
                f"{key} ended {ended - offered_ns[key]} ns after its time",
                "2 s at most",
            )
            ended_keys.add(key)
    need(
        ended_keys == offered_ns.keys(),
        f"said nothing of {short(sorted(offered_ns.keys() - ended_keys))}",
        "all frames accounted for",
    )
    need(medium.quiet, "is not quiet when all is over", "quiet")


@MEDIUM.rule("hears", "Lets radios in sight receive each other, and never themselves.")
def _hears(case: MediumCase) -> None:
    medium = case.make(radios())
    senders = {request[4]: request[0] for request in requests()}
    heard = [row for row in list_rows(medium, live(medium, requests()))[1] if row[-1] == ReceptionOutcome.DECODED]
    need(len(heard) > 0, "nobody heard anything", "receptions")
    for row in heard:
        need(senders[row[0]] != row[1], f"{row[1]} heard itself", "receivers other than the sender")  # type: ignore[index]


@MEDIUM.rule("cut", "Answers the same in steps of 1 ms and of 10 ms.")
def _cut(case: MediumCase) -> None:
    if not case.repeats:
        return
    fine, coarse = case.make(radios()), case.make(radios())
    expected = "answers that do not depend on how advance is cut"
    a, b = list_rows(fine, live(fine, requests(), cut=NS_PER_MS)), list_rows(coarse, live(coarse, requests()))
    same(a[1], b[1], "receptions in cuts of 1 and 10 ms differ", expected)
    same(a[0], b[0], "transmissions in cuts of 1 and 10 ms differ", expected)


@MEDIUM.rule("company", "Answers the same for radios whatever others are out of reach.")
def _company(case: MediumCase) -> None:
    if not case.repeats:
        return
    alone, company = case.make(radios()), case.make(radios(far=True))
    a, b = list_rows(alone, live(alone, requests())), list_rows(company, live(company, requests()))
    same(a[1], b[1], "two radios 90 km off change receptions", "chance by names, not by rows")
    same(a[0], b[0], "two radios 90 km off change transmissions", "chance by names, not by rows")


@MEDIUM.rule("repeatable", "If declared: two new instances give the same answers.")
def _repeatable(case: MediumCase) -> None:
    if not case.repeats:
        return
    first, second = (
        list_rows(medium, live(medium, requests())) for medium in (case.make(radios()), case.make(radios()))
    )
    same(first[1], second[1], "two instances differ", "the same from the same inputs")


@MEDIUM.rule(
    "pure",
    "Reads no clock, draws no random numbers of its own, never sleeps, and opens no file, socket or "
    "thread. Not checked of media that run programs.",
)
def _pure(case: MediumCase) -> None:
    if case.runs_programs:
        return
    live(case.make(radios()), requests())
    live(case.make(radios()), requests(), call=watched)


@MEDIUM.rule(
    "copies",
    "A deep copy made midway continues like the original, and shares no state with it. A medium that runs "
    "programs may refuse with a ComponentError.",
)
def _copies(case: MediumCase) -> None:
    middle = 1_010 * NS_PER_MS  # advertising events are under way
    trunk = case.make(radios())
    live(trunk, requests(), until=middle)
    if case.runs_programs:
        try:
            branch = case.add(copy.deepcopy(trunk))
        except ComponentError:
            return
    else:
        branch = case.add(copied(trunk))
    if not case.repeats:
        return
    straight = case.make(radios())
    rest = list_rows(straight, live(straight, requests())[middle // TICK_NS :])
    expected = "a copy that goes on alike, and an original that does not notice"
    for medium in (branch, trunk):
        later = list_rows(medium, live(medium, requests(), begin=middle))
        same(rest[1], later[1], "receptions of the straight run and of a copy differ", expected)
        same(rest[0], later[0], "transmissions of the straight run and of a copy differ", expected)


@MEDIUM.rule("refuses", "Refuses an impossible frame, whatever its numbers, and continues.")
def _refuses(case: MediumCase) -> None:
    medium = case.make(radios())
    sizes = (0, -5, 10**12, -(2**62))
    wrong = [("blue/b0", 1 + k, int(Waveform.OFDM_6M), size, 1_000 + k) for k, size in enumerate(sizes)]
    wrong += [("blue/b0", 9 + k, waveform, 180, 2_000 + k) for k, waveform in enumerate((-1, 4, 2**40))]
    try:
        answers = live(medium, [*wrong, *requests()])
    except Broken:
        raise
    except Exception as error:
        raise Broken(f"raised {error!r}", "frames that are REFUSED in `Sent`") from error
    fates = {
        key: fate for answer in answers for key, fate in zip(*(answer.sent[k].tolist() for k in (0, 5)), strict=True)
    }
    for _, _, waveform, size, key in wrong:
        need(
            fates.get(key) == TransmissionFate.REFUSED,
            f"{size} bytes in waveform {waveform}: {fates.get(key)}",
            "REFUSED",
        )
    need(TransmissionFate.SENT in fates.values(), "nothing was sent any more", "the good frames sent")


@MEDIUM.rule("closes", "Can be closed at any time, and again.")
def _closes(case: MediumCase) -> None:
    medium = case.make(radios())
    live(medium, requests(), until=NS_PER_S // 2)
    for _ in range(2):
        try:
            medium.close()
        except Exception as error:
            raise Broken(f"close() raised {error!r}", "no error") from error
