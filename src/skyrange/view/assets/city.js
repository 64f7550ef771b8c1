// Solids of a city: roofs and walls as triangles, and their edges as lines.
import { fillRings, orderedRing } from "./triangles.js";
/** @import { Buildings } from "./scene.js" */
const MAX_HOLE_CORNERS = 4000;

/** @typedef {{height: number, rings: number[][]}} Building outlines in metres, pairs of east and north; the first ring is the outer one */
/** @typedef {{solid: Float32Array, edges: Float32Array}} CityMesh solid: east, north, up, light and kind (0 wall, 1 roof); edges: east, north, up */

/** @param {Buildings} buildings @returns {Building[]} */
export const unpackBuildings = ({ heights, rings, corners, outlines }) => {
  const found = [];
  for (let building = 0, ring = 0, at = 0; building < heights.length; building++) {
    const mine = [];
    for (let k = 0; k < rings[building]; k++, ring++) {
      const flat = [];
      for (let corner = 0, east = 0, north = 0; corner < corners[ring]; corner++) flat.push((east += outlines[at++]) / 10, (north += outlines[at++]) / 10);
      if (flat.length >= 6) mine.push(flat);
    }
    if (mine.length && mine.reduce((sum, one) => sum + one.length, 0) < MAX_HOLE_CORNERS * 2) found.push({ height: heights[building] / 10, rings: mine });
  }
  return found;
};

/** Light comes from the south-west: a wall is the brighter the more it faces it. @param {number} east @param {number} north of the wall's edge */
export const wallLight = (east, north) => 0.87 + (0.15 * (north * -0.55 + -east * -0.83)) / (Math.hypot(east, north) || 1);

/** @param {Building[]} buildings @returns {CityMesh} */
export const buildCity = (buildings) => {
  const solid = [], edges = [];
  for (const { height, rings } of buildings) {
    const roof = fillRings(rings);
    for (let i = 0; i < roof.length; i += 2) solid.push(roof[i], roof[i + 1], height, 1, 1);
    for (let nth = 0; nth < rings.length; nth++) {
      const ring = orderedRing(rings[nth], nth ? -1 : 1);
      for (let i = 0; i < ring.length; i += 2) {
        const k = (i + 2) % ring.length, ae = ring[i], an = ring[i + 1], be = ring[k], bn = ring[k + 1], light = wallLight(be - ae, bn - an);
        solid.push(ae, an, 0, light, 0, be, bn, 0, light, 0, be, bn, height, light, 0, ae, an, 0, light, 0, be, bn, height, light, 0, ae, an, height, light, 0);
        const h = (i + ring.length - 2) % ring.length, was = Math.atan2(an - ring[h + 1], ae - ring[h]), is = Math.atan2(bn - an, be - ae);
        edges.push(ae, an, height, be, bn, height);
        if (Math.abs(Math.sin((is - was) / 2)) > 0.2) edges.push(ae, an, 0, ae, an, height);
      }
    }
  }
  return { solid: new Float32Array(solid), edges: new Float32Array(edges) };
};
