// What is claimed and heard by radio: lies, receptions, and what a receiver hears.
/** @import { EventTable } from "./events.js" */
/** @import { Store } from "./store.js" */
const LIE_METRES = 15;
const OLDEST_S = 3;
const STEP_S = 0.2;
const CLAIM_S = 3;
const FLASH_S = 0.4;
const HEARD_S = 10;
const MAX_FLASHES = 800;
const MAX_SCANNED = 40_000;

/** @typedef {{arm: number, node: number, uas: string, at: number[], heading: number, age: number, hostile: boolean}} Lie */
/** @typedef {{receiver: number, node: number, age: number, rssi: number}} Reception */

/** Per table of claims, what is known of each row: 0 nothing, 1 true, 2 a lie. @type {WeakMap<EventTable, {shuffles: number, kinds: Uint8Array}>} */
const judged = new WeakMap();
const here = [0, 0, 0, 0];

/** How far a place is from the straight line between two others. @param {number[]} at @param {number[]} a @param {number[]} b */
const distanceToLine = (at, a, b) => {
  let along = 0, length = 0;
  for (let axis = 0; axis < 3; axis++) {
    along += (at[axis] - a[axis]) * (b[axis] - a[axis]);
    length += (b[axis] - a[axis]) ** 2;
  }
  const part = length > 0 ? Math.min(Math.max(along / length, 0), 1) : 0;
  return Math.hypot(...[0, 1, 2].map((axis) => a[axis] + (b[axis] - a[axis]) * part - at[axis]));
};

/**
 * How far a claimed place is from where its sender was at any time of the seconds before it was decoded: a claim is as old as the message that it was made from.
 * Null where that is not known yet; `whole` says whether all of these seconds are.
 * @param {Store} store @param {number} arm @param {number} node @param {number} time @param {number[]} at @returns {{away: number, whole: boolean} | null}
 */
const claimError = (store, arm, node, time, at) => {
  const track = node < (store.scene?.vehicles.length ?? 0) ? store.arms[arm].tracks.truth[node] : null;
  if ((track && track.until < time - 1e-6) || !store.nodePlace(arm, node, time, here)) return null;
  let after = here.slice(0, 3), away = distanceToLine(at, after, after), whole = true;
  for (let ago = STEP_S; ago < OLDEST_S + 1e-6; ago += STEP_S) {
    whole = store.nodePlace(arm, node, time - ago, here);
    if (!whole) break;
    away = Math.min(away, distanceToLine(at, here, after));
    after = here.slice(0, 3);
  }
  return { away, whole };
};

/** @param {Store} store @param {number} arm @param {number} row */
const isLie = (store, arm, row) => {
  const { claims } = store.arms[arm].events;
  let memory = judged.get(claims);
  if (!memory || memory.shuffles !== claims.shuffles || memory.kinds.length < claims.size) {
    const kinds = new Uint8Array(Math.max(64, claims.size * 2));
    if (memory && memory.shuffles === claims.shuffles) kinds.set(memory.kinds);
    judged.set(claims, (memory = { shuffles: claims.shuffles, kinds }));
  }
  if (memory.kinds[row]) return memory.kinds[row] === 2;
  const node = claims.number("node", row);
  if (store.isHostile(node)) return (memory.kinds[row] = 2) === 2;
  const error = claimError(store, arm, node, claims.number("t", row), ["e", "n", "u"].map((name) => claims.number(name, row)));
  if (!error) return false;
  const lie = error.away > LIE_METRES;
  if (!lie || error.whole) memory.kinds[row] = lie ? 2 : 1;      // what came before may still be read
  return lie;
};

/** The lies of the last seconds, the newest of each sender and claimed id. @param {Store} store @param {number} arm @param {number} time @returns {Lie[]} */
export const findLies = (store, arm, time) => {
  const { claims } = store.arms[arm].events, until = claims.until(time), found = [];
  /** @type {Set<string>} */
  const seen = new Set();
  const first = claims.until(time - CLAIM_S);
  for (let row = until - 1; row >= first; row--) {
    if (!isLie(store, arm, row)) continue;
    const node = claims.number("node", row), uas = claims.text("uas", row), key = node + " " + uas;
    if (seen.has(key)) continue;
    seen.add(key);
    const at = [claims.number("e", row), claims.number("n", row), claims.number("u", row)];
    found.push({ arm, node, uas, at, heading: headingOfClaim(claims, row, node), age: time - claims.number("t", row), hostile: store.isHostile(node) });
  }
  return found;
};

/** From the claim before, radians clockwise from north. @param {EventTable} claims @param {number} row @param {number} node */
const headingOfClaim = (claims, row, node) => {
  for (let k = row - 1; k >= 0 && claims.number("t", k) > claims.number("t", row) - 4; k--) {
    if (claims.number("node", k) !== node || claims.number("uas", k) !== claims.number("uas", row)) continue;
    const east = claims.number("e", row) - claims.number("e", k), north = claims.number("n", row) - claims.number("n", k);
    return Math.hypot(east, north) > 0.2 ? Math.atan2(east, north) : 0;
  }
  return 0;
};

/** What was received just now, the newest first. @param {Store} store @param {number} arm @param {number} time @returns {Reception[]} */
export const findFlashes = (store, arm, time) => {
  const { receptions } = store.arms[arm].events, until = receptions.until(time), first = Math.max(receptions.until(time - FLASH_S), until - MAX_FLASHES), found = [];
  for (let row = until - 1; row >= first; row--) {
    found.push({ receiver: receptions.number("receiver", row), node: receptions.number("node", row), age: (time - receptions.number("t", row)) / FLASH_S, rssi: receptions.number("rssi", row) });
  }
  return found;
};

/** Whom a receiver heard lately: the newest reception of each node, the strongest first. @param {Store} store @param {number} arm @param {number} receiver @param {number} time @returns {Reception[]} */
export const findHeard = (store, arm, receiver, time) => {
  const { receptions } = store.arms[arm].events, last = receptions.until(time), first = Math.max(receptions.until(time - HEARD_S), last - MAX_SCANNED);
  /** @type {Map<number, Reception>} */
  const found = new Map();
  for (let row = last - 1; row >= first; row--) {
    const node = receptions.number("node", row);
    if (receptions.number("receiver", row) === receiver && !found.has(node)) found.set(node, { receiver, node, age: time - receptions.number("t", row), rssi: receptions.number("rssi", row) });
  }
  return [...found.values()].sort((a, b) => b.rssi - a.rssi);
};
