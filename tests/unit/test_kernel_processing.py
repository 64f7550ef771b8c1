"""Endpoints with limited processing: order, overflow, forwarding, forks, and what is refused."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise

import pytest

from skyrange.contracts.frames import Frame
from skyrange.contracts.links import Act, ProcessingLimit, TapPlacement
from skyrange.contracts.verdicts import Verdict
from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_S, Time
from skyrange.defence.placement import DefenceTap
from skyrange.kernel import Kernel, Wiring
from tests.probes.test_taps import Meddler
from tests.probes.toys import MS, ROUGH, Fleet, Log, Station, onboard

VEHICLES = ("blue/b1", "blue/b2")
END = 3 * NS_PER_S
SLOW = (
    ProcessingLimit("blue/b1.autopilot", 10.0, 2),
    ProcessingLimit("blue/b1.proxy", 30.0, 3),
    ProcessingLimit("blue.gcs", 35.0, 4),
)


def wiring(processing: Sequence[ProcessingLimit] = SLOW, rough: bool = False, muted: bool = False) -> Wiring:
    made = [onboard(vehicle, ROUGH if rough else None) for vehicle in VEHICLES]
    return Wiring(
        seed=5,
        links=[spec for links, _ in made for spec in links],
        routes=[route for _, routes in made for route in routes],
        agents=[Station("blue", VEHICLES, period=20 * MS), Fleet("fleet", VEHICLES)],
        taps=[TapPlacement("gcs:blue/b1", "companion", Meddler, "mitm")] if rough else [],
        acts=[Act("mitm", start_ns=500 * MS, muted=muted)] if rough else [],
        processing=processing,
    )


class Watcher(DefenceTap):
    """A defence that lets everything pass."""

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        return ()


def guarded(processing: Sequence[ProcessingLimit] = SLOW, rough: bool = True, muted: bool = False) -> Wiring:
    """With a defence at the companion's end of a link that takes 7 ms for each frame, in both directions."""
    made = wiring(processing, rough)
    guard = TapPlacement("gcs:blue/b1", "companion", Watcher, "guard", cost_ns=7 * MS)
    return replace(made, taps=[guard, *made.taps], acts=[*made.acts, Act("guard", muted=muted, role="defence")])


def flown(wired: Wiring) -> Log:
    log = Log()
    kernel = Kernel(wired, [log])
    kernel.advance(END)
    kernel.finish()
    return log


def delivered(log: Log, endpoint: str) -> list[int]:
    """When frames were delivered to an endpoint, over all of its links."""
    return sorted(int(row[7]) for row in log.frames if row[8] == "delivered" and row[6] == endpoint)


