"""Agreement of ground receivers: a station believes a broadcast if its strengths at several places fit one position."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Final

from pydantic import AfterValidator, BeforeValidator

import skyrange.plugin as sky
from skyrange.attack.contract import GroundReceiver
from skyrange.attack.declaration import Acting
from skyrange.core.elementary import log
from skyrange.defence.bases.receptions import TapOf
from skyrange.defence.bases.signal_strengths import (
    Shift,
    StrengthTest,
    assumed_decorrelation,
    assumed_k,
    assumed_missing,
    assumed_shadowing,
    assumed_shift,
    channel_of,
    map_of,
)
from skyrange.defence.placement import Alarm
from skyrange.defence.receptions import Held, Reader, Sender
from skyrange.defence.remote_id.signal import ErrorRate, PowerLimits, doubt_m, is_usable
from skyrange.radio.ground_receptions import Reception, ReceptionReport, decode, encode

KIND: Final = "remote_id.ground"
_Names = Annotated[tuple[str, ...], BeforeValidator(sky.items, json_schema_input_type=list[str]), AfterValidator(tuple)]


@sky.defence(
    "remote_id.ground",
    surface=("oracle",),
    place="the station's end of the oracle link; knows what its ground receivers decoded, their places, and a map of "
    "the buildings",
    effect="keeps false aircraft out of the station's traffic picture, and warns its operator; aircraft are not told",
    alerts=(KIND,),
    against=("remote_id.spoof", "remote_id.replay", "remote_id.signed_ghost"),
    evasion="transmits from the claimed place",
    cost="a test of about 600 hypotheses for each reception; no frame and no delay is added",
    realism={
        "signal strength": "simulated",
        "building map": "assumed: the operator has the range's own",
    },
)
class GroundCheck(Acting):
    """Takes receptions out of a station's reports whose strengths at its receivers do not fit the claimed position."""

    operators: _Names = sky.param(
        "Operators whose receivers are compared; default: all that have receivers.", default=()
    )
    legal_dbm: PowerLimits = sky.param(
        "Least and greatest power (EIRP) of honest aircraft in dBm. 36 is the limit in the USA (47 CFR 15.247(b), 1 W "
        "and 6 dBi), 20 in Europe (EN 300 328); the least is assumed.",
        default=(0.0, 36.0),
    )
    false_alarm: ErrorRate = sky.param(
        "Largest probability that an honest sender in sight is ever rejected by one station.", default=0.001
    )
    rician_k_db: sky.Number = assumed_k()
    decorrelation_m: sky.Number = assumed_decorrelation()
    shadowing_db: sky.Number | None = assumed_shadowing()
    map_shift_m: Shift = assumed_shift()
    map_missing: sky.Number = assumed_missing()
    city: sky.City | None
    reader: Reader
    own: Mapping[str, GroundReceiver]
    """Of a tap: the receivers of its operator."""
    alarm: Alarm
    held: Held = sky.state(Held)

    def prepare(self, context: sky.DefenceContext) -> None:
        self.city, self.reader = map_of(self, context), Reader(context.origin)

    def build(self, context: sky.DefenceContext) -> sky.Defence:
        """Taps. Raises `InputError` where nobody has receivers on the ground, or a named operator has none."""
        known_operators = sorted({receiver.operator for receiver in context.receivers.values()})
        if not known_operators:
            hint = "Add [[radio.receivers]]."
            raise sky.InputError.one(
                context.id, "operators", "no receivers", "an operator with receivers on the ground", hint
            )
        for place, name in enumerate(self.operators):
            if name not in known_operators:
                expected = "an operator with receivers on the ground"
                raise sky.InputError.one(
                    context.id, f"operators.{place}", name, expected, sky.nearest(name, known_operators)
                )
        operators, taps = self.operators or known_operators, []
        for operator in operators:
            tap = self.copy()
            tap.own = {name: receiver for name, receiver in context.receivers.items() if receiver.operator == operator}
            tap.alarm = Alarm(operator)
            taps.append(sky.TapPlacement(sky.link_name("oracle", operator), "gcs", TapOf(tap), inspects=_is_report))
        agreements = [sky.Exclusive(f"agreement of the receivers of {operator}") for operator in operators]
        return sky.Defence(taps=taps, exclusive=agreements)

    def next_wakeup(self) -> sky.Time | None:
        return None

    def on_wakeup(self, now: sky.Time) -> Sequence[sky.Verdict]:
        return ()

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> Sequence[sky.Verdict]:
        """Add the strengths of a report to the tests of its senders; malformed reports pass, as the station refuses
        them.
        """
        if frame.direction != "rev":
            return ()
        try:
            report = decode(frame.payload)
        except sky.DecodeError:
            return ()
        alerts: list[sky.Verdict] = []
        kept = []
        for reception in report.body:
            reception_alerts = self._judge(now, reception)
            if reception_alerts is None:
                kept.append(reception)
            else:
                alerts += reception_alerts
        if len(kept) == len(report.body):
            return ()
        return [sky.Replace(encode(ReceptionReport(body=tuple(kept)))) if kept else sky.Drop(), *alerts]

    def _judge(self, now: sky.Time, reception: Reception) -> list[sky.Verdict] | None:
        """The alarms of a reception that is not believed; `None` if it is."""
        receiver = self.own.get(reception.receiver)
        try:
            message = sky.decode_remote_id(bytes.fromhex(reception.body))
        except (sky.DecodeError, ValueError):
            return None
        if receiver is None:
            return None
        address = bytes.fromhex(reception.address)
        sender, claim = self.reader.take(address, reception.time_ns, reception.rssi_dbm, message)
        test = self._test_of(sender)
        claimed_place = None if claim is None else claim.place
        if (
            claim is not None
            and claimed_place is not None
            and is_usable(self.city, receiver.place, claimed_place, doubt_m(claim))
        ):
            test.add(reception.receiver, receiver.place, claimed_place, reception.rssi_dbm)
        score = test.log_evidence / -log(self.false_alarm)
        if score < 1.0:
            return None
        place = test.likely_place
        data: dict[str, str | float] = {"uas_id": sender.uas_id, "address": reception.address, "cells": test.cells}
        if place is not None:
            data |= {"east_m": place[0], "north_m": place[1]}
        return [*self.alarm.raise_at(now, KIND, score, **data)]

    def _test_of(self, sender: Sender) -> StrengthTest:
        test = self.held.touch(sender)
        if not isinstance(test, StrengthTest):
            test = StrengthTest((self.legal_dbm[0], self.legal_dbm[1]), channel_of(self))
            self.held.put(sender, test)
        return test


def _is_report(frame: sky.Frame) -> bool:
    """Whether a frame is one of those that may report receptions."""
    return frame.direction == "rev"
