// Viewer of flights: mounts stage, player, timeline and panel in an element and reads a source.
import { applyAddress, keepAddress } from "./address.js";
import { Camera } from "./camera.js";
import { controlStage } from "./controls.js";
import { makeFlatRenderer } from "./flat.js";
import { Frame } from "./frame.js";
import { Inspector } from "./inspector.js";
import { describeNode, LabelLayer } from "./labels.js";
import { clockText, element, setText } from "./page-parts.js";
import { Player } from "./player.js";
import { makeRenderer } from "./renderer.js";
import { RecordClient } from "./record-client.js";
import { readSource } from "./source.js";
import { Store } from "./store.js";
import { readTheme, watchTheme } from "./theme.js";
import { Timeline } from "./timeline.js";
import { armBar, toolBar } from "./toolbar.js";
import { TrailSet } from "./trails.js";
import { TwinChart } from "./twin-chart.js";
/** @import { Scene } from "./scene.js" */
/** @import { Source } from "./source.js" */
/** @import { Theme } from "./theme.js" */
const GATHER_MS = 500;
const PANEL_MS = 100;
const MOST_PIXELS = 3.2e6;

/** @typedef {{store: Store, camera: Camera, drawCalls: () => number, unmount: () => void}} Viewer */

/** Say in plain words that something failed. @param {HTMLElement} host @param {string} title @param {string} text */
export const showFailure = (host, title, text) => {
  host.classList.add("sky-viewer");
  host.replaceChildren(element("div", { className: "sky-failure", role: "alert" }, element("h2", { textContent: title }), element("p", { textContent: text })));
};

/** The picture: WebGL 2, or a 2-D canvas where there is none. @param {HTMLElement} stage @param {Store} store @param {Theme} theme @param {TrailSet[]} trails */
const makePicture = (stage, store, theme, trails) => {
  const canvas = () => element("canvas", { className: "sky-picture", "aria-hidden": "true" });
  const plain = new URLSearchParams(location.search).has("flat");
  let picture = canvas(), renderer = plain ? null : makeRenderer(picture, store, theme, trails), flat = false;
  const withoutGl = () => {
    const other = canvas();
    if (picture.parentNode) picture.replaceWith(other);
    picture = other;
    flat = true;
    renderer = makeFlatRenderer(picture, store, theme, trails);
    if (store.scene) renderer.setScene(store.scene);
    return renderer;
  };
  if (!renderer) withoutGl();
  stage.prepend(picture);
  return {
    calls: () => renderer?.calls() ?? 0,
    setScene: (/** @type {Scene} */ scene) => renderer?.setScene(scene),
    /** Copy what was drawn in this task. @param {HTMLCanvasElement} still */
    copyTo: (still) => {
      still.width = picture.width;
      still.height = picture.height;
      still.getContext("2d")?.drawImage(picture, 0, 0);
    },
    draw: (/** @type {Frame} */ frame, /** @type {Camera} */ camera) => {
      const width = stage.clientWidth, height = stage.clientHeight, ratio = Math.min(window.devicePixelRatio || 1, 2, Math.sqrt(MOST_PIXELS / Math.max(width * height, 1)));
      if (!width || !height) return false;
      if (!flat && (picture.width !== Math.round(width * ratio) || picture.height !== Math.round(height * ratio))) {
        picture.width = Math.round(width * ratio);
        picture.height = Math.round(height * ratio);
      }
      if (width !== camera.width || height !== camera.height) {
        camera.update(width, height);
        if (!camera.touched) camera.fit(store.bounds);
      }
      camera.update(width, height);
      if (!renderer?.draw(frame, camera)) withoutGl().draw(frame, camera);
      return true;
    },
  };
};

/**
 * Show flights in an element.
 * @param {HTMLElement} host @param {Source} source @param {{whole?: boolean, record?: string, scans?: string}} [options] whole: the page is the viewer's alone; record: where the server answers about the record; scans: and about scans
 * @returns {Viewer}
 */
