"""Changes of the channel of Wi-Fi control links: orders, announcements, policies, and jammers that follow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from skyrange.contracts.channel_plans import ChannelPolicy
from skyrange.contracts.mailboxes import ChannelOrder, End, Inbox, Outbox
from skyrange.contracts.medium import RadioTable
from skyrange.core.chance import Chance
from skyrange.core.ids import Port, hash64
from skyrange.core.time import NS_PER_MS, Time, ceil_to
from skyrange.radio.control_link.propagation import Propagation
from skyrange.radio.control_link.wifi_link import BEACON_NS, AnnouncedChange, Transmitter, WifiLink
from skyrange.radio.control_link.wifi_rates import PREAMBLE_DBM
from skyrange.radio.phy import OFDM, centre_mhz
from skyrange.radio.spectrum import NoiseBurst

POLICY_NS: Final[Time] = 20 * NS_PER_MS
"""How often policies decide: at every update of the links' conditions."""


class ChannelChanges:
    """Carries out orders to the radios of Wi-Fi links. Deep-copyable.

    An access point announces a change in each of its next beacons (IEEE 802.11-2020, 11.8.8; that the element is
    9.4.2.18 is assumed) and changes at the last of them. An aircraft that decodes one of them changes with it; another
    one stays, and loses its association when it has missed enough beacons.
    """

    def __init__(self, links: Sequence[WifiLink], chance: Chance) -> None:
        stations = {id(link.station): link.station for link in links}
        self._links = [(station, [link for link in links if link.station is station]) for station in stations.values()]
        self._chance = chance
        self._last: Time = -1

    def carry_out(self, now: Time, out: Outbox) -> bool:
        """Do what was ordered or announced and is due at `now`; returns whether a radio has changed its channel."""
        changed = False
        for station, links in self._links:
            changed |= self._step_station(now, station, links, out)
            for link in links:
                order, link.aircraft.order = link.aircraft.order, None
                if order is not None:
                    changed |= _tune(now, link.aircraft, order, [link])
        self._last = now
        return changed

    def _step_station(self, now: Time, station: Transmitter, links: Sequence[WifiLink], out: Outbox) -> bool:
        order, station.order = station.order, None
        if order is not None and order.announcements == 0:
            station.announced = None
            return _tune(now, station, order, links)
        if order is not None:
            first = ceil_to(now + 1, BEACON_NS)
            station.announced = AnnouncedChange(order, first + (order.announcements - 1) * BEACON_NS)
            for link in links:
                link.told = False
        announced = station.announced
        if announced is None:
            return False
        if order is None:  # beacons since the last step
            for at in range(ceil_to(self._last + 1, BEACON_NS), min(now, announced.at) + 1, BEACON_NS):
                for link in links:
                    if link.associated and not link.told and link.aircraft.channel == station.channel:
                        draw = self._chance.uniform4("channel switch", hash64(link.name), at, 0)[0]
                        link.told = draw < link.to_aircraft.beacon_success(at)
        if now < announced.at:
            return False
        station.announced = None
        was = station.channel
        for link in links:
            if link.told:
                _tune(now, link.aircraft, announced.order, [link])
        _tune(now, station, announced.order, links)
        informed = sum(link.told for link in links)
        what: dict[str, str | int] = {"from": was, "to": station.channel, "told": informed, "of": len(links)}
        out.note("event.channel_change", station.name, what)
        return True


def _tune(now: Time, radio: Transmitter, order: ChannelOrder, links: Sequence[WifiLink]) -> bool:
    """Have a radio change its channel; meanwhile its links carry nothing."""
    if radio.channel == order.channel:
        return False
    radio.channel, radio.channel_since = order.channel, now
    for link in links:
        link.down_until = max(link.down_until, now + order.retune_ns)
    return True


class ChannelPolicies:
    """A defence's agent (`skyrange.contracts.components.Agent`) that asks its policies and gives their orders."""

    service_ns: Time = POLICY_NS
    ports: Sequence[Port] = ()

    def __init__(
        self, defence: str, policies: Sequence[tuple[End, Sequence[str], ChannelPolicy]], links: Mapping[str, WifiLink]
    ) -> None:
        """`policies` are those of `defence`, each with its end and the names of its links."""
        self.name = f"{defence} channels"
        self._policies = [(end, [links[name] for name in sorted(names)], policy) for end, names, policy in policies]
        self._last: Time = -1

    def next_wakeup(self) -> Time | None:
        """The next update."""
        return 0 if self._last < 0 else self._last + POLICY_NS

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        """Ask every policy."""
        out = Outbox()
        for end, links, policy in self._policies:
            out.acts += policy.step(now, [link.report(end, self._last, now) for link in links])
        self._last = now
        return out


class FollowingJammers:
    """The channels on which such jammers are, by radio and access point. Deep-copyable.

    A jammer whose access point has left scans, and finds it when it has been on its new channel for the jammer's search
    time, if it hears it there with -82 dBm. An access point that leaves sooner is not found.
    """

    def __init__(self, stations: Sequence[Transmitter]) -> None:
        self._stations = {station.address: station for station in stations}
        self._centres: dict[tuple[int, bytes], float] = {}

    def tune(
        self,
        now: Time,
        bursts: Sequence[NoiseBurst],
        propagation: Mapping[float, Propagation],
        radios: RadioTable,
    ) -> Sequence[NoiseBurst]:
        """The bursts, those of jammers that follow on the channel where they are now."""
        if not any(burst.bssid for burst in bursts):
            return bursts
        return [self._tune(now, burst, propagation, radios) if burst.bssid else burst for burst in bursts]

    def _tune(
        self, now: Time, burst: NoiseBurst, propagation: Mapping[float, Propagation], radios: RadioTable
    ) -> NoiseBurst:
        key = burst.radio, burst.bssid
        at = self._centres.setdefault(key, burst.centre_mhz)
        station = self._stations.get(burst.bssid)
        if station is not None and now - station.channel_since >= burst.follow_ns:
            centre = centre_mhz(OFDM, station.channel)
            if centre != at:
                rows = np.array([burst.radio]), np.array([station.row])
                gain = propagation[centre].gains_db(radios, *rows, centre, now).item()
                if station.power_dbm + gain >= PREAMBLE_DBM:
                    at = self._centres[key] = centre
        return burst._replace(centre_mhz=at)
