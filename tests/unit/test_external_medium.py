"""A medium whose engine is another program, and what it does with engines that misbehave."""

from __future__ import annotations

import copy
import gc
import math
import os
import signal
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from skyrange.codec import medium_protocol as protocol
from skyrange.contracts.components import InstanceStatus
from skyrange.contracts.medium import (
    ANY_CHANNEL,
    EmitterTable,
    OnAir,
    RadioSpec,
    RadioTable,
    ReceptionOutcome,
    TransmissionFate,
    TxBatch,
    Waveform,
)
from skyrange.core.chance import Chance
from skyrange.core.errors import ComponentError, InputError
from skyrange.core.time import NS_PER_MS, NS_PER_S
from skyrange.radio.builtin.listening import HOPPER, SNIFFER
from skyrange.radio.builtin.params import RadioEnvironment
from skyrange.radio.contract import MediumContext
from skyrange.radio.external.medium import ExternalMedium

pytestmark = pytest.mark.rotating

ENGINE = (
    f"""
import sys
sys.path.insert(0, {str(Path(__file__).parents[2])!r})
"""
    + """
import os, socket
import numpy as np
from skyrange.codec import medium_protocol as p
from skyrange.codec.medium_protocol import MessageType as M
from tests import engine_messages as e
link = socket.socket(fileno=0)
passed = []
def read(count):
    data = b""
    while len(data) < count:
        piece, descriptors, _, _ = socket.recv_fds(link, count - len(data), 1)
        if not piece:
            os._exit(0)
        passed.extend(descriptors)
        data += piece
    return data
def receive():
    global number
    length, kind, number = p.unpack_header(read(12))
    return kind, read(length)
def answer(kind, body=b""):
    link.sendall(p.pack(kind, number, body))
def ready(**other):
    fields = dict(name="test", release="1", waveforms=2, abilities=p.Ability(5), lookahead_ns=0) | other
    answer(M.READY, e.encode_ready(p.Ready(**fields)))
def done(sent=(), heard=(), active=0):
    answer(M.DONE, e.encode_done(p.Done(active, 0, np.array(list(sent), p.SENT), np.array(list(heard), p.HEARD))))
kind, body = receive()
hello = e.decode_hello(body)
n = len(hello.radios)
"""
)
"""The beginning of an engine; each test has an end of its own."""

ALL = """
ready()
while True:
    kind, body = receive()
    if kind != M.ADVANCE:
        break
    asked = e.decode_advance(body, n)
    sent, heard = [], []
    for t in asked.transmissions:
        sent.append((t["key"], t["at_ns"], asked.until_ns, t["radio"], t["channel"], 0))
        for path in asked.paths[t["first_path"] : t["first_path"] + t["paths"]]:
            dbm = t["power_dbm"] + path["gain_db"]
            heard.append((t["key"], asked.until_ns, dbm, 20.0, path["radio"], t["channel"], 0))
    print(len(asked.noise), asked.noise["from_ns"].tolist(), asked.noise["to_ns"].tolist(), flush=True)
    done(sent, heard)
"""
"""Every frame ends at the end of the step and reaches all radios in its paths."""

RADIOS = [RadioSpec(name, listening=SNIFFER) for name in ("a", "b", "c")]


def _medium(
    end: str,
    radios: list[RadioSpec] = RADIOS,
    deadline_s: float = 20.0,
    context_deadline_s: float = math.inf,
    **context: object,
) -> ExternalMedium:
    given = MediumContext(radios, Chance(1), deadline_s=context_deadline_s, **context)  # type: ignore[arg-type]
    return ExternalMedium("test", [sys.executable, "-c", ENGINE + end], given, deadline_s=deadline_s)


def _table(medium: ExternalMedium, places: list[tuple[float, float, float]] | None = None) -> RadioTable:
    given = places or [(100.0 * k, 0.0, 50.0) for k in range(len(medium.radios))]
    return RadioTable(0, np.array(given), np.zeros((len(given), 3)))


