// Controls of the camera and the stage: mouse, touch and keys.
/** @import { Camera } from "./camera.js" */
/** @import { Store } from "./store.js" */
/** @typedef {{pick: (x: number, y: number) => number, choose: (node: number) => void, hover: (node: number, x: number, y: number) => void, step: (by: number) => void}} StageActions */
const TURN_PER_PIXEL = 0.006;
const CLICK_PIXELS = 5;

/**
 * @param {HTMLElement} stage @param {Camera} camera @param {Store} store @param {boolean} whole whether the page is the viewer's alone
 * @param {StageActions} act
 */
export const controlStage = (stage, camera, store, whole, act) => {
  /** @type {Map<number, {x: number, y: number}>} */
  const fingers = new Map();
  let travelled = 0, entered = whole, stood = { yaw: 0, pitch: 0, touched: false };
  const changed = () => store.changed();
  const local = (/** @type {PointerEvent | WheelEvent} */ event) => {
    const box = stage.getBoundingClientRect();
    return { x: event.clientX - box.left, y: event.clientY - box.top };
  };
  const enter = (/** @type {boolean} */ inside) => {
    entered = inside || whole;
    stage.classList.toggle("entered", entered);
  };
  enter(false);
  stage.addEventListener("pointerdown", (event) => {
    stage.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    if (fingers.size === 1) {
      travelled = 0;
      stood = { yaw: camera.yaw, pitch: camera.pitch, touched: camera.touched };
    }
    act.hover(-1, 0, 0);
  });
  stage.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId), { x, y } = local(event);
    if (!before) {
      if (event.pointerType === "mouse") act.hover(act.pick(x, y), x, y);
      return;
    }
    const dx = event.clientX - before.x, dy = event.clientY - before.y;
    travelled += Math.abs(dx) + Math.abs(dy);
    fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    if (fingers.size > 1) {
      const [a, b] = [...fingers.values()], other = a.x === event.clientX && a.y === event.clientY ? b : a;
      const was = Math.hypot(before.x - other.x, before.y - other.y), now = Math.hypot(event.clientX - other.x, event.clientY - other.y);
      if (was > 8 && now > 8) camera.zoom(was / now);
      camera.move(dx / 2, dy / 2);
    } else if (travelled > CLICK_PIXELS) {
      if (event.shiftKey || event.buttons & 6 || camera.top) {
        store.view.chasing = false;
        camera.move(dx, dy);
      }
      else camera.turn(dx * TURN_PER_PIXEL, dy * TURN_PER_PIXEL);
    }
    changed();
  });
  const release = (/** @type {PointerEvent} */ event) => {
    if (!fingers.delete(event.pointerId) || fingers.size) return;
    if (event.type === "pointercancel") Object.assign(camera, stood);        // the finger scrolls the page
    if (event.type === "pointerup" && travelled <= CLICK_PIXELS) {
      enter(true);
      const { x, y } = local(event);
      act.choose(act.pick(x, y));
    }
    changed();
  };
  stage.addEventListener("pointerup", release);
  stage.addEventListener("pointercancel", release);
  stage.addEventListener("pointerleave", () => act.hover(-1, 0, 0));
  stage.addEventListener("blur", () => enter(false));
  stage.addEventListener("contextmenu", (event) => event.preventDefault());
  stage.addEventListener("dblclick", () => {
    camera.fit(store.bounds);
    changed();
  });
  stage.addEventListener("wheel", (event) => {
    if (!entered && !event.ctrlKey) return;
    event.preventDefault();
    const { x, y } = local(event), factor = Math.exp(Math.min(Math.max(event.deltaY * (event.deltaMode ? 30 : 1), -300), 300) * 0.0015);
    camera.move((camera.width / 2 - x) * (1 - factor), (camera.height / 2 - y) * (1 - factor));
    camera.zoom(factor);
    changed();
  }, { passive: false });
  stage.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const arrow = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
    if (arrow && (event.shiftKey || camera.top)) camera.move(arrow[0] * 40, arrow[1] * 40);
    else if (arrow) camera.turn(arrow[0] * -0.08, arrow[1] * 0.06);
    else if (event.key === "+" || event.key === "=") camera.zoom(0.85);
    else if (event.key === "-") camera.zoom(1 / 0.85);
    else if (event.key === "f" || event.key === "Home") camera.fit(store.bounds);
    else if (event.key === "n" || event.key === "p") act.step(event.key === "n" ? 1 : -1);
    else if (event.key === "c") store.show({ chasing: !store.view.chasing });
    else if (event.key === "Escape") {
      act.choose(-1);
      enter(false);
    } else return;
    event.preventDefault();
    changed();
  });
};
