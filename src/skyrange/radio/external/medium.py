"""A radio medium whose Wi-Fi is simulated by another program, over the medium protocol.

Waveforms that the engine does not simulate stay with a builtin medium beside it, such as Bluetooth with ns-3. The two
do not interfere with each other.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from typing import Any, Final, Literal, NamedTuple

import numpy as np

from skyrange.codec.medium_protocol import (
    HEARD,
    NOISE,
    ORIGIN_NS,
    PATH,
    SENT,
    TRANSMISSION,
    Ability,
    Advance,
    Building,
    Done,
    EngineRadio,
    Hello,
    MessageType,
    Rows,
    decode_done,
    decode_losses,
    encode_advance,
    encode_path_losses,
)
from skyrange.contracts.medium import (
    ANY_CHANNEL,
    EmitterTable,
    Floats,
    Heard,
    Ints,
    OnAir,
    ProgramStatus,
    RadioSpec,
    RadioTable,
    ReceptionOutcome,
    Sent,
    TransmissionFate,
    TxBatch,
    Waveform,
)
from skyrange.core.errors import ComponentError, DecodeError
from skyrange.core.ids import hash64
from skyrange.core.time import NS_PER_MS, Time
from skyrange.radio.builtin.listening import find_tuned
from skyrange.radio.builtin.medium import BuiltinMedium
from skyrange.radio.builtin.state import radio_arrays
from skyrange.radio.contract import MediumContext
from skyrange.radio.external.engine import WIFI, EngineStarts
from skyrange.radio.external.paths import PIECE_NS, NoiseSources, PathFinder, background_pieces
from skyrange.radio.phy import MAX_BYTES, MIN_BYTES, centre_mhz
from skyrange.radio.propagation.loss_table import NO_TABLE

DEADLINE_S: Final = 60.0
"""Wall time within which an engine must answer, in seconds."""
_DEFAULT_CHANNEL: Final = 6
_KEPT_NS: Final = 10 * NS_PER_MS
"""How long the start of a frame is remembered after its end: longer than its reception takes."""


class _Offer(NamedTuple):
    """A frame that is to be sent."""

    at: Time
    radio: int
    key: int
    power_dbm: float
    size_bytes: int
    waveform: int
    channel: int


class ExternalMedium:
    """A `Medium` that hands Wi-Fi frames to an engine. A deep copy forks the engine."""

    runs_programs = True

    def __init__(
        self,
        name: str,
        command: Sequence[str],
        context: MediumContext,
        params: Mapping[str, str] | None = None,
        *,
        deadline_s: float = DEADLINE_S,
    ) -> None:
        """Start the engine `name` with `command`, and greet it with `params`.

        Raises `InputError` for radios that cannot be, as the builtin medium does, and `ComponentError` if the engine
        does not start, speaks another version, or cannot do what the context asks for.
        """
        surroundings = context.surroundings
        table = NO_TABLE if context.loss_table is None else context.loss_table
        self._builtin = BuiltinMedium(context.radios, context.chance, context.city, surroundings, table=table)
        self.radios: Sequence[RadioSpec] = self._builtin.radios
        self._every_pair = context.every_pair
        self._losses_by = context.losses
        own_losses = context.losses == "engine"
        self._arrays = radio_arrays(self.radios, context.chance)
        self._finder = PathFinder(
            self.radios, self._arrays, context.chance, context.city, surroundings, own_losses=own_losses, table=table
        )
        self._noise = NoiseSources()
        self._channels = {
            step.channel
            for radio in self.radios
            for chain in radio.listening
            for step in chain.turns
            if step.waveforms[0] in WIFI
        }
        self._queue: list[_Offer] = []
        self._refused: list[tuple[int, int, int, Time]] = []
        self._starts: dict[int, tuple[Time, Time]] = {}
        self._under_way: dict[int, tuple[Time, int, int]] = {}
        self._losses = np.zeros((len(self.radios), len(ReceptionOutcome)), dtype=np.int64)
        self._active = 0
        self._until: Time | None = None
        self._engine_until: Time | None = None
        self._places: Floats | None = None
        hello = Hello(
            context.chance.seed & 0xFFFF_FFFF_FFFF_FFFF,
            float(surroundings.horizon_m),
            own_losses,
            [EngineRadio(radio.name, hash64(radio.name), radio.noise_figure_db) for radio in self.radios],
            params or {},
            _buildings(context) if own_losses else (),
        )
        self.name = name
        deadline_s = min(deadline_s, context.deadline_s)
        self._engines = EngineStarts(name, command, hello, deadline_s, context.on_death)
        self._engine, self._ready = self._engines.start()
        self.lookahead_ns: Time = self._ready.lookahead_ns

    def __deepcopy__(self, memo: dict[int, Any]) -> ExternalMedium:
        """Fork the engine; raises `ComponentError` if it cannot."""
        if Ability.FORKS not in self._ready.abilities:
            raise ComponentError(self._engine.name, "cannot be copied while it runs")
        twin = object.__new__(type(self))
        twin.__dict__.update(self.__dict__)
        for part in ("_builtin", "_finder", "_noise"):
            setattr(twin, part, copy.deepcopy(getattr(self, part), memo))
        twin._queue, twin._refused = list(self._queue), list(self._refused)
        twin._starts, twin._losses = dict(self._starts), self._losses.copy()
        twin._under_way = dict(self._under_way)
        twin._channels = set(self._channels)
        twin._engines = copy.copy(self._engines)
        twin._engine = self._engine.fork()
        return twin

    @property
    def repeatable(self) -> Literal["bytes", "outcome"]:
        """What the engine declares."""
        return "bytes" if Ability.REPEATS in self._ready.abilities else "outcome"

    @property
    def manifest(self) -> Mapping[str, Any]:
        """The engine's name, versions and command, who computes the losses, and the waveforms that stay builtin."""
        return {
            "engine": self._ready.name,
            "release": self._ready.release,
            "command": list(self._engines.command),
            "losses": self._losses_by,
            "builtin_waveforms": [w.name for w in Waveform if not self._simulates(int(w))],
        }

    @property
    def programs(self) -> Sequence[ProgramStatus]:
        """The engine."""
        return (self._engines.status(self._engine),)

    @property
    def losses(self) -> Ints:
        """(radios, outcomes): counts of each `ReceptionOutcome` at each receiver, of the engine and the builtin."""
        return self._losses + self._builtin.losses

    @property
    def quiet(self) -> bool:
        """Whether nothing waits or is on the air."""
        return not (self._queue or self._refused or self._active) and self._builtin.quiet

    def _simulates(self, waveform: int) -> bool:
        return waveform in WIFI and bool(self._ready.waveforms >> waveform & 1)

    def offer(self, now: Time, requests: TxBatch) -> None:
        """Take frames; see `Medium.offer`."""
        if not len(requests.key):
            return
        if requests.radio.min() < 0 or requests.radio.max() >= len(self.radios):
            raise ValueError(
                f"a radio in row {int(requests.radio.min())} or {int(requests.radio.max())} of {len(self.radios)}"
            )
        if self._until is not None and requests.at_ns.min() <= self._until:
            raise ValueError(f"a frame offered at {int(requests.at_ns.min())} ns, when {self._until} ns had passed")
        is_simulated = np.array([self._simulates(waveform) for waveform in requests.waveform.tolist()], dtype=bool)
        if not is_simulated.all():
            self._builtin.offer(now, TxBatch(*(column[~is_simulated] for column in requests)))
        for row in np.flatnonzero(is_simulated).tolist():
            radio, at, kind, channel, power, size, key = (column[row].item() for column in requests)
            channel = _DEFAULT_CHANNEL if channel == ANY_CHANNEL else channel
            power = float(self._arrays.tx_power_dbm[radio, 0]) if np.isnan(power) else power
            is_valid = MIN_BYTES[kind] <= size <= MAX_BYTES[kind] and 1 <= channel <= 13 and key >= 0
            if not is_valid or not np.isfinite(power) or power > 60.0:
                self._refused.append((key, radio, requests.channel[row].item(), at))
                continue
            self._channels.add(channel)
            self._queue.append(_Offer(at, radio, key, power, size, kind, channel))

    def emit(self, now: Time, sources: EmitterTable) -> None:
        """Make noise from `now` on; see `BuiltinMedium.emit`."""
        self._builtin.emit(now, sources)
        self._noise.emit(now, sources)

    def advance(self, until: Time, radios: RadioTable) -> OnAir:
        """Let time pass; see `Medium.advance`.

        Raises `ComponentError` if the engine does not answer as it must, unless the context asks for another one or
        none in its place. What is under way then is lost: each frame of which the engine has not told that it was sent
        is told of as LOST.
        """
        beside = self._builtin.advance(until, radios)  # checks the arguments
        begin, self._until = self._until, until
        # frames of one radio and instant stay in the order in which they were offered
        due = sorted((offer for offer in self._queue if offer.at <= until), key=lambda offer: (offer.at, offer.radio))
        self._queue = [offer for offer in self._queue if offer.at > until]
        answer = _NOTHING
        for offer in due:
            self._under_way[offer.key] = (offer.at, offer.radio, offer.channel)
        if not self._engines.gone:
            frames, frame_paths = self._transmissions(due, radios)
            noise, noise_paths = self._noises(begin, until, radios)
            if due or self._active or len(noise):
                try:
                    answer = self._exchange(until, radios, frames, noise, [*frame_paths, *noise_paths])
                except ComponentError as error:
                    self._replace_engine(error)
                    answer = self._lose(until)
        elif due:
            answer = self._lose(until)
        return self._merge(until, answer, beside)

    def _replace_engine(self, error: ComponentError) -> None:
        """Go on after `error` with another engine or without one, which knows of nothing that is under way."""
        made = self._engines.replace(self._engine, error)
        if made is not None:
            self._engine, self._ready = made
        self._active, self._places, self._engine_until = 0, None, None
        self._starts.clear()

    def _lose(self, until: Time) -> OnAir:
        """Tell of every frame that is under way that it is lost."""
        rows = [(k, r, c, until, until, int(TransmissionFate.LOST)) for k, (_, r, c) in self._under_way.items()]
        self._under_way.clear()
        return OnAir(Sent(*np.array(rows, dtype=np.int64).reshape(-1, 6).T), _NOTHING.heard)

    def _transmissions(self, due: Sequence[_Offer], table: RadioTable) -> tuple[Rows, list[Rows]]:
        frames = np.zeros(len(due), dtype=TRANSMISSION)
        paths = []
        first = 0
        for number, (at, radio, key, power, size, kind, channel) in enumerate(due):
            reached = self._finder.find(table, radio, power, float(centre_mhz(kind, channel)), at)
            frames[number] = (key, at, power, radio, size, kind, channel, first, len(reached), 0)
            paths.append(reached)
            first += len(reached)
        return frames, paths

    def _noises(self, begin: Time | None, until: Time, table: RadioTable) -> tuple[Rows, list[Rows]]:
        """Noise that begins after `begin`, None for the first step, in which older noise may still last."""
        rows, paths = self._noise.pieces(ORIGIN_NS if begin is None else begin, until, table, self._finder)
        since = until - PIECE_NS if begin is None else begin
        for channel in sorted(self._channels):
            centre = float(centre_mhz(WIFI[0], channel))
            more = background_pieces(self._finder.params, self._arrays.who, since, until, centre)
            rows, paths = [*rows, *more[0]], [*paths, *more[1]]
        return (np.concatenate(rows) if rows else np.zeros(0, dtype=NOISE)), paths

    def _exchange(self, until: Time, table: RadioTable, frames: Rows, noise: Rows, paths: Sequence[Rows]) -> OnAir:
        noise["first_path"] = int(frames["paths"].sum()) + np.cumsum(noise["paths"]) - noise["paths"]
        places = None if self._places is table.pos_enu_m else table.pos_enu_m
        self._places = table.pos_enu_m
        body = encode_advance(
            Advance(
                until, table.from_ns, places, frames, noise,
                np.concatenate(paths) if paths else np.zeros(0, dtype=PATH),
            )
        )  # fmt: skip
        begin, self._engine_until = self._engine_until, until
        kind, answer = self._engine.request(MessageType.ADVANCE, body)
        try:
            if kind != MessageType.DONE:
                raise DecodeError(f"{kind.name} instead of DONE")
            done = decode_done(answer)
            self._check(done, begin, until)
        except DecodeError as error:
            raise self._engine.misspoke(error) from None
        self._active = done.active
        on_air = self._interpret(done)
        if not done.active:
            self._under_way.clear()
        return on_air

    def _check(self, done: Done, begin: Time | None, until: Time) -> None:
        """Raise `DecodeError` for rows of radios, times, fates or outcomes that cannot be."""
        for rows, last in ((done.sent, TransmissionFate.REFUSED), (done.heard, ReceptionOutcome.ELSEWHERE)):
            name = "sent" if rows is done.sent else "heard"
            if not len(rows):
                continue
            if rows["radio"].max() >= len(self.radios) or rows["channel"].max() > 255:
                raise DecodeError(f"a row of {name} with a radio or channel that is not there")
            if rows["fate" if name == "sent" else "outcome"].max() > last:
                raise DecodeError(f"a row of {name} with an unknown {'fate' if name == 'sent' else 'outcome'}")
            if rows["ended_ns"].max() > until or (begin is not None and rows["ended_ns"].min() <= begin):
                raise DecodeError(f"a row of {name} that ends outside of the step until {until} ns")
        if not (np.isfinite(done.heard["rssi_dbm"]).all() and np.isfinite(done.heard["snir_db"]).all()):
            raise DecodeError("a signal strength that is no number")
        keys_sent = done.sent["key"].tolist()
        strange = set(keys_sent) - self._under_way.keys()
        if strange or len(set(keys_sent)) < len(keys_sent):
            key = min(strange) if strange else min(key for key in keys_sent if keys_sent.count(key) > 1)
            raise DecodeError(
                f"a row of sent for frame {key}, which {'is not under way' if strange else 'has another'}"
            )
        started = set(keys_sent) | self._starts.keys()
        unknown = set(done.heard["key"].tolist()) - started
        if unknown:
            raise DecodeError(f"a reception of frame {min(unknown)}, of which it has not told that it was sent")

    def _interpret(self, done: Done) -> OnAir:
        """Sort the rows, and discard what receivers decoded while they listened elsewhere."""
        sent, heard = done.sent, done.heard
        sent = sent[np.lexsort((sent["key"], sent["ended_ns"]))]
        for row in sent:
            self._under_way.pop(int(row["key"]), None)
            self._starts[int(row["key"])] = (int(row["started_ns"]), int(row["ended_ns"]))
        times = np.array([self._starts[key] for key in heard["key"].tolist()], dtype=np.int64).reshape(-1, 2)
        heard = heard.copy()
        tuned = find_tuned(
            self._arrays.chain, self._arrays.turn_channel, heard["radio"].astype(np.int64),
            heard["channel"].astype(np.int64), times[:, 0].copy(), times[:, 1].copy(),
        )  # fmt: skip
        heard["outcome"][~tuned] = ReceptionOutcome.ELSEWHERE
        np.add.at(self._losses, (heard["radio"].astype(np.int64), heard["outcome"].astype(np.int64)), 1)
        if not self._every_pair:
            heard = heard[heard["outcome"] == ReceptionOutcome.DECODED]
        if self._until is not None:
            over = self._until - _KEPT_NS
            self._starts = {key: span for key, span in self._starts.items() if span[1] >= over}
        return OnAir(_columns(sent, Sent), _columns(heard, Heard))

    def _merge(self, until: Time, first: OnAir, second: OnAir) -> OnAir:
        """Both answers and the refusals, in the order that the contract asks for."""
        late = [row for row in self._refused if row[3] <= until]
        self._refused = [row for row in self._refused if row[3] > until]
        refused = np.array([(k, r, c, at, at, int(TransmissionFate.REFUSED)) for k, r, c, at in late], dtype=np.int64)
        sent = [
            np.concatenate(column) for column in zip(first.sent, second.sent, refused.reshape(-1, 6).T, strict=True)
        ]
        order = np.lexsort((sent[0], sent[4]))
        heard = [np.concatenate(column) for column in zip(first.heard, second.heard, strict=True)]
        heard_order = np.lexsort((heard[1], heard[0], heard[3]))
        return OnAir(Sent(*(column[order] for column in sent)), Heard(*(column[heard_order] for column in heard)))

    def path_losses_db(self, ends_m: Floats) -> Floats:
        """Basic transmission losses by the engine's own model, in dB: of (k, 6) pairs of places in metres, (k,).

        NaN where the model gives none. Raises `ComponentError` if the engine has no model.
        """
        kind, body = self._engine.request(MessageType.PATH_LOSSES, encode_path_losses(ends_m))
        try:
            if kind != MessageType.LOSSES:
                raise DecodeError(f"{kind.name} instead of LOSSES")
            return decode_losses(body)
        except DecodeError as error:
            raise self._engine.misspoke(error) from None

    def close(self) -> None:
        """End the engine; again does nothing."""
        self._engine.close()


def _columns(rows: Rows, into: type[Any]) -> Any:
    """Rows of the protocol as columns of the contract."""
    columns = [rows[name] for name in into._fields]
    return into(*(column.astype(np.float64 if column.dtype.kind == "f" else np.int64) for column in columns))


_NOTHING: Final = OnAir(*(_columns(np.zeros(0, dtype=kind), rows) for kind, rows in ((SENT, Sent), (HEARD, Heard))))


def _buildings(context: MediumContext) -> list[Building]:
    if context.city is None:
        return []
    return [
        Building(building.base_m, building.height_m, np.array(polygon[0][:-1], dtype=np.float64))
        for building in context.city.buildings
        for polygon in building.polygons
    ]