def _batch(*rows: tuple[int, int, int, int]) -> TxBatch:
    """Frames of 100 bytes: radio, time, waveform, key."""
    radio, at, kind, key = (np.array(column, dtype=np.int64) for column in zip(*rows, strict=True))
    count = len(rows)
    return TxBatch(radio, at, kind, np.full(count, ANY_CHANNEL), np.full(count, np.nan), np.full(count, 100), key)


def _one(medium: ExternalMedium) -> OnAir:
    medium.offer(1, _batch((0, NS_PER_MS, Waveform.OFDM_6M, 5)))
    return medium.advance(10 * NS_PER_MS, _table(medium))


def test_a_frame_goes_out_and_comes_back() -> None:
    medium = _medium(ALL)
    try:
        answer = _one(medium)
        assert answer.sent.key.tolist() == [5]
        assert answer.heard.radio.tolist() == [1, 2]
        assert answer.heard.outcome.tolist() == [ReceptionOutcome.DECODED] * 2
        assert answer.heard.rssi_dbm[0] > answer.heard.rssi_dbm[1] > -100.0
        assert medium.losses[:, ReceptionOutcome.DECODED].tolist() == [0, 1, 1]
        assert medium.quiet
        assert medium.manifest["engine"] == "test"
        assert medium.manifest["builtin_waveforms"] == ["DSSS_1M", "BLE_1M", "BLE_CODED"]
    finally:
        medium.close()


def test_gains_are_those_of_the_builtin() -> None:
    from skyrange.radio.builtin.medium import BuiltinMedium

    medium = _medium(ALL)
    builtin = BuiltinMedium(RADIOS, Chance(1), every_pair=True)
    try:
        ours = _one(medium).heard
        builtin.offer(1, _batch((0, NS_PER_MS, Waveform.OFDM_6M, 5)))
        theirs = builtin.advance(10 * NS_PER_MS, _table(medium)).heard
        assert ours.radio.tolist() == theirs.radio.tolist()
        # the same path; fading may be of another bin, because the builtin's frame starts after DIFS
        assert np.abs(ours.rssi_dbm - theirs.rssi_dbm).max() < 6.0
    finally:
        medium.close()


def test_a_receiver_that_listens_elsewhere_hears_nothing() -> None:
    hopper = RadioSpec("b", listening=HOPPER)
    medium = _medium(ALL, [RADIOS[0], hopper, RADIOS[2]])
    try:
        heard = [0, 0, 0]
        for step in range(130):  # 2.6 s, one turn through 13 channels
            medium.offer(step, _batch((0, step * 20 * NS_PER_MS + 1, Waveform.OFDM_6M, step)))
            for radio in medium.advance((step + 1) * 20 * NS_PER_MS, _table(medium)).heard.radio.tolist():
                heard[radio] += 1
        assert heard[2] == 130
        assert heard[1] in (9, 10)  # 200 ms of 2.6 s; the engine lets each frame last up to 20 ms
        assert medium.losses[1, ReceptionOutcome.ELSEWHERE] == 130 - heard[1]
    finally:
        medium.close()


def test_waveforms_that_the_engine_lacks_stay_builtin() -> None:
    medium = _medium(ALL)
    try:
        medium.offer(1, _batch((0, NS_PER_MS, Waveform.DSSS_1M, 5)))
        answer = medium.advance(10 * NS_PER_MS, _table(medium))
        assert answer.sent.key.tolist() == [5]
        assert answer.heard.snir_db[0] != 20.0  # the engine would have said so
    finally:
        medium.close()


def test_frames_that_cannot_be_are_refused() -> None:
    medium = _medium(ALL)
    try:
        batch = _batch(*((0, NS_PER_MS, int(Waveform.OFDM_6M), key) for key in range(5)))
        batch.size_bytes[:] = (10**9, 13, 100, 100, 100)
        batch.channel[:] = (6, 6, 14, 6, 6)
        batch.power_dbm[:] = (0.0, 0.0, 0.0, 1e9, 0.0)
        medium.offer(1, batch)
        answer = medium.advance(10 * NS_PER_MS, _table(medium))
        fates = dict(zip(answer.sent.key.tolist(), answer.sent.fate.tolist(), strict=True))
        refused, sent = TransmissionFate.REFUSED, TransmissionFate.SENT
        assert fates == {0: refused, 1: refused, 2: refused, 3: refused, 4: sent}
    finally:
        medium.close()


