// Renderer without WebGL: the same frame on a 2-D canvas, far walls before near ones.
import { LINE_FLOATS, SYMBOL, SYMBOL_FLOATS } from "./batches.js";
import { unpackBuildings, wallLight } from "./city.js";
import { BODY_FLOATS } from "./frame.js";
import { fitCanvas, roundStep } from "./page-parts.js";
import { rgb } from "./theme.js";
import { orderedRing } from "./triangles.js";
import { TRAIL_S } from "./trails.js";
/** @import { Camera } from "./camera.js" */
/** @import { Frame } from "./frame.js" */
/** @import { Renderer } from "./renderer.js" */
/** @import { Store } from "./store.js" */
/** @import { Theme } from "./theme.js" */
/** @import { TrailSet } from "./trails.js" */
const FLAT_BUILDINGS = 400;
const FLAT_TRAILS = 4000;

/** @param {HTMLCanvasElement} canvas @param {Store} store @param {Theme} theme @param {TrailSet[]} trails @returns {Renderer} */
export const makeFlatRenderer = (canvas, store, theme, trails) => {
  /** @type {{height: number, ring: number[], mid: number[]}[]} */
  let nearest = [];
  const a = [0, 0, 0], b = [0, 0, 0];
  const css = (/** @type {ArrayLike<number>} */ ink, /** @type {number} */ at = 0, /** @type {number} */ k = 1) => `rgb(${Math.min(ink[at] * k, 1) * 255},${Math.min(ink[at + 1] * k, 1) * 255},${Math.min(ink[at + 2] * k, 1) * 255})`;
  return {
    calls: () => 0,
    setScene: (scene) => {
      nearest = unpackBuildings(scene.buildings).slice(0, FLAT_BUILDINGS).map(({ height, rings }) => {
        const ring = orderedRing(rings[0], 1);
        return { height, ring, mid: [ring[0], ring[1]] };
      });
    },
    draw: (frame, camera) => {
      const fitted = fitCanvas(canvas, 1);
      if (!fitted) return true;
      const { context, width, height } = fitted;
      const stroke = (/** @type {ArrayLike<number>} */ from, /** @type {ArrayLike<number>} */ to) => {
        if (!camera.project(from[0], from[1], from[2], a) || !camera.project(to[0], to[1], to[2], b)) return;
        context.beginPath();
        context.moveTo(a[0], a[1]);
        context.lineTo(b[0], b[1]);
        context.stroke();
      };
      context.fillStyle = theme.ground;
      context.fillRect(0, 0, width, height);
      const step = roundStep(camera.distance * 0.18), east = Math.round(camera.target[0] / step) * step, north = Math.round(camera.target[1] / step) * step;
      context.strokeStyle = theme.grid;
      context.globalAlpha = 0.35;
      for (let i = -12; i <= 12; i++) {
        stroke([east + i * step, north - 12 * step, 0], [east + i * step, north + 12 * step, 0]);
        stroke([east - 12 * step, north + i * step, 0], [east + 12 * step, north + i * step, 0]);
      }
      context.globalAlpha = 1;
      if (store.view.layers.buildings) drawBuildings(context, camera);
      drawTrails(context, frame, stroke);
      for (let i = 0, { data } = frame.lines; i < frame.lines.size; i++) {
        const at = i * LINE_FLOATS;
        context.strokeStyle = css(data, at + 8);
        context.globalAlpha = data[at + 11];
        context.lineWidth = data[at + 3];
        context.setLineDash(data[at + 7] ? [data[at + 7], data[at + 7] * 0.7] : []);
        stroke(data.subarray(at, at + 3), data.subarray(at + 4, at + 7));
      }
      context.setLineDash([]);
      for (let slot = 0, { bodies } = frame; slot < frame.slots; slot++) {
        const at = slot * BODY_FLOATS, alpha = bodies[at + 7], size = bodies[at + 9] / camera.metre, heading = bodies[at + 3];
        if (alpha <= 0 || !camera.project(bodies[at], bodies[at + 1], bodies[at + 2], a)) continue;
        context.globalAlpha = alpha;
        context.fillStyle = css(bodies, at + 4);
        context.beginPath();
        for (const [turn, away] of [[0, 1.2], [2.5, 0.9], [Math.PI, 0.3], [-2.5, 0.9]])
          if (camera.project(bodies[at] + Math.sin(heading + turn) * away * size, bodies[at + 1] + Math.cos(heading + turn) * away * size, bodies[at + 2], b)) context.lineTo(b[0], b[1]);
        if (bodies[at + 10] > 0) {
          context.strokeStyle = context.fillStyle;
          context.setLineDash([3, 2]);
          context.stroke();
          context.setLineDash([]);
        } else context.fill();
      }
      for (let i = 0, { data } = frame.symbols; i < frame.symbols.size; i++) {
        const at = i * SYMBOL_FLOATS;
        if (!camera.project(data[at], data[at + 1], data[at + 2], a)) continue;
        context.globalAlpha = data[at + 7];
        context.fillStyle = context.strokeStyle = css(data, at + 4);
        context.lineWidth = 1.4;
        context.beginPath();
        context.arc(a[0], a[1], data[at + 3], 0, 7);
        if (data[at + 8] === SYMBOL.ring || data[at + 8] === SYMBOL.dashed) context.stroke();
        else context.fill();
      }
      context.globalAlpha = 1;
      return true;
    },
  };

  /** @param {CanvasRenderingContext2D} context @param {Frame} frame @param {(from: ArrayLike<number>, to: ArrayLike<number>) => void} stroke */
  function drawTrails(context, frame, stroke) {
    const { time, layers, arms } = store.view, vehicles = store.scene?.vehicles.length ?? 0;
    context.lineWidth = 1.6;
    trails.forEach((set, arm) => {
      if (!layers.trails || !arms[arm]) return;
      if (set.stale) set.rebuild(store.arms[arm].tracks.truth);
      const [first, until] = set.window(time), { data } = set;
      for (let i = Math.max(first, until - FLAT_TRAILS); i < until; i++) {
        const at = i * 8, vehicle = Math.floor(data[at + 7]), end = data[at + 3] + (data[at + 7] - vehicle) * 8, slot = (arm * vehicles + vehicle) * BODY_FLOATS, alpha = frame.bodies[slot + 8];
        if (!alpha || data[at + 3] >= time || end < time - TRAIL_S) continue;
        context.globalAlpha = alpha * Math.max(1 - (time - end) / TRAIL_S, 0);
        context.strokeStyle = css(frame.bodies, slot + 4);
        const part = Math.min((time - data[at + 3]) / (end - data[at + 3]), 1);
        stroke(data.subarray(at, at + 3), [0, 1, 2].map((axis) => data[at + axis] + (data[at + 4 + axis] - data[at + axis]) * part));
      }
    });
    context.globalAlpha = 1;
  }

  /** @param {CanvasRenderingContext2D} context @param {Camera} camera */
  function drawBuildings(context, camera) {
    const away = (/** @type {{mid: number[]}} */ one) => -((one.mid[0] - camera.eye[0]) ** 2 + (one.mid[1] - camera.eye[1]) ** 2), wall = rgb(theme.wall);
    context.strokeStyle = theme.edge;
    context.lineWidth = 0.5;
    for (const { height, ring } of nearest.sort((p, q) => away(p) - away(q))) {
      for (let i = 0; i < ring.length; i += 2) {
        const k = (i + 2) % ring.length, p = [ring[i], ring[i + 1]], q = [ring[k], ring[k + 1]];
        if ((q[1] - p[1]) * (camera.eye[0] - p[0]) - (q[0] - p[0]) * (camera.eye[1] - p[1]) > 0)
          fill(context, camera, [[...p, 0], [...q, 0], [...q, height], [...p, height]], css(wall, 0, wallLight(q[0] - p[0], q[1] - p[1])));
      }
      if (camera.eye[2] > height) {
        const roof = [];
        for (let i = 0; i < ring.length; i += 2) roof.push([ring[i], ring[i + 1], height]);
        if (fill(context, camera, roof, theme.roof)) context.stroke();
      }
    }
  }

  /** @param {CanvasRenderingContext2D} context @param {Camera} camera @param {number[][]} corners @param {string} colour */
  function fill(context, camera, corners, colour) {
    context.beginPath();
    for (const [e, n, u] of corners) {
      if (!camera.project(e, n, u, a)) return false;
      context.lineTo(a[0], a[1]);
    }
    context.closePath();
    context.fillStyle = colour;
    context.fill();
    return true;
  }
};
