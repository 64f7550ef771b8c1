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
from skyrange.contracts.mailboxes import Arrival, Inbox, Outbox
from skyrange.core.errors import DecodeError
from skyrange.core.ids import FrameId, Port
from skyrange.core.time import NEVER, NS_PER_MS, NS_PER_S, Epoch, Time
from skyrange.core.volumes import Volume4D
from skyrange.utm.alternatives import Limits, reach
from skyrange.utm.approval_service import answer_end, answer_intent, tell_overruled
from skyrange.utm.contract import Alternative, ApprovalDecision, OperationalIntent, Overruled, overruled_by
from skyrange.utm.federated.exchanges import Asked, Call, Caller, Reply, Server, WrongReplyError
from skyrange.utm.federated.tokens import TokenChecker, Tokens
from skyrange.utm.federated.uss.directory import Directory, Peer
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
        operators: Sequence[tuple[str, Port]],
        dss: Peer,
        directory: Directory,
        base_url: str,
        tokens: Tokens,
        checker: TokenChecker,
        limits: Limits,
        epoch: Epoch,
        journal: Journal[OwnIntent] | None = None,
        own: Iterable[OwnIntent] = (),
        constraints: bool = False,
    ) -> None:
        """`uss` is what tokens call it; `base_url` where others reach it; `own` what it managed before a restart.

        `constraints` says whether it has the role of constraint processing.
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
        for one in own:
            self._restore(one)

    def _restore(self, own: OwnIntent) -> None:
        """Go on with an intent that it managed before a restart."""
        self._intents.restore(own)
        self._book.restore(own.intent.operator, own.intent.id)
        if own.intent.state is IntentState.ENDED:
            self._queue.add(Task(own.intent, None, ()))

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
        self._intents.forget(now)
        for arrival in inbox:
            if arrival.port.link in self._approvals:
                asked = self._book.read(arrival, out)
                if asked is not None:
                    self._queue.add(Task(asked.request.intent(self._epoch), asked, (asked.cause,)))
            else:
                self._on_frame(now, arrival, out)
        for call in self._caller.on_time(now, out):
            self._on_failure(now, call, f"does not answer {call.operation.value}", out)
        while self._task is None and (task := self._queue.take(now)) is not None:
            self._begin(now, task, out)
        return out

    def _on_frame(self, now: Time, arrival: Arrival, out: Outbox) -> None:
        try:
            frame = decode(arrival.payload)
            if isinstance(frame, UssRequest):
                asked = self._server.read(now, arrival, frame, out)
                if asked is not None:
                    self._be_told(self._peer_requests.answer(now, asked, out), asked, out)
                return
            reply = self._caller.read(arrival, frame)
            if reply is not None:
                self._on_reply(now, reply, out)
        except WrongReplyError as error:
            self._server.count_bad(str(error), arrival.ref, out)
            self._on_failure(now, error.call, f"answers {error.call.operation.value} wrongly", out)
        except DecodeError as error:
            self._server.count_bad(str(error), arrival.ref, out)

    def _be_told(self, intent: OperationalIntent | None, asked: Asked, out: Outbox) -> None:
        """Take an intent of another USS into account: it ends own ones that it outranks."""
        if intent is None:
            return
        if self._task is not None:
            self._task.relevant[intent.id] = None
        overruled = self._overrule(intent, (asked.ref,))
        tell_overruled(ApprovalDecision(accepted=True, overruled=overruled), self._book, self._epoch, (asked.ref,), out)

    def _overrule(self, intent: OperationalIntent, causes: Refs) -> tuple[Overruled, ...]:
        """End the own intents that an intent outranks, but for those in flight."""
        overruled = []
        for other in self._intents.find_outranked(intent):
            one = overruled_by(intent, other)
            if not one.in_flight:
                self._queue.add(Task(self._intents.release(other), None, causes))
            overruled.append(one)
        return tuple(overruled)

    # --- a task --------------------------------------------------------------------------------------------

    def _begin(self, now: Time, task: Task, out: Outbox) -> None:
        intent, held = task.intent, self._intents.get(task.intent.id)
        own = self._intents.own.get(intent.id)
        if task.ends and task.asked is None and held is not None:
            return  # its operator has claimed it anew
        self._task = task
        if self._intents.is_uncertain(intent.id):
            self._call_dss(now, task, Op.GetOperationalIntentReference, {}, None, out)
            return
        if task.ends:
            if own is None:
                self._finish_end(task, out)
            else:
                self._call_dss(now, task, Op.DeleteOperationalIntentReference, {"ovn": own.ovn}, None, out)
            return
        if own is not None and held == intent:
            self._answer(task, ApprovalDecision(accepted=True, ovn=own.ovn, tracked=True), out)
            return
        problem = find_problem(now, intent, held.state if held is not None else None)
        if not problem and own is None and intent.state in OFF_NOMINAL:
            problem = f"an intent that is unknown cannot become {intent.state.value}"
        if problem:
            self._answer(task, ApprovalDecision(accepted=False, reason=problem), out)
        elif intent.state in OFF_NOMINAL:
            self._put(now, task, out)
        else:
            task.listed.clear()
            for operation in self._queries:
                area = {"area_of_interest": volume_body(self._area(task), self._epoch)}
                self._call_dss(now, task, operation, {}, area, out)

    @property
    def _queries(self) -> Sequence[Op]:
        """What it asks the DSS for."""
        if self._processes_constraints:
            return (Op.QueryOperationalIntentReferences, Op.QueryConstraintReferences)
        return (Op.QueryOperationalIntentReferences,)

    def _area(self, task: Task) -> Volume4D:
        return reach(task.intent.volumes, self._limits)

    def _on_reply(self, now: Time, reply: Reply, out: Outbox) -> None:
        call, task = reply.call, self._task
        if call.operation is Op.NotifyOperationalIntentDetailsChanged:
            if reply.status != 204:
                self._note_failure(call.receiver, f"notification: status {reply.status}", (reply.ref,), out)
            return
        if task is None or not task.takes(call.exchange):
            return  # its task was given up
        task.causes = (*task.causes[:1], reply.ref)
        if call.operation is Op.CreateOperationalIntentReference and 400 <= reply.status < 500 and call.tries == 1:
            self._intents.lose_own(task.intent.id)
        if call.operation in _DETAILS:
            self._on_details(now, task, reply, out)
        elif reply.status in (200, 201):
            _ACCEPTED[call.operation](self, now, task, reply, out)
        elif reply.status == 409:
            self._on_conflict(now, task, reply, out)
        elif reply.status == 404 and call.operation is Op.DeleteOperationalIntentReference:
            self._finish_end(task, out)
        elif reply.status == 404 and call.operation is Op.GetOperationalIntentReference:  # the DSS has lost the intent
            self._intents.lose_own(task.intent.id)
            task.refusal = ""
            self._begin(now, task, out)
        else:
            refusal = f"DSS: {reply.body.get('message') or f'status {reply.status}'}"
            if reply.status == 400 and call.operation is Op.UpdateOperationalIntentReference and not task.refusal:
                task.refusal = refusal  # perhaps because the DSS has lost the intent
                self._call_dss(now, task, Op.GetOperationalIntentReference, {}, None, out)
            else:
                self._fail(now, task, refusal, out)

    def _on_references(self, now: Time, task: Task, reply: Reply, out: Outbox) -> None:
        """The DSS has told what may be in the way."""
        if reply.call.operation is Op.QueryConstraintReferences:
            rows = reply.body.get("constraint_references", ())
            task.listed[reply.call.operation] = [ConstraintReference.of(one, self._epoch) for one in rows]
        else:
            rows = reply.body.get("operational_intent_references", ())
            task.listed[reply.call.operation] = [IntentReference.of(one, self._epoch) for one in rows]
        if len(task.listed) < len(self._queries):
            return
        found = [one for operation in self._queries for one in task.listed[operation]]
        self._intents.lose_all_but((one.id for one in found), [self._area(task)])
        for one in found:
            if one.manager == self.uss:
                self._expect_own(task, one)
            else:
                self._inquire(now, task, one, out)
        self._decide_if_told(now, task, out)

    def _expect_own(self, task: Task, reference: ConstraintReference) -> None:
        """The DSS has an own intent that the key has to name."""
        task.relevant[reference.id] = None
        if isinstance(reference, IntentReference):
            self._intents.confirm(reference)

    def _inquire(self, now: Time, task: Task, reference: ConstraintReference, out: Outbox) -> None:
        """Ask the managing USS what an intent claims or a constraint closes, unless the version is known."""
        known = self._intents.other(reference.id)
        task.relevant[reference.id] = None
        if known is not None and (known.version, known.manager) == (reference.version, reference.manager):
            return
        peer = self._directory.find(reference.uss_base_url)
        if peer is None:
            self._assume(task, reference)
            return
        is_intent = isinstance(reference, IntentReference)
        scope = Scope.StrategicCoordination if is_intent else Scope.ConstraintProcessing
        token = self._tokens.get(now, peer.name, scope.value)
        parameters = {"entityid": reference.id}
        operation = Op.GetOperationalIntentDetails if is_intent else Op.GetConstraintDetails
        exchange = self._caller.call(now, peer.name, peer.port, token, operation, parameters, None, task.causes, out)
        task.awaited[exchange] = reference

    def _on_details(self, now: Time, task: Task, reply: Reply, out: Outbox) -> None:
        reference = task.awaited.pop(reply.call.exchange, None)
        if reference is None:
            return
        if reply.status == 200:
            try:
                self._learn(reference, reply)
            except DecodeError as error:
                self._note_failure(reference.manager, f"details: {error}", (reply.ref,), out)
                self._assume(task, reference)
        elif reply.status == 404:  # it has ended since the DSS was asked
            self._intents.lose(reference.id)
            task.relevant.pop(reference.id, None)
        else:
            self._note_failure(reference.manager, f"details: status {reply.status}", (reply.ref,), out)
            self._assume(task, reference)
        self._decide_if_told(now, task, out)

    def _learn(self, reference: ConstraintReference, reply: Reply) -> None:
        """Know the details of an intent or a constraint. Raises `DecodeError`."""
        is_intent = isinstance(reference, IntentReference)
        body = reply.body["operational_intent" if is_intent else "constraint"]
        kind = IntentReference if is_intent else ConstraintReference
        told = kind.of(body["reference"], self._epoch)
        if (told.id, told.manager) != (reference.id, reference.manager):
            raise DecodeError("the details are those of another one")
        if isinstance(told, IntentReference):
            self._intents.learn(told, IntentDetails.of(body["details"], self._epoch))
        else:
            self._intents.learn_constraint(told, volumes_of(body["details"]["volumes"], self._epoch))

    def _assume(self, task: Task, reference: ConstraintReference) -> None:
        """Suppose what an intent claims whose USS does not tell: nothing if that is down and nobody flies, else the
        whole area; and that a constraint closes the whole area.
        """
        if not isinstance(reference, IntentReference):
            self._intents.assume_constraint(reference, self._area(task))
            return
        is_down = reference.uss_availability is UssAvailabilityState.Down
        if is_down and reference.state is State.Accepted:
            task.relevant.pop(reference.id, None)
            self._intents.lose(reference.id)
            return
        self._intents.assume(reference, self._area(task), task.intent.priority + 1)

    def _decide_if_told(self, now: Time, task: Task, out: Outbox) -> None:
        if task.awaited:
            return
        found = self._intents.examine(task.intent)
        if found.reason:
            rejection = ApprovalDecision(accepted=False, reason=found.reason, alternatives=found.alternatives)
            self._answer(task, rejection, out)
        else:
            task.outranked = len(found.outranked)
            self._put(now, task, out)

    def _put(self, now: Time, task: Task, out: Outbox) -> None:
        """Have the DSS accept the intent, with the OVNs of all that is known to be there."""
        intent, own = task.intent, self._intents.own.get(task.intent.id)
        is_new = own is None or not own.ovn
        if is_new:
            self._intents.announce(intent, self.uss, self._base_url)
        body = {
            "extents": [volume_body(one, self._epoch) for one in intent.volumes],
            "key": self._intents.key(id_ for id_ in task.relevant if id_ != intent.id),
            "state": (State.Accepted if is_new else intent.state).value,  # the DSS takes no other first version
            "uss_base_url": self._base_url,
            "new_subscription": {"uss_base_url": self._base_url, "notify_for_constraints": self._processes_constraints},
        }
        operation = Op.CreateOperationalIntentReference if is_new else Op.UpdateOperationalIntentReference
        self._call_dss(now, task, operation, {} if own is None or is_new else {"ovn": own.ovn}, body, out)

    def _on_accepted(self, now: Time, task: Task, reply: Reply, out: Outbox) -> None:
        reference = IntentReference.of(reply.body["operational_intent_reference"], self._epoch)
        task.is_new = reference.version == 1
        intent = replace(task.intent, state=IntentState(reference.state.value))
        self._intents.accept(intent, reference)
        self._notify(now, intent, reference, reply, out)
        if intent.state is not task.intent.state:
            self._put(now, task, out)
            return
        overruled = self._overrule(intent, task.causes)
        accepted = ApprovalDecision(accepted=True, ovn=reference.ovn, tracked=True)
        self._answer(task, replace(accepted, overruled=overruled, conflicts=task.outranked), out)

    def _on_deleted(self, now: Time, task: Task, reply: Reply, out: Outbox) -> None:
        reference = IntentReference.of(reply.body["operational_intent_reference"], self._epoch)
        self._notify(now, None, reference, reply, out)
        self._finish_end(task, out)

    def _on_own_reference(self, now: Time, task: Task, reply: Reply, out: Outbox) -> None:
        """The DSS has told the current version of an own intent."""
        if task.refusal:
            self._fail(now, task, task.refusal, out)
            return
        reference = IntentReference.of(reply.body["operational_intent_reference"], self._epoch)
        if reference.manager == self.uss:
            self._intents.own[task.intent.id] = reference
            self._begin(now, task, out)
        elif task.ends:
            self._finish_end(task, out)
        else:
            self._intents.lose_own(task.intent.id)
            self._fail(now, task, f"{task.intent.id} is an intent of {reference.manager}", out)

    def _on_conflict(self, now: Time, task: Task, reply: Reply, out: Outbox) -> None:
        """The DSS knows intents that this USS does not, or another version of this one."""
        task.conflicts += 1
        if task.conflicts > MAX_CONFLICTS:
            self._fail(now, task, "others claim airspace there all the time", out)
            return
        intents, constraints = (
            reply.body.get(name) or () for name in ("missing_operational_intents", "missing_constraints")
        )
        missing: list[ConstraintReference] = [IntentReference.of(one, self._epoch) for one in intents]
        missing += [ConstraintReference.of(one, self._epoch) for one in constraints]
        data: dict[str, Scalar] = {"intent": task.intent.id, "missing": len(missing)}
        out.note("decision.uss_conflict", task.intent.vehicle, data, (reply.ref,))
        if not missing:
            self._call_dss(now, task, Op.GetOperationalIntentReference, {}, None, out)
            return
        for one in missing:
            if one.manager == self.uss:
                self._expect_own(task, one)
            else:
                self._intents.lose(one.id)  # the version that was known is not the current one
                self._inquire(now, task, one, out)
        self._decide_if_told(now, task, out)

    def _on_failure(self, now: Time, call: Call, problem: str, out: Outbox) -> None:
        """A call was not answered, or not as the standard has it."""
        name, task = call.receiver, self._task
        self._note_failure(name, problem, call.causes, out)
        if task is None or not task.takes(call.exchange):
            return
        if call.operation in _DETAILS:
            reference = task.awaited.pop(call.exchange, None)
            if reference is not None:
                self._assume(task, reference)
                self._decide_if_told(now, task, out)
        else:
            self._fail(now, task, f"{name} {problem}", out)

    def _fail(self, now: Time, task: Task, reason: str, out: Outbox) -> None:
        """Nothing can be decided now: an end is tried again later; an operator may ask again for the same."""
        self._note_failure(task.intent.vehicle, reason, task.causes, out)
        if task.ends:
            task.due = now + RETRY_NS
            self._task = None
            self._queue.add(task)
            return
        again = (Alternative(task.intent.volumes),) if task.intent.volumes else ()
        self._answer(task, ApprovalDecision(accepted=False, reason=reason[:256], alternatives=again), out)

    def _answer(self, task: Task, decision: ApprovalDecision, out: Outbox) -> None:
        self._task = None
        if not decision.accepted and (task.is_new or self._intents.is_uncertain(task.intent.id)):
            self._queue.add(Task(self._intents.release(task.intent), None, task.causes))
        if task.asked is not None:
            answer_intent(task.asked, decision, self._book, self._epoch, out)

    def _finish_end(self, task: Task, out: Outbox) -> None:
        self._task = None
        self._intents.end(task.intent.id)
        if task.asked is not None:
            answer_end(task.asked, self._book, out)

    # --- the federation ------------------------------------------------------------------------------------

    def _call_dss(
        self, now: Time, task: Task, operation: Op, more: Mapping[str, str], body: Mapping[str, Any] | None, out: Outbox
    ) -> None:
        off_nominal = task.intent.state in OFF_NOMINAL
        scopes = [Scope.ConformanceMonitoringForSituationalAwareness if off_nominal else Scope.StrategicCoordination]
        if self._processes_constraints:
            scopes.append(Scope.ConstraintProcessing)
        token = self._tokens.get(now, self._dss.name, *(scope.value for scope in scopes))
        parameters = {"entityid": task.intent.id, **more}
        receiver, port = self._dss.name, self._dss.port
        task.calls.add(self._caller.call(now, receiver, port, token, operation, parameters, body, task.causes, out))

    def _notify(
        self, now: Time, intent: OperationalIntent | None, reference: IntentReference, reply: Reply, out: Outbox
    ) -> None:
        """Tell the subscribers of an intent, or of its end."""
        for one in reply.body.get("subscribers") or ():
            peer = self._directory.find(one["uss_base_url"])
            if peer is None:
                continue  # its own, or a USS that it cannot reach
            body: dict[str, Any] = {"operational_intent_id": reference.id, "subscriptions": one["subscriptions"]}
            if intent is not None:
                body["operational_intent"] = self._intents.show(intent, reference)
            token = self._tokens.get(now, peer.name, Scope.StrategicCoordination.value)
            operation = Op.NotifyOperationalIntentDetailsChanged
            self._caller.call(now, peer.name, peer.port, token, operation, {}, body, (reply.ref,), out)

    def _note_failure(self, about: str, reason: str, causes: Refs, out: Outbox) -> None:
        out.note("decision.uss_failed", about, {"reason": reason[:256]}, causes)


_DETAILS: Final = frozenset({Op.GetOperationalIntentDetails, Op.GetConstraintDetails})
_Accepted = Callable[[Uss, Time, Task, Reply, Outbox], None]
_ACCEPTED: Final[Mapping[Op, _Accepted]] = {
    Op.QueryOperationalIntentReferences: Uss._on_references,
    Op.QueryConstraintReferences: Uss._on_references,
    Op.CreateOperationalIntentReference: Uss._on_accepted,
    Op.UpdateOperationalIntentReference: Uss._on_accepted,
    Op.DeleteOperationalIntentReference: Uss._on_deleted,
    Op.GetOperationalIntentReference: Uss._on_own_reference,
}
