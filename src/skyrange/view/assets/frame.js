// What is drawn at one moment: bodies, lines and symbols of all arms, composed from the store.
import { LineBatch, SYMBOL, SymbolBatch } from "./batches.js";
import { findFlashes, findHeard, findLies } from "./claims.js";
import { findReceiverTracks } from "./receiver-tracks.js";
import { addScans } from "./scan-points.js";
import { inkOn, rgb } from "./theme.js";
/** @import { Lie } from "./claims.js" */
/** @import { Scene } from "./scene.js" */
/** @import { Store } from "./store.js" */
/** @import { Theme } from "./theme.js" */
/** @import { TrailSet } from "./trails.js" */
export const BODY_FLOATS = 12;
export const MAX_GHOSTS = 64;
const MANY_BODIES = 300;
const STATION_FADE_S = 10;
const HEAD_S = 6;
const BELIEF_AWAY_M = 10;
const HEARD_LINE_S = 3;
const TRACK_FADE_S = 10;
const PLANS_SHOWN = 12;

/** @typedef {{vehicle: number, arm: number, e: number, n: number, u: number}} Spot a body that is shown */

/** Bodies by slot (arms, then aircraft, then ghosts): place and heading; colour and alpha; alpha of its trail, pixels of its radius, whether dashed. */
export class Frame {
  constructor() {
    this.lines = new LineBatch();
    this.symbols = new SymbolBatch();
    this.bodies = new Float32Array(0);
    this.slots = 0;
    this.ghosts = 0;
    /** @type {Lie[]} */
    this.lies = [];
    /** @type {Spot[]} */
    this.spots = [];
    this.place = new Float32Array(4);
    this.other = new Float32Array(4);
    this.foot = [0, 0, 0];
  }

  /** @param {Store} store @param {Scene} scene @param {Theme} theme @param {TrailSet[]} trails */
  compose(store, scene, theme, trails) {
    const { vehicles } = scene, { view } = store, slots = scene.arms.length * vehicles.length + MAX_GHOSTS;
    if (this.slots !== slots) {
      this.slots = slots;
      this.bodies = new Float32Array(slots * BODY_FLOATS);
    }
    for (let slot = 0; slot < slots; slot++) this.bodies[slot * BODY_FLOATS + 7] = this.bodies[slot * BODY_FLOATS + 8] = 0;
    this.lines.clear();
    this.symbols.clear();
    this.spots.length = this.lies.length = this.ghosts = 0;
    const first = view.arms.indexOf(true);
    this.addGround(store, scene, theme);
    if (store.scans.length) addScans(this, store, theme);
    view.arms.forEach((shown, arm) => {
      if (!shown) return;
      const alpha = arm === first ? 1 : 0.42;
      this.addArm(store, scene, theme, arm, alpha);
      if (scene.flying && view.layers.trails) this.addHeads(store, arm, trails[arm], alpha);
      if (arm !== first) this.addTwin(store, scene, theme, first, arm);
      if (view.layers.radio) this.addRadio(store, theme, arm, alpha);
      if (view.layers.claims) this.addLies(store, scene, theme, arm, alpha);
    });
  }

