// Panel of what is selected: state, beliefs, what it hears, and what was noted about it.
import { findHeard } from "./claims.js";
import { FieldPlots } from "./field-plots.js";
import { frameRow, LinkFrames } from "./link-frames.js";
import { clockText, element, kindText, replaceChildren, rounded, setText, shortened } from "./page-parts.js";
import { ScanPoints } from "./scan-points.js";
import { inkOn } from "./theme.js";
/** @import { EventTable } from "./events.js" */
/** @import { RecordClient } from "./record-client.js" */
/** @import { Scene } from "./scene.js" */
/** @import { Store } from "./store.js" */
/** @import { Theme } from "./theme.js" */
/** @import { Track } from "./tracks.js" */
const NOTES_SHOWN = 12;
const HEARD_SHOWN = 10;
const SEARCH_SHOWN = 60;
const MAX_SCANNED_ROWS = 100_000;

/** @param {EventTable} table @param {number} vehicle @param {number} time @returns {number} its newest row, or -1 */
const newestOf = (table, vehicle, time) => {
  const last = table.until(time) - 1;
  for (let row = last; row >= 0 && row > last - MAX_SCANNED_ROWS; row--) if (table.number("vehicle", row) === vehicle) return row;
  return -1;
};

/** The panel beside the stage. */
export class Inspector {
  /** @param {Store} store @param {Theme} theme @param {(node: number) => void} choose @param {RecordClient | null} record @param {RecordClient | null} scans */
  constructor(store, theme, choose, record, scans) {
    this.store = store;
    this.theme = theme;
    this.choose = choose;
    this.swatch = element("span", { className: "sky-swatch" });
    this.title = element("h2", { className: "sky-name" });
    this.kind = element("span", { className: "sky-dim" });
    this.facts = element("dl", { className: "sky-facts" });
    this.heard = element("ul", { className: "sky-heard" });
    this.heardTitle = element("h3", { textContent: "Hears", title: "Diamonds in the scene: where the broadcasts that it heard last put each sender" });
    this.notes = element("ol", { className: "sky-notes" });
    this.notesTitle = element("h3", { textContent: "Noted about it" });
    this.search = element("input", { type: "search", placeholder: "Find an aircraft", "aria-label": "Find an aircraft", oninput: () => this.list() });
    this.found = element("ul", { className: "sky-list" });
    this.close = element("button", { type: "button", className: "sky-close", "aria-label": "Let go of it (escape)", title: "Let go of it (escape)", textContent: "×", onclick: () => choose(-1) });
    this.record = record;
    this.recorded = record ? [new LinkFrames(store, record), new FieldPlots(store, theme, record)] : [];
    this.sees = scans ? new ScanPoints(store, scans) : null;
    this.chosen = element("div", {}, element("div", { className: "sky-panel-head" }, this.swatch, this.title, this.close), this.kind, this.facts, this.sees?.root ?? "", this.heardTitle, this.heard, this.notesTitle, this.notes, ...this.recorded.map(({ root }) => root));
    this.nobody = element("div", {}, element("h2", { className: "sky-name", textContent: "Aircraft" }), this.search, this.found);
    this.root = element("aside", { className: "sky-panel", "aria-label": "What is selected" }, this.nobody, this.chosen);
    this.keys = { heard: "", notes: "", facts: "", list: "" };
  }

  update() {
    const { store } = this, { scene, view } = store;
    if (!scene) return;
    const focused = this.root.contains(document.activeElement), other = this.chosen.hidden !== view.selected < 0;
    this.nobody.hidden = view.selected >= 0;
    this.chosen.hidden = view.selected < 0;
    if (focused && other) (view.selected < 0 ? this.search : this.close).focus({ preventScroll: true });
    this.sees?.update();
    if (view.selected < 0) return this.list();
    const vehicle = scene.vehicles[view.selected], radio = scene.radios[view.selected - scene.vehicles.length];
    setText(this.title, store.nodeName(view.selected));
    const ink = vehicle ? inkOn(vehicle, this.theme) : radio?.kind === "attack" ? this.theme.bad : this.theme.dim;
    this.swatch.style.backgroundColor = ink;
    setText(this.kind, vehicle ? `${scene.operators[vehicle.operator].id} · ${vehicle.airframe}` : radio?.kind === "attack" ? "radio of an attack" : "radio on the ground");
    this.showFacts(scene);
    this.showHeard();
    this.showNotes();
    for (const part of this.recorded) part.update();
  }

