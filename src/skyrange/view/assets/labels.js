// Layer of names, call-outs, marks, scale and compass above the picture; what would overlap is left out.
import { callouts, marksUntil } from "./incidents.js";
import { clockText, fitCanvas, rounded, roundStep, shortened } from "./page-parts.js";
import { LABEL_FONT, Occupancy, TextSprites } from "./label-sprites.js";
import { inkOn } from "./theme.js";
/** @import { Camera } from "./camera.js" */
/** @import { Frame } from "./frame.js" */
/** @import { Scene } from "./scene.js" */
/** @import { Store } from "./store.js" */
/** @import { Theme } from "./theme.js" */
const MAX_NAMES = 140;
const PICK_PIXELS = 18;

/** @typedef {{node: number, arm: number, x: number, y: number, depth: number}} ScreenSpot */

/** The layer above the picture. */
export class LabelLayer {
  /** @param {HTMLCanvasElement} canvas @param {Store} store @param {Theme} theme */
  constructor(canvas, store, theme) {
    this.canvas = canvas;
    this.store = store;
    this.theme = theme;
    this.sprites = new TextSprites();
    /** @type {ScreenSpot[]} */
    this.spots = [];
    this.point = [0, 0, 0];
  }

  /** The aircraft or radio at a place of the screen, or -1. @param {number} x @param {number} y */
  pick(x, y) {
    let best = PICK_PIXELS, found = -1;
    for (const spot of this.spots) {
      const away = Math.hypot(spot.x - x, spot.y - y);
      if (away < best) [best, found] = [away, spot.node];
    }
    return found;
  }

  /** @param {Frame} frame @param {Camera} camera @param {Scene} scene */
  draw(frame, camera, scene) {
    const fitted = fitCanvas(this.canvas);
    if (!fitted) return;
    const { context, width, height, ratio } = fitted, { theme, store, point } = this, { view } = store, { selected, hovered } = view;
    const taken = new Occupancy(width, height), halo = theme.dark ? "rgba(9,13,20,.88)" : "rgba(255,255,255,.92)", first = view.arms.indexOf(true);
    this.spots = [];
    for (const { vehicle, arm, e, n, u } of frame.spots)
      if (camera.project(e, n, u, point) && point[0] > -20 && point[0] < width + 20 && point[1] > -20 && point[1] < height + 20) this.spots.push({ node: vehicle, arm, x: point[0], y: point[1], depth: point[2] });
    const aircraft = this.spots.length;
    scene.radios.forEach(({ at, arms }, i) => {
      if (at && arms.some((arm) => view.arms[arm]) && camera.project(at[0], at[1], at[2], point)) this.spots.push({ node: scene.vehicles.length + i, arm: first, x: point[0], y: point[1], depth: point[2] });
    });
    taken.take(0, height - 64, 240, 64, true);
    taken.take(0, 0, width, 36, true);
    const name = (/** @type {string} */ text, /** @type {string} */ ink, /** @type {number} */ x, /** @type {number} */ y, /** @type {boolean} */ bold, /** @type {boolean} */ always = false) => {
      const { canvas, wide } = this.sprites.get(text, ink, halo, ratio, bold);
      if (always) x = Math.max(Math.min(x, width - wide - 4), 2);
      if (!taken.take(x, y - 7, wide, 14, always)) return false;
      context.drawImage(canvas, Math.round(x * ratio) / ratio, Math.round((y - 9) * ratio) / ratio, canvas.width / ratio, canvas.height / ratio);
      return true;
    };
    this.drawMarks(context, camera, name);
    for (const spot of this.spots) if (spot.node === selected || spot.node === hovered) this.drawRing(context, spot);
    const chosen = this.spots.filter((spot) => spot.node === selected || spot.node === hovered), rest = this.spots.slice(0, aircraft).filter((spot) => spot.node !== selected && spot.node !== hovered);
    for (const spot of chosen) if (spot.arm === first) name(this.nameOf(scene, spot.node), theme.ink, spot.x + 14, spot.y - 13, true, true);
    for (const lie of frame.lies)
      if (camera.project(lie.at[0], lie.at[1], lie.at[2], point)) name((lie.hostile ? "false: " : "wrong: ") + shortened(lie.uas || "no id", 24), theme.bad, point[0] + 17, point[1] + 3, true, frame.lies.length < 6);
    this.drawCallouts(context, camera, scene, taken);
    for (const spot of this.spots.slice(aircraft)) if (spot.node !== selected && spot.node !== hovered) name(this.nameOf(scene, spot.node), store.isHostile(spot.node) ? theme.bad : theme.dim, spot.x + 9, spot.y - 4, store.isHostile(spot.node));
    if (view.layers.names) {
      rest.sort((p, q) => (p.arm === first ? 0 : 1) - (q.arm === first ? 0 : 1) || p.depth - q.depth);
      let left = MAX_NAMES;
      for (const spot of rest) if (spot.arm === first && left > 0 && name(scene.vehicles[spot.node].short, theme.ink, spot.x + 10, spot.y - 10, false)) left--;
    }
    if (view.layers.volumes) this.nameClosed(camera, scene, name);
    if (view.layers.plans && view.layers.names) this.numberPlan(camera, scene, name);
    this.drawScale(context, camera, height);
  }

