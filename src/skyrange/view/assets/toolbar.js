// Bars of switches: arms, operators, layers and views.
import { element, toggle } from "./page-parts.js";
/** @import { Camera } from "./camera.js" */
/** @import { Scene } from "./scene.js" */
/** @import { LayerName, Store } from "./store.js" */
/** @type {[LayerName, string, string][]} */
const LAYERS = [
  ["belief", "Beliefs", "Rings: where autopilots believe to be"], ["station", "Stations", "Dots: where ground stations last heard their aircraft"], ["claims", "Lies", "Red ghosts: places that broadcasts claim falsely"],
  ["radio", "Radio", "Lines: broadcasts that were received"], ["volumes", "Airspace", "Claimed and closed volumes"], ["trails", "Trails", "The last 30 s"], ["names", "Names", "Names of aircraft"], ["buildings", "City", "Buildings"],
];

/** Switches of arms, and of operators. @param {Store} store */
export const armBar = (store) => {
  const root = element("div", { className: "sky-switches" });
  return {
    root,
    /** @param {Scene} scene */
    update: (scene) => {
      const arms = element("div", { className: "sky-group", role: "group", "aria-label": "Arms shown" });
      scene.arms.forEach((arm, place) => {
        const made = toggle(arm.title || "run", store.view.arms[place], (shown) => {
          store.view.arms = store.view.arms.map((was, i) => (i === place ? shown : was));
          store.changed("data");
        });
        made.prepend(element("span", { className: place === 0 ? "sky-arm" : "sky-arm sky-faint", "aria-hidden": "true" }));
        if (arm.status) made.append(element("span", { className: arm.bad ? "sky-status sky-bad" : "sky-status", textContent: arm.status }));
        arms.append(made);
      });
      const operators = element("div", { className: "sky-group", role: "group", "aria-label": "Operators shown" });
      scene.operators.forEach((operator, place) => {
        const count = scene.vehicles.filter((one) => one.operator === place).length;
        const made = toggle(`${operator.id} ${count}`, store.view.operators[place], (shown) => {
          store.view.operators = store.view.operators.map((was, i) => (i === place ? shown : was));
          store.changed();
        });
        const swatch = element("span", { className: "sky-swatch sky-inked" });
        swatch.style.setProperty("--ink-light", operator.ink[0]);
        swatch.style.setProperty("--ink-dark", operator.ink[1]);
        made.prepend(swatch);
        operators.append(made);
      });
      root.replaceChildren(...(scene.arms.length > 1 || scene.arms[0].status ? [arms] : []), ...(scene.operators.length > 1 ? [operators] : []));
    },
  };
};

/** Switches of layers and views, above the stage. @param {Store} store @param {Camera} camera */
export const toolBar = (store, camera) => {
  const view = (/** @type {string} */ label, /** @type {boolean} */ top, /** @type {string} */ title) =>
    element("button", { type: "button", className: "sky-chip", textContent: label, title, onclick: () => {
      camera.fit(store.bounds, top);
      store.changed();
    } });
  const views = element("div", { className: "sky-group", role: "group", "aria-label": "View" }, view("3-D", false, "See all flights from the side (f)"), view("Top", true, "See all flights from above"));
  const layers = element("div", { className: "sky-group", role: "group", "aria-label": "Layers" });
  /** @type {[LayerName | "everyone", HTMLButtonElement][]} */
  const buttons = [];
  for (const [name, label, title] of LAYERS) {
    const made = toggle(label, true, (shown) => {
      store.view.layers[name] = shown;
      store.changed();
    }, { title });
    buttons.push([name, made]);
    layers.append(made);
  }
  const scope = toggle("of all aircraft", true, (everyone) => store.show({ everyone }), { title: "Show beliefs and stations of all aircraft, or of the selected one only" });
  buttons.push(["everyone", scope]);
  layers.insertBefore(scope, layers.children[2]);
  const chase = toggle("Follow", false, (chasing) => store.show({ chasing }), { title: "Keep the selected aircraft in the middle (c)", hidden: true });
  const [side, above] = /** @type {HTMLButtonElement[]} */ ([...views.children]);
  views.append(chase);
  const root = element("div", { className: "sky-tools" }, views, layers);
  return {
    root,
    /** @param {Scene} scene */
    update: (scene) => {
      for (const [name, made] of buttons) made.hidden = (name === "buildings" && !scene.buildings.heights.length) || (name === "volumes" && !scene.volumes.length);
    },
    refresh: () => {
      chase.hidden = store.view.selected < 0;
      for (const [made, pressed] of /** @type {[HTMLButtonElement, boolean][]} */ ([[chase, store.view.chasing], [side, !camera.top], [above, camera.top]])) made.setAttribute("aria-pressed", String(pressed));
      for (const [name, made] of buttons) {
        const pressed = String(name === "everyone" ? store.view.everyone : store.view.layers[name]);
        if (made.getAttribute("aria-pressed") !== pressed) made.setAttribute("aria-pressed", pressed);
      }
    },
  };
};
