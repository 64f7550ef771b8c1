// Newest frames on the links of the selected aircraft, decoded, those that an attack sent or altered marked.
import { clockText, element, setText } from "./page-parts.js";
/** @import { FrameRow, LinkRows, RecordClient } from "./record-client.js" */
/** @import { Store } from "./store.js" */
const STEP_S = 0.2;
/** Wall time between two questions while it plays. */
const PAUSE_MS = 400;

/** A frame as an item of a list; its time seeks. @param {Store} store @param {FrameRow} frame */
export const frameRow = (store, { t, name, text, fate, author, act }) => {
  const mark = [act, fate].filter(Boolean).join(" · ");
  return element("li", { className: author === "attack" ? "sky-hostile" : "" },
    element("button", { type: "button", textContent: clockText(t, 2), "aria-label": `Go to ${clockText(t, 2)}`, onclick: () => store.seek(t) }),
    element("div", {}, element("b", { textContent: name }), mark ? element("em", { textContent: mark }) : "", element("p", { textContent: text, title: text })));
};

/** The frames of one aircraft at the time that is shown, asked for while the list is open. */
export class LinkFrames {
  /** @param {Store} store @param {RecordClient} record */
  constructor(store, record) {
    this.store = store;
    this.record = record;
    this.said = element("p", { className: "sky-dim", role: "status" });
    this.list = element("div", { className: "sky-links" });
    this.root = element("details", { className: "sky-more", ontoggle: () => this.update() }, element("summary", { textContent: "Frames on its links" }), this.said, this.list);
    this.shown = "";
    this.asked = -Infinity;
  }

  update() {
    const { store } = this, { scene, view } = store, vehicle = scene?.vehicles[view.selected], arm = Math.max(view.arms.indexOf(true), 0);
    this.root.hidden = !vehicle;
    if (!vehicle || !this.root.open) return;
    const until = (Math.floor(view.time / STEP_S + 1e-6) + 1) * STEP_S, key = `${arm} ${vehicle.id} ${until.toFixed(1)}`;
    if (key === this.shown || performance.now() - this.asked < PAUSE_MS) {
      if (key !== this.shown && !view.playing) setTimeout(() => this.update(), PAUSE_MS);
      return;
    }
    this.shown = key;
    this.asked = performance.now();
    this.record.frames(arm, vehicle.id, Math.min(until, view.time + 1e-6)).then(
      ({ links }) => this.shown === key && this.show(links),
      (/** @type {Error} */ error) => this.shown === key && this.say(error.message),
    );
  }

  /** @param {string} text */
  say(text) {
    setText(this.said, text);
    this.list.replaceChildren();
  }

  /** @param {LinkRows[]} links */
  show(links) {
    const told = links.filter(({ frames }) => frames.length);
    setText(this.said, told.length ? "" : "No frame yet.");
    this.list.replaceChildren(...told.map(({ link, frames }) => element("section", {},
      element("h4", { textContent: link.split(":")[0], title: link }, element("span", { className: "sky-dim", textContent: ` ${frames[0].src} → ${frames[0].dst}` })),
      element("ol", {}, ...frames.map((frame) => frameRow(this.store, frame))))));
  }
}