  /** Names of closed airspace. @param {Camera} camera @param {Scene} scene @param {(text: string, ink: string, x: number, y: number, bold: boolean) => boolean} name */
  nameClosed(camera, scene, name) {
    const { arms, time } = this.store.view, { point } = this;
    for (const { vehicle, arm, from_s, until_s, upper_m, ring, name: text } of scene.volumes)
      if (vehicle === null && text && arms[arm] && time >= from_s && time <= until_s && camera.project(ring[0][0], ring[0][1], upper_m, point)) name(text, this.theme.bad, point[0] + 4, point[1] - 8, true);
  }

  /** Numbers of the mission items of the selected aircraft. @param {Camera} camera @param {Scene} scene @param {(text: string, ink: string, x: number, y: number, bold: boolean) => boolean} name */
  numberPlan(camera, scene, name) {
    const { point } = this, vehicle = scene.vehicles[this.store.view.selected];
    for (const [i, at] of vehicle?.plan.entries() ?? [])
      if (vehicle.items[i] >= 0 && camera.project(at[0], at[1], at[2], point)) name(String(vehicle.items[i]), inkOn(vehicle, this.theme), point[0] + 5, point[1] - 9, true);
  }

  /** @param {Scene} scene @param {number} node */
  nameOf(scene, node) {
    return node < scene.vehicles.length ? scene.vehicles[node].id : scene.radios[node - scene.vehicles.length].id;
  }

  /** @param {CanvasRenderingContext2D} context @param {ScreenSpot} spot */
  drawRing(context, { node, arm, x, y }) {
    context.strokeStyle = this.theme.ink;
    context.globalAlpha = node !== this.store.view.selected ? 0.5 : arm === this.store.view.arms.indexOf(true) ? 0.9 : 0.45;
    context.lineWidth = 1.5;
    context.beginPath();
    context.arc(x, y, 19, 0, 7);
    context.stroke();
    context.globalAlpha = 1;
  }

  /** Mishaps up to now, where they happened. @param {CanvasRenderingContext2D} context @param {Camera} camera @param {(text: string, ink: string, x: number, y: number, bold: boolean) => boolean} name */
  drawMarks(context, camera, name) {
    const { theme, point } = this;
    for (const mark of marksUntil(this.store)) {
      if (!camera.project(mark.at[0], mark.at[1], mark.at[2], point)) continue;
      const [x, y] = point, r = 5;
      context.beginPath();
      if (mark.violent) {
        context.moveTo(x - r, y - r);
        context.lineTo(x + r, y + r);
        context.moveTo(x + r, y - r);
        context.lineTo(x - r, y + r);
      } else {
        context.moveTo(x, y - r);
        context.lineTo(x + r, y + r * 0.7);
        context.lineTo(x - r, y + r * 0.7);
        context.closePath();
      }
      context.lineCap = context.lineJoin = "round";
      context.strokeStyle = theme.card;
      context.lineWidth = 5;
      context.stroke();
      context.strokeStyle = mark.violent ? theme.bad : theme.warn;
      context.lineWidth = 2.2;
      context.stroke();
      if (mark.recent) name(mark.title, mark.violent ? theme.bad : theme.warn, x + 9, y + 10, true);
    }
  }

