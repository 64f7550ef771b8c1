// Control of a run that flies: its acts, its pause and its speed, for a page whose address has the token.
import { clockText, element, setText } from "./page-parts.js";
const ASK_MS = 400;
const KEPT = "skyrange-control-token";
const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 5, 10, 0];

/**
 * @typedef {{id: string, role: string, kind: string, manual: boolean, muted: boolean, status: "waiting" | "acting" | "ended", start_s: number | null, stop_s: number | null}} Act
 * @typedef {{acts: Act[], now_s: number, end_s: number, ended: boolean, paused: boolean, speed: number, held: boolean}} State
 * @typedef {{do: string, act?: string, speed?: number}} Command
 */

/** The token of the address, which is taken out of it and kept for when the page is loaded again. @returns {string} */
const takeToken = () => {
  const hash = new URLSearchParams(location.hash.slice(1)), given = hash.get("token");
  try {
    if (given === null) return sessionStorage.getItem(KEPT) ?? "";
    sessionStorage.setItem(KEPT, given);
    hash.delete("token");
    history.replaceState(history.state, "", location.pathname + location.search + (String(hash) ? "#" + hash : ""));
  } catch {
    // without storage the token stays in the address
  }
  return given ?? "";
};

/** @param {Act} act */
const describeAct = (act) => {
  const words = { waiting: "waits", acting: "acts", ended: "has ended" }[act.status];
  const since = act.status === "waiting" ? act.start_s : act.status === "acting" ? act.start_s : act.stop_s;
  const time = since === null ? "" : ` ${act.status === "waiting" ? "until" : act.status === "acting" ? "since" : "at"} ${clockText(since)}`;
  return words + time + (act.muted ? ", muted" : "");
};

/** Why an act has no button that can be pressed; "" if it has. @param {Act} act @param {State} state */
const reasonOf = (act, state) => {
  if (state.ended) return "The run has ended.";
  if (act.status === "ended") return "An act starts once.";
  if (act.status === "waiting" && act.start_s !== null) return `It starts at ${clockText(act.start_s)}.`;
  return act.status === "waiting" && !act.manual ? "It starts by its condition: its scenario does not say manual = true." : "";
};

/** One act of the list: its words, and its button. @param {(command: Command) => void} send */
const actItem = (send) => {
  const name = element("b"), words = element("span"), button = element("button", { type: "button", className: "sky-chip" });
  const item = element("li", {}, name, words, button);
  /** @type {Act | undefined} */
  let shown;
  button.addEventListener("click", () => {
    if (shown) send({ do: shown.status === "waiting" ? "start" : "stop", act: shown.id });
  });
  return {
    item,
    /** @param {Act} act @param {State} state */
    update: (act, state) => {
      shown = act;
      const reason = reasonOf(act, state), verb = act.status === "waiting" ? "Start" : "Stop";
      setText(name, act.id);
      name.title = [act.role, act.kind].filter(Boolean).join(" ");
      setText(words, `${act.role}, ${describeAct(act)}`);
      setText(button, verb);
      button.setAttribute("aria-label", `${verb} ${act.role} ${act.id}`);
      button.disabled = reason !== "";
      button.title = reason;
      item.dataset.status = act.status;
      item.dataset.role = act.role;
    },
  };
};

/** Show the control of a run above its stage. @param {HTMLElement} host @param {string} url where its server answers */
export const mountControl = (host, url) => {
  const token = takeToken(), said = element("p", { className: "sky-control-said", role: "status" });
  const pause = element("button", { type: "button", className: "sky-chip", textContent: "Pause the run", disabled: true });
  const speed = element("select", { "aria-label": "Speed of the run", disabled: true }, ...SPEEDS.map((one) => element("option", { value: String(one), textContent: one ? `${one} × real time` : "as fast as possible" })));
  const clock = element("output", { className: "sky-clock", "aria-label": "Time that the run has reached" });
  const list = element("ul", { className: "sky-acts", "aria-label": "Attacks, faults and defences" });
  const root = element("section", { className: "sky-control", "aria-label": "Control of the run" }, element("div", { className: "sky-control-run" }, pause, speed, clock), list, said);
  host.insertBefore(root, host.querySelector(".sky-main"));
  /** @type {Map<string, ReturnType<typeof actItem>>} */
  const items = new Map();
  let paused = false, timer = 0;

  const say = (/** @type {string} */ text, wrong = false) => {
    setText(said, text);
    said.classList.toggle("sky-wrong", wrong);
  };
  const show = (/** @type {State} */ state) => {
    paused = state.paused;
    setText(pause, state.ended ? "The run has ended" : paused ? "Resume the run" : "Pause the run");
    pause.disabled = speed.disabled = state.ended;
    pause.hidden = speed.hidden = !state.held;
    setText(clock, clockText(state.now_s));
    const value = String(state.speed);
    if (speed.value !== value && document.activeElement !== speed) {
      if (![...speed.options].some((one) => one.value === value)) speed.append(element("option", { value, textContent: `${state.speed} × real time` }));
      speed.value = value;
    }
    for (const act of state.acts) {
      let item = items.get(act.id);
      if (!item) {
        item = actItem(send);
        items.set(act.id, item);
        list.append(item.item);
      }
      item.update(act, state);
    }
  };
  /** @param {RequestInit} [more] @returns {Promise<any>} */
  const ask = async (more = {}) => {
    const response = await fetch(url, { ...more, headers: { Authorization: `Bearer ${token}` }, cache: "no-store" });
    const answer = await response.json();
    if (!response.ok) throw new Error(String(answer.error ?? response.statusText));
    return answer;
  };
  const look = async () => {
    timer = 0;
    try {
      const state = await ask();
      show(state);
      if (state.ended) return;
    } catch (error) {
      say(error instanceof TypeError ? "The run does not answer." : String(/** @type {Error} */ (error).message), true);
    }
    timer ||= window.setTimeout(look, ASK_MS);
  };
  /** @param {Command} command */
  const send = async (command) => {
    try {
      const answer = await ask({ method: "POST", body: JSON.stringify(command) });
      show(answer.state);
      say(command.act === undefined ? "" : `${command.act} ${command.do}s at ${clockText(answer.at_s, 2)}`);
    } catch (error) {
      say(String(/** @type {Error} */ (error).message), true);
    }
  };
  pause.addEventListener("click", () => send({ do: paused ? "resume" : "pause" }));
  speed.addEventListener("change", () => send({ do: "speed", speed: Number(speed.value) }));
  if (token) look();
  else say("To control the run, open the address that skyrange printed: it has the token.", true);
};
