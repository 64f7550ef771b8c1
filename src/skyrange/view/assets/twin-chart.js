// Chart of the distance between an aircraft and its twin in another arm over time.
import { findMishaps, findNearMisses, searchesNear } from "./encounters.js";
import { clockText, element, fitCanvas, roundStep, setText } from "./page-parts.js";
/** @import { Encounter } from "./encounters.js" */
/** @import { Store } from "./store.js" */
/** @import { Theme } from "./theme.js" */
const POINTS = 240;
const COARSE_S = 2;
const MAX_JUDGED = 4000;
const APART_M = 5;
const FINE_S = 0.2;
const HIT_PIXELS = 7;
const SAID = 3;

/** The distance of twins over time: of the aircraft that is selected, or of the one whose twins came farthest apart. */
export class TwinChart {
  /** @param {Store} store @param {Theme} theme */
  constructor(store, theme) {
    this.store = store;
    this.theme = theme;
    this.title = element("figcaption");
    this.said = element("p", { className: "sky-twins-marks" });
    this.canvas = element("canvas", { "aria-hidden": "true" });
    this.root = element("figure", { className: "sky-twins", hidden: true }, this.title, this.canvas, this.said);
    this.vehicle = this.worst = -1;
    /** @type {number[]} */
    this.away = [];
    this.most = 0;
    /** @type {Encounter[]} */
    this.marks = [];
    this.canvas.addEventListener("click", (event) => {
      const box = this.canvas.getBoundingClientRect(), { start, end } = store.span();
      const time = start + ((event.clientX - box.left) / box.width) * (end - start), reach = (HIT_PIXELS / box.width) * (end - start);
      const near = this.marks.filter((mark) => Math.abs(mark.time - time) <= reach).sort((a, b) => Math.abs(a.time - time) - Math.abs(b.time - time));
      store.seek(near[0]?.time ?? time);
    });
  }

  /** @param {number} vehicle @param {number} time metres, NaN where a twin is missing */
  distance(vehicle, time) {
    const { arms } = this.store, a = [0, 0, 0, 0], b = [0, 0, 0, 0];
    if (!arms[0].tracks.truth[vehicle].at(time, a) || !arms[1].tracks.truth[vehicle].at(time, b)) return NaN;
    return Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
  }

  /** Find out what to show, after more is known or another aircraft is selected. */
  gather() {
    const { store } = this, { scene, view } = store;
    this.root.hidden = scene?.arms.length !== 2 || !scene.vehicles.length;
    if (!scene || this.root.hidden) return;
    const { start, end } = store.span();
    if (view.selected >= 0 && view.selected < scene.vehicles.length) this.vehicle = view.selected;
    else {
      let most = -1;
      for (let v = 0; v < Math.min(scene.vehicles.length, MAX_JUDGED); v++)
        for (let time = start; time <= end; time += Math.max(COARSE_S, (end - start) / 60)) {
          const away = this.distance(v, time);
          if (away > most) [most, this.vehicle] = [away, v];
        }
      if (most < 0) this.vehicle = 0;
    }
    this.away = Array.from({ length: POINTS + 1 }, (_, i) => this.distance(this.vehicle, start + ((end - start) * i) / POINTS));
    this.most = this.away.reduce((most, away) => (away > most ? away : most), 0);
    this.marks = [...this.apart(start, end), ...[0, 1].flatMap((arm) => [...findNearMisses(store, arm, this.vehicle), ...findMishaps(store, arm, this.vehicle)])].sort((a, b) => a.time - b.time);
    this.describe();
    this.paint();
  }

  /** When the twins are first some metres apart. @param {number} start @param {number} end @returns {Encounter[]} */
  apart(start, end) {
    for (let time = start; this.most >= APART_M && time <= end; time += FINE_S)
      if (this.distance(this.vehicle, time) >= APART_M) return [{ arm: 0, time, title: `${APART_M} m apart`, violent: false }];
    return [];
  }

  /** Say in words what is marked. */
  describe() {
    const { store, marks } = this, { start, end } = store.span(), arms = store.scene?.arms ?? [];
    const words = marks.slice(0, SAID).map(({ arm, time, title }) => `${clockText(time)} ${title}${title.endsWith("apart") ? "" : `, ${arms[arm].title}`}`);
    setText(this.said, [...words, ...(marks.length > SAID ? [`${marks.length - SAID} more`] : [])].join(" · "));
    this.canvas.title = `Distance between twins from ${clockText(start, 0)} to ${clockText(end, 0)}, with mishaps and aircraft nearer than 10 m${searchesNear(store) ? "" : " (not searched for among so many)"}; a click seeks`;
  }

  paint() {
    const { store, theme } = this, { scene, view } = store, fitted = this.root.hidden ? null : fitCanvas(this.canvas);
    if (!fitted || !scene?.vehicles[this.vehicle]) return;
    const { context, width, height } = fitted, { start, end } = store.span(), top = Math.max(roundStep(this.most * 1.15), this.most * 1.02, 1), low = height - 5;
    const y = (/** @type {number} */ away) => low - (away / top) * (height - 12), now = this.distance(this.vehicle, view.time);
    setText(this.title, `${scene.vehicles[this.vehicle].id}: ${Number.isNaN(now) ? "–" : now.toFixed(1) + " m"} from its twin, at most ${this.most.toFixed(0)} m`);
    context.strokeStyle = theme.rule;
    context.lineWidth = 1;
    context.beginPath();
    context.moveTo(0, low + 0.5);
    context.lineTo(width, low + 0.5);
    context.stroke();
    context.beginPath();
    let open = false;
    this.away.forEach((away, i) => {
      if (Number.isNaN(away)) open = false;
      else if (open) context.lineTo((i / POINTS) * width, y(away));
      else {
        context.moveTo((i / POINTS) * width, y(away));
        open = true;
      }
    });
    context.strokeStyle = theme.accent;
    context.lineWidth = 1.8;
    context.lineJoin = "round";
    context.stroke();
    this.paintMarks(context, (time) => ((time - start) / (end - start)) * width, y);
    const x = ((view.time - start) / (end - start)) * width;
    context.strokeStyle = theme.ink;
    context.globalAlpha = 0.5;
    context.beginPath();
    context.moveTo(x, 0);
    context.lineTo(x, height);
    context.stroke();
    context.globalAlpha = 1;
    if (!Number.isNaN(now)) {
      context.fillStyle = theme.accent;
      context.beginPath();
      context.arc(x, y(now), 3.2, 0, 7);
      context.fill();
    }
  }

  /** A cross for a collision or crash, a diamond for what is less; those of the twin are hollow. @param {CanvasRenderingContext2D} context @param {(time: number) => number} x @param {(away: number) => number} y */
  paintMarks(context, x, y) {
    const { theme } = this;
    for (const { arm, time, title, violent } of this.marks) {
      const away = this.distance(this.vehicle, time), at = x(time), high = y(Number.isNaN(away) ? 0 : away), r = 4.5;
      context.strokeStyle = context.fillStyle = violent ? theme.bad : title.endsWith("apart") ? theme.ink : theme.warn;
      context.lineWidth = 1.8;
      context.beginPath();
      for (const [right, down] of violent ? [[-r, -r], [r, r], [0, 0], [r, -r], [-r, r]] : [[0, -r], [r, 0], [0, r], [-r, 0], [0, -r]]) context.lineTo(at + right, high + down);
      if (violent || arm) context.stroke();
      else context.fill();
    }
  }
}
