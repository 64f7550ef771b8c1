// Tracks of aircraft: places at times, in typed arrays that grow by doubling.
/** @import { NumberArray } from "./stream.js" */
const HOLD_S = 2;
const BRIDGE_S = 10;
const TURN_RADIANS = Math.PI / 128;

const HEARD_APART_S = 0.09;
const OLD_TENTHS = 255;

/** @typedef {{from: number, step: number, samples: number, places: Float32Array, turns: Uint8Array | null, ages: ArrayLike<number> | null, row: number}} TrackBlock */

/** Where one aircraft is in one layer. In a held layer it stays where it was between two samples. */
export class Track {
  /** @param {boolean} held */
  constructor(held) {
    this.held = held;
    this.size = 0;
    this.until = -Infinity;
    this.t = new Float64Array(8);
    this.xyz = new Float32Array(24);
    this.turn = new Uint8Array(8);
    this.cursor = 0;
    /** When positions were heard, in order of time. @type {number[]} */
    this.heard = [];
  }

  /** @param {number} size */
  grow(size) {
    const room = Math.max(size, this.t.length * 2);
    for (const name of /** @type {const} */ (["t", "xyz", "turn"])) {
      const old = this[name], made = new /** @type {any} */ (old.constructor)(name === "xyz" ? room * 3 : room);
      made.set(old);
      /** @type {any} */ (this)[name] = made;
    }
  }

  /** @param {number} i @param {number} j */
  same(i, j) {
    const { xyz } = this;
    return Object.is(xyz[i * 3], xyz[j * 3]) && Object.is(xyz[i * 3 + 1], xyz[j * 3 + 1]) && Object.is(xyz[i * 3 + 2], xyz[j * 3 + 2]) && this.turn[i] === this.turn[j];
  }

  /** Add a later sample; samples that say nothing new are left out. @param {number} t @param {number} e @param {number} n @param {number} u @param {number} turn */
  append(t, e, n, u, turn) {
    if (this.size === this.t.length) this.grow(this.size + 1);
    const i = this.size;
    this.t[i] = t;
    this.xyz[i * 3] = e;
    this.xyz[i * 3 + 1] = n;
    this.xyz[i * 3 + 2] = u;
    this.turn[i] = turn;
    this.until = t;
    if (i > 0 && this.same(i, i - 1)) {
      if (this.held) return;
      if (i > 1 && this.same(i, i - 2)) {
        this.t[i - 1] = t;
        return;
      }
    }
    this.size++;
  }

  /** @param {TrackBlock} block */
  add(block) {
    if (block.from >= this.until - 1e-6) this.extend(block);
    else this.merge(block);
  }

  /** @param {TrackBlock} block */
  extend({ from, step, samples, places, turns, ages, row }) {
    const east = row * 3 * samples, north = east + samples, up = north + samples;
    for (let k = 0; k < samples; k++) {
      const t = from + k * step, age = ages ? ages[row * samples + k] : OLD_TENTHS;
      if (age < OLD_TENTHS && !Number.isNaN(places[east + k])) this.hear(t - age / 10);
      if (t > this.until + 1e-6) this.append(t, places[east + k], places[north + k], places[up + k], turns ? turns[row * samples + k] : 0);
    }
  }

  /** @param {number} t */
  hear(t) {
    const { heard } = this;
    let i = heard.length;
    while (i && heard[i - 1] > t + HEARD_APART_S) i--;
    if (!i || heard[i - 1] < t - HEARD_APART_S) heard.splice(i, 0, t);
  }

  /** When a position was last heard, NaN if it never was. @param {number} time */
  lastHeard(time) {
    const { heard } = this;
    let low = 0;
    for (let high = heard.length; low < high; ) {
      const middle = (low + high) >> 1;
      if (heard[middle] <= time + 1e-6) low = middle + 1;
      else high = middle;
    }
    return low ? heard[low - 1] : NaN;
  }

