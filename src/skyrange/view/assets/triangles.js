// Triangles of outlines with holes, by clipping ears; only corners that bend inwards can lie in an ear.
/** Twice the area of a ring of pairs, positive where it runs counter-clockwise. @param {ArrayLike<number>} ring */
export const ringArea = (ring) => {
  let sum = 0;
  for (let i = 0, j = ring.length - 2; i < ring.length; j = i, i += 2) sum += ring[j] * ring[i + 1] - ring[i] * ring[j + 1];
  return sum;
};

/** A ring that runs counter-clockwise (1) or clockwise (-1). @param {number[]} ring @param {1 | -1} sign */
export const orderedRing = (ring, sign) => {
  if (Math.sign(ringArea(ring)) !== -sign) return ring;
  const turned = [];
  for (let i = ring.length - 2; i >= 0; i -= 2) turned.push(ring[i], ring[i + 1]);
  return turned;
};

/** One ring from an outline and its holes, each joined where it is nearest. @param {number[][]} rings */
const joinHoles = (rings) => {
  let outer = orderedRing(rings[0], 1);
  for (const raw of rings.slice(1)) {
    const hole = orderedRing(raw, -1);
    let nearest = Infinity, from = 0, into = 0;
    for (let i = 0; i < outer.length; i += 2)
      for (let k = 0; k < hole.length; k += 2) {
        const away = (outer[i] - hole[k]) ** 2 + (outer[i + 1] - hole[k + 1]) ** 2;
        if (away < nearest) [nearest, from, into] = [away, i, k];
      }
    outer = [...outer.slice(0, from + 2), ...hole.slice(into), ...hole.slice(0, into + 2), ...outer.slice(from)];
  }
  return outer;
};

/** East and north of the corners of triangles that fill an outline with holes. @param {number[][]} rings @returns {number[]} */
export const fillRings = (rings) => {
  const p = rings.length > 1 ? joinHoles(rings) : orderedRing(rings[0], 1), count = p.length / 2;
  const out = [], next = new Int32Array(count), before = new Int32Array(count), inward = new Uint8Array(count);
  const cross = (/** @type {number} */ a, /** @type {number} */ b, /** @type {number} */ c) =>
    (p[b * 2] - p[a * 2]) * (p[c * 2 + 1] - p[a * 2 + 1]) - (p[b * 2 + 1] - p[a * 2 + 1]) * (p[c * 2] - p[a * 2]);
  const same = (/** @type {number} */ a, /** @type {number} */ b) => p[a * 2] === p[b * 2] && p[a * 2 + 1] === p[b * 2 + 1];
  for (let i = 0; i < count; i++) {
    next[i] = (i + 1) % count;
    before[i] = (i + count - 1) % count;
  }
  for (let i = 0; i < count; i++) inward[i] = cross(before[i], i, next[i]) <= 0 ? 1 : 0;
  const isEar = (/** @type {number} */ a, /** @type {number} */ b, /** @type {number} */ c) => {
    for (let k = next[c]; k !== a; k = next[k])
      if (inward[k] && !same(k, a) && !same(k, b) && !same(k, c) && cross(a, b, k) >= 0 && cross(b, c, k) >= 0 && cross(c, a, k) >= 0) return false;
    return true;
  };
  let at = 0;
  for (let left = count, stuck = 0; left > 2 && stuck <= left; ) {
    const a = before[at], c = next[at], bend = cross(a, at, c), ear = bend > 0 && (left === 3 || isEar(a, at, c));
    if (!ear && bend !== 0) {
      at = c;
      stuck++;
      continue;
    }
    if (ear) for (const k of [a, at, c]) out.push(p[k * 2], p[k * 2 + 1]);
    next[a] = c;
    before[c] = a;
    left--;
    stuck = 0;
    inward[a] = cross(before[a], a, c) <= 0 ? 1 : 0;
    inward[c] = cross(a, c, next[c]) <= 0 ? 1 : 0;
    at = c;
  }
  return out;
};