  /** @param {Store} store @param {Scene} scene @param {Theme} theme @param {number} arm @param {number} alpha */
  addArm(store, { vehicles, arms }, theme, arm, alpha) {
    const { view } = store, { truth, autopilot, station } = store.arms[arm].tracks, { place, other, foot, bodies } = this, { time, selected } = view;
    const many = vehicles.length * arms.length > MANY_BODIES, radius = many ? 6.5 : vehicles.length > 40 ? 8.5 : 11;
    for (let v = 0; v < vehicles.length; v++) {
      if (!store.shows(v)) continue;
      const ink = rgb(inkOn(vehicles[v], theme)), mine = selected === v, near = selected < 0 || selected >= vehicles.length || mine;
      const here = truth[v].at(time, place), at = (arm * vehicles.length + v) * BODY_FLOATS;
      bodies[at + 4] = ink[0];
      bodies[at + 5] = ink[1];
      bodies[at + 6] = ink[2];
      bodies[at + 8] = view.layers.trails ? alpha * (near ? 0.9 : 0.3) : 0;
      if (here) {
        bodies.set(place, at);
        bodies[at + 7] = alpha;
        bodies[at + 9] = mine ? radius * 1.35 : radius;
        bodies[at + 10] = 0;
        this.spots.push({ vehicle: v, arm, e: place[0], n: place[1], u: place[2] });
        if (place[2] > 0.5) {
          foot[0] = place[0];
          foot[1] = place[1];
          foot[2] = 0;
          this.lines.add(place, foot, ink, (many ? 0.2 : 0.5) * alpha * (near ? 1 : 0.5), mine ? 1.6 : 1);
          if (!many) this.symbols.add(foot, ink, 0.5 * alpha, 2, SYMBOL.dot);
        }
      }
      if (!view.everyone && !mine) continue;
      if (view.layers.belief && autopilot[v].at(time, other)) {
        const away = here ? Math.hypot(place[0] - other[0], place[1] - other[1], place[2] - other[2]) : Infinity, strength = (mine ? 0.6 : 0.35) + 0.5 * Math.min(away / BELIEF_AWAY_M, 1);
        this.symbols.add(other, ink, Math.min(strength, 1) * alpha, radius + 1, SYMBOL.ring);
        if (here) this.lines.add(place, other, ink, Math.min(strength, 1) * alpha, 1.4);
      }
      if (view.layers.station && station[v].at(time, other)) {
        const age = time - station[v].t[station[v].find(time + 1e-6)];
        this.symbols.add(other, ink, Math.max(1 - age / STATION_FADE_S, 0.2) * alpha, 3, SYMBOL.dot);
      }
    }
  }

  /** The newest pieces of trails, which are not closed yet while it flies. @param {Store} store @param {number} arm @param {TrailSet | undefined} set @param {number} alpha */
  addHeads({ view }, arm, set, alpha) {
    for (const { vehicle, arm: mine, e, n, u } of this.spots) {
      const anchor = mine === arm ? set?.open.get(vehicle)?.anchor : undefined, at = (this.slots - MAX_GHOSTS) / view.arms.length * arm * BODY_FLOATS + vehicle * BODY_FLOATS;
      if (!anchor || view.time <= anchor[0] || view.time > anchor[0] + HEAD_S) continue;
      this.lines.add([anchor[1], anchor[2], anchor[3]], [e, n, u], [this.bodies[at + 4], this.bodies[at + 5], this.bodies[at + 6]], alpha * 0.85, 1.8);
    }
  }

  /** A line between the selected aircraft and its twin. @param {Store} store @param {Scene} scene @param {Theme} theme @param {number} first @param {number} arm */
  addTwin(store, { vehicles }, theme, first, arm) {
    const { selected, time } = store.view, { place, other } = this;
    if (selected < 0 || selected >= vehicles.length || !store.shows(selected)) return;
    if (store.nodePlace(first, selected, time, place) && store.nodePlace(arm, selected, time, other)) this.lines.add(place, other, rgb(theme.ink), 0.55, 1, 3);
  }