def _noise_lines(medium: ExternalMedium) -> list[str]:
    return medium._engine._program._output.read_text().splitlines()


def test_noise_is_cut_into_pieces_that_follow_each_other() -> None:
    medium = _medium(ALL)
    try:
        row = [np.array([value]) for value in (1, 2437.0, 20.0, 20.0, 5 * NS_PER_MS, 70 * NS_PER_MS)]
        medium.emit(0, EmitterTable(*row))
        for step in range(1, 12):
            if step == 3:  # the same sources again: nothing is sent twice
                medium.emit(20 * NS_PER_MS, EmitterTable(*row))
            medium.advance(step * 10 * NS_PER_MS, _table(medium))
        found = [line.split(" ", 1)[1] for line in _noise_lines(medium) if not line.startswith("0 ")]
        assert found == [
            "[5000000] [20000000]", "[20000000] [40000000]", "[40000000] [60000000]", "[60000000] [70000000]"
        ]  # fmt: skip
    finally:
        medium.close()


def test_background_traffic_is_noise_at_each_receiver() -> None:
    medium = _medium(ALL, surroundings=RadioEnvironment(city_busy=0.2))
    try:
        for step in range(1, 101):
            medium.advance(step * 10 * NS_PER_MS, _table(medium))
        count = sum(int(line.split()[0]) for line in _noise_lines(medium))
        assert 3 * 1000 * 0.15 < count < 3 * 1000 * 0.25  # busy in 20 % of the intervals of 1 ms
    finally:
        medium.close()


def test_it_does_nothing_while_nothing_is_on_the_air() -> None:
    medium = _medium(ALL)
    try:
        for step in range(1, 50):
            medium.advance(step * 10 * NS_PER_MS, _table(medium))
        assert _noise_lines(medium) == []
    finally:
        medium.close()


@pytest.mark.parametrize(
    ("end", "words"),
    [
        ("answer(M.FAILED, e.encode_failed('no such model'))", "failed: no such model"),
        ("answer(M.DONE)", "DONE instead of READY"),
        ("link.sendall(b'GARBAGE! HTTP/1.1 400')", "none of this protocol"),
        ("number = 99; ready()", "answered request 99; request 1 is open"),
        ("b = bytearray(e.encode_ready(p.Ready('t', '1', 2, p.Ability(0), 0))); b[8] = 2; answer(M.READY, bytes(b))",
         "version 2 of the medium protocol; this is version 1"),
        ("answer(M.READY, b'SKY')", "ends within a field"),
        ("ready(waveforms=12)", "neither of the Wi-Fi waveforms"),
        ("print('cannot find the library'); sys.exit(4)", r"ended \(exit 4\). Its last output was: cannot find"),
        ("os.kill(os.getpid(), 11)", r"ended \(signal SIGSEGV\). It printed nothing"),
        ("import time; time.sleep(60)", "did not answer for 1 s of wall time"),
    ],
)  # fmt: skip
def test_an_engine_that_greets_wrongly_is_named(end: str, words: str) -> None:
    with pytest.raises(ComponentError, match=f"radio engine test: .*{words}"):
        _medium(end, deadline_s=1.0 if "sleep" in end else 20.0)


