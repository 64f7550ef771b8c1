"""UAS service supplier (USS) of a federation: decides on the intents of its operators by what all USSs share.

Nobody approves its decisions. It asks the DSS which intents of others may be in the way, their USSs what these claim,
and compares. The DSS then accepts its intent only if it knows all of them in their current versions; otherwise it
learns what it has missed, and compares again. Whoever has a subscription there is told of the new intent.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

from uas_standards.astm.f3548.v21.api import OperationalIntentState as State
from uas_standards.astm.f3548.v21.api import OperationID as Op
from uas_standards.astm.f3548.v21.api import UssAvailabilityState
from uas_standards.astm.f3548.v21.constants import Scope

from skyrange.codec.f3548.frames import UssRequest, decode
from skyrange.codec.f3548.values import ConstraintReference, IntentDetails, IntentReference, volume_body, volumes_of
from skyrange.contracts.alerts import Scalar
from skyrange.contracts.mailboxes import Arrival, Inbox, Outbox, Turn
from skyrange.core.errors import DecodeError
from skyrange.core.ids import FrameId, Port
from skyrange.core.time import NEVER, NS_PER_MS, NS_PER_S, Epoch, Time
from skyrange.core.volumes import Volume4D
from skyrange.utm.alternatives import Limits, reach
from skyrange.utm.approval_service import answer_end, answer_intent, tell_overruled
from skyrange.utm.contract import Alternative, ApprovalDecision, OperationalIntent, Overruled, overruled_by
from skyrange.utm.federated.exchanges import (
    NOTHING,
    Call,
    Caller,
    Directory,
    Peer,
    Reply,
    Server,
    WrongReplyError,
)
from skyrange.utm.federated.tokens import TokenChecker, Tokens
from skyrange.utm.federated.uss.peer_requests import SERVES, PeerRequests
from skyrange.utm.federated.uss.shared_intents import OwnIntent, SharedIntents
from skyrange.utm.federated.uss.tasks import Task, TaskQueue
from skyrange.utm.intent_register import find_problem
from skyrange.utm.intent_states import OFF_NOMINAL, IntentState
from skyrange.utm.journal import Journal, NoJournal
from skyrange.utm.request_book import RequestBook

SERVICE_NS: Final = 10 * NS_PER_MS
MAX_CONFLICTS: Final = 32
"""How often the DSS may know more than the USS, before the operator is told to ask again."""
RETRY_NS: Final = 5 * NS_PER_S
"""After which a USS tries again to end an intent that the DSS did not let it end; OiMaxCancelTime."""
Refs = tuple[FrameId, ...]


class Uss:
    """A USS as an agent: requests of its operators on `approval` links, the federation on `uss` links.

    Requests of operators are worked on one after the other.

    Notes: those of `FlightApproval`; `decision.uss_conflict` about the vehicle whenever the DSS knew more, {intent,
    missing}; `decision.uss_failed` about the vehicle or a USS, {reason}; `decision.uss_bad_request` about itself.
    """

    def __init__(
        self,
        name: str,
        uss: str,
        *,
        operators: Sequence[tuple[str, Port]],
        dss: Peer,
        directory: Directory,
        base_url: str,
        tokens: Tokens,
        checker: TokenChecker,
        limits: Limits,
        epoch: Epoch,
        journal: Journal[OwnIntent] | None = None,
        earlier_intents: Iterable[OwnIntent] = (),
        constraints: bool = False,
    ) -> None:
        """`uss` is what tokens call it; `base_url` where others reach it.

        `earlier_intents` are those that it managed before a restart; `constraints` says whether it
        has the role of constraint processing.
        """
        self.name = name
        self.uss = uss
        self.service_ns = SERVICE_NS
        self.ports: Sequence[Port] = (
            *(port for _, port in operators),
            dss.port,
            *directory.ports,
        )
        self._book = RequestBook(operators)
        self._approvals = frozenset(port.link for _, port in operators)
        self._dss = dss
        self._directory = directory
        self._base_url = base_url
        self._tokens = tokens
        self._limits = limits
        self._epoch = epoch
        self._server = Server(name, checker, SERVES)
        self._caller = Caller()
        self._intents = SharedIntents(limits, epoch, journal or NoJournal())
        self._peer_requests = PeerRequests(self._server, self._intents, epoch)
        self._processes_constraints = constraints
        self._queue = TaskQueue()
        self._task: Task | None = None
        for earlier in earlier_intents:
            self._restore_intent(earlier)

    def _restore_intent(self, earlier: OwnIntent) -> None:
        """Go on with an intent that it managed before a restart."""
        self._intents.restore(earlier)
        self._book.restore(earlier.intent.operator, earlier.intent.id)
        if earlier.intent.state is IntentState.ENDED:
            self._queue.add(Task(earlier.intent, None, ()))

    @property
    def bad_requests(self) -> int:
        """Frames of the federation that were not understood, or refused unseen."""
        return self._server.bad_requests

    @property
    def own_intents(self) -> list[OperationalIntent]:
        """The intents that it manages, as the DSS has accepted them."""
        return self._intents.own_intents

    # --- the agent -----------------------------------------------------------------------------------------

    def next_wakeup(self) -> Time | None:
        """When a call is repeated, or a task is tried again."""
        due = self._caller.due
        if self._task is None:
            due = min(due, self._queue.due)
        return None if due == NEVER else due

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        """Read requests and the mail of the federation, and go on with what is in progress."""
        out = Outbox()
        turn = Turn(now, out)
        self._intents.forget(now)
        for arrival in inbox:
            if arrival.port.link in self._approvals:
                open_request = self._book.read(arrival, out)
                if open_request is not None:
                    self._queue.add(Task(open_request.request.intent(self._epoch), open_request, (open_request.cause,)))
            else:
                self._on_frame(turn.caused_by(arrival.ref), arrival)
        for call in self._caller.repeat_overdue(turn):
            self._on_failure(turn, call, f"does not answer {call.operation.value}")
        while self._task is None and (task := self._queue.take(now)) is not None:
            self._begin_task(turn, task)
        return out

    def _on_frame(self, turn: Turn, arrival: Arrival) -> None:
        try:
            frame = decode(arrival.payload)
            if isinstance(frame, UssRequest):
                request = self._server.read(turn, arrival, frame)
                if request is not None:
                    self._end_outranked(turn, self._peer_requests.answer(turn, request))
                return
            reply = self._caller.read(arrival, frame)
            if reply is not None:
                self._on_reply(turn, reply)
        except WrongReplyError as error:
            self._server.count_bad(str(error), arrival.ref, turn.out)
            self._on_failure(turn, error.call, f"answers {error.call.operation.value} wrongly")
        except DecodeError as error:
            self._server.count_bad(str(error), arrival.ref, turn.out)

    def _end_outranked(self, turn: Turn, intent: OperationalIntent | None) -> None:
        """Take an intent of another USS into account: it ends own ones that it outranks."""
        if intent is None:
            return
        if self._task is not None:
            self._task.relevant[intent.id] = None
        overruled = self._overrule_own_intents(intent, turn.causes)
        tell_overruled(turn, ApprovalDecision(accepted=True, overruled=overruled), self._book, self._epoch)

    def _overrule_own_intents(self, intent: OperationalIntent, causes: Refs) -> tuple[Overruled, ...]:
        """End the own intents that an intent outranks, but for those in flight."""
        overruled = []
        for other in self._intents.find_outranked(intent):
            overruling = overruled_by(intent, other)
            if not overruling.in_flight:
                self._queue.add(Task(self._intents.release(other), None, causes))
            overruled.append(overruling)
        return tuple(overruled)

    # --- a task --------------------------------------------------------------------------------------------

    def _begin_task(self, turn: Turn, task: Task) -> None:
        intent, known_intent = task.intent, self._intents.get(task.intent.id)
        managed = self._intents.own.get(intent.id)
        if task.ends and task.request is None and known_intent is not None:
            return  # its operator has claimed it anew
        self._task = task
        if self._intents.is_uncertain(intent.id):
            self._call_dss(turn, task, Op.GetOperationalIntentReference)
            return
        if task.ends:
            if managed is None:
                self._finish_end(turn, task)
            else:
                self._call_dss(turn, task, Op.DeleteOperationalIntentReference, parameters={"ovn": managed.ovn})
            return
        if managed is not None and known_intent == intent:
            self._answer_operator(turn, task, ApprovalDecision(accepted=True, ovn=managed.ovn, tracked=True))
            return
        problem = find_problem(turn.now, intent, known_intent.state if known_intent is not None else None)
        if not problem and managed is None and intent.state in OFF_NOMINAL:
            problem = f"an intent that is unknown cannot become {intent.state.value}"
        if problem:
            self._answer_operator(turn, task, ApprovalDecision(accepted=False, reason=problem))
        elif intent.state in OFF_NOMINAL:
            self._put_reference(turn, task)
        else:
            task.listed.clear()
            for operation in self._queries:
                area = {"area_of_interest": volume_body(self._query_area(task), self._epoch)}
                self._call_dss(turn, task, operation, body=area)

    @property
    def _queries(self) -> Sequence[Op]:
        """What it asks the DSS for."""
        if self._processes_constraints:
            return (Op.QueryOperationalIntentReferences, Op.QueryConstraintReferences)
        return (Op.QueryOperationalIntentReferences,)

    def _query_area(self, task: Task) -> Volume4D:
        return reach(task.intent.volumes, self._limits)

    def _on_reply(self, turn: Turn, reply: Reply) -> None:
        call, task = reply.call, self._task
        if call.operation is Op.NotifyOperationalIntentDetailsChanged:
            if reply.status != 204:
                self._note_failure(turn, call.receiver, f"notification: status {reply.status}")
            return
        if task is None or not task.takes(call.exchange):
            return  # its task was given up
        task.causes = (*task.causes[:1], reply.ref)
        try:
            self._continue_task(turn, task, reply)
        except DecodeError as error:
            self._fail_task(turn, task, f"{call.receiver} answers {call.operation.value} wrongly: {error}")

    def _continue_task(self, turn: Turn, task: Task, reply: Reply) -> None:
        """Go on with a task after a reply that belongs to it. Raises `DecodeError` for one that makes no sense."""
        call = reply.call
        if call.operation is Op.CreateOperationalIntentReference and 400 <= reply.status < 500 and call.tries == 1:
            self._intents.remove_own(task.intent.id)
        if call.operation in _DETAILS:
            self._on_details(turn, task, reply)
        elif reply.status in (200, 201):
            _ACCEPTED[call.operation](self, turn, task, reply)
        elif reply.status == 409 and call.operation in _CHANGES:
            self._on_conflict(turn, task, reply)
        elif reply.status == 404 and call.operation is Op.DeleteOperationalIntentReference:
            self._finish_end(turn, task)
        elif reply.status == 404 and call.operation is Op.GetOperationalIntentReference:  # the DSS has lost the intent
            self._intents.remove_own(task.intent.id)
            task.refusal = ""
            self._begin_task(turn, task)
        else:
            refusal = f"DSS: {reply.body.get('message') or f'status {reply.status}'}"
            if reply.status == 400 and call.operation is Op.UpdateOperationalIntentReference and not task.refusal:
                task.refusal = refusal  # perhaps because the DSS has lost the intent
                self._call_dss(turn, task, Op.GetOperationalIntentReference)
            else:
                self._fail_task(turn, task, refusal)

    def _on_references(self, turn: Turn, task: Task, reply: Reply) -> None:
        """The DSS has told what may be in the way."""
        if reply.call.operation is Op.QueryConstraintReferences:
            rows = reply.body.get("constraint_references", ())
            task.listed[reply.call.operation] = [ConstraintReference.of(reference, self._epoch) for reference in rows]
        else:
            rows = reply.body.get("operational_intent_references", ())
            task.listed[reply.call.operation] = [IntentReference.of(reference, self._epoch) for reference in rows]
        if len(task.listed) < len(self._queries):
            return
        references = [reference for operation in self._queries for reference in task.listed[operation]]
        self._intents.remove_others_but((reference.id for reference in references), [self._query_area(task)])
        for reference in references:
            if reference.manager == self.uss:
                self._confirm_own(task, reference)
            else:
                self._ask_for_details(turn, task, reference)
        self._decide_if_complete(turn, task)

    def _confirm_own(self, task: Task, reference: ConstraintReference) -> None:
        """The DSS has an own intent that the key has to name."""
        task.relevant[reference.id] = None
        if isinstance(reference, IntentReference):
            self._intents.confirm(reference)

    def _ask_for_details(self, turn: Turn, task: Task, reference: ConstraintReference) -> None:
        """Ask the managing USS what an intent claims or a constraint closes, unless the version is known."""
        known_reference = self._intents.find_other(reference.id)
        task.relevant[reference.id] = None
        if known_reference is not None and (known_reference.version, known_reference.manager) == (
            reference.version,
            reference.manager,
        ):
            return
        peer = self._directory.find(reference.uss_base_url)
        if peer is None:
            self._assume_worst(task, reference)
            return
        is_intent = isinstance(reference, IntentReference)
        scope = Scope.StrategicCoordination if is_intent else Scope.ConstraintProcessing
        token = self._tokens.get(turn.now, peer.name, scope.value)
        parameters = {"entityid": reference.id}
        operation = Op.GetOperationalIntentDetails if is_intent else Op.GetConstraintDetails
        exchange = self._caller.call(turn.caused_by(*task.causes), peer, operation, token=token, parameters=parameters)
        task.awaited[exchange] = reference

    def _on_details(self, turn: Turn, task: Task, reply: Reply) -> None:
        reference = task.awaited.pop(reply.call.exchange, None)
        if reference is None:
            return
        if reply.status == 200:
            try:
                self._store_details(reference, reply)
            except DecodeError as error:
                self._note_failure(turn, reference.manager, f"details: {error}")
                self._assume_worst(task, reference)
        elif reply.status == 404:  # it has ended since the DSS was asked
            self._intents.remove_other(reference.id)
            task.relevant.pop(reference.id, None)
        else:
            self._note_failure(turn, reference.manager, f"details: status {reply.status}")
            self._assume_worst(task, reference)
        self._decide_if_complete(turn, task)

    def _store_details(self, reference: ConstraintReference, reply: Reply) -> None:
        """Know the details of an intent or a constraint. Raises `DecodeError`."""
        is_intent = isinstance(reference, IntentReference)
        body = reply.body["operational_intent" if is_intent else "constraint"]
        kind = IntentReference if is_intent else ConstraintReference
        answered = kind.of(body["reference"], self._epoch)
        if (answered.id, answered.manager) != (reference.id, reference.manager):
            raise DecodeError("the details are those of another one")
        if isinstance(answered, IntentReference):
            self._intents.store_intent(answered, IntentDetails.of(body["details"], self._epoch))
        else:
            self._intents.store_constraint(answered, volumes_of(body["details"]["volumes"], self._epoch))

    def _assume_worst(self, task: Task, reference: ConstraintReference) -> None:
        """Suppose what an intent claims whose USS does not tell: nothing if that is down and nobody flies, else the
        whole area; and that a constraint closes the whole area.
        """
        if not isinstance(reference, IntentReference):
            self._intents.assume_constraint(reference, self._query_area(task))
            return
        is_down = reference.uss_availability is UssAvailabilityState.Down
        if is_down and reference.state is State.Accepted:
            task.relevant.pop(reference.id, None)
            self._intents.remove_other(reference.id)
            return
        self._intents.assume_intent(reference, self._query_area(task), task.intent.priority + 1)

    def _decide_if_complete(self, turn: Turn, task: Task) -> None:
        if task.awaited:
            return
        examined = self._intents.examine(task.intent)
        if examined.reason:
            rejection = ApprovalDecision(accepted=False, reason=examined.reason, alternatives=examined.alternatives)
            self._answer_operator(turn, task, rejection)
        else:
            task.outranked = len(examined.outranked)
            self._put_reference(turn, task)

    def _put_reference(self, turn: Turn, task: Task) -> None:
        """Have the DSS accept the intent, with the OVNs of all that is known to be there."""
        intent, managed = task.intent, self._intents.own.get(task.intent.id)
        is_new = managed is None or not managed.ovn
        if is_new:
            self._intents.announce(intent, self.uss, self._base_url)
        body = {
            "extents": [volume_body(volume, self._epoch) for volume in intent.volumes],
            "key": self._intents.list_ovns(id_ for id_ in task.relevant if id_ != intent.id),
            "state": (State.Accepted if is_new else intent.state).value,  # the DSS takes no other first version
            "uss_base_url": self._base_url,
            "new_subscription": {"uss_base_url": self._base_url, "notify_for_constraints": self._processes_constraints},
        }
        operation = Op.CreateOperationalIntentReference if is_new else Op.UpdateOperationalIntentReference
        parameters = {} if managed is None or is_new else {"ovn": managed.ovn}
        self._call_dss(turn, task, operation, parameters=parameters, body=body)

    def _on_accepted(self, turn: Turn, task: Task, reply: Reply) -> None:
        """The DSS has accepted a version of the intent. Raises `DecodeError` if it is another than was sent."""
        reference = IntentReference.of(reply.body["operational_intent_reference"], self._epoch)
        created = reply.call.operation is Op.CreateOperationalIntentReference
        sent = State.Accepted.value if created else task.intent.state.value
        if (reference.id, reference.manager, reference.state.value) != (task.intent.id, self.uss, sent):
            raise DecodeError("the reference is that of another intent, USS or state")
        if not reference.ovn:
            raise DecodeError("the reference has no OVN")
        task.is_new = reference.version == 1
        intent = replace(task.intent, state=IntentState(reference.state.value))
        self._intents.accept(intent, reference)
        self._notify_subscribers(turn, intent, reference, reply)
        if intent.state is not task.intent.state:
            self._put_reference(turn, task)
            return
        overruled = self._overrule_own_intents(intent, task.causes)
        accepted = ApprovalDecision(accepted=True, ovn=reference.ovn, tracked=True)
        self._answer_operator(turn, task, replace(accepted, overruled=overruled, conflicts=task.outranked))

    def _on_deleted(self, turn: Turn, task: Task, reply: Reply) -> None:
        reference = IntentReference.of(reply.body["operational_intent_reference"], self._epoch)
        self._notify_subscribers(turn, None, reference, reply)
        self._finish_end(turn, task)

    def _on_own_reference(self, turn: Turn, task: Task, reply: Reply) -> None:
        """The DSS has told the current version of an own intent."""
        if task.refusal:
            self._fail_task(turn, task, task.refusal)
            return
        reference = IntentReference.of(reply.body["operational_intent_reference"], self._epoch)
        if reference.id != task.intent.id or not reference.ovn:
            raise DecodeError("the reference is that of another intent, or has no OVN")
        if reference.manager == self.uss:
            self._intents.own[task.intent.id] = reference
            self._begin_task(turn, task)
        elif task.ends:
            self._finish_end(turn, task)
        else:
            self._intents.remove_own(task.intent.id)
            self._fail_task(turn, task, f"{task.intent.id} is an intent of {reference.manager}")

    def _on_conflict(self, turn: Turn, task: Task, reply: Reply) -> None:
        """The DSS knows intents that this USS does not, or another version of this one."""
        intents, constraints = (
            reply.body.get(name) or () for name in ("missing_operational_intents", "missing_constraints")
        )
        missing: list[ConstraintReference] = [IntentReference.of(reference, self._epoch) for reference in intents]
        missing += [ConstraintReference.of(reference, self._epoch) for reference in constraints]
        task.conflicts += 1
        if task.conflicts > MAX_CONFLICTS:
            again = (Alternative(task.intent.volumes),) if missing else ()
            reason = (
                "others claim airspace there all the time" if missing else "DSS: status 409, without what is missing"
            )
            self._fail_task(turn, task, reason, again)
            return
        data: dict[str, Scalar] = {"intent": task.intent.id, "missing": len(missing)}
        turn.note("decision.uss_conflict", task.intent.vehicle, data)
        if not missing:
            self._call_dss(turn, task, Op.GetOperationalIntentReference)
            return
        for reference in missing:
            if reference.manager == self.uss:
                self._confirm_own(task, reference)
            else:
                self._intents.remove_other(reference.id)  # the version that was known is not the current one
                self._ask_for_details(turn, task, reference)
        self._decide_if_complete(turn, task)

    def _on_failure(self, turn: Turn, call: Call, problem: str) -> None:
        """A call was not answered, or not as the standard has it."""
        name, task = call.receiver, self._task
        self._note_failure(turn.caused_by(*call.causes), name, problem)
        if task is None or not task.takes(call.exchange):
            return
        if call.operation in _DETAILS:
            reference = task.awaited.pop(call.exchange, None)
            if reference is not None:
                self._assume_worst(task, reference)
                self._decide_if_complete(turn, task)
        else:
            self._fail_task(turn, task, f"{name} {problem}")

    def _fail_task(self, turn: Turn, task: Task, reason: str, again: tuple[Alternative, ...] = ()) -> None:
        """Nothing can be decided. The operator is told why, with the same flight as the alternative (`again`) only
        where others were quicker. An end is tried again later, until the time of the intent is over.
        """
        self._note_failure(turn.caused_by(*task.causes), task.intent.vehicle, reason)
        managed = self._intents.own.get(task.intent.id)
        if not task.ends:
            rejection = ApprovalDecision(accepted=False, reason=reason[:256], alternatives=again)
            self._answer_operator(turn, task, rejection)
        elif managed is None or managed.end_ns <= turn.now:
            self._finish_end(turn, task)
        else:
            task.due = turn.now + RETRY_NS
            self._task = None
            self._queue.add(task)

    def _answer_operator(self, turn: Turn, task: Task, decision: ApprovalDecision) -> None:
        self._task = None
        if not decision.accepted and (task.is_new or self._intents.is_uncertain(task.intent.id)):
            self._queue.add(Task(self._intents.release(task.intent), None, task.causes))
        if task.request is not None:
            answer_intent(turn, task.request, decision, self._book, self._epoch)

    def _finish_end(self, turn: Turn, task: Task) -> None:
        self._task = None
        self._intents.end(task.intent.id)
        if task.request is not None:
            answer_end(turn, task.request, self._book)

    # --- the federation ------------------------------------------------------------------------------------

    def _call_dss(
        self,
        turn: Turn,
        task: Task,
        operation: Op,
        *,
        parameters: Mapping[str, str] = NOTHING,
        body: Mapping[str, Any] | None = None,
    ) -> None:
        off_nominal = task.intent.state in OFF_NOMINAL
        scopes = [Scope.ConformanceMonitoringForSituationalAwareness if off_nominal else Scope.StrategicCoordination]
        if self._processes_constraints:
            scopes.append(Scope.ConstraintProcessing)
        token = self._tokens.get(turn.now, self._dss.name, *(scope.value for scope in scopes))
        parameters = {"entityid": task.intent.id, **parameters}
        turn = turn.caused_by(*task.causes)
        task.calls.add(self._caller.call(turn, self._dss, operation, token=token, parameters=parameters, body=body))

    def _notify_subscribers(
        self, turn: Turn, intent: OperationalIntent | None, reference: IntentReference, reply: Reply
    ) -> None:
        """Tell the subscribers of an intent, or of its end."""
        for subscriber in reply.body.get("subscribers") or ():
            peer = self._directory.find(subscriber["uss_base_url"])
            if peer is None:
                continue  # its own, or a USS that it cannot reach
            body: dict[str, Any] = {"operational_intent_id": reference.id, "subscriptions": subscriber["subscriptions"]}
            if intent is not None:
                body["operational_intent"] = self._intents.describe_own(intent, reference)
            token = self._tokens.get(turn.now, peer.name, Scope.StrategicCoordination.value)
            operation = Op.NotifyOperationalIntentDetailsChanged
            self._caller.call(turn, peer, operation, token=token, body=body)

    def _note_failure(self, turn: Turn, about: str, reason: str) -> None:
        turn.note("decision.uss_failed", about, {"reason": reason[:256]})


_CHANGES: Final = frozenset(
    {
        Op.CreateOperationalIntentReference,
        Op.UpdateOperationalIntentReference,
        Op.DeleteOperationalIntentReference,
    }
)
_DETAILS: Final = frozenset({Op.GetOperationalIntentDetails, Op.GetConstraintDetails})
_Accepted = Callable[[Uss, Turn, Task, Reply], None]
_ACCEPTED: Final[Mapping[Op, _Accepted]] = {
    Op.QueryOperationalIntentReferences: Uss._on_references,
    Op.QueryConstraintReferences: Uss._on_references,
    Op.CreateOperationalIntentReference: Uss._on_accepted,
    Op.UpdateOperationalIntentReference: Uss._on_accepted,
    Op.DeleteOperationalIntentReference: Uss._on_deleted,
    Op.GetOperationalIntentReference: Uss._on_own_reference,
}
