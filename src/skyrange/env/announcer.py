"""Agent that notes what the environment's agents have chosen, so that the record of an episode has all of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.core.ids import Port
from skyrange.core.time import NS_PER_MS, Time
from skyrange.env.acts import ACT_DELAY_NS, BlueAct, BlueChoices, Clock, RedChoice


@dataclass(slots=True)
class Announcer:
    """Notes each choice but "nothing", when its step begins."""

    name: str
    choices: RedChoice | BlueChoices
    clock: Clock
    ports: Sequence[Port] = ()
    service_ns: Time = NS_PER_MS
    due: Time = ACT_DELAY_NS

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        """Note the choices of the step that has begun."""
        out, choices = Outbox(), self.choices
        self.due = self.clock.next_act(now)
        if isinstance(choices, RedChoice):
            if choices.act is not None:
                out.note("event.red_action", choices.vehicle, {"action": choices.act.name.lower()})
            return out
        for vehicle, act in choices.acts.items():
            if act is not BlueAct.NOTHING:
                out.note("event.blue_action", vehicle, {"action": act.name.lower()})
        return out

    def next_wakeup(self) -> Time | None:
        """The beginning of the next step."""
        return self.due
