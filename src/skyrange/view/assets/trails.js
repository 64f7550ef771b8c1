// Trails of aircraft: few segments with times instead of all samples, in order of time.
/** @import { PositionsNews } from "./store.js" */
/** @import { Track } from "./tracks.js" */
const TOLERANCE_M = 0.4;
const LONGEST_S = 4;
const SHORTEST_S = 1;
const SEGMENT_FLOATS = 8;
/** Seconds that a trail shows. */
export const TRAIL_S = 30;

/** @typedef {{anchor: number[], pending: number[][]}} OpenSegment anchor and samples as time, east, north, up */

/** The trails of one arm: rows of both ends; `a.w` is the beginning, `b.w` the aircraft and the duration as its fraction of 8 s. */
export class TrailSet {
  constructor() {
    this.size = 0;
    this.data = new Float32Array(SEGMENT_FLOATS * 256);
    /** Rows that the renderer has to upload again begin here. */
    this.fresh = 0;
    /** @type {Map<number, OpenSegment>} */
    this.open = new Map();
    this.newest = -Infinity;
    this.stale = false;
  }

  /** @param {PositionsNews} news */
  add(news) {
    if (news.from < this.newest - 1e-6) {
      this.stale = true;
      return;
    }
    this.newest = news.until;
    /** @type {number[][]} */
    const made = [];
    news.rows.forEach((vehicle, row) => {
      for (let k = 0, at = row * 3 * news.samples; k < news.samples; k++, at++)
        this.sample(vehicle, [news.from + k * news.step, news.places[at], news.places[at + news.samples], news.places[at + 2 * news.samples]], made);
      this.close(vehicle, made);
    });
    this.append(made);
  }

  /** Begin again from whole tracks, for blocks that came in another order. @param {Track[]} tracks */
  rebuild(tracks) {
    this.size = this.fresh = 0;
    this.open.clear();
    this.stale = false;
    /** @type {number[][]} */
    const made = [];
    tracks.forEach((track, vehicle) => {
      for (let i = 0; i < track.size; i++) this.sample(vehicle, [track.t[i], track.xyz[i * 3], track.xyz[i * 3 + 1], track.xyz[i * 3 + 2]], made);
      this.close(vehicle, made);
    });
    this.append(made);
  }

  /** @param {number} vehicle @param {number[]} sample @param {number[][]} made */
  sample(vehicle, sample, made) {
    const one = this.open.get(vehicle);
    if (Number.isNaN(sample[1])) {
      if (one) this.close(vehicle, made, true);
      this.open.delete(vehicle);
    } else if (!one || sample[0] - one.anchor[0] > LONGEST_S * 2) this.open.set(vehicle, { anchor: sample, pending: [] });
    else if (sample[0] > one.anchor[0] + 1e-6) {
      if (one.pending.length && (sample[0] - one.anchor[0] > LONGEST_S || !this.fits(one, sample))) this.close(vehicle, made, true);
      one.pending.push(sample);
    }
  }

  /** Whether the samples between lie on the line to a new one. @param {OpenSegment} one @param {number[]} end */
  fits({ anchor, pending }, end) {
    const span = end[0] - anchor[0];
    return pending.every((sample) => {
      const part = (sample[0] - anchor[0]) / span;
      for (let axis = 1; axis < 4; axis++) if (Math.abs(anchor[axis] + (end[axis] - anchor[axis]) * part - sample[axis]) > TOLERANCE_M) return false;
      return true;
    });
  }

  /** @param {number} vehicle @param {number[][]} made @param {boolean} [surely] even where it is short */
  close(vehicle, made, surely = false) {
    const one = this.open.get(vehicle), end = one?.pending.at(-1);
    if (!one || !end || (!surely && end[0] - one.anchor[0] < SHORTEST_S)) return;
    const [t, e, n, u] = one.anchor;
    if (Math.hypot(end[1] - e, end[2] - n, end[3] - u) > 0.05) made.push([e, n, u, t, end[1], end[2], end[3], vehicle + Math.min(end[0] - t, 7.9) / 8]);
    one.anchor = end;
    one.pending = [];
  }

  /** @param {number[][]} made */
  append(made) {
    made.sort((a, b) => a[3] - b[3]);
    const size = this.size + made.length;
    if (size * SEGMENT_FLOATS > this.data.length) {
      const grown = new Float32Array(Math.max(size * SEGMENT_FLOATS, this.data.length * 2));
      grown.set(this.data.subarray(0, this.size * SEGMENT_FLOATS));
      this.data = grown;
    }
    let at = this.size * SEGMENT_FLOATS;
    const last = this.size ? this.data[at - SEGMENT_FLOATS + 3] : -Infinity;
    for (const row of made) {
      this.data.set(row, at);
      at += SEGMENT_FLOATS;
    }
    this.fresh = Math.min(this.fresh, this.size);
    this.size = size;
    if (made.length && made[0][3] < last - LONGEST_S * 2) this.stale = true;
  }

  /** The rows that may show at a time: the first, and the one after the last. @param {number} time */
  window(time) {
    return [this.rank(time - TRAIL_S - LONGEST_S * 2), this.rank(time + LONGEST_S * 2)];
  }

  /** How many segments begin before a time; neighbours may be a little out of order. @param {number} time */
  rank(time) {
    let low = 0;
    for (let high = this.size; low < high; ) {
      const middle = (low + high) >> 1;
      if (this.data[middle * SEGMENT_FLOATS + 3] < time) low = middle + 1;
      else high = middle;
    }
    return low;
  }
}
