"""Parts of a kernel that belong to one run: its links and agents, what acts in it, and who is told."""

from __future__ import annotations

from collections.abc import Sequence

from skyrange.contracts.channel_plans import TunableChannel
from skyrange.contracts.components import Agent, Observer, OriginatingRouter, SimulatorEngine
from skyrange.contracts.links import Channel
from skyrange.contracts.scan_light import ScanMaker
from skyrange.core.chance import Chance
from skyrange.core.errors import ComponentError
from skyrange.core.ids import Port, originator_id, split_run
from skyrange.core.time import Time
from skyrange.kernel.acts.act_states import ActState, ActStates
from skyrange.kernel.acts.body_hooks import BodyHookInjector
from skyrange.kernel.acts.manual_acts import ManualActs
from skyrange.kernel.acts.scan_hooks import ScanHookInjector
from skyrange.kernel.acts.sensor_hooks import SensorHookInjector
from skyrange.kernel.directed_link import DirectedLink, Mailbox, TapSlot
from skyrange.kernel.event_heap import Event
from skyrange.kernel.monitors import Monitors
from skyrange.kernel.network import RunNetwork, Sender
from skyrange.kernel.observers import ObserverList
from skyrange.kernel.wiring import Wiring, attach_routes, build_links, index_by_sender, place_taps


class AgentSlot:
    """An agent in the kernel: its mailbox, and how the network knows it."""

    __slots__ = ("agent", "box", "sender")

    def __init__(self, agent: Agent, attack: ActState | None, run: RunParts) -> None:
        self.agent = agent
        self.sender = Sender(agent.name, agent.ports, attack, run.network)
        self.box = Mailbox(agent.name, f"{run.prefix}{agent.name}", agent.service_ns, polled=False, run=run.mail)


class RunParts:
    """What one run of a kernel has for itself: its links, its agents, what acts in it, and who is told."""

    def __init__(self, wiring: Wiring, observers: Sequence[Observer], number: int, *, alone: bool) -> None:
        """`number` is its place in a batch of runs, 0 where it is `alone`. Raises `InputError`."""
        self.number = number
        self.prefix = "" if alone else f"{number:06d}|"
        """What makes its names unique among those of other runs, in the order of their numbers."""
        self.mail = None if alone else number
        """As `Mailbox.run`."""
        self.wiring = wiring
        self.world = wiring.world
        self.links = build_links(wiring, Chance(wiring.seed))
        self.observers = ObserverList(observers)
        self.attacks = ActStates(wiring.acts, wiring.world)
        self.manual_acts = ManualActs(wiring.manual_acts, self.attacks.by_id())
        self.taps = place_taps(wiring, self.links, self.attacks.by_id())
        parts: list[DirectedLink | TapSlot] = [*self.links.values(), *self.taps]
        for link in self.links.values():
            link.prefix = self.prefix
        for part in parts:
            part.observers = self.observers
            part.order = f"{self.prefix}{part.name}"
        agents = (*wiring.agents, *wiring.truth_subscribers)
        hostile = [agent for attack in self.attacks.each for agent in attack.plan.agents]
        routers = [agent for agent in (*agents, *hostile) if isinstance(agent, OriginatingRouter)]
        originators = {port: originator_id(port.endpoint) for agent in routers for port in agent.originates}
        self.network = RunNetwork(number, self.links, index_by_sender(self.links), originators, self.observers)
        self.slots = [AgentSlot(agent, None, self) for agent in agents]
        self.slots += [AgentSlot(agent, attack, self) for attack in self.attacks.each for agent in attack.plan.agents]
        self.agents = {slot.agent.name: slot for slot in self.slots}
        variable = [(spec.name, spec.channel) for spec in wiring.links if not isinstance(spec.channel, Channel)]
        self.tunable = {name: channel for name, channel in variable if isinstance(channel, TunableChannel)}
        self.truth_subscribers = sorted(truth_subscriber.name for truth_subscriber in wiring.truth_subscribers)
        self.sensor_hooks = SensorHookInjector(self.attacks.each, wiring.world)
        self.scan_hooks = ScanHookInjector(self.attacks.each, wiring.world)
        for subscriber in wiring.truth_subscribers:
            if isinstance(subscriber, ScanMaker):
                subscriber.attach_light(self.scan_hooks)
        moved = [
            vehicle
            for mount in wiring.engines
            if not isinstance(mount.engine, SimulatorEngine)
            for run, vehicle in map(split_run, mount.engine.moves)
            if run == number
        ]
        self.body_hooks = BodyHookInjector(self.attacks.each, wiring.world, moved)

    @property
    def next_change(self) -> Time:
        """When one of its acts begins or ends next, or has to be looked at."""
        return min(self.attacks.next_change, self.manual_acts.next_due)

    def attach(self, engines: Sequence[tuple[Sequence[Port], Mailbox]], heap: list[Event]) -> None:
        """Give links their mailboxes, routes and monitors, once they are numbered.

        `engines` are the ports and the mailbox of each.
        """
        owners = [(place, port, port, slot.box) for slot in self.slots for place, port in enumerate(slot.agent.ports)]
        owners += [
            (place, port, port._replace(run=0), box)
            for ports, box in engines
            for place, port in enumerate(ports)
            if port.run == self.number
        ]
        owned = {port for _, _, port, _ in owners}
        attach_routes(self.wiring, self.links, owned, self.network.originators)
        incoming = {Port(link.dst, link.link_name): link for link in self.links.values()}
        for place, port, own_port, box in owners:
            link = incoming.get(own_port)
            if link is None:
                raise ComponentError(box.name, f"owns the port {port.endpoint} on {port.link}, which is no link's end")
            if link.mailbox is not None:
                raise ComponentError(
                    box.name, f"owns the port {port.endpoint} on {port.link}, as {link.mailbox.name} does"
                )
            link.mailbox, link.place, link.port = box, place, port
        self.monitors = Monitors(
            self.wiring.monitors, [(self.wiring.links, self.links)], heap, self.observers, self.prefix
        )
