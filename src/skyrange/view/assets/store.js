// Store of all state: what the stream told, and what the page shows of it.
import { addEvents, emptyTables, TextList } from "./events.js";
import { readPositionsHead, readScene } from "./scene.js";
import { sumTurns, Track, unbendPlaces } from "./tracks.js";
/** @import { ScanRow } from "./record-client.js" */
/** @import { EventTables } from "./events.js" */
/** @import { Scene } from "./scene.js" */
/** @import { Message } from "./stream.js" */
const MANY_VEHICLES = 60;

/** @typedef {{truth: Track[], autopilot: Track[], station: Track[]}} Layers */
/** @typedef {{tracks: Layers, events: EventTables}} ArmData */
/** @typedef {"names" | "trails" | "belief" | "station" | "claims" | "radio" | "volumes" | "plans" | "buildings"} LayerName */
/** @typedef {{time: number, playing: boolean, speed: number, following: boolean, selected: number, hovered: number, arms: boolean[], operators: boolean[], layers: Record<LayerName, boolean>, everyone: boolean, chasing: boolean}} ViewState */
/** @typedef {{scene: boolean, data: boolean, view: boolean}} Changes */
/** @typedef {{arm: number, layer: string, from: number, until: number, step: number, samples: number, rows: number[], places: Float32Array}} PositionsNews */

/** @returns {ViewState} */
const firstView = () => ({
  time: 0, playing: false, speed: 1, following: false, selected: -1, hovered: -1, arms: [], operators: [], everyone: true, chasing: false,
  layers: { names: true, trails: true, belief: true, station: true, claims: true, radio: true, volumes: true, plans: true, buildings: true },
});

/** All state of one viewer; listeners hear of changes once before a frame is painted. */
export class Store {
  constructor() {
    /** @type {Scene | null} */
    this.scene = null;
    /** @type {ArmData[]} */
    this.arms = [];
    this.view = firstView();
    /** @type {((changes: Changes) => void)[]} */
    this.listeners = [];
    /** @type {((news: PositionsNews) => void)[]} */
    this.positionListeners = [];
    /** @type {Changes} */
    this.changes = { scene: false, data: false, view: false };
    this.frame = 0;
    this.texts = new TextList();
    this.bounds = { low: [Infinity, Infinity, 0], high: [-Infinity, -Infinity, 1] };
    /** Newest scans of the selected aircraft. @type {ScanRow[]} */
    this.scans = [];
    /** The newest time that was told. */
    this.newest = -Infinity;
    /** What the connection says, an empty string where all is well. */
    this.notice = "";
  }

  /** @param {(changes: Changes) => void} listener */
  subscribe(listener) {
    this.listeners.push(listener);
  }

  /** @param {keyof Changes} [what] */
  changed(what = "view") {
    this.changes[what] = true;
    this.frame ||= requestAnimationFrame(() => this.tell());
  }

  tell() {
    const { changes } = this;
    this.frame = 0;
    this.changes = { scene: false, data: false, view: false };
    for (const listener of this.listeners) listener(changes);
  }

  /** Change some of the view. @param {Partial<ViewState>} some */
  show(some) {
    Object.assign(this.view, some);
    this.changed();
  }

  /** @param {number} time */
  seek(time) {
    const { start, end } = this.span();
    this.show({ time: Math.min(Math.max(time, start), end), following: false });
  }

  /** The time that can be shown. */
  span() {
    const start = this.scene?.start ?? 0, end = this.scene ? (this.scene.flying ? Math.max(this.scene.end, this.newest) : this.scene.end) : 1;
    return { start, end: Math.max(end, start + 0.001) };
  }

  /** Forget what the stream told, before it tells everything again. */
  restart() {
    this.scene = null;
  }

  /** @param {Message} message */
  take(message) {
    if (message.kind === "S") this.takeScene(message);
    else if (!this.scene) return;
    else if (message.kind === "P") this.takePositions(message, this.scene);
    else if (message.kind === "E") this.takeEvents(message);
  }

