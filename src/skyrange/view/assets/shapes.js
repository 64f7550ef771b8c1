// Shapes of aircraft and of the ground, as triangles.
/** @typedef {number[]} Mesh right, forward, up and tone of each corner; a tone of 2 is the nose */

/** @param {Mesh} out @param {number} tone @param {number[][]} corners a convex face */
const face = (out, tone, ...corners) => {
  for (let i = 2; i < corners.length; i++) for (const k of [corners[0], corners[i - 1], corners[i]]) out.push(k[0], k[1], k[2], tone);
};

/** @param {Mesh} out @param {number[]} low @param {number[]} high */
const box = (out, [x, y, z], [X, Y, Z]) => {
  face(out, 1, [x, y, Z], [X, y, Z], [X, Y, Z], [x, Y, Z]);
  face(out, 0.72, [x, y, z], [X, y, z], [X, y, Z], [x, y, Z]);
  face(out, 0.72, [X, Y, z], [x, Y, z], [x, Y, Z], [X, Y, Z]);
  face(out, 0.82, [X, y, z], [X, Y, z], [X, Y, Z], [X, y, Z]);
  face(out, 0.82, [x, Y, z], [x, y, z], [x, y, Z], [x, Y, Z]);
};

/** Four arms with rotors, a body and a nose, within a radius of 1. @returns {Mesh} */
export const multirotor = () => {
  /** @type {Mesh} */
  const out = [];
  for (const [sx, sy] of [[1, 1], [-1, 1], [-1, -1], [1, -1]]) {
    const x = 0.66 * sx, y = 0.66 * sy, w = 0.08;
    face(out, 0.85, [-w * sy, w * sx, 0.1], [w * sy, -w * sx, 0.1], [x + w * sy, y - w * sx, 0.14], [x - w * sy, y + w * sx, 0.14]);
    const disc = [0, 1, 2, 3, 4, 5, 6, 7].map((k) => [x + 0.34 * Math.cos((k * Math.PI) / 4), y + 0.34 * Math.sin((k * Math.PI) / 4), 0.2]);
    face(out, 1, ...disc);
  }
  box(out, [-0.24, -0.36, -0.1], [0.24, 0.36, 0.24]);
  face(out, 2, [-0.24, 0.36, 0.24], [0.24, 0.36, 0.24], [0, 0.92, 0.1]);
  face(out, 2, [0.24, 0.36, 0.24], [0.24, 0.36, -0.1], [0, 0.92, 0.1]);
  face(out, 2, [-0.24, 0.36, -0.1], [-0.24, 0.36, 0.24], [0, 0.92, 0.1]);
  return out;
};

/** A multirotor of few triangles, for many that are small. @returns {Mesh} */
export const smallMultirotor = () => {
  /** @type {Mesh} */
  const out = [];
  for (const [sx, sy] of [[1, 1], [-1, 1], [-1, -1], [1, -1]]) {
    const x = 0.72 * sx, y = 0.72 * sy, w = 0.27;
    face(out, 0.9, [0, 0, 0.2], [x + w * sy, y - w * sx, 0.15], [x - w * sy, y + w * sx, 0.15]);
  }
  face(out, 1, [-0.3, -0.42, 0.3], [0.3, -0.42, 0.3], [0.3, 0.3, 0.3], [-0.3, 0.3, 0.3]);
  face(out, 2, [-0.3, 0.3, 0.3], [0.3, 0.3, 0.3], [0, 1.15, 0.25]);
  return out;
};

/** A fixed wing. @returns {Mesh} */
export const fixedWing = () => {
  /** @type {Mesh} */
  const out = [];
  face(out, 1, [-1.1, 0.05, 0.1], [0, 0.3, 0.14], [0, -0.12, 0.14], [-1.1, -0.15, 0.1]);
  face(out, 0.9, [1.1, 0.05, 0.1], [1.1, -0.15, 0.1], [0, -0.12, 0.14], [0, 0.3, 0.14]);
  face(out, 0.95, [-0.42, -0.8, 0.12], [0, -0.66, 0.12], [0.42, -0.8, 0.12], [0.42, -0.94, 0.12], [-0.42, -0.94, 0.12]);
  box(out, [-0.12, -0.9, -0.04], [0.12, 0.6, 0.2]);
  face(out, 2, [-0.12, 0.6, 0.2], [0.12, 0.6, 0.2], [0, 1.05, 0.08]);
  face(out, 0.8, [0, -0.9, 0.2], [0, -0.6, 0.2], [0, -0.88, 0.55]);
  return out;
};

/** The ground as a disc around the middle; the third number is how much of it is haze. */
export const groundDisc = () => {
  const out = [], rings = [0, 0.35, 1], parts = 40;
  for (let ring = 1; ring < rings.length; ring++)
    for (let k = 0; k < parts; k++) {
      const at = (/** @type {number} */ r, /** @type {number} */ i) => [rings[r] * Math.cos((i * 2 * Math.PI) / parts), rings[r] * Math.sin((i * 2 * Math.PI) / parts), r === 2 ? 1 : 0];
      for (const corner of [at(ring - 1, k), at(ring, k), at(ring, k + 1), at(ring - 1, k), at(ring, k + 1), at(ring - 1, k + 1)]) out.push(...corner);
    }
  return new Float32Array(out);
};

/** Lines of a grid in whole steps, in short pieces. @param {number} count lines to each side */
export const gridLines = (count) => {
  const out = [];
  for (let line = -count; line <= count; line++) for (let k = -count; k < count; k += 5) out.push(line, k, line, k + 5, k, line, k + 5, line);
  return new Float32Array(out);
};
