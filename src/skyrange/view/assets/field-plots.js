// Plots of recorded fields of the selected aircraft, on the clock of the timeline.
import { clockText, element, fitCanvas, setText } from "./page-parts.js";
/** @import { RecordClient, Series } from "./record-client.js" */
/** @import { Store } from "./store.js" */
/** @import { Theme } from "./theme.js" */
const MOST_PLOTS = 6;

/** @typedef {{source: string, field: string, root: HTMLElement, caption: HTMLElement, canvas: HTMLCanvasElement, key: string, arms: (Series | null)[], problem: string}} Plot */

/** The newest value up to a time. @param {Series} series @param {number} time */
const valueAt = ({ t, v }, time) => {
  let low = 0;
  for (let high = t.length; low < high; ) {
    const middle = (low + high) >> 1;
    if (t[middle] <= time) low = middle + 1;
    else high = middle;
  }
  return low ? v[low - 1] : null;
};

/** @param {number} value */
const numberText = (value) => (Math.abs(value) >= 1e5 || Number.isInteger(value) ? value.toFixed(0) : value.toPrecision(4)).replace("-", "−");

/** Plots that a reader has added; each has a line for each arm that is shown. */
export class FieldPlots {
  /** @param {Store} store @param {Theme} theme @param {RecordClient} record */
  constructor(store, theme, record) {
    this.store = store;
    this.theme = theme;
    this.record = record;
    /** @type {Plot[]} */
    this.plots = [];
    this.choice = element("select", { "aria-label": "Field to plot", onchange: () => this.add() }, element("option", { value: "", textContent: "Plot a field …" }));
    this.list = element("div", { className: "sky-plots" });
    this.root = element("details", { className: "sky-more", ontoggle: () => this.fill() }, element("summary", { textContent: "Recorded fields" }), this.choice, this.list);
    this.filled = false;
  }

  fill() {
    if (this.filled || !this.root.open) return;
    this.filled = true;
    this.record.fields(0).then(
      (sources) => this.choice.append(...Object.entries(sources).map(([source, fields]) => element("optgroup", { label: source }, ...fields.map(([field, unit]) => element("option", { value: JSON.stringify([source, field]), textContent: unit ? `${field} (${unit})` : field }))))),
      (/** @type {Error} */ error) => this.list.append(element("p", { className: "sky-dim", textContent: error.message })),
    );
  }

  add() {
    if (!this.choice.value) return;
    const [source, field] = JSON.parse(this.choice.value), caption = element("span"), canvas = element("canvas", { "aria-hidden": "true" });
    this.choice.value = "";
    if (this.plots.length >= MOST_PLOTS || this.plots.some((plot) => plot.source === source && plot.field === field)) return;
    const remove = element("button", { type: "button", className: "sky-close", textContent: "×", "aria-label": `Remove the plot of ${field}`, onclick: () => this.remove(plot) });
    /** @type {Plot} */
    const plot = { source, field, caption, canvas, root: element("figure", {}, element("figcaption", {}, caption, remove), canvas), key: "", arms: [], problem: "" };
    canvas.addEventListener("click", (event) => {
      const box = canvas.getBoundingClientRect(), { start, end } = this.store.span();
      this.store.seek(start + ((event.clientX - box.left) / box.width) * (end - start));
    });
    this.plots.push(plot);
    this.list.append(plot.root);
    this.update();
  }

  /** @param {Plot} plot */
  remove(plot) {
    this.plots = this.plots.filter((other) => other !== plot);
    plot.root.remove();
  }

  update() {
    const { scene, view } = this.store, vehicle = scene?.vehicles[view.selected];
    this.root.hidden = !vehicle;
    if (!scene || !vehicle || !this.root.open) return;
    for (const plot of this.plots) {
      const key = `${vehicle.id} ${view.arms.join()}`;
      if (plot.key !== key) {
        plot.key = key;
        plot.problem = "";
        plot.arms = view.arms.map(() => null);
        view.arms.forEach((shown, arm) => {
          if (shown) this.load(plot, key, arm, vehicle.id);
        });
      }
      this.paint(plot);
    }
  }

  /** @param {Plot} plot @param {string} key @param {number} arm @param {string} vehicle */
  load(plot, key, arm, vehicle) {
    this.record.series(arm, vehicle, plot.source, plot.field).then(
      (series) => {
        if (plot.key !== key) return;
        plot.arms[arm] = series;
        this.paint(plot);
      },
      (/** @type {Error} */ error) => {
        if (plot.key !== key) return;
        plot.problem = error.message;
        this.paint(plot);
      },
    );
  }

  /** @param {Plot} plot */
  paint(plot) {
    const { store, theme } = this, { time } = store.view, { start, end } = store.span(), told = plot.arms.flatMap((series, arm) => (series?.t.length ? [{ series, arm }] : []));
    const now = told.map(({ series }) => valueAt(series, time)).map((value) => (value === null ? "–" : numberText(value))), unit = told[0]?.series.unit ?? "";
    setText(plot.caption, `${plot.source}.${plot.field}: ${plot.problem || (now.length ? `${now.join(" / ")} ${unit}` : "no values")}`);
    const fitted = fitCanvas(plot.canvas);
    if (!fitted) return;
    const { context, width, height } = fitted, values = told.flatMap(({ series }) => series.v.filter((value) => value !== null));
    const low = values.reduce((least, value) => Math.min(least, value), Infinity), high = values.reduce((most, value) => Math.max(most, value), -Infinity);
    if (!values.length) return;
    const x = (/** @type {number} */ t) => ((t - start) / (end - start)) * width, y = (/** @type {number} */ value) => height - 4 - ((value - low) / Math.max(high - low, 1e-12)) * (height - 8);
    told.reverse().forEach(({ series: { t, v } }, i) => {
      context.beginPath();
      let open = false;
      t.forEach((at, k) => {
        const value = v[k];
        if (value === null) open = false;
        else if (open) context.lineTo(x(at), y(value));
        else {
          context.moveTo(x(at), y(value));
          open = true;
        }
      });
      const first = i === told.length - 1;
      context.strokeStyle = first ? theme.accent : theme.dim;
      context.lineWidth = first ? 1.6 : 1.2;
      context.stroke();
    });
    context.strokeStyle = theme.ink;
    context.globalAlpha = 0.5;
    context.beginPath();
    context.moveTo(x(time), 0);
    context.lineTo(x(time), height);
    context.stroke();
    context.globalAlpha = 1;
    plot.canvas.title = `From ${numberText(low)} to ${numberText(high)} ${unit}, ${clockText(start, 0)} to ${clockText(end, 0)}; a click seeks`;
  }
}
