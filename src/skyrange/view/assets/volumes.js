// Faces and edges of claimed and closed airspace, each corner with the time that it is shown and the aircraft that claims it.
import { fillRings, orderedRing } from "./triangles.js";
/** @import { Scene } from "./scene.js" */
const MAX_CORNERS_OF_VOLUME = 400;

/** @param {Scene} scene @returns {{faces: Float32Array, edges: Float32Array}} east, north, up, from, until and slot (-1 where it is closed to all) */
export const volumeMeshes = (scene) => {
  /** @type {number[]} */
  const faces = [], /** @type {number[]} */ edges = [];
  for (const { arm, vehicle, from_s, until_s, lower_m, upper_m, ring: corners } of scene.volumes) {
    const ring = orderedRing(corners.slice(0, MAX_CORNERS_OF_VOLUME).flatMap(([e, n]) => [e, n]), 1), slot = vehicle === null ? -1 : arm * scene.vehicles.length + vehicle;
    const put = (/** @type {number[]} */ into, /** @type {number} */ e, /** @type {number} */ n, /** @type {number} */ u) => into.push(e, n, u, Math.max(from_s, -1e6), Math.min(until_s, 1e9), slot);
    const top = fillRings([ring]);
    for (let i = 0; i < top.length; i += 2) put(faces, top[i], top[i + 1], upper_m);
    for (let i = 0; i < ring.length; i += 2) {
      const k = (i + 2) % ring.length, ae = ring[i], an = ring[i + 1], be = ring[k], bn = ring[k + 1];
      for (const [e, n, u] of [[ae, an, lower_m], [be, bn, lower_m], [be, bn, upper_m], [ae, an, lower_m], [be, bn, upper_m], [ae, an, upper_m]]) put(faces, e, n, u);
      for (const [e, n, u] of [[ae, an, upper_m], [be, bn, upper_m], [ae, an, lower_m], [be, bn, lower_m]]) put(edges, e, n, u);
      if (ring.length <= 16) for (const u of [lower_m, upper_m]) put(edges, ae, an, u);
    }
  }
  return { faces: new Float32Array(faces), edges: new Float32Array(edges) };
};
