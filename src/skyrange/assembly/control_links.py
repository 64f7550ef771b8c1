"""Control links of a scenario over the air: their channels, and the agent that updates them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from skyrange.assembly.radio import check_place
from skyrange.attack.contract import AirLink
from skyrange.city.city import City
from skyrange.contracts.channel_plans import ChannelPlan, ChannelPolicy
from skyrange.contracts.links import LinkSpec, TapPlacement, VariableChannel
from skyrange.contracts.mailboxes import End
from skyrange.core.chance import Chance
from skyrange.core.errors import InputError, Problem, nearest
from skyrange.core.ids import link_name, vehicle_id
from skyrange.radio.control_link.cellular_link import CellularLink
from skyrange.radio.control_link.channel_changes import ChannelPolicies
from skyrange.radio.control_link.foreign_radio import ForeignRadio
from skyrange.radio.control_link.links import ControlLinks, cell_name
from skyrange.radio.control_link.params import CellularParams, WifiParams
from skyrange.radio.control_link.propagation import Propagation
from skyrange.radio.control_link.sik.link import SikLink
from skyrange.radio.control_link.sik.params import SikParams
from skyrange.radio.control_link.sik.radio import SikRadio
from skyrange.radio.control_link.wifi_link import Transmitter, WifiLink
from skyrange.radio.control_link.wifi_rates import WIDTH_MHZ
from skyrange.radio.phy import OFDM, WIFI_CHANNELS, centre_mhz
from skyrange.radio.propagation.loss_table import NO_TABLE
from skyrange.radio.propagation.loss_table_file import read_loss_table
from skyrange.radio.propagation.path_loss import noise_dbm
from skyrange.radio.spectrum import Spectrum
from skyrange.scenario.model.operators import Operator
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.validation.error_messages import spell_path

ANTENNA_M = 2.0
"""Height of an access point's antenna where the scenario has none: on a tripod."""


@dataclass(slots=True)
class LinksOverAir:
    """The channels of control links over the air, and what their radios share."""

    wifi: list[WifiLink] = field(default_factory=list)
    cellular: list[CellularLink] = field(default_factory=list)
    sik: list[SikLink] = field(default_factory=list)
    spectrum: Spectrum = field(default_factory=Spectrum)
    fixed: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    """Places of access points, cells and ground radios by name."""
    dipoles: set[str] = field(default_factory=set)
    """Those with a dipole antenna."""
    foreign: list[ForeignRadio] = field(default_factory=list)
    """Radios of attackers on channels of Wi-Fi links; their places are in `fixed`."""

    @property
    def channels(self) -> Mapping[str, VariableChannel]:
        """The channels by the name of the link."""
        wifi: dict[str, VariableChannel] = {link.name: link for link in self.wifi}
        return wifi | {link.name: link for link in self.cellular} | {link.name: link for link in self.sik}

    def __bool__(self) -> bool:
        return bool(self.wifi or self.cellular or self.sik)


def make_links_over_air(scenario: Scenario) -> LinksOverAir:
    """The channels of all links that the scenario puts on the air."""
    made = LinksOverAir()
    stations: dict[tuple[str, WifiParams], Transmitter] = {}
    chance = Chance(scenario.seed)
    for operator, vehicle in scenario.fleet:
        key = vehicle_id(operator.id, vehicle.id)
        name = link_name("gcs", key)
        params = scenario.over_air(name)
        if isinstance(params, WifiParams):
            _add_wifi(made, stations, operator, name, key, params)
        elif isinstance(params, SikParams):
            _add_sik(made, operator, name, key, params, chance)
        elif params is not None:
            _add_cellular(made, name, key, params)
    return made