export const mount = (host, source, { whole = false, record = "", scans = "" } = {}) => {
  host.classList.add("sky-viewer");
  host.classList.toggle("sky-whole", whole);
  const store = new Store(), camera = new Camera(), frame = new Frame(), theme = watchTheme(host, () => store.changed("data"));
  /** @type {TrailSet[]} */
  const trails = [];
  const verdict = element("p", { className: "sky-verdict" }), facts = element("p", { className: "sky-about" }), notice = element("p", { className: "sky-notice", role: "status" });
  const over = element("canvas", { className: "sky-over", "aria-hidden": "true" }), tip = element("div", { className: "sky-tip", hidden: true });
  const still = element("canvas", { className: "sky-still", "aria-hidden": "true" }), printed = element("p", { className: "sky-printed" });
  const stage = element("div", { className: "sky-stage", tabIndex: 0, role: "application", "aria-label": "Flights in three dimensions. Arrow keys turn, shift and arrow keys move, plus and minus zoom, f shows all, c follows what is chosen, n and p choose an aircraft, escape lets go of it, space plays." }, over);
  const picture = makePicture(stage, store, theme, trails), labels = new LabelLayer(over, store, theme);
  const showTip = (/** @type {string} */ text, /** @type {number} */ x, /** @type {number} */ y) => {
    tip.hidden = !text;
    setText(tip, text);
    const box = host.getBoundingClientRect(), right = x - box.left > box.width * 0.65;
    tip.style.left = right ? "auto" : `${x - box.left + 14}px`;
    tip.style.right = right ? `${box.right - x + 14}px` : "auto";
    const low = y - box.top > box.height * 0.65;
    tip.style.top = low ? "auto" : `${y - box.top + 14}px`;
    tip.style.bottom = low ? `${box.bottom - y + 10}px` : "auto";
  };
  const choose = (/** @type {number} */ node) => {
    store.show({ selected: node });
    store.changed("data");
  };
  const timeline = new Timeline(store, theme, showTip), player = new Player(store, (by) => timeline.stepAll(by)), inspector = new Inspector(store, theme, choose, record ? new RecordClient(record) : null, scans ? new RecordClient(scans) : null), twins = new TwinChart(store, theme);
  const arms = armBar(store), tools = toolBar(store, camera);
  const waiting = element("p", { className: "sky-waiting", role: "status", textContent: source.kind === "socket" ? "Connecting …" : "Loading …" });
  const hint = element("p", { className: "sky-hint", textContent: window.matchMedia("(pointer: coarse)").matches ? "one finger turns · two move and zoom" : `drag turns · shift-drag moves · ${whole ? "" : "click, then "}wheel zooms${whole ? "" : " (or ctrl)"}` });
  stage.append(still, waiting, hint, tip);
  host.replaceChildren(
    element("header", { className: "sky-head" }, element("div", { className: "sky-words" }, verdict, facts, printed, notice), arms.root),
    element("div", { className: "sky-main" }, element("div", { className: "sky-view" }, stage, tools.root, twins.root), inspector.root),
    element("footer", { className: "sky-dock" }, player.root, timeline.root),
  );
  host.append(tip);

  const showWords = (/** @type {Scene} */ scene) => {
    setText(verdict, scene.verdict || scene.name);
    const left = scene.leftOut.map(([what, shown, all]) => `${shown.toLocaleString("en")} of ${all.toLocaleString("en")} ${what}`);
    setText(facts, [scene.verdict ? scene.name : "", `${scene.vehicles.length.toLocaleString("en")} aircraft`, scene.flying ? "flying" : "", left.length ? "shown: " + left.join(", ") : ""].filter(Boolean).join(" · "));
    waiting.hidden = true;
  };
  store.positionListeners.push((news) => {
    if (news.layer === "truth") trails[news.arm]?.add(news);
  });
  const place = [0, 0, 0, 0];
  let known = "", fitted = "", gathered = 0, pause = GATHER_MS, painted = 0, selected = -1, gathering = 0;
  const gather = () => {
    gathering = 0;
    gathered = performance.now();
    if (!store.scene) return;
    timeline.gather();
    twins.gather();
    pause = Math.max(GATHER_MS, (performance.now() - gathered) * 20);
  };
  store.subscribe((changes) => {
    const { scene, view } = store, now = performance.now();
    if (!scene) return;
    if (changes.scene) {
      const key = scene.arms.map((arm) => arm.id).join() + scene.vehicles.map((one) => one.id).join();
      if (known !== key) {
        known = key;
        applyAddress(store, scene, camera);
      }
      showWords(scene);
      arms.update(scene);
      tools.update(scene);
      picture.setScene(scene);
    }
    const bounds = [...store.bounds.low, ...store.bounds.high].join();
    if (!camera.touched && bounds !== fitted) camera.fit(store.bounds);
    fitted = bounds;
    if (view.chasing && store.nodePlace(Math.max(view.arms.indexOf(true), 0), view.selected, view.time, place)) {
      camera.target = place.slice(0, 3);
      camera.touched = true;
    }
    if (changes.data || changes.scene) setText(notice, store.notice);
    frame.compose(store, scene, theme, trails);
    if (picture.draw(frame, camera)) labels.draw(frame, camera, scene);
    timeline.place();
    if (changes.data) {
      if (selected !== view.selected || now - gathered > pause) gather();
      else gathering ||= window.setTimeout(gather, pause);
      selected = view.selected;
    }
    if (now - painted > PANEL_MS || !view.playing) {
      painted = now;
      inspector.update();
      twins.paint();
      tools.refresh();
    }
  });
  controlStage(stage, camera, store, whole, {
    pick: (x, y) => labels.pick(x, y),
    choose,
    hover: (node, x, y) => {
      const box = stage.getBoundingClientRect();
      showTip(node >= 0 ? describeNode(store, node) : "", x + box.left, y + box.top);
      stage.classList.toggle("sky-pointing", node >= 0);
      if (store.view.hovered !== node) store.show({ hovered: node });
    },
    step: (by) => {
      const count = store.scene?.vehicles.length ?? 0;
      if (count) choose((((store.view.selected < 0 ? (by > 0 ? -1 : 0) : store.view.selected) + by) % count + count) % count);
    },
  });
  const keys = (/** @type {KeyboardEvent} */ event) => {
    if (event.defaultPrevented || !(whole || host.contains(/** @type {Node} */ (event.target)))) return;
    if (event.key === "Escape" && store.view.selected >= 0) choose(-1);
    else player.key(event);
  };
  /** Show a still on light ground, or the picture again. @param {boolean} paper */
  const print = (paper) => {
    if (host.classList.contains("sky-print") === paper) return;
    host.classList.toggle("sky-print", paper);
    readTheme(host, theme);
    if (store.scene) store.tell();
    timeline.paint();
    twins.paint();
    if (!paper) return;
    picture.copyTo(still);
    still.getContext("2d")?.drawImage(over, 0, 0, still.width, still.height);
    const { end } = store.span();
    setText(printed, `A still at ${clockText(store.view.time)} of ${clockText(end, 0)}. In a browser, the flights play.`);
  };
  const resized = new ResizeObserver(() => store.changed()), onPaper = window.matchMedia("print"), leaving = new AbortController(), { signal } = leaving;
  document.addEventListener("keydown", keys, { signal });
  window.addEventListener("beforeprint", () => print(true), { signal });
  window.addEventListener("afterprint", () => print(false), { signal });
  onPaper.addEventListener("change", () => print(onPaper.matches), { signal });
  resized.observe(stage);
  keepAddress(store, camera, whole);
  // the scene's trails have to be there before its positions come
  const takeScene = store.takeScene.bind(store);
  store.takeScene = (message) => {
    const before = store.arms;
    takeScene(message);
    if (store.arms !== before) trails.splice(0, trails.length, ...store.arms.map(() => new TrailSet()));
  };
  const stop = readSource(source, store, (error) => {
    if (store.scene) {
      store.notice = error.message;
      store.changed("data");
    } else showFailure(host, "The flight cannot be shown", error.message);
  });
  return {
    store,
    camera,
    drawCalls: () => picture.calls(),
    unmount: () => {
      stop();
      resized.disconnect();
      leaving.abort();
      host.replaceChildren();
    },
  };
};
