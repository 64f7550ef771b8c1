// Timeline beneath the slider: lanes of attacks, alerts, decisions, mishaps and modes; a click seeks, hovering explains.
import { attackSpans, defenceSpans, linkLosses, listIncidents, modeSpans } from "./incidents.js";
import { clockText, element, fitCanvas, replaceChildren, rounded, setText, shortened } from "./page-parts.js";
/** @import { Incident } from "./incidents.js" */
/** @import { Store } from "./store.js" */
/** @import { Theme } from "./theme.js" */
const MAX_ATTACK_LANES = 4;
const HIT_PIXELS = 5;
const CROWDED = 300;
const MODE_HUES = [212, 150, 32, 285, 95, 190, 5, 250];

/** @typedef {{name: string, kind: string, incidents: Incident[], row: HTMLElement, canvas: HTMLCanvasElement, last: HTMLElement}} Lane */

/** The lanes of a timeline. */
export class Timeline {
  /** @param {Store} store @param {Theme} theme @param {(text: string, x: number, y: number) => void} tip shows a tooltip, or none for an empty text */
  constructor(store, theme, tip) {
    this.store = store;
    this.theme = theme;
    this.tip = tip;
    /** @type {Lane[]} */
    this.lanes = [];
    this.rows = element("div", { className: "sky-lane-rows" });
    this.needle = element("div", { className: "sky-needle", "aria-hidden": "true" });
    this.live = element("p", { className: "sky-hidden", role: "status" });
    this.root = element("div", { className: "sky-timeline", role: "group", "aria-label": "Timeline: arrow keys in a lane go from event to event" }, this.rows, this.needle, this.live);
    this.key = "";
    this.read = 0;
    new ResizeObserver(() => this.paint()).observe(this.root);
  }

  /** Gather what happened, and build the lanes anew where there are others than before. */
  gather() {
    const { store } = this, { selected, arms } = store.view, vehicles = store.scene?.vehicles.length ?? 0, first = Math.max(arms.indexOf(true), 0);
    /** @type {{name: string, kind: string, incidents: Incident[]}[]} */
    const wanted = [...attackSpans(store)].slice(0, MAX_ATTACK_LANES).map(([name, incidents]) => ({ name, kind: "attack", incidents }));
    const alerts = listIncidents(store, "alerts"), mishaps = listIncidents(store, "mishaps");
    const defences = defenceSpans(store), losses = linkLosses(store);
    if (defences.length) wanted.push({ name: "Defences", kind: "defence", incidents: defences });
    if (alerts.length) wanted.push({ name: "Alerts", kind: "alert", incidents: alerts });
    wanted.push({ name: "Decisions", kind: "decision", incidents: listIncidents(store, "decisions") });
    if (losses.length) wanted.push({ name: "Link lost", kind: "loss", incidents: losses });
    if (mishaps.length) wanted.push({ name: "Mishaps", kind: "mishap", incidents: mishaps });
    if (selected >= 0 && selected < vehicles) wanted.push({ name: "Mode", kind: "mode", incidents: arms.flatMap((shown, arm) => (shown && (arm === first || arms.length === 2) ? modeSpans(store, arm, selected) : [])) });
    const key = wanted.map((lane) => lane.kind + lane.name).join("\n");
    if (key !== this.key) {
      this.key = key;
      this.lanes = wanted.map((lane) => this.makeLane(lane));
      replaceChildren(this.rows, ...this.lanes.map((lane) => lane.row));
    } else wanted.forEach((lane, i) => (this.lanes[i].incidents = lane.incidents));
    this.paint();
  }

  /** @param {{name: string, kind: string, incidents: Incident[]}} wanted @returns {Lane} */
  makeLane({ name, kind, incidents }) {
    const canvas = element("canvas", { "aria-hidden": "true" });
    const last = element("span", { className: "sky-lane-last" });
    const marks = element("div", { className: "sky-lane-marks", tabIndex: 0, role: "group", "aria-label": `${name}: left and right arrows go to the event before and after` }, canvas);
    const row = element("div", { className: kind === "mode" && this.store.arms.length > 1 ? "sky-lane sky-tall" : "sky-lane" }, element("span", { className: `sky-lane-name sky-${kind}`, textContent: shortened(name, 40), title: name }), marks, last);
    /** @type {Lane} */
    const lane = { name, kind, incidents, row, canvas, last };
    marks.addEventListener("pointermove", (event) => {
      const found = this.hit(lane, event);
      this.tip(found ? this.words(found) : "", event.clientX, event.clientY);
    });
    marks.addEventListener("pointerleave", () => this.tip("", 0, 0));
    marks.addEventListener("click", (event) => {
      const found = this.hit(lane, event);
      this.store.seek(found && found.until - found.from < 1 ? found.from : this.timeAt(canvas, event.clientX));
    });
    marks.addEventListener("keydown", (event) => {
      if (event.key !== "ArrowLeft" && event.key !== "ArrowRight") return;
      event.preventDefault();
      event.stopPropagation();
      this.step(lane, event.key === "ArrowLeft" ? -1 : 1);
    });
    return lane;
  }

