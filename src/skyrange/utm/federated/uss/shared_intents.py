"""Intents that a USS knows: those that it manages, and those of others of which it was told."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

from uas_standards.astm.f3548.v21.api import OperationalIntentState as State

from skyrange.codec.f3548.values import ConstraintReference, IntentDetails, IntentReference
from skyrange.core.errors import DecodeError
from skyrange.core.time import Epoch, Time
from skyrange.core.volumes import Volume4D
from skyrange.utm.alternatives import Limits
from skyrange.utm.contract import OperationalIntent, claim_of
from skyrange.utm.intent_register import Examination, IntentRegister
from skyrange.utm.intent_states import OFF_NOMINAL, IntentState
from skyrange.utm.journal import Journal


class OwnIntent(NamedTuple):
    """An intent that a USS manages."""

    intent: OperationalIntent
    """What its operator claims; of one that has ended, perhaps not yet at the DSS, without volumes."""
    reference: IntentReference
    """The version that the DSS has; without an OVN where the DSS was asked for the first one, and may have it."""


UNKNOWN_VERSION: Final = -1
"""Of an intent whose USS did not tell what it claims."""


class SharedIntents:
    """References by id, and what they claim in one register. Deep-copyable."""

    def __init__(self, limits: Limits, epoch: Epoch, journal: Journal[OwnIntent]) -> None:
        """`limits` of the alternatives that are offered; `journal` is told of own intents."""
        self.own: dict[str, IntentReference] = {}
        """References of the intents that it manages, as the DSS has accepted them; see `OwnIntent`."""
        self._others: dict[str, ConstraintReference] = {}
        """References of the intents and constraints of others."""
        self._register = IntentRegister(limits)
        self._epoch = epoch
        self._journal = journal

    def forget(self, now: Time) -> None:
        """Forget intents that are long over."""
        for id_ in self._register.forget(now):
            self._others.pop(id_, None)
            self.remove_own(id_)

    def get(self, id_: str) -> OperationalIntent | None:
        """What an intent claims, if it is known."""
        return self._register.get(id_)

    def find_other(self, id_: str) -> ConstraintReference | None:
        """The reference of an intent or a constraint of another USS."""
        return self._others.get(id_)

    @property
    def own_intents(self) -> list[OperationalIntent]:
        """Own intents that claim airspace."""
        intents = (self._register.get(id_) for id_ in self.own)
        return [intent for intent in intents if intent is not None]

    def examine(self, intent: OperationalIntent) -> Examination:
        """What of all that is known is in the way of an intent, and alternatives to it."""
        return self._register.examine(intent)

    # --- own intents ---------------------------------------------------------------------------------------

    def announce(self, intent: OperationalIntent, manager: str, base_url: str) -> None:
        """The DSS is about to be asked for the first version of an own intent.

        The journal has the intent as one that has ended, so that a USS that is killed before it knows the answer
        removes from the DSS what nobody claims.
        """
        reference = IntentReference(
            id=intent.id,
            manager=manager,
            version=0,
            ovn="",
            uss_base_url=base_url,
            start_ns=min(volume.start_ns for volume in intent.volumes),
            end_ns=max(volume.end_ns for volume in intent.volumes),
            state=State.Accepted,
        )
        self.own[intent.id] = reference
        self._journal.put(OwnIntent(_ended(intent), reference))

    def confirm(self, reference: IntentReference) -> None:
        """The DSS has an own intent; it may be one of which that was not certain."""
        if self.is_uncertain(reference.id):
            self.own[reference.id] = reference

    def is_uncertain(self, id_: str) -> bool:
        """Whether the DSS may have an own intent or not."""
        reference = self.own.get(id_)
        return reference is not None and not reference.ovn

    def accept(self, intent: OperationalIntent, reference: IntentReference) -> None:
        """The DSS has accepted a version of an own intent."""
        self.restore(OwnIntent(intent, reference))
        self._journal.put(OwnIntent(intent, reference))

    def restore(self, own_intent: OwnIntent) -> None:
        """An own intent is known from before."""
        self.own[own_intent.intent.id] = own_intent.reference
        if own_intent.intent.volumes:
            self._register.put(own_intent.intent)

    def release(self, intent: OperationalIntent) -> OperationalIntent:
        """Release the airspace of an own intent, which the DSS may still know; returns it as one that has ended."""
        ended = _ended(intent)
        self._register.remove(intent.id)
        if intent.id in self.own:
            self._journal.put(OwnIntent(ended, self.own[intent.id]))
        return ended

    def remove_own(self, id_: str) -> None:
        """The DSS does not have an own intent."""
        if self.own.pop(id_, None) is not None:
            self._journal.delete(id_)

    def end(self, id_: str) -> None:
        """An own intent has ended."""
        self._register.remove(id_)
        self.remove_own(id_)

    def find_outranked(self, intent: OperationalIntent) -> list[OperationalIntent]:
        """Own intents that one of higher priority overlaps, and that are not flown outside their volumes."""
        outranked = []
        for id_ in self._register.overlapping(intent.volumes, ignored=intent.id):
            own_intent = self._register.get(id_) if id_ in self.own else None
            if own_intent is not None and own_intent.priority < intent.priority and own_intent.state not in OFF_NOMINAL:
                outranked.append(own_intent)
        return outranked

    # --- those of others -----------------------------------------------------------------------------------

    def store_intent(self, reference: IntentReference, details: IntentDetails) -> None:
        """Know a version of an intent of another USS. Raises `DecodeError` for one without volumes."""
        volumes = (*details.volumes, *details.off_nominal_volumes)
        if not volumes:
            raise DecodeError("an intent without volumes")
        vehicle = f"{reference.manager} ({reference.id[:8]})"
        state = IntentState(reference.state.value)
        self._others[reference.id] = reference
        self._register.put(
            OperationalIntent(reference.id, reference.manager, vehicle, volumes, details.priority, state)
        )

    def store_constraint(self, reference: ConstraintReference, volumes: Sequence[Volume4D]) -> None:
        """Know a version of a constraint. Raises `DecodeError` for one without volumes."""
        if not volumes:
            raise DecodeError("a constraint without volumes")
        self._others[reference.id] = reference
        self._register.put(claim_of(reference.id, reference.id[:8], volumes))

    def assume_constraint(self, reference: ConstraintReference, area: Volume4D) -> None:
        """Suppose that a constraint closes `area`, because its manager does not tell."""
        self.store_constraint(replace(reference, version=UNKNOWN_VERSION), [area])

    def assume_intent(self, reference: IntentReference, area: Volume4D, priority: int) -> None:
        """Suppose that an intent claims `area`, because its USS does not tell; it is asked again the next time."""
        self.store_intent(replace(reference, version=UNKNOWN_VERSION), IntentDetails((area,), (), priority))

    def remove_other(self, id_: str) -> None:
        """Know an intent of another USS no more."""
        if self._others.pop(id_, None) is not None:
            self._register.remove(id_)

    def remove_others_but(self, ids: Iterable[str], area: Sequence[Volume4D]) -> None:
        """Know no other intents of others in an area than these, because the DSS knows no others."""
        kept_ids = frozenset(ids)
        for id_ in self._register.overlapping(area):
            if id_ not in kept_ids:
                self.remove_other(id_)

    # --- what is told --------------------------------------------------------------------------------------

    def list_ovns(self, ids: Iterable[str]) -> list[str]:
        """The OVNs of the versions of intents and constraints that are known."""
        known = (self.own.get(id_) or self._others.get(id_) for id_ in ids)
        return sorted(reference.ovn for reference in known if reference is not None and reference.ovn)

    def describe_own(self, intent: OperationalIntent, reference: IntentReference) -> dict[str, Any]:
        """An own intent as JSON, for another USS."""
        off_nominal = intent.state in OFF_NOMINAL
        nominal, outside = ((), intent.volumes) if off_nominal else (intent.volumes, ())
        details = IntentDetails(nominal, outside, intent.priority)
        return {"reference": reference.body(self._epoch), "details": details.body(self._epoch)}


def _ended(intent: OperationalIntent) -> OperationalIntent:
    return replace(intent, volumes=(), state=IntentState.ENDED)
