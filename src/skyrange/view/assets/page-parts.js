// Helpers of the page: elements, canvases that fit their box, and how times and numbers are written.
/** @typedef {Record<string, string | number | boolean | ((event: any) => void) | undefined>} Properties */

/**
 * An element with properties, attributes (`aria-…`, `data-…`, `role`), listeners (`on…`) and children.
 * @template {keyof HTMLElementTagNameMap} K
 * @param {K} tag @param {Properties} [properties] @param {(Node | string)[]} children @returns {HTMLElementTagNameMap[K]}
 */
export const element = (tag, properties = {}, ...children) => {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (typeof value === "function") made.addEventListener(name.slice(2), value);
    else if (name.includes("-") || name === "role" || name === "for") made.setAttribute(name, String(value));
    else if (value !== undefined) /** @type {any} */ (made)[name] = value;
  }
  made.append(...children);
  return made;
};

/** A button that is pressed or not. @param {string} label @param {boolean} pressed @param {(pressed: boolean) => void} act @param {Properties} [more] */
export const toggle = (label, pressed, act, more = {}) => {
  const made = element("button", {
    type: "button", className: "sky-chip", "aria-pressed": String(pressed), ...more,
    onclick: () => {
      const now = made.getAttribute("aria-pressed") !== "true";
      made.setAttribute("aria-pressed", String(now));
      act(now);
    },
  }, element("span", { textContent: label }));
  return made;
};

/** Set a text without touching the page where it is the same. @param {Node} node @param {string} text */
export const setText = (node, text) => {
  if (node.textContent !== text) node.textContent = text;
};

/**
 * Replace the children of an element; what has the focus hands it to what takes its place.
 * @param {HTMLElement} parent @param {Node[]} children
 */
export const replaceChildren = (parent, ...children) => {
  const reachable = () => /** @type {HTMLElement[]} */ ([...parent.querySelectorAll("button, input, select, [tabindex]")]);
  const focused = reachable().findIndex((one) => one === document.activeElement);
  parent.replaceChildren(...children);
  if (focused >= 0) reachable()[Math.min(focused, reachable().length - 1)]?.focus({ preventScroll: true });
};

/**
 * The context of a canvas whose pixels fit its box, with the size in CSS pixels; null where it has no size.
 * @param {HTMLCanvasElement} canvas @param {number} [most] pixels of the screen per CSS pixel at most
 */
export const fitCanvas = (canvas, most = 2) => {
  const width = canvas.clientWidth, height = canvas.clientHeight, ratio = Math.min(window.devicePixelRatio || 1, most), context = canvas.getContext("2d");
  if (!width || !height || !context) return null;
  const wide = Math.round(width * ratio), high = Math.round(height * ratio);
  if (canvas.width !== wide || canvas.height !== high) {
    canvas.width = wide;
    canvas.height = high;
  }
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return { context, width, height, ratio };
};

/** 75.25 as 1:15.2. @param {number} time @param {number} [digits] */
export const clockText = (time, digits = 1) => {
  const scale = 10 ** digits, all = Math.round(Math.abs(time) * scale), minutes = Math.floor(all / scale / 60), seconds = (all - minutes * 60 * scale) / scale;
  return (time < 0 && all ? "−" : "") + minutes + ":" + seconds.toFixed(digits).padStart(digits ? 3 + digits : 2, "0");
};

/** A round step near a number, such as 1, 2, 5 or 10. @param {number} about */
export const roundStep = (about) => {
  const base = 10 ** Math.floor(Math.log10(Math.max(about, 1e-9))), part = about / base;
  return base * (part < 1.5 ? 1 : part < 3.5 ? 2 : part < 7.5 ? 5 : 10);
};

/** `decision.approval_requested` as `approval requested`. @param {string} kind */
export const kindText = (kind) => kind.replace(/^(decision|event|mishap)\./, "").replaceAll("_", " ").replaceAll(".", " ");

/** A text whose numbers have two decimals at most. @param {string} text */
export const rounded = (text) => text.replace(/(\.\d\d)\d+/g, "$1");

/** @param {string} text @param {number} most */
export const shortened = (text, most) => (text.length > most ? text.slice(0, most - 1) + "…" : text);
