// Player: the clock that runs, its buttons and slider, and keys.
import { clockText, element, setText } from "./page-parts.js";
/** @import { Store } from "./store.js" */
const SPEEDS = [0.25, 0.5, 1, 2, 4, 8, 16];
const LIVE_LAG_S = 0.4;
const MAX_LAG_S = 3;
const CATCH_UP = 0.2;
const NEWS_APART_S = 0.05;
const MAX_PACE = 200;
const CALM_MS = 1000;
const SVG = "http://www.w3.org/2000/svg";
const SIGNS = { play: "M4 2.5v11l9.5-5.5z", pause: "M3.5 2.5h3.2v11H3.5zM9.3 2.5h3.2v11H9.3z", back: "M3 3h2v10H3zM13 3v10L6 8z", next: "M11 3h2v10h-2zM3 3v10l7-5z" };

/** @param {keyof typeof SIGNS} name */
const sign = (name) => {
  const picture = document.createElementNS(SVG, "svg"), path = document.createElementNS(SVG, "path");
  picture.setAttribute("viewBox", "0 0 16 16");
  picture.setAttribute("aria-hidden", "true");
  path.setAttribute("d", SIGNS[name]);
  picture.append(path);
  return picture;
};

/** The transport of a viewer. */
export class Player {
  /** @param {Store} store @param {(by: number) => void} stepIncident */
  constructor(store, stepIncident) {
    this.store = store;
    this.last = 0;
    /** Seconds of this clock behind the newest news while it follows: a little more than between two of them. */
    this.lag = LIVE_LAG_S;
    /** Simulated seconds that a second of this clock brings. */
    this.pace = 1;
    this.news = { end: NaN, at: 0 };
    this.timer = 0;
    /** Whether pictures should change in steps instead of moving. */
    this.calm = window.matchMedia("(prefers-reduced-motion: reduce)");
    this.shown = "";
    this.button = element("button", { type: "button", className: "sky-play", "aria-label": "Play", onclick: () => this.toggle() }, sign("play"));
    this.clock = element("output", { className: "sky-clock" });
    this.slider = element("input", { type: "range", min: "0", max: "1", step: "0.1", className: "sky-slider", "aria-label": "Time", oninput: () => store.seek(Number(this.slider.value)) });
    this.speed = element("select", { "aria-label": "Speed", onchange: () => store.show({ speed: Number(this.speed.value) }) }, ...SPEEDS.map((speed) => element("option", { value: String(speed), textContent: speed + " ×" })));
    this.live = element("button", { type: "button", className: "sky-chip sky-live", textContent: "Live", "aria-pressed": "true", onclick: () => store.show({ following: true, playing: true }) });
    const step = (/** @type {number} */ by, /** @type {string} */ label) => element("button", { type: "button", className: "sky-step", "aria-label": label, title: label, onclick: () => stepIncident(by) }, sign(by < 0 ? "back" : "next"));
    this.root = element("div", { className: "sky-player" },
      element("div", { className: "sky-player-left" }, step(-1, "Event before (,)"), this.button, step(1, "Next event (.)")),
      this.slider, element("div", { className: "sky-player-right" }, this.clock, this.speed, this.live));
    this.speed.value = "1";
    store.subscribe(() => this.update());
    this.stepIncident = stepIncident;
  }

  toggle() {
    const { view } = this.store, { start, end } = this.store.span();
    if (!view.playing && view.time >= end - 0.05 && !this.store.scene?.flying) view.time = start;
    this.store.show({ playing: !view.playing, following: view.playing ? false : view.following });
  }

  /** Keys that work in all of the viewer; true where one was meant. @param {KeyboardEvent} event */
  key(event) {
    const target = /** @type {HTMLElement} */ (event.target);
    if (event.ctrlKey || event.metaKey || event.altKey || /^(INPUT|SELECT|TEXTAREA)$/.test(target.tagName) && !(target === this.slider && event.key === " ")) return false;
    if (event.key === " " && target.tagName !== "BUTTON") this.toggle();
    else if (event.key === "," || event.key === ".") this.stepIncident(event.key === "," ? -1 : 1);
    else if (event.key === "[" || event.key === "]") this.store.show({ speed: SPEEDS[Math.min(Math.max(SPEEDS.indexOf(this.store.view.speed) + (event.key === "[" ? -1 : 1), 0), SPEEDS.length - 1)] });
    else return false;
    event.preventDefault();
    return true;
  }

  /** How fast the run flies, and how often news of it come. @param {number} end @param {number} now */
  measure(end, now) {
    const { news } = this, wait = (now - news.at) / 1000;
    if (end === news.end || wait < NEWS_APART_S) return;
    if (news.at && end > news.end) {
      this.pace += (Math.min((end - news.end) / wait, MAX_PACE) - this.pace) * 0.25;
      this.lag = Math.min(Math.max(wait * 1.2, this.lag * 0.98, LIVE_LAG_S), MAX_LAG_S);
    }
    this.news = { end, at: now };
  }

  /** Move the clock on by what passed since the frame before. */
  advance() {
    const { view } = this.store, now = performance.now(), since = this.last ? now - this.last : 0, { start, end } = this.store.span();
    if (this.calm.matches && view.playing && this.last && since < CALM_MS) {
      this.timer ||= window.setTimeout(() => {
        this.timer = 0;
        this.store.changed();
      }, CALM_MS - since);
      return;
    }
    const passed = Math.min(since / 1000, this.calm.matches ? 1.5 : 0.25);
    this.last = view.playing ? now : 0;
    if (!view.playing) return;
    if (!this.store.scene?.flying) view.following = false;
    if (view.following) {
      this.measure(end, now);
      const behind = end - this.lag * this.pace - view.time, most = MAX_LAG_S * Math.max(this.pace, 1);
      view.time = Math.max(start, Math.abs(behind) > most ? end - this.lag * this.pace : view.time + passed * Math.max(this.pace + behind * CATCH_UP, 0));
    } else view.time += passed * view.speed;
    if (view.time >= end) {
      view.time = end;
      if (this.store.scene?.flying) view.following = true;
      else view.playing = false;
    }
    this.store.changed();
  }

  update() {
    const { store } = this, { view, scene } = store, { start, end } = store.span();
    if (!scene) return;
    this.advance();
    const { slider } = this;
    if (slider.min !== String(start)) slider.min = String(start);
    if (slider.max !== String(end)) slider.max = String(end);
    const value = view.time.toFixed(1);
    if (slider.value !== value) slider.value = value;
    slider.setAttribute("aria-valuetext", clockText(view.time));
    setText(this.clock, `${clockText(view.time)} / ${clockText(end, 0)}`);
    this.live.hidden = !scene.flying;
    this.live.setAttribute("aria-pressed", String(view.following));
    if (this.speed.value !== String(view.speed)) this.speed.value = String(view.speed);
    const wanted = view.playing ? "Pause" : "Play";
    if (this.shown !== wanted) {
      this.shown = wanted;
      this.button.setAttribute("aria-label", wanted);
      this.button.title = wanted + " (space)";
      this.button.replaceChildren(sign(view.playing ? "pause" : "play"));
    }
  }
}