@pytest.mark.parametrize(
    ("end", "words"),
    [
        ("sys.exit(3)", r"ended \(exit 3\)"),
        ("link.sendall(b'x' * 5); import time; time.sleep(60)", "did not answer for 2 s"),
        ("done([(5, 1, 2_000_000, 77, 6, 0)])", "a radio or channel that is not there"),
        ("done([(5, 1, 2_000_000, 0, 6, 9)])", "unknown fate"),
        ("done([(5, 1, 2_000_000, 0, 6, 3)])", "unknown fate"),  # LOST is not for engines to say
        ("done([(5, 1, 2_000_000, 0, 6, 0)], [(5, 2_000_000, -50, 3, 1, 6, 8)])", "unknown outcome"),
        ("done([(5, 1, 90_000_000, 0, 6, 0)])", "outside of the step"),
        ("done([], [(5, 2_000_000, -50, 3, 1, 6, 0)])", "a reception of frame 5"),
        ("done([(99, 1, 2_000_000, 0, 6, 0)])", "frame 99, which is not under way"),
        ("done([(5, 1, 2_000_000, 0, 6, 0)] * 2)", "frame 5, which has another"),
        ("done([(5, 1, 2_000_000, 0, 6, 0)], [(5, 2_000_000, float('nan'), 3, 1, 6, 0)])", "no number"),
        ("answer(M.DONE, b'\\xff' * 24)", "ends within a field"),
        ("answer(M.LOSSES, e.encode_losses(np.zeros(1)))", "LOSSES instead of DONE"),
        ("answer(M.FAILED, e.encode_failed('out of memory'))", "failed: out of memory"),
    ],
)
def test_an_engine_that_answers_wrongly_is_named(end: str, words: str) -> None:
    medium = _medium(f"ready()\nreceive()\n{end}", deadline_s=2.0)
    try:
        with pytest.raises(ComponentError, match=f"radio engine test: .*{words}"):
            _one(medium)
    finally:
        medium.close()


def test_a_program_that_is_not_there_is_named() -> None:
    with pytest.raises(ComponentError, match="radio engine test: cannot start /nowhere/engine"):
        ExternalMedium("test", ["/nowhere/engine"], MediumContext(RADIOS, Chance(1)))


def test_radios_are_checked_before_the_engine_starts() -> None:
    with pytest.raises(InputError, match="two radios"):
        _medium("sys.exit(1)", [RADIOS[0], RADIOS[0]])


def test_own_losses_need_an_engine_that_can() -> None:
    with pytest.raises(ComponentError, match="cannot compute path losses"):
        _medium(ALL, losses="engine")


def test_an_engine_that_cannot_fork_is_not_copied() -> None:
    medium = _medium(ALL.replace("ready()", "ready(abilities=p.Ability(4))"))
    try:
        with pytest.raises(ComponentError, match="cannot be copied while it runs"):
            copy.deepcopy(medium)
    finally:
        medium.close()


def _lost(medium: ExternalMedium) -> list[list[int]]:
    """The fates of a frame each that is offered in three steps of 10 ms."""
    fates = []
    for step in range(3):
        medium.offer(step, _batch((0, step * 10 * NS_PER_MS + 1, Waveform.OFDM_6M, step)))
        fates.append(medium.advance((step + 1) * 10 * NS_PER_MS, _table(medium)).sent.fate.tolist())
    return fates


ONCE = ALL.replace("done(sent, heard)", "if asked.until_ns == 20_000_000: os._exit(7)\n    done(sent, heard)")
"""It ends in the second step."""


def test_frames_of_an_engine_that_ended_are_lost_and_told() -> None:
    lost, sent = TransmissionFate.LOST, TransmissionFate.SENT
    for on_death, last, state in (("restart", sent, InstanceStatus.READY), ("continue", lost, InstanceStatus.DEAD)):
        medium = _medium(ONCE, on_death=on_death)
        try:
            before = medium.programs[0]
            assert (before.state, before.ended) == (InstanceStatus.READY, ())
            assert _lost(medium) == [[sent], [lost], [last]]
            (after,) = medium.programs
            assert (after.state, len(after.ended)) == (state, 1)
            assert "exit 7" in after.ended[0]
            assert (after.pid == before.pid) == (on_death == "continue")
            assert medium.quiet
        finally:
            medium.close()


