"""Is an attack acting? What the kernel keeps of each attack while it runs, and the triggers that start some.

Triggers look at truth, at a tick and before its sensor faults and engines, so what an attack does at the tick that
starts it counts. They are asked in muted runs too: nothing but what comes out of an attack tells the twins apart.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from skyrange.agent.contracts import Trigger, World
from skyrange.agent.links import AttackPlan
from skyrange.agent.messages import Note, Scalar
from skyrange.core.errors import Fault, InputError, attribute_error, nearest
from skyrange.core.time import NEVER, NS_PER_MS, Time, to_seconds

LOOK_NS = 10 * NS_PER_MS
"""Triggers are asked this often: at 30 m/s an aircraft flies 0.3 m in between."""


class Stage:
    """One attack at run time: when it acts, as far as that is known."""

    __slots__ = ("_phase", "muted", "plan", "start_ns", "stop_ns")

    def __init__(self, plan: AttackPlan) -> None:
        self.plan = plan
        self.muted = plan.muted
        self.start_ns: Time = NEVER
        self.stop_ns: Time = NEVER
        self._phase = 0  # 0 waits, 1 acts, 2 is over: what has been noted
        if plan.trigger is None:
            self.begin(plan.start_ns)

    @property
    def id(self) -> str:
        """The attack's id."""
        return self.plan.id

    def begin(self, start: Time) -> None:
        """It acts from `start` on; its own parts may know."""
        plan = self.plan
        self.start_ns = start
        self.stop_ns = min(plan.stop_ns, start + plan.lasts_ns)  # Python's integers do not overflow
        if plan.schedule is not None:
            plan.schedule.start_ns, plan.schedule.stop_ns = self.start_ns, self.stop_ns

    def turned(self, now: Time) -> list[Note]:
        """What to note at a tick: that it has begun, that it is over. A muted attack has nothing to say."""
        notes: list[Note] = []
        if self._phase == 0 and now >= self.start_ns:
            self._phase = 1
            notes.append(self._note("event.attack_start", self.start_ns))
        if self._phase == 1 and now >= self.stop_ns:
            self._phase = 2
            notes.append(self._note("event.attack_stop", self.stop_ns))
        return [] if self.muted else notes

    @property
    def over(self) -> bool:
        """Whether nothing more will come of it."""
        return self._phase == 2

    def _note(self, kind: str, at: Time) -> Note:
        data: dict[str, Scalar] = {"at_s": to_seconds(at), "triggered": self.plan.trigger is not None}
        return Note(kind, self.id, data)


def takes_effect(attack: Stage | None, now: Time) -> bool:
    """Whether what a tap, agent or sensor fault of `attack` puts out counts at `now`: always without an attack."""
    return attack is None or (not attack.muted and attack.start_ns <= now < attack.stop_ns)


class Stages:
    """All attacks of one kernel."""

    def __init__(self, plans: Sequence[AttackPlan], world: World | None) -> None:
        """Raises `InputError` for a trigger without a world, or on a vehicle that the world does not have."""
        self.each = [Stage(plan) for plan in sorted(plans, key=lambda plan: plan.id)]
        vehicles = list(world.vehicles) if world is not None else []
        _check(plans, vehicles, world)
        self._rows = {
            stage.id: [vehicles.index(vehicle) for vehicle in stage.plan.trigger.vehicles]
            for stage in self.each
            if stage.plan.trigger is not None
        }
        self._waiting = list(self.each)
        self._look: Time = 0

    def by_id(self) -> Mapping[str, Stage]:
        """Each by its attack's id."""
        return {stage.id: stage for stage in self.each}

    @property
    def triggered(self) -> Mapping[str, Time]:
        """Since when those act whose trigger has held."""
        return {one.id: one.start_ns for one in self.each if one.plan.trigger is not None and one.start_ns != NEVER}

    def begin(self, attack: str, start: Time) -> None:
        """The trigger of an attack has held elsewhere; once only. `KeyError` for one that is none of these."""
        stage = self.by_id()[attack]
        if stage.start_ns == NEVER:
            stage.begin(start)

    @property
    def present(self) -> bool:
        """Whether any may still begin or end."""
        return bool(self._waiting)

    def tick(self, now: Time, world: World) -> list[Note]:
        """Ask the triggers that are due; returns what is to be noted."""
        if now >= self._look:
            self._look = now - now % LOOK_NS + LOOK_NS
            asked = [stage for stage in self._waiting if stage.start_ns == NEVER]
            asked = [stage for stage in asked if stage.plan.start_ns <= now < stage.plan.stop_ns]
            truth = world.truth() if asked else {}
            for stage in asked:
                trigger = stage.plan.trigger
                assert trigger is not None
                if self._holds(stage.id, trigger, now, truth):
                    stage.begin(now)
        notes = [note for stage in self._waiting for note in stage.turned(now)]
        if notes:
            self._waiting = [stage for stage in self._waiting if not stage.over]
        return notes

    def _holds(self, id_: str, trigger: Trigger, now: Time, truth: Mapping[str, object]) -> bool:
        try:
            return bool(trigger.holds(now, truth, self._rows[id_]))  # type: ignore[arg-type]
        except Exception as error:
            raise attribute_error(f"trigger of attack {id_}", now, error) from error


def _check(plans: Sequence[AttackPlan], vehicles: Sequence[str], world: World | None) -> None:
    faults = []
    for plan in plans:
        if plan.trigger is None:
            continue
        if world is None:
            faults.append(Fault(f"{plan.id}.trigger", "no world", "a world whose truth it can look at"))
            continue
        faults += [
            Fault(f"{plan.id}.trigger", vehicle, "a vehicle", nearest(vehicle, vehicles))
            for vehicle in plan.trigger.vehicles
            if vehicle not in vehicles
        ]
    if faults:
        raise InputError("wiring", faults)
