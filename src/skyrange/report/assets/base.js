// Data and state shared by the page's parts: the unpacked run, the clock, the focus, and small helpers.
const $ = (id) => document.getElementById(id);
const RUN = JSON.parse(await unpackText($("run").textContent));
const sums = (steps, scale) => {
  const out = new Float64Array(steps.length);
  let total = 0;
  for (let i = 0; i < steps.length; i++) out[i] = (total += steps[i]) * scale;
  return out;
};
const unpack = (raw) => {
  const column = (key) => sums(raw[key], 0.01);
  return { size: raw.t.length, t: column("t"), e: column("e"), n: column("n"), u: column("u"), x: column("x") };
};
RUN.vehicles.forEach((v, i) => {
  v.index = i;
  v.truth = unpack(v.truth);
  v.belief = unpack(v.belief);
});
// Row of the last sample not after t, or -1.
const rowAt = (track, t) => {
  let low = -1, high = track.size;
  while (high - low > 1) {
    const mid = (low + high) >> 1;
    if (track.t[mid] <= t) low = mid; else high = mid;
  }
  return low;
};
// [east, north, up, fourth] at t, held at both ends; null without samples.
const at = (track, t) => {
  if (!track.size) return null;
  const i = Math.max(rowAt(track, t), 0), j = Math.min(i + 1, track.size - 1);
  const f = Math.min(Math.max((t - track.t[i]) / (track.t[j] - track.t[i] || 1), 0), 1);
  const mix = (column) => column[i] + (column[j] - column[i]) * f;
  return [mix(track.e), mix(track.n), mix(track.u), mix(track.x)];
};

const scheme = matchMedia("(prefers-color-scheme: dark)");
let theme = {};
const readTheme = () => {
  const style = getComputedStyle(document.documentElement);
  theme = { dark: scheme.matches };
  for (const name of ["card", "ink0", "dim", "rule", "accent"]) {
    let value = style.getPropertyValue("--" + name).trim();
    if (value.length === 4) value = "#" + [...value.slice(1)].map((c) => c + c).join("");
    theme[name] = value;
  }
};
readTheme();
const ink = (thing) => thing.ink[theme.dark ? 1 : 0];

// The shared state, which is the viewer's where the page has one; whoever draws registers with `onChange` and is called
// once a frame when something changed.
const state = { t: RUN.end, focus: -1, shown: RUN.operators.map(() => true) };
// What has scrolled out of sight is not drawn.
const listeners = [];
let pending = false;
const sight = new IntersectionObserver((entries) => {
  for (const entry of entries) for (const one of listeners) if (one.where === entry.target) one.seen = entry.isIntersecting;
  changed();
}, { rootMargin: "80px" });
const onChange = (draw, where = null) => {
  listeners.push({ draw, where, seen: !where });
  if (where) sight.observe(where);
};
const changed = () => {
  if (pending) return;
  pending = true;
  requestAnimationFrame(() => {
    pending = false;
    for (const one of listeners) if (one.seen) one.draw();
  });
};
scheme.addEventListener("change", () => { readTheme(); changed(); });
const clamped = (t) => Math.min(Math.max(t, RUN.start), RUN.end);
const setTime = (t) => {
  if (viewer) viewer.store.seek(clamped(t));
  else { state.t = clamped(t); changed(); }
};
const setFocus = (index) => {
  if (state.focus === index) return;
  if (viewer) viewer.store.show({ hovered: index });
  else { state.focus = index; changed(); }
};
const followViewer = () => {
  const { view, scene } = viewer.store;
  if (!scene) return;
  const focus = view.hovered >= 0 ? view.hovered : view.selected, now = { t: clamped(view.time), focus: focus < RUN.vehicles.length ? focus : -1, shown: [...view.operators] };
  if (now.t === state.t && now.focus === state.focus && now.shown.join() === state.shown.join()) return;
  Object.assign(state, now);
  changed();
};
const followAddress = () => {
  const asked = new URLSearchParams(location.hash.slice(1)), t = Number(asked.get("t") ?? NaN);
  if (!Number.isFinite(t)) return;
  state.focus = RUN.vehicles.findIndex((v) => v.id === asked.get("select"));
  setTime(t);
};
if (viewer) {
  viewer.store.subscribe(followViewer);
  followViewer();
} else {
  addEventListener("hashchange", followAddress);
  followAddress();
}
const visible = (v) => state.shown[v.op];

const seconds = (t) => t < 100 ? t.toFixed(1) + " s" : Math.floor(t / 60) + " min " + (t % 60).toFixed(0).padStart(2, "0") + " s";
const niceStep = (span, about) => {
  const rough = Math.max(span, 1e-9) / about, power = 10 ** Math.floor(Math.log10(rough));
  return [1, 2, 5, 10].find((f) => f * power >= rough * 0.999) * power;
};
const tickText = (value, step) => {
  const text = value.toFixed(Math.max(0, -Math.floor(Math.log10(step) + 1e-9)));
  return (Number(text) === 0 ? "0" : text).replace("-", "−");
};
const make = (tag, props = {}, ...children) => {
  const node = document.createElement(tag);
  for (const [key, value] of Object.entries(props)) {
    if (key.includes("-") || key === "role") node.setAttribute(key, value); else node[key] = value;
  }
  node.append(...children);
  return node;
};
// Fit a canvas to its box and the display; returns its context scaled to CSS pixels, or null while it has no size.
const fit = (canvas) => {
  const w = canvas.clientWidth, h = canvas.clientHeight, ratio = Math.min(devicePixelRatio || 1, 2);
  if (!w || !h) return null;
  if (canvas.width !== Math.round(w * ratio) || canvas.height !== Math.round(h * ratio)) {
    canvas.width = Math.round(w * ratio);
    canvas.height = Math.round(h * ratio);
  }
  const ctx = canvas.getContext("2d");
  ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
  ctx.clearRect(0, 0, w, h);
  return { ctx, w, h };
};
const FONT = "12px system-ui,-apple-system,'Segoe UI',Roboto,sans-serif";

// A read-out that follows the pointer; lines are [swatch colour or "", label, value].
const tip = $("tip");
const showTip = (x, y, title, lines) => {
  tip.replaceChildren(make("b", { textContent: title }));
  for (const [colour, label, value] of lines) {
    const name = make("span", { textContent: label });
    if (colour) {
      const swatch = make("span", { className: "swatch" });
      swatch.style.setProperty("--ink", colour);
      name.prepend(swatch);
    }
    tip.append(make("div", { className: "row" }, name, make("span", { textContent: value })));
  }
  tip.hidden = false;
  const box = tip.getBoundingClientRect();
  tip.style.left = Math.min(x + 14, innerWidth - box.width - 8) + "px";
  tip.style.top = (y + 16 + box.height > innerHeight ? y - box.height - 12 : y + 16) + "px";
};
const hideTip = () => { tip.hidden = true; };