  /** @param {Message} message */
  takeScene(message) {
    const before = this.scene, scene = readScene(message), { view } = this;
    const same = (/** @type {{id: string}[]} */ old, /** @type {{id: string}[]} */ now) => old.length === now.length && old.every((one, i) => one.id === now[i].id);
    const goesOn = before !== null && same(before.arms, scene.arms) && same(before.vehicles, scene.vehicles) && same(before.radios, scene.radios);
    this.scene = scene;
    if (!goesOn) {
      this.texts = new TextList();
      this.newest = -Infinity;
      this.arms = scene.arms.map(() => ({
        tracks: { truth: scene.vehicles.map(() => new Track(false)), autopilot: scene.vehicles.map(() => new Track(true)), station: scene.vehicles.map(() => new Track(true)) },
        events: emptyTables(this.texts),
      }));
      this.bounds = { low: [Infinity, Infinity, 0], high: [-Infinity, -Infinity, 1] };
    } else if (!message.arrays.heights) scene.buildings = before.buildings;
    for (const vehicle of scene.vehicles) for (const place of [vehicle.home, ...vehicle.plan]) if (place) this.widen(place[0], place[1], place[2]);
    if (view.arms.length !== scene.arms.length || view.operators.length !== scene.operators.length) {
      const many = scene.vehicles.length > MANY_VEHICLES;
      Object.assign(view, { arms: scene.arms.map(() => true), operators: scene.operators.map(() => true), time: scene.flying ? scene.end : scene.start, following: scene.flying, playing: scene.flying, everyone: !many });
      Object.assign(view.layers, { volumes: !many });
    }
    if (view.selected >= scene.vehicles.length + scene.radios.length) view.selected = -1;
    this.changed("scene");
    this.changed("data");
  }

  /** @param {number} e @param {number} n @param {number} u */
  widen(e, n, u) {
    const { low, high } = this.bounds, place = [e, n, u];
    for (let axis = 0; axis < 3; axis++) {
      if (place[axis] < low[axis]) low[axis] = place[axis];
      if (place[axis] > high[axis]) high[axis] = place[axis];
    }
  }

  /** @param {Message} message @param {Scene} scene */
  takePositions(message, scene) {
    const head = readPositionsHead(message, scene);
    if (!head || !head.samples) return;
    const { arm, layer, from, step, samples, rows, gaps } = head, { starts, bends, turns, ages } = message.arrays;
    const places = unbendPlaces(starts, bends, rows.length, samples, gaps), headings = turns ? sumTurns(turns, rows.length, samples) : null;
    rows.forEach((vehicle, row) => this.arms[arm].tracks[layer][vehicle].add({ from, step, samples, places, turns: headings, ages: ages ?? null, row }));
    const until = from + (samples - 1) * step, every = Math.max(1, Math.round(2 / step));
    if (layer === "truth")
      for (let row = 0; row < rows.length; row++)
        for (let k = 0; k < samples; k += every) {
          const at = row * 3 * samples + k;
          if (!Number.isNaN(places[at])) this.widen(places[at], places[at + samples], places[at + 2 * samples]);
        }
    this.newest = Math.max(this.newest, until);
    for (const listener of this.positionListeners) listener({ arm, layer, from, until, step, samples, rows, places });
    this.changed("data");
  }

  /** @param {Message} message */
  takeEvents({ head }) {
    const data = this.arms[head.arm];
    if (!data) return;
    addEvents(data.events, this.texts, head);
    if (Number.isFinite(head.until_s)) this.newest = Math.max(this.newest, head.until_s);
    this.changed("data");
  }

  /** Whether an aircraft's operator is shown. @param {number} vehicle */
  shows(vehicle) {
    return this.view.operators[this.scene?.vehicles[vehicle]?.operator ?? 0] !== false;
  }

  /** The true place of an aircraft or radio in an arm; false where it has none. @param {number} arm @param {number} node @param {number} time @param {Float32Array | number[]} out */
  nodePlace(arm, node, time, out) {
    const scene = this.scene;
    if (!scene) return false;
    if (node < scene.vehicles.length) return this.arms[arm]?.tracks.truth[node]?.at(time, out) ?? false;
    const at = scene.radios[node - scene.vehicles.length]?.at;
    if (!at) return false;
    [out[0], out[1], out[2]] = at;
    out[3] = 0;
    return true;
  }

  /** @param {number} node */
  nodeName(node) {
    const scene = this.scene;
    return scene ? (scene.vehicles[node] ?? scene.radios[node - scene.vehicles.length])?.id ?? "" : "";
  }

  /** Whether a node is a radio of an attack. @param {number} node */
  isHostile(node) {
    const scene = this.scene;
    return scene ? scene.radios[node - scene.vehicles.length]?.kind === "attack" : false;
  }
}