def test_a_frame_that_waits_is_lost_with_its_engine() -> None:
    """Its engine had said that something is under way, and ends in a later step without a new frame."""
    waits = ALL.replace("done(sent, heard)", "if asked.until_ns > 20_000_000: os._exit(7)\n    done(active=1)")
    medium = _medium(waits, on_death="continue")
    try:
        medium.offer(0, _batch((0, 1, Waveform.OFDM_6M, 5)))
        assert not len(medium.advance(10 * NS_PER_MS, _table(medium)).sent.key)
        assert not medium.quiet
        answer = medium.advance(30 * NS_PER_MS, _table(medium)).sent
        assert (answer.key.tolist(), answer.fate.tolist()) == ([5], [TransmissionFate.LOST])
        assert medium.quiet
    finally:
        medium.close()


def test_an_engine_that_always_ends_is_started_four_times() -> None:
    medium = _medium("ready()\nreceive()\nsys.exit(3)", on_death="restart")
    try:
        for step in range(6):
            medium.offer(step, _batch((0, step * 10 * NS_PER_MS + 1, Waveform.OFDM_6M, step)))
            fates = medium.advance((step + 1) * 10 * NS_PER_MS, _table(medium)).sent.fate.tolist()
            assert fates == [TransmissionFate.LOST]
        assert len(medium.programs[0].ended) == 4
        assert medium.programs[0].state == InstanceStatus.DEAD
    finally:
        medium.close()


def test_the_context_may_shorten_the_deadline() -> None:
    with pytest.raises(ComponentError, match=r"did not answer for 1 s"):
        _medium("import time; time.sleep(60)", context_deadline_s=1.0)


def _alive(pid: int) -> bool:
    try:
        return "Z" not in Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False


def test_the_engine_ends_with_its_medium() -> None:
    medium = _medium(ALL)
    pid = medium._engine._program.pid
    assert _alive(pid)
    medium.close()
    medium.close()
    assert not _alive(pid)
    medium = _medium(ALL)
    pid = medium._engine._program.pid
    del medium
    gc.collect()
    assert not _alive(pid)


def test_an_engine_that_does_not_end_is_killed() -> None:
    end = "ready()\nimport signal, time\nsignal.signal(signal.SIGTERM, signal.SIG_IGN)\nwhile True: time.sleep(1)"
    medium = _medium(end)
    pid = medium._engine._program.pid
    medium.close()
    assert not _alive(pid)


def test_the_horizon_limits_the_paths() -> None:
    medium = _medium(ALL, surroundings=RadioEnvironment(horizon_m=150.0))
    try:
        assert _one(medium).heard.radio.tolist() == [1]
    finally:
        medium.close()


def test_a_time_that_has_passed_and_a_radio_that_is_not_there_are_errors() -> None:
    medium = _medium(ALL)
    try:
        medium.advance(NS_PER_S, _table(medium))
        with pytest.raises(ValueError, match="had passed"):
            medium.offer(1, _batch((0, NS_PER_S, Waveform.OFDM_6M, 5)))
        with pytest.raises(ValueError, match="a radio in row"):
            medium.offer(1, _batch((3, 2 * NS_PER_S, Waveform.OFDM_6M, 5)))
        with pytest.raises(ValueError, match="asked to advance"):
            medium.advance(1, _table(medium))
    finally:
        medium.close()


def test_a_stopped_engine_is_reported_and_killed() -> None:
    medium = _medium(ALL, deadline_s=0.5)
    pid = medium._engine._program.pid
    os.kill(pid, signal.SIGSTOP)
    begin = time.monotonic()
    with pytest.raises(ComponentError, match=r"did not answer for 0\.5 s"):
        _one(medium)
    medium.close()
    assert not _alive(pid)
    assert time.monotonic() - begin < 10.0


def test_protocol_versions_agree_with_the_page() -> None:
    page = Path(__file__).parents[2] / "docs" / "reference" / "medium-protocol.md"
    assert f"This is version **{protocol.VERSION}**" in page.read_text()
