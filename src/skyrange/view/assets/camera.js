// Camera: in perspective, or straight from above; its matrix and where places are on the screen.
const FIELD_OF_VIEW = 0.62;
const HOME_YAW = -0.62;
const HOME_PITCH = 0.62;
const TOP_PITCH = 1.5606;

/** @typedef {{low: number[], high: number[]}} Bounds */

/** Where the flight is seen from. Yaw 0 looks north, a pitch of a quarter turn looks down. */
export class Camera {
  constructor() {
    this.yaw = HOME_YAW;
    this.pitch = HOME_PITCH;
    this.distance = 300;
    this.target = [0, 0, 0];
    this.eye = [0, 0, 0];
    this.top = false;
    this.size = 100;
    /** Whether somebody moved it since it was fitted. */
    this.touched = false;
    this.matrix = new Float32Array(16);
    this.width = this.height = 1;
    /** Pixels of a metre at depth 1, and at the target. */
    this.focal = this.metre = 1;
  }

  /** Show all of the flights. @param {Bounds} bounds @param {boolean} [top] */
  fit({ low, high }, top = this.top) {
    if (!(low[0] <= high[0])) return;
    this.top = top;
    this.touched = false;
    this.yaw = top ? 0 : HOME_YAW;
    this.pitch = top ? TOP_PITCH : HOME_PITCH;
    this.target = low.map((value, axis) => (value + high[axis]) / 2);
    this.size = Math.max(Math.hypot(high[0] - low[0], high[1] - low[1]), high[2] - low[2], 20);
    for (let round = 0; round < 4; round++) {
      let near = this.size * 0.1, far = this.size * 8;
      for (let i = 0; i < 16; i++) {
        this.distance = (near + far) / 2;
        const box = this.boxOnScreen(low, high);
        if (box && box[1] - box[0] < this.width * 0.9 && box[3] - box[2] < this.height * 0.84) far = this.distance;
        else near = this.distance;
      }
      this.distance = far;
      const box = this.boxOnScreen(low, high);
      if (box) this.move(this.width / 2 - (box[0] + box[1]) / 2, (this.height * 0.52 - (box[2] + box[3]) / 2) * Math.max(Math.sin(this.pitch), 0.35));
    }
    this.touched = false;
  }

  /** Left, right, top and bottom of a box in pixels; null where some of it is behind the eye. @param {number[]} low @param {number[]} high */
  boxOnScreen(low, high) {
    const point = [0, 0, 0], found = [Infinity, -Infinity, Infinity, -Infinity];
    this.update(this.width, this.height);
    for (let corner = 0; corner < 8; corner++) {
      if (!this.project(corner & 1 ? high[0] : low[0], corner & 2 ? high[1] : low[1], corner & 4 ? high[2] : low[2], point)) return null;
      for (const axis of [0, 1]) {
        found[axis * 2] = Math.min(found[axis * 2], point[axis]);
        found[axis * 2 + 1] = Math.max(found[axis * 2 + 1], point[axis]);
      }
    }
    return found;
  }

  /** @param {number} width @param {number} height CSS pixels */
  update(width, height) {
    const { yaw, pitch, distance, target, top, matrix: m } = this;
    this.width = width;
    this.height = height;
    const cp = Math.cos(pitch), sp = Math.sin(pitch), cy = Math.cos(yaw), sy = Math.sin(yaw);
    const back = [-sy * cp, -cy * cp, sp], right = [cy, -sy, 0];
    const up = [back[1] * right[2] - back[2] * right[1], back[2] * right[0] - back[0] * right[2], back[0] * right[1] - back[1] * right[0]];
    const eye = (this.eye = target.map((x, axis) => x + back[axis] * distance));
    const f = 1 / Math.tan(FIELD_OF_VIEW / 2), aspect = width / height;
    const shift = (/** @type {number[]} */ a) => -(a[0] * eye[0] + a[1] * eye[1] + a[2] * eye[2]);
    const far = distance * 6 + this.size * 4, near = top ? -far : Math.max(distance * 0.02, 0.3), scale = top ? f / distance : f;
    const rows = [[...right, shift(right)].map((x) => (x * scale) / aspect), [...up, shift(up)].map((x) => x * scale), [...back, shift(back)]];
    for (let k = 0; k < 4; k++) {
      m[k * 4] = rows[0][k];
      m[k * 4 + 1] = rows[1][k];
      m[k * 4 + 2] = top ? (rows[2][k] * -2) / (far - near) - (k === 3 ? (far + near) / (far - near) : 0) : (rows[2][k] * (near + far)) / (near - far) + (k === 3 ? (2 * near * far) / (near - far) : 0);
      m[k * 4 + 3] = top ? (k === 3 ? 1 : 0) : -rows[2][k];
    }
    this.focal = (height / 2) * scale;
    this.metre = top ? this.focal : this.focal / distance;
  }

  /** East, north and up as pixels right and down, and a depth; false behind the eye. @param {number} e @param {number} n @param {number} u @param {number[]} out */
  project(e, n, u, out) {
    const m = this.matrix, w = m[3] * e + m[7] * n + m[11] * u + m[15];
    if (w < 0.01) return false;
    out[0] = ((m[0] * e + m[4] * n + m[8] * u + m[12]) / w + 1) * 0.5 * this.width;
    out[1] = (1 - (m[1] * e + m[5] * n + m[9] * u + m[13]) / w) * 0.5 * this.height;
    out[2] = w;
    return true;
  }

  /** @param {number} yaw @param {number} pitch radians more */
  turn(yaw, pitch) {
    this.yaw += yaw;
    if (this.top && Math.abs(pitch) > 0) this.top = false;
    if (!this.top) this.pitch = Math.min(Math.max(this.pitch + pitch, 0.03), TOP_PITCH);
    this.touch();
  }

  /** @param {number} right @param {number} down pixels by which the ground follows */
  move(right, down) {
    const k = 1 / this.metre, cy = Math.cos(this.yaw), sy = Math.sin(this.yaw), along = down / Math.max(Math.sin(this.pitch), 0.35);
    this.target[0] -= (cy * right - sy * along) * k;
    this.target[1] -= (-sy * right - cy * along) * k;
    this.touch();
  }

  /** @param {number} factor of the distance */
  zoom(factor) {
    this.distance = Math.min(Math.max(this.distance * factor, 4), this.size * 30 + 1000);
    this.touch();
  }

  touch() {
    this.touched = true;
  }

  /** The camera in an address. */
  text() {
    const { yaw, pitch, distance, target } = this;
    return [yaw.toFixed(3), pitch.toFixed(3), distance.toFixed(1), ...target.map((x) => x.toFixed(1)), ...(this.top ? ["top"] : [])].join(",");
  }

  /** @param {string} text */
  read(text) {
    const parts = text.split(","), values = parts.slice(0, 6).map(Number);
    if (values.length !== 6 || !values.every(Number.isFinite) || !(values[2] > 0)) return;
    this.yaw = values[0];
    this.pitch = Math.min(Math.max(values[1], 0.03), TOP_PITCH);
    this.distance = Math.min(Math.max(values[2], 4), 1e6);
    this.target = values.slice(3);
    this.top = parts[6] === "top";
    this.touch();
  }
}