  /** Aircraft to choose from. */
  list() {
    const { store } = this, { scene } = store, asked = this.search.value.trim().toLowerCase();
    if (!scene) return;
    const nodes = [...scene.radios.map((radio, i) => ({ id: radio.id, place: scene.vehicles.length + i, hostile: radio.kind === "attack" })).filter((radio) => radio.hostile), ...scene.vehicles.map((one, place) => ({ id: one.id, place, hostile: false }))];
    const fits = nodes.filter(({ id, place }) => id.toLowerCase().includes(asked) && (place >= scene.vehicles.length || store.shows(place))), key = `${asked} ${fits.length} ${this.theme.version} ${nodes.length}`;
    if (key === this.keys.list) return;
    this.keys.list = key;
    this.found.replaceChildren(...fits.slice(0, SEARCH_SHOWN).map(({ id, place, hostile }) => {
      const swatch = element("span", { className: hostile ? "sky-swatch sky-mast" : "sky-swatch" });
      swatch.style.backgroundColor = hostile ? this.theme.bad : inkOn(scene.vehicles[place], this.theme);
      return element("li", {}, element("button", { type: "button", onclick: () => this.choose(place) }, swatch, element("span", { textContent: id })));
    }));
    if (fits.length > SEARCH_SHOWN) this.found.append(element("li", { className: "sky-dim", textContent: `and ${fits.length - SEARCH_SHOWN} more` }));
  }

  /** @param {Scene} scene */
  showFacts(scene) {
    const { store } = this, { selected, time, arms } = store.view, shown = arms.flatMap((on, arm) => (on ? [arm] : [])), /** @type {string[][]} */ rows = [];
    if (selected < scene.vehicles.length) for (const arm of shown) {
      const { tracks, events } = store.arms[arm], at = [0, 0, 0, 0], other = [0, 0, 0, 0], here = tracks.truth[selected].at(time, at), mode = newestOf(events.modes, selected, time), status = newestOf(events.status, selected, time);
      const away = (/** @type {Track} */ track) => (here && track.at(time, other) ? Math.hypot(at[0] - other[0], at[1] - other[1], at[2] - other[2]).toFixed(1) + " m" : "–"), speed = tracks.truth[selected].velocity(time);
      const item = status < 0 ? -1 : events.status.number("item", status), charge = status < 0 ? -1 : events.status.number("charge", status), heard = tracks.station[selected].lastHeard(time);
      rows.push([
        mode < 0 ? "–" : events.modes.text("mode", mode), item >= 0 ? String(item) : "–", charge >= 0 ? Math.round(charge * 100) + " %" : "–", here ? at[2].toFixed(1) + " m" : "–",
        speed ? `${speed.over.toFixed(1)} m/s` : "–", speed ? `${speed.up.toFixed(1)} m/s`.replace("-0.0", "0.0").replace("-", "−") : "–", here ? `${Math.round(at[0]) || 0}, ${Math.round(at[1]) || 0} m`.replaceAll("-", "−") : "–", away(tracks.autopilot[selected]),
        away(tracks.station[selected]), Number.isNaN(heard) ? (tracks.station.some((one) => one.size) ? "never" : "–") : `${Math.max(time - heard, 0).toFixed(1)} s ago`,
      ]);
    }
    else rows.push((scene.radios[selected - scene.vehicles.length]?.at ?? []).map((value) => value.toFixed(1) + " m"));
    const names = selected < scene.vehicles.length ? ["Mode", "Mission item", "Charge", "Height", "Speed", "Climb", "East, north", "Belief off by", "Station off by", "Station heard it"] : ["East", "North", "Up"];
    const key = names.length + " " + shown.join() + selected;
    if (key !== this.keys.facts) {
      this.keys.facts = key;
      this.facts.classList.toggle("sky-two", rows.length > 1);
      const head = rows.length > 1 ? [element("dt", {}), ...shown.slice(0, 2).map((arm) => element("dd", { className: "sky-dim", textContent: scene.arms[arm].title }))] : [];
      this.facts.replaceChildren(...head, ...names.flatMap((name) => [element("dt", { textContent: name }), ...rows.slice(0, 2).map(() => element("dd"))]));
    }
    const cells = [...this.facts.querySelectorAll("dd:not(.sky-dim)")], columns = Math.min(rows.length, 2);
    names.forEach((_, i) => {
      for (let k = 0; k < columns; k++) setText(cells[i * columns + k], rows[k][i] ?? "–");
    });
  }