  /** Boxes beside aircraft that say what was decided about them just now. @param {CanvasRenderingContext2D} context @param {Camera} camera @param {Scene} scene @param {Occupancy} taken */
  drawCallouts(context, camera, scene, taken) {
    const { theme, point, store } = this, place = [0, 0, 0, 0];
    for (const { arm, node, title, text, age, alarm } of callouts(store)) {
      if (!store.nodePlace(arm, node, store.view.time, place) || !camera.project(place[0], place[1], place[2], point)) continue;
      context.font = "650 " + LABEL_FONT;
      const body = shortened(rounded(text), 42), wide = Math.max(context.measureText(title).width, body ? context.measureText(body).width * 0.94 : 0) + 18, high = body ? 38 : 23, [x, y] = point;
      const spots = [[x + 24, y - high - 20], [x - wide - 24, y - high - 20], [x + 24, y + 20], [x - wide - 24, y + 20], [x + 24, y - high - 64]];
      const spot = spots.find(([left, top]) => taken.take(left, top, wide, high));
      if (!spot) continue;
      const [left, top] = spot;
      context.globalAlpha = Math.min(1, Math.max(0.15, (4.5 - age) / 1.2));
      context.strokeStyle = alarm ? theme.bad : node < scene.vehicles.length ? inkOn(scene.vehicles[node], theme) : theme.dim;
      context.lineWidth = 1.2;
      context.beginPath();
      context.moveTo(x, y);
      context.lineTo(left > x ? left : left + wide, top > y ? top : top + high);
      context.stroke();
      context.fillStyle = theme.card;
      context.beginPath();
      context.roundRect(left, top, wide, high, 7);
      context.fill();
      context.stroke();
      context.textBaseline = "alphabetic";
      context.textAlign = "left";
      context.fillStyle = alarm ? theme.bad : theme.ink;
      context.fillText(title, left + 9, top + 15.5);
      context.font = LABEL_FONT;
      context.fillStyle = theme.dim;
      if (body) context.fillText(body, left + 9, top + 30.5);
      context.globalAlpha = 1;
    }
  }

  /** @param {CanvasRenderingContext2D} context @param {Camera} camera @param {number} height */
  drawScale(context, camera, height) {
    const { theme } = this, metres = roundStep(100 / camera.metre), long = metres * camera.metre, x = 34, y = height - 34, flat = Math.max(Math.abs(Math.sin(camera.pitch)), 0.3);
    context.strokeStyle = context.fillStyle = theme.ink;
    context.lineWidth = 1.5;
    context.beginPath();
    context.moveTo(66, y + 8);
    context.lineTo(66, y + 14);
    context.lineTo(66 + long, y + 14);
    context.lineTo(66 + long, y + 8);
    context.stroke();
    context.font = LABEL_FONT;
    context.textAlign = "left";
    context.textBaseline = "alphabetic";
    context.fillText(`${metres >= 1000 ? metres / 1000 + " km" : metres + " m"}`, 66, y + 3);
    const tip = (/** @type {number} */ turn, /** @type {number} */ r) => /** @type {[number, number]} */ ([x + Math.sin(turn - camera.yaw) * r, y - Math.cos(turn - camera.yaw) * r * flat]);
    context.globalAlpha = 0.35;
    context.beginPath();
    context.ellipse(x, y, 17, 17 * flat, 0, 0, 7);
    context.stroke();
    context.globalAlpha = 1;
    context.beginPath();
    for (const [turn, r] of [[0, 16], [2.6, 10], [Math.PI, 4], [-2.6, 10]]) context.lineTo(...tip(turn, r));
    context.fill();
    context.font = "700 10.5px system-ui, sans-serif";
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.fillText("N", ...tip(0, 25));
    context.textAlign = "left";
  }
}

/** What a tooltip says of a node. @param {Store} store @param {number} node */
export const describeNode = (store, node) => {
  const place = [0, 0, 0, 0], arm = Math.max(store.view.arms.indexOf(true), 0), vehicle = store.scene?.vehicles[node];
  if (!store.nodePlace(arm, node, store.view.time, place)) return store.nodeName(node);
  const speed = vehicle ? store.arms[arm].tracks.truth[node].velocity(store.view.time) : null;
  return `${store.nodeName(node)} · ${place[2].toFixed(0)} m up${speed ? ` · ${speed.over.toFixed(1)} m/s` : ""} · ${clockText(store.view.time)}`;
};
