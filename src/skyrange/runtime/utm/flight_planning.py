"""Interfaces of InterUSS for automated tests: flight planning v1 and versioning, which `uss_qualifier` uses.

A flight plan is the operational intent of one operator; the interface is another form of the requests that a ground
station makes. What is planned is what the USS manages.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from pydantic import ValidationError
from uas_standards.interuss.automated_testing.flight_planning.v1 import api
from uas_standards.interuss.automated_testing.flight_planning.v1.constants import Scope

from skyrange import __version__
from skyrange.codec.f3548.operations import check
from skyrange.codec.f3548.values import volume_of, volumes_of
from skyrange.codec.json_errors import describe
from skyrange.core.ids import vehicle_id
from skyrange.core.time import Epoch, parse_rfc3339
from skyrange.runtime.utm.operators import Notice, Operators
from skyrange.utm.airspace.claimed_airspace import Airspace
from skyrange.utm.contract import OperationalIntent, make_uuid
from skyrange.utm.intent_states import IntentState
from skyrange.utm.messages import DecisionBody, Request, Response

PREFIX: Final = "/flight_planning/v1"
VERSIONING_PREFIX: Final = "/versioning/versions/"
VERSIONING_SCOPE: Final = "interuss.versioning.read_system_versions"
_STATUS: Final = {
    IntentState.ACCEPTED: api.FlightPlanStatus.Planned,
    IntentState.ACTIVATED: api.FlightPlanStatus.OkToFly,
    IntentState.NONCONFORMING: api.FlightPlanStatus.OffNominal,
    IntentState.CONTINGENT: api.FlightPlanStatus.OffNominal,
}
_REMEMBERED: Final = 10_000
_Answer = tuple[int, dict[str, Any]]


class FlightPlanning:
    """The interface for the flights of one operator."""

    def __init__(
        self, operator: str, operators: Operators, held: Callable[[], Sequence[OperationalIntent]], epoch: Epoch
    ) -> None:
        """`held()` is what the USS manages, of all its operators."""
        self._operator = operator
        self._operators = operators
        self._held = held
        self._epoch = epoch
        self._planned: dict[str, None] = {}
        """Ids of intents that were accepted, the latest last: one that is not held any more is closed."""

    async def answer(
        self, method: str, path: str, query: Mapping[str, str], body: dict[str, Any] | None, scopes: frozenset[str]
    ) -> _Answer:
        """Status and body of the response to a request below `PREFIX`. Raises `DecodeError` for a wrong body."""
        plan = path.removeprefix("/flight_plans/").lower() if path.startswith("/flight_plans/") else None
        needed = Scope.Plan if plan is not None or path == "/user_notifications" else Scope.DirectAutomatedTest
        if needed.value not in scopes:
            return 403, {"message": f"it needs the scope {needed.value}"}
        if (method, path) == ("GET", "/status"):
            status = api.StatusResponseStatus.Ready.value
            name = "Flight Planning Automated Testing Interface"
            return 200, {"status": status, "api_name": name, "api_version": f"v{api.API_VERSION}"}
        if (method, path) == ("POST", "/clear_area_requests"):
            return await self._clear(check(body, api.ClearAreaRequest))
        if (method, path) == ("GET", "/user_notifications"):
            return self._notifications(query)
        if plan is not None and method == "PUT":
            return await self._put(plan, check(body, api.UpsertFlightPlanRequest))
        if plan is not None and method == "DELETE":
            return await self._delete(plan)
        return 404, {"message": f"{method} {PREFIX}{path} is unknown"}

    def _find(self, id_: str) -> OperationalIntent | None:
        return next((intent for intent in self._held() if intent.id == id_ and intent.operator == self._operator), None)

    def _status(self, id_: str) -> api.FlightPlanStatus:
        intent = self._find(id_)
        if intent is not None:
            return _STATUS[intent.state]
        return api.FlightPlanStatus.Closed if id_ in self._planned else api.FlightPlanStatus.NotPlanned

    async def _put(self, plan: str, body: Mapping[str, Any]) -> _Answer:
        id_ = make_uuid(f"flight plan {self._operator} {plan}")
        before = self._status(id_)
        if body["execution_style"] is api.ExecutionStyle.Hypothetical:
            return 200, _result(api.PlanningActivityResult.NotSupported, before, "hypothetical plans are not supported")
        try:
            intent = self._intent(id_, plan, body["flight_plan"])
        except NotImplementedError as error:
            return 200, _result(api.PlanningActivityResult.NotSupported, before, str(error))
        try:
            request = Request.of(intent, self._epoch)
        except ValidationError as error:
            raise describe(error) from error
        response = await self._operators.ask(self._operator, request)
        decision = response.body
        if not isinstance(decision, DecisionBody):
            return 200, _result(_failure(response), before, decision.message)
        if decision.decision != "Accepted":
            return 200, _result(api.PlanningActivityResult.Rejected, self._status(id_), decision.reason)
        self._planned.pop(id_, None)
        self._planned[id_] = None
        if len(self._planned) > _REMEMBERED:
            del self._planned[next(iter(self._planned))]
        inclusion = api.AdvisoryInclusion
        advisories = (
            inclusion.AtLeastOneAdvisoryOrCondition if decision.conflicts else inclusion.NoAdvisoriesOrConditions
        )
        result = _result(api.PlanningActivityResult.Completed, _STATUS[intent.state], decision.reason)
        return 200, {**result, "includes_advisories": advisories.value}

    def _intent(self, id_: str, plan: str, info: Mapping[str, Any]) -> OperationalIntent:
        """The intent of a flight plan. Raises `NotImplementedError` for one that the USS does not support."""
        basic = info["basic_information"]
        references = (
            altitude["reference"]
            for area in basic["area"]
            for altitude in (area["volume"].get("altitude_lower"), area["volume"].get("altitude_upper"))
            if altitude is not None
        )
        if any(reference is not api.AltitudeReference.W84 for reference in references):
            raise NotImplementedError("altitudes above ground or take-off are not supported")
        priority = (info.get("astm_f3548_21") or {}).get("priority") or 0
        return OperationalIntent(
            id_,
            self._operator,
            vehicle_id(self._operator, f"plan-{plan[:8]}"),
            volumes_of(basic["area"], self._epoch),
            priority,
            _state(basic["usage_state"], basic["uas_state"]),
        )

    async def _delete(self, plan: str) -> _Answer:
        id_ = make_uuid(f"flight plan {self._operator} {plan}")
        intent = self._find(id_)
        if intent is None:
            return 404, {"message": f"there is no flight plan {plan[:64]}"}
        response = await self._operators.ask(self._operator, Request.end(intent))
        if isinstance(response.body, DecisionBody):
            return 200, _result(api.PlanningActivityResult.Completed, api.FlightPlanStatus.Closed)
        return 200, _result(_failure(response), _STATUS[intent.state], response.body.message)

    async def _clear(self, body: Mapping[str, Any]) -> _Answer:
        """End every flight plan in an area."""
        airspace = Airspace()
        for held_intent in self._held():
            if held_intent.operator == self._operator:
                airspace.put(held_intent.id, held_intent.volumes)
        failed = []
        area = volume_of(body["extent"], self._epoch, "extent")
        for id_ in sorted({overlap.intent for overlap in airspace.find_overlaps([area])}):
            intent = self._find(id_)
            if intent is None:
                continue
            response = await self._operators.ask(self._operator, Request.end(intent))
            if not isinstance(response.body, DecisionBody):
                failed.append(f"{id_}: {response.body.message}")
        return 200, {"outcome": {"success": not failed, "message": "; ".join(failed)[:1_024] or "the area is clear"}}

    def _notifications(self, query: Mapping[str, str]) -> _Answer:
        try:
            after, before = (None if name not in query else parse_rfc3339(query[name]) for name in ("after", "before"))
        except ValueError as error:
            return 400, {"message": f"after and before are times in RFC 3339: {error}"}
        if after is None:
            return 400, {"message": "after: it is needed"}
        from_ns = Epoch.from_datetime(after).unix_ns
        until_ns = None if before is None else Epoch.from_datetime(before).unix_ns
        notifications = [
            self._notification(notice)
            for notice in self._operators.notices[self._operator]
            if from_ns <= notice.at + self._epoch.unix_ns
            and (until_ns is None or notice.at + self._epoch.unix_ns <= until_ns)
        ]
        return 200, {"user_notifications": notifications}

    def _notification(self, notice: Notice) -> dict[str, Any]:
        count = notice.body.conflicts or 1
        return {
            "observed_at": {"value": self._epoch.rfc3339(notice.at), "format": "RFC3339"},
            "message": notice.body.reason,
            "conflicts": "Single" if count == 1 else "Multiple",
        }


def answer_version(identity: str, scopes: frozenset[str]) -> _Answer:
    """The version of this software, by InterUSS's versioning interface."""
    if VERSIONING_SCOPE not in scopes:
        return 403, {"message": f"it needs the scope {VERSIONING_SCOPE}"}
    return 200, {"system_identity": identity, "system_version": f"skyrange {__version__}"}


def _state(usage: api.BasicFlightPlanInformationUsageState, uas: api.FunctionalState) -> IntentState:
    usages = api.BasicFlightPlanInformationUsageState
    if usage is usages.Closed:
        raise NotImplementedError("a flight plan is closed by DELETE")
    if uas is api.FunctionalState.OffNominal:
        return IntentState.NONCONFORMING
    if uas is api.FunctionalState.Contingent:
        return IntentState.CONTINGENT
    return IntentState.ACTIVATED if usage is usages.InUse else IntentState.ACCEPTED


def _failure(response: Response) -> api.PlanningActivityResult:
    """What an error means for a plan: one that is wrong is rejected; it is not the fault of the USS."""
    wrong = 400 <= response.status < 500
    return api.PlanningActivityResult.Rejected if wrong else api.PlanningActivityResult.Failed


def _result(result: api.PlanningActivityResult, status: api.FlightPlanStatus, notes: str = "") -> dict[str, Any]:
    return {"planning_result": result.value, "flight_plan_status": status.value, **({"notes": notes} if notes else {})}
