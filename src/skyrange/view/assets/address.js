// Address of the page: a view that is kept in its hash or query, so that a link shows it again.
/** @import { Camera } from "./camera.js" */
/** @import { Scene } from "./scene.js" */
/** @import { Store } from "./store.js" */
const WRITE_MS = 400;

/** Parameters of the address, those of the hash before those of the query. @returns {URLSearchParams} */
const readAddress = () => {
  const found = new URLSearchParams(location.search), hash = location.hash.slice(1);
  if (hash.includes("=")) new URLSearchParams(hash).forEach((value, name) => found.set(name, value));
  return found;
};

/** Show what the address asks for; the scene has to be known. @param {Store} store @param {Scene} scene @param {Camera} camera */
export const applyAddress = (store, scene, camera) => {
  const asked = readAddress(), { view } = store, time = Number(asked.get("t") ?? NaN), arms = asked.get("arms"), node = scene.nodes.get(asked.get("select") ?? "");
  if (Number.isFinite(time)) Object.assign(view, { time: Math.min(Math.max(time, scene.start), Math.max(scene.end, scene.flying ? time : 0)), following: false, playing: false });
  if (node !== undefined) view.selected = node;
  if (arms) {
    const wanted = arms.split(","), shown = scene.arms.map((arm) => wanted.includes(arm.id));
    if (shown.includes(true)) view.arms = shown;
  }
  camera.read(asked.get("camera") ?? "");
};

/** Keep the address up to date, while nothing plays. @param {Store} store @param {Camera} camera @param {boolean} whole whether the page is the viewer's alone */
export const keepAddress = (store, camera, whole) => {
  window.addEventListener("hashchange", () => {
    if (!store.scene || !location.hash.includes("=")) return;
    applyAddress(store, store.scene, camera);
    store.changed("data");
  });
  let timer = 0, before = "", used = whole;
  const write = () => {
    timer = 0;
    const { view, scene } = store;
    if (!scene) return;
    const parts = [`t=${view.time.toFixed(1)}`];
    if (view.selected >= 0) parts.push("select=" + encodeURIComponent(store.nodeName(view.selected)).replaceAll("%2F", "/"));
    if (view.arms.includes(false)) parts.push("arms=" + scene.arms.filter((_, arm) => view.arms[arm]).map((arm) => encodeURIComponent(arm.id)).join(","));
    if (camera.touched) parts.push("camera=" + camera.text());
    const hash = "#" + parts.join("&");
    if (hash === before) return;
    const known = before !== "";
    before = hash;
    if (!known && !used) return;
    try {
      history.replaceState(history.state, "", hash);
    } catch {
      used = false;
    }
  };
  store.subscribe(() => {
    used ||= camera.touched || store.view.selected >= 0;
    if (!timer && !store.view.playing) timer = window.setTimeout(write, WRITE_MS);
  });
};
