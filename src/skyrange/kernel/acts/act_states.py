"""Attacks, defences and faults at run time: when each acts, the triggers that start some, and what faults may act on.

Triggers are evaluated on truth at a tick, before its sensor faults and engines, so what an attack does at the tick that
starts it takes effect. They are evaluated in muted runs too: only the output of an attack may differ between twins.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from skyrange.contracts.alerts import Scalar
from skyrange.contracts.components import BodyHook, SensorHook, Trigger, World
from skyrange.contracts.links import Act
from skyrange.contracts.mailboxes import Note
from skyrange.contracts.scan_light import ScanHook
from skyrange.core.errors import ComponentError, InputError, Problem, attribute_error, nearest
from skyrange.core.ids import FrameId
from skyrange.core.time import NEVER, NS_PER_MS, Time, to_seconds

TRIGGER_PERIOD_NS = 10 * NS_PER_MS
"""How often triggers are evaluated: at 30 m/s an aircraft flies 0.3 m in between."""


class ActState:
    """An act at run time: when it acts, as far as that is known."""

    __slots__ = ("_by", "_phase", "muted", "plan", "start_ns", "stop_ns", "withheld")

    def __init__(self, plan: Act) -> None:
        self.plan = plan
        self.muted = plan.muted
        self.withheld = False
        """Of a muted defence: whether it would have done something. Until then the run is as if it were not muted."""
        self.start_ns: Time = NEVER
        self.stop_ns: Time = NEVER
        self._phase = 0  # 0 waits, 1 acts, 2 has ended: what has been noted
        self._by: list[str | None] = [None, None]
        """Who started it, and who stopped it, by hand."""
        if plan.trigger is None and not plan.manual:
            self.begin(plan.start_ns)

    @property
    def id(self) -> str:
        """The attack's id."""
        return self.plan.id

    def begin(self, start: Time, *, by: str | None = None) -> None:
        """Have it act from `start` on; its own parts may read that. `by` is who started it by hand."""
        plan = self.plan
        self._by[0] = by
        self.start_ns = start
        self.stop_ns = min(plan.stop_ns, start + plan.lasts_ns)  # Python's integers do not overflow
        if plan.schedule is not None:
            plan.schedule.start_ns, plan.schedule.stop_ns = self.start_ns, self.stop_ns

    def end(self, stop: Time, *, by: str | None = None) -> None:
        """Have it act until `stop` instead; `by` is who stopped it by hand."""
        self._by[1] = by
        self.stop_ns = stop
        if self.plan.schedule is not None:
            self.plan.schedule.stop_ns = stop

    def note_changes(self, now: Time) -> list[Note]:
        """Notes for a tick: that it has begun, that it has ended; none of a muted attack."""
        notes: list[Note] = []
        if self._phase == 0 and now >= self.start_ns:
            self._phase = 1
            notes.append(self._note(0, self.start_ns))
        if self._phase == 1 and now >= self.stop_ns:
            self._phase = 2
            notes.append(self._note(1, self.stop_ns))
        return [] if self.muted or not self.plan.noted else notes

    def next_change(self, next_evaluation: Time) -> Time:
        """When it begins or ends, or its trigger is evaluated next."""
        if self._phase == 1:
            return self.stop_ns
        if self.start_ns != NEVER:
            return self.start_ns
        return next_evaluation if self.plan.trigger is not None else NEVER

    @property
    def ended(self) -> bool:
        """Whether nothing more will come of it."""
        return self._phase == 2

    @property
    def _events(self) -> tuple[str, str]:
        if self.plan.is_fault:
            return "event.fault_start", "event.fault_stop"
        if self.plan.is_defence:
            return "event.defence_start", "event.defence_stop"
        if self.plan.honest:
            return "event.honest_start", "event.honest_stop"
        return "event.attack_start", "event.attack_stop"

    def _note(self, change: int, at: Time) -> Note:
        """That it has begun (0) or ended (1)."""
        data: dict[str, Scalar] = {"at_s": to_seconds(at), "triggered": self.plan.trigger is not None}
        by = self._by[change]
        return Note(self._events[change], self.id, data if by is None else data | {"by": by})


def takes_effect(attack: ActState | None, now: Time) -> bool:
    """Whether the output of a tap, agent or sensor fault of `attack` counts at `now`: always without an attack."""
    return attack is None or (not attack.muted and attack.start_ns <= now < attack.stop_ns)


def note_withheld(attack: ActState | None, now: Time) -> None:
    """Note that the output of a part of a defence was discarded at `now`, if it was because the defence is muted."""
    if attack is None or not attack.plan.is_defence:
        return
    if attack.muted and attack.start_ns <= now < attack.stop_ns:
        attack.withheld = True


def _order_of(plan: Act) -> tuple[bool, str]:
    """Attacks and faults by id, then defences as they were given."""
    return (True, "") if plan.is_defence else (False, plan.id)