def build_control_links(
    scenario: Scenario, city: City | None, chance: Chance, made: LinksOverAir
) -> ControlLinks | None:
    """The agent that updates the channels; `None` without any. Call it once the medium is built."""
    if not made or scenario.radio is None:
        return None
    names = [*made.spectrum.radios, *made.fixed]
    antennas = [("dipole" if name in made.dipoles else "isotropic", 0.0) for name in names]
    file = scenario.radio.table
    table = read_loss_table(Path(file)).table if made.wifi and file is not None else NO_TABLE
    propagation = {}
    for wifi in made.wifi:
        centre = centre_mhz(OFDM, wifi.params.channel)
        if centre not in propagation:
            propagation[centre] = Propagation(
                names, antennas, chance, city, randomness=scenario.radio.chance, table=table
            )
    wifi_propagation = next(iter(propagation.values()), None)
    for cellular in made.cellular:
        centre = cellular.params.frequency_mhz
        if centre not in propagation:
            propagation[centre] = Propagation(names, antennas, chance, city, randomness=scenario.radio.chance)
    for sik in made.sik:
        middle = sik.params.centre_mhz
        if middle not in propagation:
            propagation[middle] = Propagation(names, antennas, chance, city, randomness=scenario.radio.chance)
    if wifi_propagation is not None:  # links may change to any channel
        for channel in WIFI_CHANNELS:
            propagation.setdefault(centre_mhz(OFDM, channel), wifi_propagation)
    return ControlLinks(
        made.wifi,
        made.cellular,
        made.spectrum,
        places=made.fixed,
        propagation=propagation,
        chance=chance,
        city_busy=scenario.radio.city_busy,
        foreign=made.foreign,
        sik=made.sik,
    )


def place_foreign_radios(taps: Sequence[TapPlacement], made: LinksOverAir) -> list[TapPlacement]:
    """The taps, those beside a Wi-Fi link with their radio on its channel. Call it before `build_control_links`.

    Raises `InputError` for one on a link that is not over Wi-Fi.
    """
    links = {link.name: link for link in made.wifi}
    transmitters = {
        (foreign.transmitter.name, foreign.transmitter.channel): foreign.transmitter for foreign in made.foreign
    }
    placed = []
    for tap in taps:
        site = tap.site
        if site is None:
            placed.append(tap)
            continue
        link = links.get(tap.match)
        if link is None:
            raise InputError.one(site.name, "match", tap.match, "a control link over Wi-Fi", nearest(tap.match, links))
        channel = link.params.channel
        transmitter = transmitters.get((site.name, channel))
        if transmitter is None:
            transmitter = transmitters[site.name, channel] = Transmitter(site.name, site.power_dbm, channel)
            made.fixed[site.name] = site.at_enu_m
        noise = float(noise_dbm(link.params.noise_figure_db, WIDTH_MHZ))
        radio = ForeignRadio(link, site, transmitter, noise)
        made.foreign.append(radio)
        placed.append(replace(tap, radio=radio))
    return placed


def make_channel_agent(defence: str, plans: Sequence[ChannelPlan], made: LinksOverAir) -> ChannelPolicies:
    """The agent of a defence that asks the policies of its channel plans; their links are watched from now on."""
    links = {link.name: link for link in made.wifi}
    policies: list[tuple[End, Sequence[str], ChannelPolicy]] = []
    for plan in plans:
        policies.append(("station", plan.links, plan.make_station(plan.links)))
        policies += [("aircraft", [name], plan.make_aircraft(name)) for name in plan.links]
        for name in plan.links:
            links[name].watch()
    return ChannelPolicies(defence, policies, links)


def describe_to_attackers(links: Sequence[LinkSpec]) -> dict[str, AirLink]:
    """What anyone near can hear of those links that are over the air."""
    heard = {}
    for spec in links:
        channel = spec.channel
        if isinstance(channel, WifiLink):
            number = channel.params.channel
            addresses = channel.station.address, channel.aircraft.address
            heard[spec.name] = AirLink("wifi", centre_mhz(OFDM, number), WIDTH_MHZ, number, *addresses)
        elif isinstance(channel, CellularLink):
            heard[spec.name] = AirLink("cellular", channel.params.frequency_mhz, channel.params.bandwidth_mhz)
        elif isinstance(channel, SikLink):
            width_mhz = (channel.params.max_khz - channel.params.min_khz) / 1e3
            heard[spec.name] = AirLink("sik", channel.params.centre_mhz, width_mhz)
    return heard


