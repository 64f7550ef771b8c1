"""One core's part of a run: its kernel and its recorder, driven from barrier to barrier."""

from __future__ import annotations

import json
import math
import time
from collections import deque
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from skyrange.assembly.aircraft import describe_engines
from skyrange.assembly.build import BuiltScenario, build
from skyrange.contracts.frames import DirectedLinkName, LinkTable
from skyrange.contracts.links import LinkSpec
from skyrange.core.errors import InputError, Problem
from skyrange.core.ids import Port, endpoint, vehicle_id
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.kernel import Kernel, Transit, Wiring
from skyrange.radio.oracle import ENDPOINT as ORACLE
from skyrange.radio.oracle import Oracle
from skyrange.record import Recorder
from skyrange.runtime.cores.division import (
    Crossing,
    Division,
    Endpoints,
    find_barriers,
    find_service_times,
    keep_own_acts,
)
from skyrange.runtime.cores.exchange import CoreFailedError, Member, Topic
from skyrange.runtime.cores.frame_messages import pack_transits, unpack_transits
from skyrange.runtime.cores.oracle_replica import OracleReplica, arrive_ahead
from skyrange.runtime.cores.scanner_replica import ScannerReplica
from skyrange.runtime.cores.separation import Approach, FleetMotion, Separation
from skyrange.runtime.memory import peak_memory_mb
from skyrange.scenario.model.scenario import Scenario
from skyrange.world.airframes import AIRFRAMES

LONGEST_PERIOD_NS: Final[Time] = 100 * NS_PER_MS
"""Longest time between two barriers: so often Ctrl-C is looked for, and the distances between aircraft."""
FLUSH_S: Final = 1.0
"""So often in wall time all cores write what they recorded, and their frames when one of them has many: together,
because all others wait for what one does alone.
"""
_STOP, _FLUSH, _WRITE_FRAMES = 1, 2, 4
"""What a core orders at a barrier: to stop, as the first one does, to write everything, or frames only."""


class ApproachError(Exception):
    """Aircraft on different cores may touch before the next barrier: the run has to be flown on one core."""

    def __init__(self, now: Time, approach: Approach) -> None:
        self.now = now
        self.approach = approach
        super().__init__(
            f"{approach.vehicle} and {approach.other}, on different cores, came within {approach.gap_m:.1f} m "
            f"at {now / NS_PER_S:.2f} s"
        )


