"""Acts of a run under manual control: its attacks, faults and defences, started and stopped by hand as it flies."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final, Literal

from skyrange.assembly.acts.conflicts import Window, window_of
from skyrange.assembly.build import BuiltScenario
from skyrange.contracts.links import Role
from skyrange.core.errors import InputError, Problem, nearest
from skyrange.core.time import NEVER, Time, to_seconds
from skyrange.kernel import Kernel
from skyrange.kernel.acts.act_states import ActState
from skyrange.scenario.model.manual_acts import ManualActTable

ActStatus = Literal["waiting", "acting", "ended"]

BY: Final = "python"
"""Who starts and stops acts, unless a caller says so."""


class RunAct:
    """An attack, a fault or a defence of a run: when it acts, and its start and stop by hand.

    A start or a stop by hand takes effect at the next multiple of 10 ms of simulated time, before anything else
    happens there, or at 0 s where the run has not begun. The record, its labels and its events are those of a run
    whose scenario has the same start or stop in `manual_acts`.
    """

    def __init__(self, kernel: Kernel, built: BuiltScenario, number: int, state: ActState) -> None:
        """Use `Run.acts`; `number` is that of the run in its kernel."""
        self.id = state.id
        self._state = state
        self._kernel = kernel
        self._built = built
        self._number = number

    @property
    def role(self) -> Role:
        """`attack`, `fault` or `defence`."""
        return self._state.plan.role

    @property
    def kind(self) -> str:
        """Its kind, such as `remote_id.spoof`; "" for one that was passed from Python."""
        table = self._built.scenario.acting.get(self.id)
        return "" if table is None else table.kind

    @property
    def manual(self) -> bool:
        """Whether it starts by hand: the scenario declares it with `manual = true`."""
        return self._state.plan.manual

    @property
    def muted(self) -> bool:
        """Whether its output is discarded."""
        return self._state.muted

    @property
    def status(self) -> ActStatus:
        """`waiting` for its start, `acting`, or `ended`, at the time that the run has reached."""
        state, now = self._state, self._kernel.now
        return "waiting" if now < state.start_ns else "acting" if now < state.stop_ns else "ended"

    @property
    def window_s(self) -> tuple[float | None, float | None]:
        """When it starts and when it stops, in simulated seconds, as far as that is known; else `None`."""
        start, stop = self._window()
        return tuple(None if time == NEVER else to_seconds(time) for time in (start, stop))  # type: ignore[return-value]

    def start(self, *, by: str = BY) -> float:
        """Start it; returns when it starts, in simulated seconds. `by` says who, for the record.

        Raises `InputError` if it is not declared with `manual = true`, has started before, would start outside its
        `start_s` to `stop_s` or after the end of the run, or excludes another act that acts then.
        """
        return self._request("start", by)

    def stop(self, *, by: str = BY) -> float:
        """Stop it; returns when it stops, in simulated seconds. `by` says who, for the record.

        Raises `InputError` if it does not act.
        """
        return self._request("stop", by)

    def describe(self) -> dict[str, Any]:
        """All of this as JSON data, with the ends of its window as `start_s` and `stop_s`."""
        start_s, stop_s = self.window_s
        facts = {"id": self.id, "role": self.role, "kind": self.kind, "manual": self.manual, "muted": self.muted}
        return {**facts, "status": self.status, "start_s": start_s, "stop_s": stop_s}

    def __repr__(self) -> str:
        return f"<{self.role} {self.id}: {self.status}>"

    def _request(self, action: Literal["start", "stop"], by: str) -> float:
        who, at = f"{self.role} {self.id}", self._kernel.next_manual_act
        if self._kernel.ended or at > self._built.duration_ns:
            raise InputError.one(who, action, f"the run ends at {to_seconds(self._end()):g} s", "a run that goes on")
        table = ManualActTable(at_s=to_seconds(at), act=self.id, action=action, by=by)
        problems = self._find_overlaps(table) if action == "start" else []
        if problems:
            raise InputError(who, problems)
        self._kernel.request_act(table.manual_act, self._number)
        return table.at_s

    def _end(self) -> Time:
        return self._kernel.now if self._kernel.ended else self._built.duration_ns

    def _window(self) -> Window:
        """When it acts, as far as that is known, with what has been requested."""
        state = self._state
        start, stop = state.start_ns, min(state.stop_ns, state.plan.stop_ns)
        for act in self._kernel.list_manual_acts(self._number)[1]:
            if act.act == self.id and act.action == "start" and start == NEVER:
                start, stop = act.at_ns, min(stop, act.at_ns + state.plan.lasts_ns)
            elif act.act == self.id and act.action == "stop":
                stop = min(stop, act.at_ns)
        return start, stop

    def _find_overlaps(self, start: ManualActTable) -> list[Problem]:
        """What would be wrong with a scenario that has this start too, with acts that exclude each other."""
        done = list_manual_acts(self._kernel, self._number)
        acts = [*(act for act in done if (act.act, act.action) != (start.act, start.action)), start]
        tables, end = self._built.scenario.acting, self._built.duration_ns
        return self._built.overlaps.find_problems({name: window_of(table, end, acts) for name, table in tables.items()})


class RunActs(dict[str, RunAct]):
    """The attacks and faults of a run by id, then its defences in their order."""

    def __missing__(self, act: str) -> RunAct:
        hint = nearest(act, self) or f"The run has {', '.join(self) or 'none'}."
        raise InputError.one("run", "acts", str(act), "an attack, a fault or a defence of the run", hint)


def list_acts(kernel: Kernel, built: BuiltScenario, number: int) -> RunActs:
    """The acts of a run; `number` is its own in the kernel."""
    return RunActs({act: RunAct(kernel, built, number, state) for act, state in kernel.list_acts(number).items()})


def list_manual_acts(kernel: Kernel, number: int) -> tuple[ManualActTable, ...]:
    """The starts and stops by hand of a run, as its scenario has them when it is flown again.

    Those without effect are left out where a later one has done the same to the same act.
    """
    carried_out, waiting = kernel.list_manual_acts(number)
    acts = [*(done.act for done in carried_out), *waiting]
    newest = {(act.act, act.action): place for place, act in enumerate(acts)}
    return tuple(ManualActTable.of_act(act) for place, act in enumerate(acts) if newest[act.act, act.action] == place)


def list_unstarted(acts: Iterable[Mapping[str, Any]]) -> list[str]:
    """A warning for each act that waits for a start by hand to the end; `acts` are as `RunAct.describe` has them."""
    return [
        f"{act['role']} {act['id']} did nothing: manual = true, and nobody has started it"
        for act in acts
        if act["manual"] and not act["muted"] and act["start_s"] is None
    ]


def describe_manual_acts(kernel: Kernel, number: int) -> list[dict[str, Any]]:
    """What the manifest says of the starts and stops by hand that have happened."""
    return [
        {**ManualActTable.of_act(done.act).model_dump(), "effective": done.effective}
        for done in kernel.list_manual_acts(number)[0]
    ]