  /** @param {Store} store @param {Theme} theme @param {number} arm @param {number} alpha */
  addRadio(store, theme, arm, alpha) {
    const { view } = store, { place, other } = this, { selected, time } = view, red = rgb(theme.bad), calm = rgb(theme.accent), busy = (store.scene?.vehicles.length ?? 0) > MANY_BODIES;
    for (const { receiver, node, age } of findFlashes(store, arm, time)) {
      const involved = selected < 0 ? !busy : receiver === selected || node === selected, hostile = store.isHostile(node);
      if (!store.nodePlace(arm, receiver, time, place) || !store.nodePlace(arm, node, time, other)) continue;
      this.lines.add(other, place, hostile ? red : calm, (1 - age) * alpha * (involved ? 0.8 : hostile ? 0.35 : selected < 0 ? 0.14 : 0.07), involved || hostile ? 1.6 : 1);
    }
    if (selected < 0 || !store.nodePlace(arm, selected, time, place)) return;
    for (const { node, age } of findHeard(store, arm, selected, time)) {
      if (age < HEARD_LINE_S && store.nodePlace(arm, node, time, other))
        this.lines.add(other, place, store.isHostile(node) ? red : calm, (0.5 - (0.4 * age) / HEARD_LINE_S) * alpha, 1.2, 5);
    }
    for (const { node, at, age } of findReceiverTracks(store, arm, selected, time)) this.symbols.add(at, store.isHostile(node) ? red : calm, Math.max(1 - age / TRACK_FADE_S, 0.25) * alpha, 5, SYMBOL.diamond);
  }

  /** @param {Store} store @param {Scene} scene @param {Theme} theme @param {number} arm @param {number} alpha */
  addLies(store, { arms, vehicles }, theme, arm, alpha) {
    const red = rgb(theme.bad), { place, bodies, foot } = this;
    for (const lie of findLies(store, arm, store.view.time)) {
      if (lie.node < vehicles.length && !store.shows(lie.node)) continue;
      const fade = alpha * (1 - lie.age / 4);
      this.lies.push(lie);
      if (this.ghosts < MAX_GHOSTS) {
        const at = (arms.length * vehicles.length + this.ghosts++) * BODY_FLOATS;
        bodies.set([lie.at[0], lie.at[1], lie.at[2], lie.heading, ...red, alpha * 0.62, 0, 13, 0, 0], at);
      }
      this.symbols.add(lie.at, red, fade, 17, SYMBOL.dashed);
      [foot[0], foot[1]] = lie.at;
      foot[2] = 0;
      this.lines.add(lie.at, foot, red, fade * 0.6, 1, 4);
      if (store.nodePlace(arm, lie.node, store.view.time, place)) this.lines.add(lie.at, place, red, fade, 1.6, 7);
    }
  }

  /** Homes and plans, which are alike in all arms, and radios. @param {Store} store @param {Scene} scene @param {Theme} theme */
  addGround(store, { vehicles, radios }, theme) {
    const { view } = store, { foot } = this, red = rgb(theme.bad), dim = rgb(theme.dim);
    vehicles.forEach(({ home, plan, ink: inks }, v) => {
      const mine = view.selected === v;
      if (!store.shows(v) || !(mine || vehicles.length <= PLANS_SHOWN)) return;
      const ink = rgb(inkOn({ ink: inks }, theme)), alpha = mine ? 0.85 : view.selected < 0 ? 0.4 : 0.2;
      if (home) this.symbols.add(home, ink, alpha, 5, SYMBOL.ring);
      if (!view.layers.plans) return;
      let before = home ? [home[0], home[1], plan[0] ? plan[0][2] : 0] : null;
      for (const at of plan) {
        if (before) this.lines.add(before, at, ink, alpha * 0.8, mine ? 1.5 : 1, 6);
        this.symbols.add(at, ink, alpha, mine ? 4 : 2.5, SYMBOL.diamond);
        before = at;
      }
    });
    for (const { kind, at, arms } of radios) {
      if (!at || !arms.some((arm) => view.arms[arm])) continue;
      const hostile = kind === "attack", ink = hostile ? red : dim;
      [foot[0], foot[1]] = at;
      foot[2] = 0;
      this.lines.add(foot, at, ink, 0.95, hostile ? 2.6 : 1.6);
      this.symbols.add(at, ink, 1, hostile ? 7 : 5, hostile ? SYMBOL.triangle : SYMBOL.diamond);
    }
  }
}
