"""Base of defences that decide on the channels of Wi-Fi control links, in the radios of both ends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

from skyrange.attack.contract import AirLink
from skyrange.attack.exclusive import Exclusive
from skyrange.contracts.channel_plans import ChannelPlan, ChannelPolicy
from skyrange.core.errors import InputError
from skyrange.core.ids import link_name
from skyrange.defence.contract import Defence, DefenceContext
from skyrange.defence.placement import Protection


@dataclass(frozen=True, slots=True)
class MakeStation:
    """Makes the policy of an access point."""

    kind: ChannelDefence
    address: bytes

    def __call__(self, links: Sequence[str]) -> ChannelPolicy:
        """The policy of the access point of some links."""
        return self.kind.make_station(self.address, links)


@dataclass(frozen=True, slots=True)
class MakeAircraft:
    """Makes the policy of an aircraft."""

    kind: ChannelDefence
    address: bytes

    def __call__(self, link: str) -> ChannelPolicy:
        """The policy of the aircraft of a link."""
        return self.kind.make_aircraft(self.address, link)


class ChannelDefence(Protection):
    """Has a policy at each access point of Wi-Fi control links, and one at each of its aircraft."""

    needs: ClassVar[tuple[str, ...]] = ("make_station", "make_aircraft")

    def make_station(self, address: bytes, links: Sequence[str]) -> ChannelPolicy:
        """The policy of the access point of this address, which has these links."""
        raise NotImplementedError

    def make_aircraft(self, address: bytes, link: str) -> ChannelPolicy:
        """The policy of the aircraft of a link, whose access point has this address."""
        raise NotImplementedError

    def build(self, context: DefenceContext) -> Defence:
        """Plans. Raises `InputError` for aircraft without a Wi-Fi control link, and for a part of an access point's."""
        wifi = {name: link for name, link in context.over_air.items() if link.kind == "wifi"}
        names = self._find_links(wifi, context)
        stations: dict[bytes, list[str]] = {}
        for name in names:
            stations.setdefault(wifi[name].station_address, []).append(name)
        plans = []
        for address, links in sorted(stations.items()):
            others = sorted(
                name for name, link in wifi.items() if link.station_address == address and name not in links
            )
            if others:
                expected = f"all aircraft of its access point, also {others[0].partition(':')[2]}"
                raise InputError.one(context.id, "vehicles", links[0].partition(":")[2], expected)
            plans.append(ChannelPlan(tuple(sorted(links)), MakeStation(self, address), MakeAircraft(self, address)))
        channels = [Exclusive(f"Wi-Fi channel of {name}") for name in names]
        return Defence(channel_plans=plans, exclusive=channels, one_process=True)

    def _find_links(self, wifi: Mapping[str, AirLink], context: DefenceContext) -> list[str]:
        """The Wi-Fi control links of the aircraft that it protects."""
        names = {link_name("gcs", vehicle): vehicle for vehicle in self.find_protected(context)}
        others = [name for name in names if name in context.over_air and name not in wifi]
        links, expected = [name for name in names if name in wifi], "an aircraft with a control link over Wi-Fi"
        if self.vehicles and others:
            kind = context.over_air[others[0]].kind
            hint = "SiK radios hop." if kind == "sik" else "A cellular operator changes frequencies itself."
            raise InputError.one(context.id, "vehicles", names[others[0]], expected, hint)
        missing = [name for name in names if name not in wifi] if self.vehicles or not links else []
        if missing:
            hint = 'Give [[links]] match = "gcs:*" the key channel = "wifi", and add [radio].'
            raise InputError.one(context.id, "vehicles", names[missing[0]], expected, hint)
        return links