  /** @param {Lane} lane @param {number} by */
  step(lane, by) {
    const { time } = this.store.view, found = by > 0 ? lane.incidents.find((one) => one.from > time + 0.02) : lane.incidents.findLast((one) => one.from < time - 0.02);
    if (!found) return;
    this.store.seek(found.from);
    setText(this.live, this.words(found));
  }

  /** Go to the incident before or after of all lanes. @param {number} by */
  stepAll(by) {
    const incidents = this.lanes.filter((lane) => lane.kind !== "mode").flatMap((lane) => lane.incidents).sort((a, b) => a.from - b.from);
    this.step({ ...this.lanes[0], incidents }, by);
  }

  /** @param {Incident} one */
  words({ arm, from, until, title, text }) {
    const { scene } = this.store, where = scene && scene.arms.length > 1 ? ` · ${scene.arms[arm].title}` : "";
    return `${clockText(from)}${until - from > 0.5 ? `–${clockText(until)}` : ""}${where}\n${title}${text ? `\n${shortened(rounded(text), 140)}` : ""}`;
  }

  /** @param {HTMLCanvasElement} canvas @param {number} x */
  timeAt(canvas, x) {
    const box = canvas.getBoundingClientRect(), { start, end } = this.store.span();
    return start + ((x - box.left) / Math.max(box.width, 1)) * (end - start);
  }

  /** @param {Lane} lane @param {MouseEvent} event */
  hit(lane, event) {
    const time = this.timeAt(lane.canvas, event.clientX), { start, end } = this.store.span(), reach = (HIT_PIXELS * (end - start)) / Math.max(lane.canvas.clientWidth, 1);
    const box = lane.canvas.getBoundingClientRect(), arms = this.store.arms.length, arm = arms > 1 ? Math.floor(((event.clientY - box.top) / box.height) * arms) : 0;
    const away = (/** @type {Incident} */ one) => Math.max(one.from - time, time - one.until, 0) + (one.arm === arm ? 0 : reach / 4);
    let best = null;
    for (const one of lane.incidents) if (away(one) <= reach && (!best || away(one) < away(best))) best = one;
    return best;
  }

  paint() {
    const { theme, store } = this, { start, end } = store.span(), arms = Math.max(store.arms.length, 1);
    const ink = /** @type {Record<string, string>} */ ({ attack: theme.bad, alert: theme.warn, defence: theme.good, loss: theme.warn, decision: theme.accent, mishap: theme.bad });
    for (const { kind, incidents, canvas } of this.lanes) {
      const fitted = fitCanvas(canvas);
      if (!fitted) continue;
      const { context, width, height } = fitted, modes = [...new Set(incidents.map((one) => one.title))].sort(), each = height / arms;
      for (const one of incidents) {
        const x = ((one.from - start) / (end - start)) * width, wide = ((one.until - one.from) / (end - start)) * width, y = one.arm * each, pad = each > 10 ? 2.5 : 1;
        context.globalAlpha = (store.view.arms[one.arm] ? 1 : 0.25) * (one.arm && arms > 1 ? 0.7 : 1) * (incidents.length > CROWDED && kind === "decision" && !one.alarm ? 0.35 : 1);
        if (kind === "mode") {
          context.fillStyle = `hsl(${MODE_HUES[modes.indexOf(one.title) % MODE_HUES.length]} ${theme.dark ? "35% 32%" : "55% 84%"})`;
          context.fillRect(x, y + pad, Math.max(wide - 1, 1), each - pad * 2);
          context.font = "10.5px system-ui, sans-serif";
          context.fillStyle = theme.ink;
          context.textBaseline = "middle";
          if (wide > context.measureText(one.title).width + 8 && each > 9) context.fillText(one.title, x + 4, y + each / 2 + 0.5);
          continue;
        }
        context.fillStyle = kind === "decision" && one.alarm ? theme.bad : ink[kind] ?? theme.dim;
        if (kind === "attack" || kind === "defence" || kind === "loss") {
          context.globalAlpha *= 0.75;
          context.fillRect(x, y + pad, Math.max(wide, 2), each - pad * 2);
        } else if (kind === "mishap") {
          context.beginPath();
          context.arc(x, y + each / 2, Math.min(4, each / 2), 0, 7);
          context.fill();
        } else context.fillRect(x - 1, y + pad, 2, each - pad * 2);
      }
    }
    this.place();
  }

  /** Say what happened last in each lane. */
  sayLast() {
    const { time } = this.store.view;
    for (const { incidents, last, kind } of this.lanes) {
      const found = incidents.findLast((one) => one.from <= time + 0.01 && this.store.view.arms[one.arm]);
      setText(last, !found ? `${incidents.length} in all` : kind === "attack" ? (found.until + 1 > time ? "now" : `until ${clockText(found.until)}`) : kind === "mode" ? found.title : `${clockText(found.from)} ${found.title}`);
    }
  }

  /** Put the needle at the time that is shown. */
  place() {
    const { start, end } = this.store.span(), canvas = this.lanes[0]?.canvas;
    if (!canvas) return;
    const part = (this.store.view.time - start) / (end - start);
    this.sayLast();
    this.needle.style.transform = `translateX(${(/** @type {HTMLElement} */ (canvas.parentElement).offsetLeft + part * canvas.clientWidth).toFixed(1)}px)`;
  }
}
