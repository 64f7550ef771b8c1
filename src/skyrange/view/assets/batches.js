// Lists of lines and symbols that are drawn in one go, filled anew for each frame.
/** @import { Rgb } from "./theme.js" */
export const LINE_FLOATS = 12;
export const SYMBOL_FLOATS = 12;
/** Kinds of symbols, as the shader knows them. */
export const SYMBOL = { dot: 0, ring: 1, diamond: 2, triangle: 3, dashed: 4 };

/** Rows of numbers in an array that grows by doubling. */
class Batch {
  /** @param {number} floats a row */
  constructor(floats) {
    this.floats = floats;
    this.size = 0;
    this.data = new Float32Array(floats * 64);
  }

  /** Where the next row begins. */
  next() {
    const at = this.size++ * this.floats;
    if (at + this.floats > this.data.length) {
      const grown = new Float32Array(this.data.length * 2);
      grown.set(this.data);
      this.data = grown;
    }
    return at;
  }

  clear() {
    this.size = 0;
  }
}

/** Lines with widths in pixels: ends, colour, width, and length of dashes in pixels (0 for none). */
export class LineBatch extends Batch {
  constructor() {
    super(LINE_FLOATS);
  }

  /** @param {ArrayLike<number>} a @param {ArrayLike<number>} b @param {Rgb} ink @param {number} alpha @param {number} width @param {number} [dash] */
  add(a, b, ink, alpha, width, dash = 0) {
    const at = this.next(), { data } = this;
    data[at] = a[0];
    data[at + 1] = a[1];
    data[at + 2] = a[2];
    data[at + 3] = width;
    data[at + 4] = b[0];
    data[at + 5] = b[1];
    data[at + 6] = b[2];
    data[at + 7] = dash;
    data[at + 8] = ink[0];
    data[at + 9] = ink[1];
    data[at + 10] = ink[2];
    data[at + 11] = alpha;
  }
}

/** Symbols that face the eye: place, radius in pixels, colour, kind. */
export class SymbolBatch extends Batch {
  constructor() {
    super(SYMBOL_FLOATS);
  }

  /** @param {ArrayLike<number>} at @param {Rgb} ink @param {number} alpha @param {number} radius @param {number} kind */
  add(at, ink, alpha, radius, kind) {
    const i = this.next(), { data } = this;
    data[i] = at[0];
    data[i + 1] = at[1];
    data[i + 2] = at[2];
    data[i + 3] = radius;
    data[i + 4] = ink[0];
    data[i + 5] = ink[1];
    data[i + 6] = ink[2];
    data[i + 7] = alpha;
    data[i + 8] = kind;
  }
}