  /** Put a block between samples that came before it. @param {TrackBlock} block */
  merge(block) {
    const { size, until } = this, end = block.from + (block.samples - 1) * block.step;
    let first = size;
    while (first && this.t[first - 1] >= block.from - 1e-6) first--;
    const t = this.t.slice(first, size), xyz = this.xyz.slice(first * 3, size * 3), turn = this.turn.slice(first, size);
    this.size = first;
    this.cursor = 0;
    this.until = -Infinity;
    this.extend(block);
    for (let i = 0; i < t.length; i++) if (t[i] > end + 1e-6) this.append(t[i], xyz[i * 3], xyz[i * 3 + 1], xyz[i * 3 + 2], turn[i]);
    this.until = Math.max(this.until, until);
  }

  /** The newest sample up to a time, or -1. @param {number} time */
  find(time) {
    const { t, size } = this;
    let low = Math.min(this.cursor, size - 1);
    if (size === 0 || t[0] > time) return -1;
    if (t[low] <= time && (low + 1 >= size || t[low + 1] > time)) return low;
    if (t[low] <= time && (low + 2 >= size || t[low + 2] > time)) return (this.cursor = low + 1);
    low = 0;
    for (let high = size; high - low > 1; ) {
      const middle = (low + high) >> 1;
      if (t[middle] <= time) low = middle;
      else high = middle;
    }
    return (this.cursor = low);
  }

  /**
   * East, north and up in metres and the heading in radians at a time; false where there is no place.
   * @param {number} time @param {Float32Array | number[]} out @param {number} [at]
   */
  at(time, out, at = 0) {
    const { t, xyz, turn, size } = this, i = this.find(time + 1e-6);
    if (i < 0 || Number.isNaN(xyz[i * 3]) || time > this.until + HOLD_S) return false;
    const k = i * 3, next = i + 1 < size && !this.held && !Number.isNaN(xyz[k + 3]) ? t[i + 1] - t[i] : 0;
    if (next > BRIDGE_S && !this.same(i, i + 1)) return false;
    const part = next > 0 ? Math.min(Math.max((time - t[i]) / next, 0), 1) : 0;
    for (let axis = 0; axis < 3; axis++) out[at + axis] = part ? xyz[k + axis] + (xyz[k + 3 + axis] - xyz[k + axis]) * part : xyz[k + axis];
    out[at + 3] = (turn[i] + (part ? (((turn[i + 1] - turn[i] + 384) & 255) - 128) * part : 0)) * TURN_RADIANS;
    return true;
  }

  /** Metres a second at a time, over the ground and upwards; null where there is no place. @param {number} time */
  velocity(time) {
    const before = [0, 0, 0, 0], after = [0, 0, 0, 0], half = 0.5;
    const from = this.at(time - half, before) ? time - half : this.at(time, before) ? time : NaN;
    const until = this.at(Math.min(time + half, this.until), after) ? Math.min(time + half, this.until) : NaN;
    if (!(until > from)) return null;
    return { over: Math.hypot(after[0] - before[0], after[1] - before[1]) / (until - from), up: (after[2] - before[2]) / (until - from) };
  }
}

/**
 * Places in metres by row, axis and time from the arrays of a message of positions, gaps as NaN.
 * @param {NumberArray} starts @param {NumberArray} bends @param {number} rows @param {number} samples @param {number[][]} gaps
 */
export const unbendPlaces = (starts, bends, rows, samples, gaps) => {
  const places = new Float32Array(rows * 3 * samples), given = Math.min(samples, 2), bent = Math.max(samples - 2, 0);
  for (let line = 0; line < rows * 3; line++) {
    let value = starts[line * given], slope = given > 1 ? starts[line * given + 1] - value : 0, at = line * samples;
    const first = line * bent;
    if (samples > 0) places[at++] = value / 100;
    if (samples > 1) places[at++] = (value += slope) / 100;
    for (let k = 0; k < bent; k++) places[at++] = (value += slope += bends[first + k]) / 100;
  }
  for (const [row, first, until] of gaps)
    for (let axis = 0; axis < 3; axis++) places.fill(NaN, (row * 3 + axis) * samples + first, (row * 3 + axis) * samples + Math.min(until, samples));
  return places;
};

/** Headings from differences modulo 256. @param {NumberArray} turns @param {number} rows @param {number} samples */
export const sumTurns = (turns, rows, samples) => {
  const found = new Uint8Array(rows * samples);
  for (let row = 0, at = 0; row < rows; row++) for (let k = 0, sum = 0; k < samples; k++, at++) found[at] = sum = (sum + turns[at]) & 255;
  return found;
};