def test_a_limited_endpoint_processes_one_frame_after_another() -> None:
    log = flown(wiring(SLOW[:1]))
    fates = [row[8] for row in log.on("autopilot:blue/b1") if row[2] == "fwd"]
    assert set(fates) == {"delivered", "overflow", "in_flight"}
    served = delivered(log, "blue/b1.autopilot")
    assert {b - a for a, b in pairwise(served)} == {NS_PER_S // 10}
    assert len(served) == pytest.approx(10 * END / NS_PER_S, abs=2)
    notes = [row for row in log.notes if row[2] == "event.processing_overflow"]
    assert [row[4] for row in notes] == [(("count", 2**k),) for k in range(fates.count("overflow").bit_length())]
    assert {row[3] for row in notes} == {"blue/b1.autopilot"}


def test_one_queue_serves_all_links_of_an_endpoint_and_forwards_what_it_has_processed() -> None:
    log = flown(wiring(SLOW[1:2]))
    served = delivered(log, "blue/b1.proxy")
    assert {row[1] for row in log.frames if row[6] == "blue/b1.proxy"} == {"autopilot:blue/b1", "log:blue/b1"}
    assert min(b - a for a, b in pairwise(served)) >= NS_PER_S // 30
    forwarded = [row[0] for row in log.frames if row[3] == "blue/b1.proxy"]
    assert len(forwarded) > 50
    assert set(forwarded) <= {-(-at // MS) * MS for at in served}


def test_without_a_limit_nothing_of_it_is_there() -> None:
    assert "overflow" not in {row[8] for row in flown(wiring(())).frames}


def test_links_of_other_endpoints_are_as_without() -> None:
    other = ("autopilot:blue/b2", "log:blue/b2")
    limited, free = flown(wiring(SLOW[:2])), flown(wiring(()))
    assert limited.on(*other) == free.on(*other)


@pytest.mark.parametrize("rough", [False, True])
def test_fusing_and_registration_change_no_byte(rough: bool) -> None:
    made = wiring(rough=rough)
    fused = flown(made)
    made = wiring(rough=rough)
    apart = flown(replace(made, fuse=False, processing=SLOW[::-1], links=[*made.links][::-1], agents=made.agents[::-1]))
    assert fused.table() == apart.table()
    assert fused.notes == apart.notes


def test_a_muted_attack_is_no_attack() -> None:
    muted = flown(wiring(rough=True, muted=True))
    assert muted.table() == flown(replace(wiring(rough=True), taps=[], acts=[])).table()


def test_what_an_endpoint_sends_waits_for_the_defences_there_and_keeps_its_order() -> None:
    costly, free = flown(guarded((), rough=False)), flown(wiring(()))
    took, before = (
        [
            int(str(row[7])) - int(str(row[0]))
            for row in log.on("gcs:blue/b1")
            if row[2] == "rev" and row[8] == "delivered"
        ]
        for log in (costly, free)
    )
    assert len(took) > 50
    assert min(took) == min(before) + 7 * MS  # alone
    assert max(took) > max(before) + 7 * MS  # behind what arrived
    arrived = [int(str(row[7])) for row in costly.on("gcs:blue/b1") if row[2] == "rev" and row[8] == "delivered"]
    assert arrived == sorted(arrived)
    assert "overflow" not in {row[8] for row in costly.frames}


def test_other_links_of_the_endpoint_wait_for_its_processor() -> None:
    costly, free = flown(guarded((), rough=False)), flown(wiring(()))
    taken = [
        [int(str(row[7])) - int(str(row[0])) for row in log.on("log:blue/b1") if row[6] == "blue/b1.companion"]
        for log in (costly, free)
    ]
    assert max(taken[0]) > max(taken[1])


def test_a_muted_defence_takes_no_time_and_changes_no_byte() -> None:
    for limits in ((), SLOW):
        for rough in (False, True):
            assert flown(guarded(limits, rough, muted=True)).table() == flown(wiring(limits, rough)).table()


def test_fusing_and_registration_change_no_byte_with_a_defence() -> None:
    made = guarded()
    apart = replace(made, fuse=False, processing=SLOW[::-1], links=[*made.links][::-1], agents=made.agents[::-1])
    fused = flown(guarded())
    assert fused.table() == flown(apart).table() != flown(wiring(rough=True)).table()


@pytest.mark.parametrize("made", [lambda: wiring(rough=True), guarded], ids=["limits", "defence"])
@pytest.mark.parametrize("fork_at", [637_500_000, 2 * NS_PER_S])
def test_a_fork_has_queues_of_its_own(fork_at: int, made: Callable[[], Wiring]) -> None:
    straight = flown(made())
    first, second = Log(), Log()
    trunk = Kernel(made(), [first])
    trunk.advance(fork_at)
    seen = len(first.frames), len(first.notes)
    branch = trunk.fork([second])
    for part in (trunk, branch):
        part.advance(END)
        part.finish()
    assert first.table() == straight.table()
    assert second.frames == first.frames[seen[0] :]
    assert second.notes == first.notes[seen[1] :]


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ([ProcessingLimit("blue/b1.autopilt", 10.0, 2)], "Did you mean 'blue/b1.autopilot'"),
        ([SLOW[0], SLOW[0]], "one limit for each endpoint"),
        ([ProcessingLimit("blue.gcs", 0.0, 2)], "over 0 and at most 1e"),
        ([ProcessingLimit("blue.gcs", float("nan"), 2)], "over 0 and at most 1e"),
        ([ProcessingLimit("blue.gcs", 10.0, 0)], "at least 1"),
    ],
)
def test_what_cannot_run_is_refused(limits: Sequence[ProcessingLimit], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Kernel(wiring(limits))
