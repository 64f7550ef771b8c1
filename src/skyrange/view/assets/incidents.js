// Incidents: mishaps, decisions, alerts and acts of attacks, as marks, call-outs and steps of the timeline.
import { kindText } from "./page-parts.js";
/** @import { Store } from "./store.js" */
const CALLOUT_S = 4.5;
const MAX_CALLOUTS = 6;
const MAX_MARKS = 400;
const JOINED_S = 3;
const QUIET_KINDS = /mode_seen|connected|telemetry|uploaded|approval_requested|approval_accepted/;
const ALARMING = /lost|fail|reject|denied|abort|collision|crash|breach|violat|emergency|evade|avoid|conflict/;

/** @typedef {{arm: number, node: number, title: string, text: string, age: number, alarm: boolean, rank: number}} Callout */
/** @typedef {{at: number[], title: string, violent: boolean, recent: boolean}} Mark */
/** @typedef {{arm: number, from: number, until: number, title: string, text: string, alarm: boolean}} Incident */

/** @param {string} kind */
const isViolent = (kind) => /collision|crash/.test(kind);
/** @param {string} text */
const capital = (text) => text.charAt(0).toUpperCase() + text.slice(1);

/** Decisions of the last seconds about aircraft that are shown, the most important first. @param {Store} store @returns {Callout[]} */
export const callouts = (store) => {
  const { view, scene } = store, /** @type {Callout[]} */ found = [];
  if (!scene) return found;
  const few = scene.vehicles.length * scene.arms.length <= 12;
  view.arms.forEach((shown, arm) => {
    const { notes } = store.arms[arm].events;
    if (!shown) return;
    for (let row = notes.until(view.time) - 1; row >= 0 && notes.number("t", row) > view.time - CALLOUT_S; row--) {
      if (notes.text("table", row) !== "decisions") continue;
      const kind = notes.text("kind", row), node = scene.nodes.get(notes.text("about", row)), mine = node === view.selected, alarm = ALARMING.test(kind), quiet = QUIET_KINDS.test(kind);
      if (node === undefined || (node < scene.vehicles.length && !store.shows(node)) || (quiet && !few && !mine)) continue;
      found.push({ arm, node, title: capital(kindText(kind)), text: notes.text("text", row), age: view.time - notes.number("t", row), alarm, rank: (mine ? 4 : 0) + (alarm ? 2 : 0) - (quiet ? 3 : 0) });
      if (found.length > 400) break;
    }
  });
  found.sort((a, b) => b.rank - a.rank || a.arm - b.arm || a.age - b.age);
  /** @type {Set<string>} */
  const seen = new Set();
  return found.filter(({ arm, node, title }) => {
    const mine = `${arm} ${node}`, alike = `${node} ${title}`;               // twins that do the same say it once
    return !seen.has(mine) && !seen.has(alike) && seen.add(mine).add(alike);
  }).slice(0, MAX_CALLOUTS);
};

/** Mishaps up to the time shown, the violent ones last. @param {Store} store @returns {Mark[]} */
export const marksUntil = (store) => {
  const { time, arms } = store.view, /** @type {Mark[]} */ found = [];
  arms.forEach((shown, arm) => {
    const { mishaps } = store.arms[arm].events, until = shown ? mishaps.until(time) : 0;
    for (let row = Math.max(until - MAX_MARKS, 0); row < until; row++) {
      const kind = mishaps.text("kind", row);
      found.push({ at: ["e", "n", "u"].map((name) => mishaps.number(name, row)), title: capital(kindText(kind)), violent: isViolent(kind), recent: time - mishaps.number("t", row) < CALLOUT_S });
    }
  });
  return found.sort((a, b) => Number(a.violent) - Number(b.violent));
};

/** Acts of attacks and faults as spans, by author and attack; acts close together are one span. @param {Store} store @returns {Map<string, Incident[]>} */
export const attackSpans = (store) => {
  /** @type {Map<string, Incident[]>} */
  const lanes = new Map();
  store.arms.forEach(({ events: { acts } }, arm) => {
    for (let row = 0; row < acts.size; row++) {
      const author = acts.text("author", row), attack = acts.text("attack", row), lane = attack || author || "attack", from = acts.number("t", row), until = Math.max(acts.number("until", row) || from, from);
      const spans = lanes.get(lane) ?? [], last = spans.at(-1), count = acts.number("n", row) || 1, title = `${capital(author)} ${attack}: ${kindText(acts.text("action", row))} ${acts.text("about", row)}`;
      lanes.set(lane, spans);
      if (last && last.arm === arm && from - last.until < JOINED_S) {
        last.until = Math.max(last.until, until);
        last.text = String(Number(last.text) + count);
      } else spans.push({ arm, from, until, title, text: String(count), alarm: author === "attack" });
    }
  });
  for (const spans of lanes.values()) for (const span of spans) span.text += span.text === "1" ? " act" : " acts";
  return lanes;
};

