"""Agreement of ground receivers: a station believes a broadcast if its strengths at several places fit one position."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from math import log
from typing import Annotated, Final

from pydantic import AfterValidator, BeforeValidator

from skyrange.attack.contract import GroundReceiver
from skyrange.attack.declaration import Acting
from skyrange.attack.exclusive import Exclusive
from skyrange.city.city import City
from skyrange.codec.f3411 import decode as decode_body
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.links import TapPlacement
from skyrange.contracts.params import items
from skyrange.contracts.plugins.fields import param, state
from skyrange.contracts.verdicts import Drop, Replace, Verdict
from skyrange.core.errors import DecodeError, InputError, nearest
from skyrange.core.ids import link_name
from skyrange.core.time import Time
from skyrange.defence.bases.receptions import TapOf
from skyrange.defence.contract import Defence, DefenceContext
from skyrange.defence.declaration import defence
from skyrange.defence.placement import Alarm
from skyrange.defence.receptions import Held, Reader, Sender
from skyrange.defence.remote_id.signal import ErrorRate, PowerLimits, doubt_m, is_usable
from skyrange.defence.remote_id.strength_test import StrengthTest
from skyrange.radio.ground_receptions import Reception, ReceptionReport, decode, encode

KIND: Final = "remote_id.ground"
_Names = Annotated[tuple[str, ...], BeforeValidator(items, json_schema_input_type=list[str]), AfterValidator(tuple)]


@defence(
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

    operators: _Names = param("Operators whose receivers are compared; default: all that have receivers.", default=())
    legal_dbm: PowerLimits = param(
        "Least and greatest power (EIRP) of honest aircraft in dBm. 36 is the limit in the USA (47 CFR 15.247(b), 1 W "
        "and 6 dBi), 20 in Europe (EN 300 328); the least is assumed.",
        default=(0.0, 36.0),
    )
    false_alarm: ErrorRate = param(
        "Largest probability that an honest sender in sight is ever rejected by one station.", default=0.001
    )
    city: City | None
    reader: Reader
    own: Mapping[str, GroundReceiver]
    """Of a tap: the receivers of its operator."""
    alarm: Alarm
    held: Held = state(Held)

    def prepare(self, context: DefenceContext) -> None:
        """Have the map."""
        self.city, self.reader = context.city, Reader(context.origin)

    def build(self, context: DefenceContext) -> Defence:
        """Taps. Raises `InputError` where nobody has receivers on the ground, or a named operator has none."""
        found = sorted({one.operator for one in context.receivers.values()})
        if not found:
            hint = "Add [[radio.receivers]]."
            raise InputError.one(
                context.id, "operators", "no receivers", "an operator with receivers on the ground", hint
            )
        for place, name in enumerate(self.operators):
            if name not in found:
                expected = "an operator with receivers on the ground"
                raise InputError.one(context.id, f"operators.{place}", name, expected, nearest(name, found))
        operators, taps = self.operators or found, []
        for operator in operators:
            tap = deepcopy(self)
            tap.own = {name: one for name, one in context.receivers.items() if one.operator == operator}
            tap.alarm = Alarm(operator)
            taps.append(TapPlacement(link_name("oracle", operator), "gcs", TapOf(tap), inspects=_is_report))
        agreements = [Exclusive(f"agreement of the receivers of {operator}") for operator in operators]
        return Defence(taps=taps, exclusive=agreements)

    def next_wakeup(self) -> Time | None:
        """Never."""
        return None

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        """Nothing."""
        return ()

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Add the strengths of a report to the tests of its senders; malformed reports pass, as the station refuses
        them.
        """
        if frame.direction != "rev":
            return ()
        try:
            report = decode(frame.payload)
        except DecodeError:
            return ()
        alerts: list[Verdict] = []
        kept = []
        for reception in report.body:
            found = self._judge(now, reception)
            if found is None:
                kept.append(reception)
            else:
                alerts += found
        if len(kept) == len(report.body):
            return ()
        return [Replace(encode(ReceptionReport(body=tuple(kept)))) if kept else Drop(), *alerts]

    def _judge(self, now: Time, reception: Reception) -> list[Verdict] | None:
        """The alarms of a reception that is not believed; `None` if it is."""
        receiver = self.own.get(reception.receiver)
        try:
            message = decode_body(bytes.fromhex(reception.body))
        except (DecodeError, ValueError):
            return None
        if receiver is None:
            return None
        address = bytes.fromhex(reception.address)
        sender, claim = self.reader.take(address, reception.time_ns, reception.rssi_dbm, message)
        test = self._test_of(sender)
        there = None if claim is None else claim.place
        if claim is not None and there is not None and is_usable(self.city, receiver.place, there, doubt_m(claim)):
            test.add(reception.receiver, receiver.place, there, reception.rssi_dbm)
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
            test = StrengthTest((self.legal_dbm[0], self.legal_dbm[1]))
            self.held.put(sender, test)
        return test


def _is_report(frame: Frame) -> bool:
    """Whether a frame is one of those that may report receptions."""
    return frame.direction == "rev"
