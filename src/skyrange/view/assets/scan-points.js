// Points of the newest scans of the selected aircraft, and the fields of its sensors.
import { SYMBOL } from "./batches.js";
import { element, setText } from "./page-parts.js";
import { rgb } from "./theme.js";
/** @import { Frame } from "./frame.js" */
/** @import { RecordClient, ScanRow } from "./record-client.js" */
/** @import { Store } from "./store.js" */
/** @import { Theme } from "./theme.js" */
const STEP_S = 0.1;
/** Wall time between an answer and the next question. */
const PAUSE_MS = 150;
const MET = ["nothing", "ground", "building", "aircraft", "noise"];

/** The scans of one aircraft at the time that is shown. */
export class ScanPoints {
  /** @param {Store} store @param {RecordClient} record */
  constructor(store, record) {
    this.store = store;
    this.record = record;
    this.title = element("h3", { textContent: "Sees", title: "Points of its newest scans: grey the ground, blue buildings, red aircraft, yellow noise" });
    this.told = element("div");
    this.root = element("div", { hidden: true }, this.title, this.told);
    this.whose = "";
    this.shown = "";
    this.waiting = false;
  }

  update() {
    const { store } = this, { scene, view } = store, vehicle = scene?.vehicles[view.selected], arm = Math.max(view.arms.indexOf(true), 0);
    const whose = vehicle ? `${arm} ${vehicle.id}` : "", until = Math.floor(view.time / STEP_S + 1e-6) * STEP_S, key = `${whose} ${until.toFixed(1)}`;
    if (whose !== this.whose) {
      this.whose = whose;
      this.shown = "";
      this.show([]);
    }
    if (!vehicle || this.waiting || key === this.shown) return;
    this.shown = key;
    this.waiting = true;
    const answered = (/** @type {ScanRow[]} */ scans) => {
      if (this.whose === whose) this.show(scans);
      setTimeout(() => {
        this.waiting = false;
        this.update();
      }, PAUSE_MS);
    };
    this.record.scans(arm, vehicle.id, until + 1e-6).then(({ scans }) => answered(scans), () => answered([]));
  }

  /** @param {ScanRow[]} scans */
  show(scans) {
    const { store } = this;
    if (!scans.length && !store.scans.length) return;
    store.scans = scans;
    this.root.hidden = !scans.length;
    this.told.replaceChildren(...scans.map(({ sensor, of, points, met }) => {
      const counts = MET.map((name, kind) => [name, met.filter((one) => one === kind).length]).filter(([, count]) => count);
      const item = element("p", { className: "sky-dim" });
      setText(item, `${sensor}: ${of.toLocaleString("en")} points${points.length / 3 < of ? `, ${(points.length / 3).toLocaleString("en")} shown` : ""} (${counts.map(([name, count]) => `${count} ${name}`).join(", ")})`);
      return item;
    }));
    store.changed();
  }
}

/** @param {Frame} frame @param {Store} store @param {Theme} theme */
export const addScans = (frame, store, theme) => {
  const inks = [theme.dim, theme.dim, theme.accent, theme.bad, theme.warn].map(rgb), field = rgb(theme.accent), at = [0, 0, 0], to = [0, 0, 0];
  /** @param {number[]} numbers @param {number} i @param {number[]} place */
  const read = (numbers, i, place) => {
    for (let axis = 0; axis < 3; axis++) place[axis] = numbers[i * 3 + axis] / 100;
  };
  for (const { points, met, field: lines } of store.scans) {
    for (const line of lines)
      for (let i = 1; i < line.length / 3; i++) {
        read(line, i - 1, at);
        read(line, i, to);
        frame.lines.add(at, to, field, 0.55, 1);
      }
    for (let i = 0; i < met.length; i++) {
      read(points, i, at);
      frame.symbols.add(at, inks[met[i]] ?? inks[0], met[i] > 2 ? 1 : 0.75, met[i] === 3 ? 2.4 : 1.3, SYMBOL.dot);
    }
  }
};
