// Solids from building outlines: roofs triangulated by ear clipping (holes joined to the outline), walls as quads.
const area2 = (ring) => {
  let sum = 0;
  for (let i = 0, j = ring.length - 1; i < ring.length; j = i++) sum += ring[j][0] * ring[i][1] - ring[i][0] * ring[j][1];
  return sum;
};
const cross = (a, b, c) => (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
const wound = (ring, sign) => (Math.sign(area2(ring)) === sign ? ring : [...ring].reverse());

const bridged = (rings) => {
  let outer = wound(rings[0], 1);
  for (const hole of rings.slice(1).map((ring) => wound(ring, -1))) {
    let best = [Infinity, 0, 0];
    for (let i = 0; i < outer.length; i++)
      for (let k = 0; k < hole.length; k++) {
        const far = (outer[i][0] - hole[k][0]) ** 2 + (outer[i][1] - hole[k][1]) ** 2;
        if (far < best[0]) best = [far, i, k];
      }
    const [, i, k] = best;
    outer = [...outer.slice(0, i + 1), ...hole.slice(k), ...hole.slice(0, k + 1), ...outer.slice(i)];
  }
  return outer;
};
const triangles = (rings) => {
  const points = bridged(rings), left = points.map((_, i) => i), out = [];
  const inside = (p, a, b, c) => cross(a, b, p) >= 0 && cross(b, c, p) >= 0 && cross(c, a, p) >= 0;
  const same = (p, q) => p[0] === q[0] && p[1] === q[1];
  let stuck = 0;
  for (let i = 0; left.length > 3 && stuck <= left.length; ) {
    const n = left.length, [a, b, c] = [left[(i + n - 1) % n], left[i % n], left[(i + 1) % n]].map((k) => points[k]);
    const ear = cross(a, b, c) > 0 && !left.some((k) => {
      const p = points[k];
      return !same(p, a) && !same(p, b) && !same(p, c) && inside(p, a, b, c);
    });
    if (ear || cross(a, b, c) === 0) {
      if (ear) out.push(a, b, c);
      left.splice(i % n, 1);
      stuck = 0;
    } else {
      i++;
      stuck++;
    }
    if (left.length) i %= left.length;
  }
  if (left.length === 3) out.push(...left.map((k) => points[k]));
  return out;
};

// Light comes from the south-west and above; a wall is the brighter the more it faces it.
const wallLight = (a, b) => {
  const dx = b[0] - a[0], dy = b[1] - a[1], long = Math.hypot(dx, dy) || 1;
  return 0.72 + 0.17 * ((dy / long) * -0.55 + (-dx / long) * -0.83);
};
// Interleaved x, y, z, light, kind (0 wall, 1 roof) for triangles, and x, y, z for edges.
const cityMesh = (buildings) => {
  const solid = [], edges = [];
  for (const { h, rings } of buildings) {
    for (const p of triangles(rings)) solid.push(p[0], p[1], h, 1, 1);
    rings.forEach((raw, nth) => {
      const ring = wound(raw, nth ? -1 : 1);
      ring.forEach((a, i) => {
        const b = ring[(i + 1) % ring.length], light = wallLight(a, b);
        for (const [p, z] of [[a, 0], [b, 0], [b, h], [a, 0], [b, h], [a, h]]) solid.push(p[0], p[1], z, light, 0);
        edges.push(a[0], a[1], h, b[0], b[1], h, a[0], a[1], 0, a[0], a[1], h);
      });
    });
  }
  return { solid: new Float32Array(solid), edges: new Float32Array(edges) };
};
