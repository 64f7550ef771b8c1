// Sprites of texts with halos, and the parts of the screen that are taken.
const CELL = 6;
const MAX_SPRITES = 3000;
/** The font of names. */
export const LABEL_FONT = '12px system-ui, -apple-system, "Segoe UI", Roboto, sans-serif';

/** Texts with a halo, painted once each. */
export class TextSprites {
  constructor() {
    /** @type {Map<string, {canvas: HTMLCanvasElement, wide: number}>} */
    this.made = new Map();
    this.key = "";
  }

  /** @param {string} text @param {string} ink @param {string} halo @param {number} ratio @param {boolean} bold */
  get(text, ink, halo, ratio, bold) {
    const key = [text, ink, halo, ratio, bold].join("\n");
    let found = this.made.get(key);
    if (found) return found;
    if (this.made.size > MAX_SPRITES) this.made.clear();
    const canvas = document.createElement("canvas"), context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d")), font = (bold ? "650 " : "500 ") + LABEL_FONT;
    context.font = font;
    const wide = Math.ceil(context.measureText(text).width) + 6;
    canvas.width = Math.ceil(wide * ratio);
    canvas.height = Math.ceil(18 * ratio);
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.font = font;
    context.textBaseline = "middle";
    context.lineJoin = "round";
    context.lineWidth = 3.5;
    context.strokeStyle = halo;
    context.strokeText(text, 3, 9);
    context.fillStyle = ink;
    context.fillText(text, 3, 9);
    found = { canvas, wide };
    this.made.set(key, found);
    return found;
  }
}

/** Which parts of the screen are taken, in cells. */
export class Occupancy {
  /** @param {number} width @param {number} height */
  constructor(width, height) {
    this.across = Math.ceil(width / CELL);
    this.down = Math.ceil(height / CELL);
    this.cells = new Uint8Array(this.across * this.down);
  }

  /** Take a box, unless some of it is taken or outside. @param {number} x @param {number} y @param {number} wide @param {number} high @param {boolean} [always] */
  take(x, y, wide, high, always = false) {
    const left = Math.floor(x / CELL), top = Math.floor(y / CELL), right = Math.ceil((x + wide) / CELL), bottom = Math.ceil((y + high) / CELL);
    if (!always && (left < 0 || top < 0 || right > this.across || bottom > this.down)) return false;
    for (let row = top; row < bottom; row++) for (let k = left; k < right; k++) if (!always && this.cells[row * this.across + k]) return false;
    for (let row = Math.max(top, 0); row < Math.min(bottom, this.down); row++) this.cells.fill(1, row * this.across + Math.max(left, 0), row * this.across + Math.min(right, this.across));
    return true;
  }
}
