// Encounters of one aircraft in one arm: other aircraft that come near, and its mishaps.
/** @import { Store } from "./store.js" */
/** Metres between two aircraft, centre to centre, below which they have a near miss; as in the tables of reports. */
const NEAR_M = 10;
const ALOFT_M = 1;
const COARSE_S = 1;
const FINE_S = 0.2;
const FASTEST_MPS = 60;
const MAX_SEARCHED = 300;

/** @typedef {{arm: number, time: number, title: string, violent: boolean}} Encounter */

/** Whether near misses are searched for, which takes long among many. @param {Store} store */
export const searchesNear = (store) => (store.scene?.vehicles.length ?? 0) <= MAX_SEARCHED;

/** Times at which another aircraft comes nearer than `NEAR_M` while both are in the air. @param {Store} store @param {number} arm @param {number} vehicle @returns {Encounter[]} */
export const findNearMisses = (store, arm, vehicle) => {
  const found = [], { start, end } = store.span(), mine = store.arms[arm].tracks.truth[vehicle], a = [0, 0, 0, 0], b = [0, 0, 0, 0];
  if (!searchesNear(store)) return [];
  for (const [other, track] of store.arms[arm].tracks.truth.entries()) {
    if (other === vehicle) continue;
    const away = (/** @type {number} */ time) => (mine.at(time, a) && track.at(time, b) && a[2] > ALOFT_M && b[2] > ALOFT_M ? Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]) : Infinity);
    let near = false;
    for (let time = start; time <= end; ) {
      const now = away(time);
      if (now < NEAR_M && !near) found.push({ arm, time, title: `near ${store.nodeName(other)}, ${now.toFixed(0)} m`, violent: false });
      near = now < NEAR_M;
      time += now < NEAR_M + FASTEST_MPS * COARSE_S || now === Infinity ? FINE_S : COARSE_S;
    }
  }
  return found;
};

/** Mishaps of an aircraft, whose texts begin with its id. @param {Store} store @param {number} arm @param {number} vehicle @returns {Encounter[]} */
export const findMishaps = (store, arm, vehicle) => {
  const { mishaps } = store.arms[arm].events, id = store.nodeName(vehicle), /** @type {Encounter[]} */ found = [];
  for (let row = 0; row < mishaps.size; row++) {
    const text = mishaps.text("text", row), kind = mishaps.text("kind", row);
    if (text.startsWith(id + ":") || text.startsWith(id + ".")) found.push({ arm, time: mishaps.number("t", row), title: kind, violent: /collision|crash/.test(kind) });
  }
  return found;
};