class ActStates:
    """All acts of one kernel."""

    def __init__(self, plans: Sequence[Act], world: World | None) -> None:
        """Raises `InputError` for a trigger without a world, or on a vehicle that the world does not have."""
        self.each = [ActState(plan) for plan in sorted(plans, key=_order_of)]
        vehicles = list(world.vehicles) if world is not None else []
        _check_triggers(plans, vehicles, world)
        self._rows = {
            attack.id: [vehicles.index(vehicle) for vehicle in attack.plan.trigger.vehicles]
            for attack in self.each
            if attack.plan.trigger is not None
        }
        self._unfinished = list(self.each)
        self._next_evaluation: Time = 0
        self.next_change: Time = -NEVER if self.each else NEVER
        """When one begins or ends next, or a trigger is evaluated; a tick before that needs no `update`."""

    def by_id(self) -> Mapping[str, ActState]:
        """Each by its attack's id."""
        return {attack.id: attack for attack in self.each}

    @property
    def triggered(self) -> Mapping[str, Time]:
        """Acts whose trigger has held, or that were started by hand, and since when they act."""
        return {
            state.id: state.start_ns
            for state in self.each
            if (state.plan.trigger is not None or state.plan.manual) and state.start_ns != NEVER
        }

    @property
    def withheld(self) -> Sequence[str]:
        """Ids of the muted defences that would have done something."""
        return [state.id for state in self.each if state.withheld]

    def begin(self, attack: str, start: Time) -> None:
        """Have an attack act from `start` on whose trigger held elsewhere; once only. `KeyError` for an unknown id."""
        state = self.by_id()[attack]
        if state.start_ns == NEVER:
            state.begin(start)
            self.next_change = min(self.next_change, start)

    def end(self, act: str, stop: Time) -> None:
        """Have an act end at `stop` that was stopped by hand elsewhere. `KeyError` for an unknown id."""
        self.by_id()[act].end(stop)

    def update(self, now: Time, world: World) -> list[Note]:
        """Evaluate the triggers that are due at a tick; returns what is to be noted."""
        if now >= self._next_evaluation:
            self._next_evaluation = now - now % TRIGGER_PERIOD_NS + TRIGGER_PERIOD_NS
            candidates = [attack for attack in self._unfinished if attack.start_ns == NEVER]
            candidates = [attack for attack in candidates if attack.plan.trigger is not None]
            candidates = [attack for attack in candidates if attack.plan.start_ns <= now < attack.plan.stop_ns]
            truth = world.truth() if candidates else {}
            for attack in candidates:
                trigger = attack.plan.trigger
                assert trigger is not None
                if self._holds(attack.id, trigger, now, truth):
                    attack.begin(now)
        notes = [note for attack in self._unfinished for note in attack.note_changes(now)]
        if notes:
            self._unfinished = [attack for attack in self._unfinished if not attack.ended]
        changes = (attack.next_change(self._next_evaluation) for attack in self._unfinished)
        self.next_change = min(changes, default=NEVER)
        return notes

    def _holds(self, id_: str, trigger: Trigger, now: Time, truth: Mapping[str, object]) -> bool:
        try:
            return bool(trigger.holds(now, truth, self._rows[id_]))  # type: ignore[arg-type]
        except Exception as error:
            raise attribute_error(f"trigger of attack {id_}", now, error) from error


def _check_triggers(plans: Sequence[Act], vehicles: Sequence[str], world: World | None) -> None:
    problems = []
    for plan in plans:
        if plan.trigger is None:
            continue
        if world is None:
            problems.append(Problem(f"{plan.id}.trigger", "no world", "a world whose truth it can read"))
            continue
        problems += [
            Problem(f"{plan.id}.trigger", vehicle, "a vehicle", nearest(vehicle, vehicles))
            for vehicle in plan.trigger.vehicles
            if vehicle not in vehicles
        ]
    if problems:
        raise InputError("wiring", problems)


class ActCounter:
    """Ids of the acts of faults of one sort."""

    def __init__(self, sort: str) -> None:
        """`sort` is what error messages call such a fault."""
        self._sort = sort
        self._counts: dict[tuple[str, str], int] = {}

    def number(self, fault: SensorHook | BodyHook | ScanHook, vehicle: str, part: str) -> FrameId:
        """The id of the next act of `fault` on a part of a vehicle. Raises `ComponentError` for another's vehicle."""
        if vehicle not in fault.vehicles:
            raise ComponentError(f"{self._sort} {fault.name}", f"reports an act on {vehicle}, which is not its own")
        link = f"{part}:{vehicle}"
        serial = self._counts.get((fault.name, link), 0)
        self._counts[fault.name, link] = serial + 1
        return FrameId(link, "fwd", fault.name, serial)


def check_faults(
    sort: str, owned: Sequence[tuple[ActState, SensorHook | BodyHook | ScanHook]], vehicles: Sequence[str]
) -> None:
    """Raise `InputError` for a name used twice, a vehicle named twice, or one that is not in `vehicles`."""
    problems = []
    seen: set[str] = set()
    for attack, fault in owned:
        if fault.name in seen:
            problems.append(Problem(f"{attack.id}.faults", repr(fault.name), f"a name that no other {sort} has"))
        seen.add(fault.name)
        problems += [
            Problem(f"{attack.id}.{fault.name}.vehicles", repr(vehicle), "a vehicle", nearest(vehicle, vehicles))
            for vehicle in fault.vehicles
            if vehicle not in vehicles
        ]
        if len(set(fault.vehicles)) < len(fault.vehicles):
            repeated = repr(list(fault.vehicles))
            problems.append(Problem(f"{attack.id}.{fault.name}.vehicles", repeated, "each vehicle once"))
    if problems:
        raise InputError("wiring", problems)
