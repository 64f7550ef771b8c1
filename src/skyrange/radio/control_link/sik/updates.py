"""Conditions of all SiK links, kept up to date during a run: gains and noise on the frequencies of the next slots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from skyrange.contracts.mailboxes import Outbox
from skyrange.contracts.medium import RadioTable
from skyrange.core.time import Time
from skyrange.radio.control_link.interference import Interference
from skyrange.radio.control_link.noise_at_radios import NoiseAtRadios
from skyrange.radio.control_link.propagation import Propagation
from skyrange.radio.control_link.sik.link import Conditions, SikLink, make_conditions
from skyrange.radio.control_link.sik.slots import AIRCRAFT, STATION
from skyrange.radio.spectrum import NoiseBurst

SLOTS: Final = 4
"""Slots for which conditions are computed, the present one included; data that wait longer have those of the last."""


class SikUpdates:
    """Updates SiK links. Deep-copyable."""

    def __init__(self, links: Sequence[SikLink], rows: Mapping[str, int]) -> None:
        """`rows` are those of all radios, by name."""
        self._links = sorted(links, key=lambda link: link.name)
        self._quiet = [_make_interference(link) for link in self._links]
        for link in self._links:
            for radio in link.radios:
                radio.row = rows[radio.name]

    def update(
        self,
        now: Time,
        table: RadioTable,
        bursts: Sequence[NoiseBurst],
        propagation: Mapping[float, Propagation],
        out: Outbox,
    ) -> None:
        """Update every link; `propagation` is by the middle of the link's band in MHz."""
        for link, quiet in zip(self._links, self._quiet, strict=True):
            model = propagation[link.params.centre_mhz]
            present = link.slots.number_at(now)
            conditions = {}
            for slot in range(present, present + SLOTS):
                conditions[slot] = _find_conditions(now, link, slot, quiet, table=table, bursts=bursts, model=model)
            for radio, found in link.update(now, conditions):
                kind, why = ("event.link_up", "packets") if found else ("event.link_down", "no packets")
                out.note(kind, link.name, {"channel": "sik", "why": why, "radio": radio})


def _find_conditions(
    now: Time,
    link: SikLink,
    slot: int,
    quiet: tuple[Interference, Interference],
    *,
    table: RadioTable,
    bursts: Sequence[NoiseBurst],
    model: Propagation,
) -> Conditions:
    station, aircraft = link.radios
    centre = link.centre_mhz(slot)
    gain = model.gains_db(table, np.array([station.row]), np.array([aircraft.row]), centre, now).item()
    if not bursts:
        return make_conditions(link, gain, quiet)
    rows = [station.row, aircraft.row]
    met = NoiseAtRadios(bursts, model, table, rows, centre_mhz=centre, width_mhz=link.width_mhz, now=now)
    noise = _make_interference(link)
    for end, sender in ((STATION, aircraft), (AIRCRAFT, station)):
        noise[end].bursts = met.at(sender.row, link.radios[end].row, sender.power_dbm)
    return make_conditions(link, gain, noise)


def _make_interference(link: SikLink) -> tuple[Interference, Interference]:
    at_station, at_aircraft = link.noise_dbm
    return Interference(at_station), Interference(at_aircraft)