def check_links_over_air(scenario: Scenario, city: City | None, made: LinksOverAir) -> Iterator[Problem]:
    """Links that cannot be on the air, antennas where none can be, and pairs of SiK radios that hear each other."""
    yield from _check_netids(made)
    for index, rule in enumerate(scenario.links):
        params = rule.over_air
        if params is None:
            continue
        where = spell_path(("links", index), scenario)
        if not rule.match.startswith("gcs:"):
            hint = 'Set match to a name or pattern such as "gcs:*".'
            yield Problem(f"{where}.channel", f"{rule.channel} for {rule.match}", "a gcs link", hint)
        if scenario.radio is None:
            hint = "Add [radio] to the scenario: losses, noise and other traffic are those of its medium."
            yield Problem(f"{where}.channel", str(rule.channel), "a radio medium", hint)
        if isinstance(params, WifiParams | SikParams):
            if params.place is not None:
                yield from check_place(f"{where}.{rule.channel}.place", params.place, city)
        else:
            for place, station in enumerate(params.base_stations):
                yield from check_place(f"{where}.cellular.base_stations[{place}].place", station.place, city)


def _add_wifi(
    made: LinksOverAir,
    stations: dict[tuple[str, WifiParams], Transmitter],
    operator: Operator,
    name: str,
    vehicle: str,
    params: WifiParams,
) -> None:
    noise = float(noise_dbm(params.noise_figure_db, WIDTH_MHZ))
    station = stations.get((operator.id, params))
    if station is None:
        number = sum(owner == operator.id for owner, _ in stations)
        ap_name = f"{operator.id} access point" + (f" {number + 1}" if number else "")
        station = stations[operator.id, params] = Transmitter(ap_name, params.power_dbm, params.channel)
        made.fixed[ap_name] = params.place or _station_place(operator)
        made.dipoles.add(ap_name)
    aircraft = Transmitter(vehicle, params.aircraft_dbm, params.channel)
    made.wifi.append(WifiLink(name, params, station, aircraft, noise))


def _add_cellular(made: LinksOverAir, name: str, vehicle: str, params: CellularParams) -> None:
    aircraft = float(noise_dbm(params.noise_figure_db, params.bandwidth_mhz))
    station = float(noise_dbm(params.station_noise_figure_db, params.bandwidth_mhz * params.share))
    link = CellularLink(name, params, vehicle, aircraft, station + params.noise_rise_db)
    for place, cell in enumerate(params.base_stations):
        made.fixed[cell_name(link, place)] = cell.place
    made.cellular.append(link)


def _add_sik(
    made: LinksOverAir, operator: Operator, name: str, vehicle: str, params: SikParams, chance: Chance
) -> None:
    ground = SikRadio(f"{vehicle} ground radio", params.power_dbm, params.serial_bps)
    aircraft = SikRadio(vehicle, params.aircraft_dbm, params.serial_bps)
    netid = params.netid + sum(link.params == params for link in made.sik)
    made.fixed[ground.name] = params.place or _station_place(operator)
    made.dipoles.add(ground.name)
    made.sik.append(SikLink(name, params, netid, (ground, aircraft), chance))


def _check_netids(made: LinksOverAir) -> Iterator[Problem]:
    """Pairs of radios that would take each other's packets for their own."""
    for place, link in enumerate(made.sik):
        for other in made.sik[:place]:
            mine, theirs = link.params, other.params
            if link.netid == other.netid and mine.min_khz < theirs.max_khz and theirs.min_khz < mine.max_khz:
                hint = "Set netid; further aircraft of a rule have the next numbers."
                yield Problem(f"{link.name}.netid", f"{link.netid}, as {other.name}", "network ids that differ", hint)


def _station_place(operator: Operator) -> tuple[float, float, float]:
    """Where the antenna of a station is if the scenario says nothing."""
    first = operator.vehicles[0].start
    east_m, north_m = operator.station or (first.east_m, first.north_m)
    return east_m, north_m, ANTENNA_M