class Core:
    """A core's part of a run. Call `open`, `advance` to the end, and `leave`, on all cores alike."""

    def __init__(self, scenario: Scenario, division: Division, member: Member) -> None:
        """Build what is on this core. Raises `InputError` on all cores alike, with everything that is wrong with the
        scenario.
        """
        self.member = member
        self._began = time.perf_counter()
        self._scenario = scenario
        self._division = division
        here = division.endpoints(scenario, member.number)
        self._here = here
        self._fleet = [division.vehicles(scenario, core) for core in range(member.count)]
        vehicles = self._fleet[member.number]
        self.built = self._build(frozenset(vehicles))
        self._motion = FleetMotion(self._fleet)
        self._operators = division.operators[member.number]
        self._vehicles = vehicles
        self._inbound: list[Transit] = []
        self._posted: deque[Time] = deque()
        """Barriers at which this core has posted, and what others posted is not collected yet."""
        self._flush_due_s = time.monotonic()
        self._writing_ordered = False
        self.wall_s = 0.0
        self.setup_s = 0.0

    def _build(self, vehicles: Container[str]) -> BuiltScenario:
        """Build what is on this core, whose aircraft are `vehicles`; exchange what is wrong: each checks its own.

        The last core has the files that belong to no vehicle: the first one writes the manifest meanwhile.
        """
        built, error = None, None
        try:
            attached = self.member.number == self.member.count - 1
            built = build(self._scenario, local=self._here, flown=vehicles, attached=attached)
        except InputError as refusal:
            error = refusal
        message = [] if error is None else [error.who, *map(asdict, error.problems)]
        parts = [json.loads(part) for part in self._gather(Topic.START, 0, message)]
        problems = dict.fromkeys(Problem(**problem) for part in parts for problem in part[1:])
        if problems:
            if built is not None:
                built.close()
            raise InputError(next(part[0] for part in parts if part), list(problems)) from error
        assert built is not None
        return built

    def open(self, open_record: Callable[[BuiltScenario], Recorder] | None) -> None:
        """Agree with the other cores on the start and on the barriers, and open the record: on the first core, which
        has `open_record`, a new one.
        """
        world = self.built.wiring.world
        assert world is not None
        message = {
            "preroll_ns": max(mount.engine.preroll_ns for mount in self.built.wiring.engines),
            "crossings": sorted(set(_list_crossings(self.built.wiring, self._here))),
            "ahead": arrive_ahead(self.built.wiring, self._here),
        }
        parts = [json.loads(part) for part in self._gather(Topic.START, 1, message)]
        crossings = [Crossing(*link) for part in parts for link in part["crossings"]]
        self.period_ns, self.lag = find_barriers(crossings, world.quantum_ns, LONGEST_PERIOD_NS)
        airframes = {
            vehicle_id(operator.id, vehicle.id): vehicle.airframe for operator, vehicle in self._scenario.fleet
        }
        self._separation = Separation(
            self._motion,
            [AIRFRAMES[airframes[vehicle]] for vehicle in self._motion.vehicles],
            self.period_ns,
            (1 + self.lag) * self.period_ns,
        )
        oracle = self.built.oracle
        ahead = all(part["ahead"] for part in parts)
        replica = None if oracle is None else self._replicate(oracle, ahead=ahead)
        wiring = self.built.wiring
        if self.member.number:
            wiring = keep_own_acts(wiring, self._division.binding.divisible)
        scanner = self._share_scanner()
        wiring = replace(
            wiring,
            preroll_ns=max(part["preroll_ns"] for part in parts),
            truth_subscribers=[*([] if replica is None else [replica]), *([] if scanner is None else [scanner])],
        )
        self.kernel = Kernel(wiring)
        record = self.built.scenario.record
        if open_record is not None:
            self.recorder = open_record(self.built)
            self._gather(Topic.START, 2, str(self.recorder.path.resolve()))
        else:
            folder = Path(json.loads(self._gather(Topic.START, 2, "")[0]))
            self.recorder = Recorder.join(
                folder,
                self.built.header,
                self.member.number,
                truth_hz=record.truth_hz,
                sensors_hz=record.sensors_hz,
                flush_s=math.inf,
                level=record.level,
                features_hz=record.features_hz,
            )
        self._attach_files(self.built.files)
        self.recorder.record_receptions(replica)
        self.recorder.record_scans(scanner)
        self._full_rows = self.recorder.block_rows
        self.recorder.block_rows *= 4  # it is told to write before
        self.kernel.set_observers([self.recorder])
        self.setup_s = time.perf_counter() - self._began

    def _attach_files(self, files: Mapping[str, bytes]) -> None:
        """Put this core's files into the folder. Where one of all cannot be written, the first core removes the folder
        once nobody writes to it.
        """
        problem = None
        try:
            self.recorder.attach_files(files)
        except InputError as error:
            problem = error
        reasons = [json.loads(part) for part in self._gather(Topic.START, 3, str(problem or ""))]
        if any(reasons) and not self.member.number:
            self.recorder.abandon()
        if problem is not None:
            raise problem
        for core, reason in enumerate(reasons):
            if reason:
                raise CoreFailedError(f"core {core}", reason)

    def advance(self, until: Time, *, stop: bool) -> bool:
        """Run to the next barrier, no later than `until`; returns whether the first core has asked to stop there.

        Raises `ApproachError` on all cores alike.
        """
        began = time.perf_counter()
        try:
            kernel = self.kernel
            barrier = min((kernel.now // self.period_ns + 1) * self.period_ns, until)
            outbound = kernel.advance(barrier, self._inbound)
            self._inbound = []
            self._post(barrier, outbound, stop=stop)
            order, last = 0, barrier == until
            # at the end all of it, because of the frames that are under way
            while len(self._posted) > (0 if last or order & _STOP else self.lag):
                order |= self._collect(last=last)
            return bool(order & _STOP)
        finally:
            self.wall_s += time.perf_counter() - began

    def _post(self, now: Time, outbound: list[Transit], *, stop: bool) -> None:
        """Give the other cores frames and positions at a barrier."""
        member = self.member
        world = self.built.wiring.world
        assert world is not None
        sent: list[list[Transit]] = [[] for _ in range(member.count)]
        for transit in outbound:
            sent[self._here.core_of(transit.frame.dst)].append(transit)
        motion = self._motion.pack(*world.motion())
        packed = [pack_transits(part) for part in sent]
        order = _STOP if stop else 0
        if not self._writing_ordered:
            if member.number == 0 and time.monotonic() >= self._flush_due_s:
                order |= _FLUSH
            elif self.recorder.waiting_rows >= self._full_rows:
                order |= _WRITE_FRAMES
            self._writing_ordered = order > _STOP
        head = np.array([order, len(motion), *map(len, packed)], dtype=np.int64).tobytes()
        member.post(Topic.BARRIER, now, b"".join([head, motion, *packed]))
        self._posted.append(now)

    def _collect(self, *, last: bool) -> int:
        """Take over what all cores posted at the earliest barrier that is left; returns what they order. After the last
        barrier nobody flies on, so no aircraft can come too near.
        """
        member = self.member
        now = self._posted.popleft()
        parts = member.collect(Topic.BARRIER, now)
        heads = [np.frombuffer(part, dtype=np.int64, count=2 + member.count) for part in parts]
        motions = []
        for part, sizes in zip(parts, heads, strict=True):
            at = sizes.nbytes + int(sizes[1])
            motions.append(part[sizes.nbytes : at])
            at += int(sizes[2 : 2 + member.number].sum())
            self._inbound += unpack_transits(part[at : at + int(sizes[2 + member.number])])
        self._motion.update(motions)
        approach = None if last else self._separation.check()
        if approach is not None:
            raise ApproachError(now, approach)
        order = int(np.bitwise_or.reduce([head[0] for head in heads]))
        if order > _STOP:
            self._writing_ordered = False
        if order & _FLUSH:
            self._flush_due_s = time.monotonic() + FLUSH_S
            self.recorder.flush()
        elif order & _WRITE_FRAMES:
            self.recorder.write_frames()
        return order

    def leave(self) -> list[Mapping[str, Any]]:
        """End this core's part of the run, and exchange what the first core needs to close the record: one entry for
        each core.
        """
        for name, path in self.kernel.kept_files().items():
            self.recorder.keep_file(name, path)
        self.kernel.advance(self.kernel.now, self._inbound)
        self.kernel.finish()
        self.built.close()
        shard = self.recorder.leave() if self.member.number else None
        summary = {
            "shard": shard,
            "engines": describe_engines(self.built.wiring.engines),
            "operators": list(self._operators),
            "vehicles": len(self._vehicles),
            "wall_s": round(self.wall_s, 3),
            "waited_s": round(self.member.waited_s, 3),
            "cpu_s": round(time.process_time(), 3),
            "peak_memory_mb": round(peak_memory_mb(), 1),
        }
        return [json.loads(part) for part in self._gather(Topic.END, 0, summary)]

    def _gather(self, topic: Topic, now: Time, value: Any) -> list[bytes]:
        return self.member.gather(topic, now, json.dumps(value).encode())

    def _replicate(self, oracle: Oracle, *, ahead: bool) -> OracleReplica:
        radio = self._scenario.radio
        operators = {} if radio is None else {receiver.id: receiver.operator for receiver in radio.receivers}
        radios = [
            medium_radio.name
            for medium_radio in oracle.medium.radios
            if self._is_own(
                endpoint(operators[medium_radio.name], "gcs")
                if medium_radio.name in operators
                else f"{medium_radio.name}.companion"
            )
        ]
        table = _number_links(self.built.wiring.links, {port: place for place, port in enumerate(oracle.ports)})
        return OracleReplica(oracle, self.member, FleetMotion(self._fleet), table, radios, ahead=ahead)

    def _share_scanner(self) -> ScannerReplica | None:
        """The scanner of the sensors on this core. Every core takes part, if any has sensors."""
        scanner = self.built.scanner
        return None if scanner is None else ScannerReplica(scanner, self.member, FleetMotion(self._fleet))

    def _is_own(self, end: str) -> bool:
        """Whether an endpoint is on this core and on no other."""
        return end != ORACLE and end in self._here


def _number_links(links: Iterable[LinkSpec], places: Mapping[Port, int]) -> LinkTable:
    """The directed links as every kernel of the run numbers them: in order of their names."""
    named = []
    for spec in links:
        named.append((f"{spec.name}:fwd", DirectedLinkName(spec.name, "fwd", spec.a, spec.b)))
        named.append((f"{spec.name}:rev", DirectedLinkName(spec.name, "rev", spec.b, spec.a)))
    names = [name for _, name in sorted(named)]
    return LinkTable(names, np.array([places.get(Port(name.dst, name.link), -1) for name in names], dtype=np.int64))


def _list_crossings(wiring: Wiring, here: Endpoints) -> Iterator[Crossing]:
    """The links on which this core sends to others, those of the oracle aside, of which each core has a replica."""
    service = find_service_times(wiring)
    for spec in wiring.links:
        if ORACLE in (spec.a, spec.b) or here.core_of(spec.a) == here.core_of(spec.b):
            continue
        for end in (spec.a, spec.b):
            if end in here:
                # a tap may send at any time
                tapped = any(end in tap.find_ends(spec) for tap in wiring.taps)
                served_ns = 0 if tapped else service.get(Port(end, spec.name), 0)
                yield Crossing(spec.channel.latency_ns, served_ns)