/** Rows of a table as incidents. @param {Store} store @param {"alerts" | "decisions" | "mishaps"} what @returns {Incident[]} */
export const listIncidents = (store, what) => {
  const /** @type {Incident[]} */ found = [], { selected } = store.view, chosen = selected < (store.scene?.vehicles.length ?? 0) ? store.nodeName(selected) : "";
  store.arms.forEach(({ events }, arm) => {
    const table = what === "decisions" ? events.notes : events[what];
    for (let row = 0; row < table.size; row++) {
      const from = table.number("t", row), kind = table.text("kind", row);
      if (what === "decisions") {
        if (table.text("table", row) !== "decisions" || (chosen && table.text("about", row) !== chosen)) continue;
        found.push({ arm, from, until: from, title: `${capital(kindText(kind))}: ${table.text("about", row)}`, text: table.text("text", row), alarm: ALARMING.test(kind) });
      } else if (what === "alerts") found.push({ arm, from, until: from, title: `${table.text("detector", row)}: ${kindText(kind)} ${table.text("subject", row)}`, text: table.text("text", row), alarm: true });
      else found.push({ arm, from, until: from, title: capital(kindText(kind)), text: table.text("text", row), alarm: isViolent(kind) });
    }
  });
  return found.sort((a, b) => a.from - b.from);
};

/** What defences did, as spans; acts of one close together are one span. @param {Store} store @returns {Incident[]} */
export const defenceSpans = (store) => {
  const /** @type {Incident[]} */ found = [];
  store.arms.forEach(({ events: { notes } }, arm) => {
    /** @type {Map<string, Incident & {acts: number}>} */
    const open = new Map();
    for (let row = 0; row < notes.size; row++) {
      if (notes.text("kind", row) !== "event.defence_act") continue;
      const id = notes.text("about", row), at = notes.number("t", row), last = open.get(id);
      if (last && at - last.until < JOINED_S) {
        last.until = at;
        last.text = `${++last.acts} acts`;
      } else {
        const span = { arm, from: at, until: at, title: `Defence ${id}: ${notes.text("text", row)}`, text: "1 act", alarm: false, acts: 1 };
        open.set(id, span);
        found.push(span);
      }
    }
  });
  return found.sort((a, b) => a.from - b.from);
};

/** When stations had lost the link to an aircraft. @param {Store} store @returns {Incident[]} */
export const linkLosses = (store) => {
  const /** @type {Incident[]} */ found = [], { end } = store.span(), { selected } = store.view, chosen = selected < (store.scene?.vehicles.length ?? 0) ? store.nodeName(selected) : "";
  store.arms.forEach(({ events: { notes } }, arm) => {
    /** @type {Map<string, Incident>} */
    const open = new Map();
    for (let row = 0; row < notes.size; row++) {
      const kind = notes.text("kind", row), vehicle = notes.text("about", row);
      if (chosen && vehicle !== chosen) continue;
      if (kind === "decision.link_lost") {
        const span = { arm, from: notes.number("t", row), until: end, title: `Link lost: ${vehicle}`, text: "", alarm: true };
        open.set(vehicle, span);
        found.push(span);
      } else if (kind === "decision.link_restored") {
        const span = open.get(vehicle);
        if (span) span.until = notes.number("t", row);
        open.delete(vehicle);
      }
    }
  });
  return found.sort((a, b) => a.from - b.from);
};

/** Modes of an aircraft as spans. @param {Store} store @param {number} arm @param {number} vehicle @returns {Incident[]} */
export const modeSpans = (store, arm, vehicle) => {
  const { modes } = store.arms[arm].events, /** @type {Incident[]} */ found = [], { end } = store.span();
  for (let row = 0; row < modes.size; row++) {
    if (modes.number("vehicle", row) !== vehicle) continue;
    const from = modes.number("t", row), last = found.at(-1);
    if (last) last.until = from;
    found.push({ arm, from, until: end, title: modes.text("mode", row), text: "", alarm: false });
  }
  return found;
};