  showHeard() {
    const { store } = this, { selected, time, arms } = store.view, arm = Math.max(arms.indexOf(true), 0), heard = findHeard(store, arm, selected, time);
    this.heardTitle.hidden = this.heard.hidden = !store.arms[arm].events.receptions.size;
    setText(this.heardTitle, heard.length ? `Hears ${heard.length}` : "Hears nobody");
    const shown = heard.slice(0, HEARD_SHOWN), key = shown.map(({ node, rssi }) => `${node} ${rssi}`).join();
    if (key !== this.keys.heard) {
      this.keys.heard = key;
      replaceChildren(this.heard, ...shown.map(({ node, rssi }) => {
        const meter = element("meter", { min: -100, max: -40, value: rssi, "aria-label": "strength" });
        return element("li", { className: store.isHostile(node) ? "sky-hostile" : "" }, element("button", { type: "button", textContent: shortened(store.nodeName(node), 22), onclick: () => this.choose(node) }), meter, element("span", { textContent: `${rssi.toFixed(0)} dBm`.replace("-", "−") }), element("span", { className: "sky-age" }));
      }));
    }
    this.heard.querySelectorAll(".sky-age").forEach((cell, i) => setText(cell, `${shown[i].age.toFixed(1)} s`));
  }

  /** How many frames caused something; with a record to ask, a list of them to open. @param {number} arm @param {number} t @param {string} kind @param {string} about @param {number} count */
  causes(arm, t, kind, about, count) {
    const text = `${count} frame${count > 1 ? "s" : ""}`, { record } = this;
    if (!record) return element("span", { className: "sky-dim", textContent: `· ${text}` });
    const list = element("ol"), say = (/** @type {string} */ what) => list.replaceChildren(element("li", { className: "sky-dim", textContent: what }));
    const open = () => {
      if (!more.open || list.childElementCount) return;
      record.causes(arm, t, kind, about).then(
        ({ frames }) => (frames.length ? list.replaceChildren(...frames.map((frame) => frameRow(this.store, frame))) : say("The record does not have them.")),
        (/** @type {Error} */ error) => say(error.message),
      );
    };
    const more = element("details", { className: "sky-causes sky-links", ontoggle: open }, element("summary", { textContent: `because of ${text}` }), list);
    return more;
  }

  showNotes() {
    const { store } = this, { selected, time, arms } = store.view, arm = Math.max(arms.indexOf(true), 0), { notes } = store.arms[arm].events, id = store.nodeName(selected), rows = [];
    for (let row = notes.until(time) - 1; row >= 0 && rows.length < NOTES_SHOWN; row--) if (notes.text("about", row) === id) rows.push(row);
    this.notesTitle.hidden = !rows.length;
    const key = `${arm} ${selected} ${notes.shuffles} ${rows.join()}`;
    if (key === this.keys.notes) return;
    this.keys.notes = key;
    replaceChildren(this.notes, ...rows.map((row) => {
      const t = notes.number("t", row), causes = notes.number("causes", row), decision = notes.text("table", row) === "decisions";
      return element("li", {},
        element("button", { type: "button", textContent: clockText(t), "aria-label": `Go to ${clockText(t)}`, onclick: () => store.seek(t) }),
        element("div", {}, element("b", { className: decision ? "sky-decision" : "", textContent: kindText(notes.text("kind", row)) }), element("span", { className: "sky-dim", textContent: ` ${notes.text("source", row)}` }), ...(causes ? [" ", this.causes(arm, t, notes.text("kind", row), id, causes)] : []), element("p", { textContent: shortened(rounded(notes.text("text", row)), 160) })));
    }));
  }
}
