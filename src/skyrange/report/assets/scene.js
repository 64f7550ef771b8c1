// Three-dimensional scene: a movable camera, a renderer, and a canvas of names and symbols above it.
const bounds = (() => {
  const low = [Infinity, Infinity, 0], high = [-Infinity, -Infinity, 1];
  const take = (e, n, u) => [e, n, u].forEach((x, k) => { low[k] = Math.min(low[k], x); high[k] = Math.max(high[k], x); });
  for (const v of RUN.vehicles) {
    for (let i = 0; i < v.truth.size; i++) take(v.truth.e[i], v.truth.n[i], v.truth.u[i]);
    if (v.home) take(...v.home);
  }
  if (low[0] > high[0]) { take(-10, -10, 0); take(10, 10, 5); }
  return { mid: low.map((x, k) => (x + high[k]) / 2), size: Math.max(Math.hypot(high[0] - low[0], high[1] - low[1]), high[2] - low[2], 10) };
})();

const makeCamera = () => {
  const camera = { yaw: -0.62, pitch: 0.5, distance: 1, target: [...bounds.mid], matrix: new Float32Array(16), eye: [0, 0, 0] };
  const fov = 0.62;
  camera.home = (yaw = -0.62, pitch = 0.46) => {
    Object.assign(camera, { yaw, pitch, target: [...bounds.mid] });
    camera.distance = (bounds.size * 0.5) / Math.tan(fov / 2) * 0.84;
  };
  camera.home();
  camera.update = (w, h) => {
    const { yaw, pitch, distance, target } = camera, cp = Math.cos(pitch), sp = Math.sin(pitch), cy = Math.cos(yaw), sy = Math.sin(yaw);
    const back = [-sy * cp, -cy * cp, sp];                           // from the target to the eye; yaw 0 looks north
    const right = [cy, -sy, 0];
    const up = [back[1] * right[2] - back[2] * right[1], back[2] * right[0] - back[0] * right[2], back[0] * right[1] - back[1] * right[0]];
    const eye = target.map((x, k) => x + back[k] * distance);
    camera.eye = eye;
    const f = 1 / Math.tan(fov / 2), near = distance * 0.02, far = distance * 12 + bounds.size * 4, deep = 1 / (near - far);
    const dot = (a) => -(a[0] * eye[0] + a[1] * eye[1] + a[2] * eye[2]);
    const sx = f / Math.max(w / h, 0.6), rows = [[...right, dot(right)].map((x) => x * sx), [...up, dot(up)].map((x) => x * f), [...back, dot(back)]];
    const m = camera.matrix;
    for (let k = 0; k < 4; k++) {
      m[k * 4] = rows[0][k];
      m[k * 4 + 1] = rows[1][k];
      m[k * 4 + 2] = rows[2][k] * (near + far) * deep + (k === 3 ? 2 * near * far * deep : 0);
      m[k * 4 + 3] = -rows[2][k];
    }
    camera.project = (e, n, u) => {
      const part = (i) => m[i] * e + m[i + 4] * n + m[i + 8] * u + m[i + 12], depth = part(3);
      return depth < near ? null : [(part(0) / depth * 0.5 + 0.5) * w, (0.5 - part(1) / depth * 0.5) * h, depth];
    };
    camera.metre = (h / 2) * f / distance;                            // pixels per metre at the target
  };
  return camera;
};

const buildScene = () => {
  const stage = $("stage");
  let picture = make("canvas", { "aria-hidden": "true" }), plain = false;
  const over = make("canvas", { className: "over", tabIndex: 0, role: "application",
    "aria-label": "Flight in three dimensions. Arrow keys turn, shift and arrow keys move, plus and minus zoom, n and p choose an aircraft, escape lets go of it, space plays, home resets." });
  stage.prepend(picture, over);
  let render = glRenderer(picture);
  const withoutGl = () => {
    const other = make("canvas", { "aria-hidden": "true" });
    picture.replaceWith(other);
    picture = other;
    plain = true;
    render = flatRenderer(picture);
  };
  if (!render) withoutGl();
  $("overview").hidden = true;
  stage.classList.add("live");
  const camera = makeCamera();
  const options = { city: true, belief: false, names: RUN.vehicles.length <= 60, size: bounds.size, dash: Math.max((RUN.end - RUN.start) / 120, 0.5), drift: !stillness.matches, quality: 1, airspace: RUN.airspace.length > 0 && RUN.vehicles.length <= 12 };
  let spots = [], lasting = 1;                                         // the quality that this machine keeps up with in motion
  const fingers = new Map();

  const chip = (label, pressed, act, colour) => {
    const node = make("button", { type: "button", className: "chip", "aria-pressed": String(pressed) });
    if (colour) node.append(make("span", { className: "swatch " + colour }));
    node.append(label);
    node.addEventListener("click", () => { node.setAttribute("aria-pressed", String(act())); changed(); });
    return node;
  };
  const chips = make("div", { className: "chips", role: "group", "aria-label": "Operators shown" });
  RUN.operators.forEach((operator, place) => {
    const count = RUN.vehicles.filter((v) => v.op === place).length;
    chips.append(chip(operator.id + " · " + count, true, () => (state.shown[place] = !state.shown[place]), "op-" + place));
  });
  const view = (label, yaw, pitch) => {
    const node = make("button", { type: "button", className: "chip", textContent: label });
    node.addEventListener("click", () => { options.drift = false; camera.home(yaw, pitch); changed(); });
    return node;
  };
  const tools = make("div", { className: "tools", role: "group", "aria-label": "View" });
  tools.append(view("3-D", -0.62, 0.46), view("Top", 0, 1.5607), view("Side", 0, 0.06),
    chip("Names", options.names, () => (options.names = !options.names)));
  if (RUN.vehicles.some((v) => v.belief.size)) tools.append(chip("Beliefs", false, () => (options.belief = !options.belief)));
  if (RUN.airspace.length) tools.append(chip("Airspace", options.airspace, () => (options.airspace = !options.airspace)));
  if (RUN.buildings.length) tools.append(chip("Buildings", true, () => (options.city = !options.city)));
  stage.append(chips, tools, make("div", { className: "hint", textContent: matchMedia("(pointer: coarse)").matches ? "one finger turns · two move and zoom" : "drag to turn · shift-drag to move · click, then scroll to zoom" }));

  const halo = (ctx, text, x, y) => {
    ctx.lineWidth = 3.5;
    ctx.strokeStyle = theme.dark ? "rgba(8,12,20,.85)" : "rgba(255,255,255,.9)";
    ctx.strokeText(text, x, y);
    ctx.fillText(text, x, y);
  };
  const drawHomes = (ctx) => {
    for (const v of RUN.vehicles) {
      const p = visible(v) && v.home && camera.project(...v.home);
      if (!p) continue;
      ctx.strokeStyle = ink(v);
      ctx.globalAlpha = 0.75;
      ctx.lineWidth = 1.5;
      ctx.beginPath();
      ctx.ellipse(p[0], p[1], 6, Math.max(6 * Math.sin(camera.pitch), 1.5), 0, 0, 7);
      ctx.stroke();
      ctx.globalAlpha = 1;
    }
  };
  const drawAirspace = (ctx) => {                                       // what is claimed or closed now, as prisms
    for (const a of RUN.airspace) {
      if (state.t < a.from || state.t > a.until || (a.v && !visible(a.v))) continue;
      const low = a.ring.map((p) => camera.project(p[0], p[1], a.low)), high = a.ring.map((p) => camera.project(p[0], p[1], a.high));
      if (low.includes(null) || high.includes(null)) continue;
      const near = !a.v || state.focus < 0 || state.focus === a.v.index;
      const trace = (ring) => {
        ctx.moveTo(ring[0][0], ring[0][1]);
        for (const p of ring) ctx.lineTo(p[0], p[1]);
        ctx.closePath();
      };
      ctx.fillStyle = ctx.strokeStyle = a.v ? ink(a.v) : "#e02424";
      ctx.lineWidth = a.v ? 1 : 1.5;
      ctx.beginPath();
      trace(low);
      trace(high);
      low.forEach((p, i) => { ctx.moveTo(p[0], p[1]); ctx.lineTo(high[i][0], high[i][1]); });
      ctx.globalAlpha = near ? 0.5 : 0.15;
      ctx.stroke();
      ctx.beginPath();
      trace(a.v ? high : low);
      ctx.globalAlpha = !a.v ? 0.2 : near ? 0.1 : 0.03;
      ctx.fill();
      ctx.globalAlpha = 1;
      if (a.name) halo(ctx, a.name, low[0][0] + 6, low[0][1] + 14);
    }
  };
  const byWeight = [...RUN.marks].sort((a, b) => Number(a.kind === "collision" || a.kind === "crash") - Number(b.kind === "collision" || b.kind === "crash"));
  const drawMarks = (ctx) => {                                          // what went wrong up to now, where it did
    for (const m of byWeight) {
      const p = m.t <= state.t + 1e-6 && camera.project(...m.at);
      if (!p) continue;
      const violent = m.kind === "collision" || m.kind === "crash", r = violent ? 6 : 7;
      ctx.beginPath();
      if (violent) {
        ctx.moveTo(p[0] - r, p[1] - r); ctx.lineTo(p[0] + r, p[1] + r);
        ctx.moveTo(p[0] + r, p[1] - r); ctx.lineTo(p[0] - r, p[1] + r);
      } else {
        ctx.moveTo(p[0], p[1] - r); ctx.lineTo(p[0] + r, p[1] + r * 0.7); ctx.lineTo(p[0] - r, p[1] + r * 0.7); ctx.closePath();
      }
      ctx.lineCap = "round";
      ctx.strokeStyle = theme.dark ? "#0b0f18" : "#fff";
      ctx.lineWidth = 5.5;
      ctx.stroke();
      ctx.strokeStyle = violent ? "#e02424" : "#e08a00";
      ctx.lineWidth = violent ? 2.8 : 2.2;
      ctx.stroke();
    }
  };
  const drawAircraft = (ctx) => {
    spots = [];
    const taken = [];
    const order = RUN.vehicles.filter((v) => visible(v) && v.truth.size).map((v) => {
      const now = at(v.truth, state.t);
      return { v, now, p: camera.project(now[0], now[1], now[2]) };
    }).filter((s) => s.p).sort((a, b) => b.p[2] - a.p[2]);
    const many = RUN.vehicles.length > 40;
    for (const { v, now, p } of order) {
      const foot = camera.project(now[0], now[1], 0), near = state.focus === v.index;
      ctx.globalAlpha = state.focus < 0 || near ? 1 : 0.4;
      if (foot && now[2] > 0.3) {
        ctx.strokeStyle = ink(v);
        ctx.lineWidth = 1;
        ctx.setLineDash([2, 3]);
        ctx.beginPath();
        ctx.moveTo(p[0], p[1]);
        ctx.lineTo(foot[0], foot[1]);
        ctx.stroke();
        ctx.setLineDash([]);
      }
      const ahead = at(v.truth, state.t + 0.4), q = camera.project(ahead[0], ahead[1], ahead[2]);
      const r = many ? 3.6 : near ? 7 : 5.5;
      if (q && Math.hypot(q[0] - p[0], q[1] - p[1]) > 0.4) {            // a nose in the direction of flight
        const a = Math.atan2(q[1] - p[1], q[0] - p[0]);
        ctx.fillStyle = ink(v);
        ctx.beginPath();
        ctx.moveTo(p[0] + Math.cos(a) * r * 2.1, p[1] + Math.sin(a) * r * 2.1);
        ctx.lineTo(p[0] + Math.cos(a + 1.15) * r, p[1] + Math.sin(a + 1.15) * r);
        ctx.lineTo(p[0] + Math.cos(a - 1.15) * r, p[1] + Math.sin(a - 1.15) * r);
        ctx.fill();
      }
      ctx.beginPath();
      ctx.arc(p[0], p[1], r, 0, 7);
      ctx.fillStyle = ink(v);
      ctx.fill();
      ctx.lineWidth = many ? 1 : 2;
      ctx.strokeStyle = theme.dark ? "#f3f6fb" : "#fff";
      ctx.stroke();
      spots.push({ v, now, x: p[0], y: p[1] });
    }
    ctx.globalAlpha = 1;
    ctx.font = "600 " + FONT;
    ctx.textAlign = "left";
    ctx.textBaseline = "middle";
    for (const { v, x, y } of [...spots].reverse().sort((a, b) => (b.v.index === state.focus) - (a.v.index === state.focus))) {
      if (!options.names && v.index !== state.focus) continue;
      const wide = ctx.measureText(v.short).width, box = [x + 9, y - 16, x + 12 + wide, y];
      if (taken.some((o) => box[0] < o[2] && box[2] > o[0] && box[1] < o[3] && box[3] > o[1])) continue;
      taken.push(box);
      ctx.fillStyle = theme.ink0;
      halo(ctx, v.short, x + 10, y - 9);
    }
  };
  const drawCompass = (ctx, w, h) => {
    const metres = niceStep(110 / camera.metre, 1) , long = metres * camera.metre;
    ctx.font = FONT;
    ctx.fillStyle = ctx.strokeStyle = theme.ink0;
    ctx.lineWidth = 1.5;
    ctx.beginPath();
    ctx.moveTo(72, h - 24); ctx.lineTo(72, h - 18); ctx.lineTo(72 + long, h - 18); ctx.lineTo(72 + long, h - 24);
    ctx.stroke();
    ctx.textAlign = "left";
    ctx.textBaseline = "alphabetic";
    ctx.fillText(tickText(metres, metres) + " m · grid " + tickText(options.grid, options.grid) + " m", 72, h - 30);
    const x = 38, y = h - 36, flat = Math.max(Math.abs(Math.sin(camera.pitch)), 0.25), turn = -camera.yaw;
    const place = (angle, r) => [x + Math.sin(angle) * r, y - Math.cos(angle) * r * flat];
    ctx.globalAlpha = 0.35;
    ctx.beginPath();
    ctx.ellipse(x, y, 19, 19 * flat, 0, 0, 7);
    ctx.stroke();
    ctx.globalAlpha = 1;
    const tipAt = place(turn, 18), leftAt = place(turn + 2.6, 11), rightAt = place(turn - 2.6, 11);
    ctx.beginPath();
    ctx.moveTo(...tipAt); ctx.lineTo(...leftAt); ctx.lineTo(x, y); ctx.lineTo(...rightAt);
    ctx.fill();
    ctx.font = "700 11px system-ui,sans-serif";
    ctx.textAlign = "center";
    ctx.textBaseline = "middle";
    const n = place(turn, 29);
    ctx.fillText("N", n[0], n[1]);
  };
  const draw = () => {
    const fitted = fit(over);
    if (!fitted) return;
    const { ctx, w, h } = fitted;
    if (!state.playing && !fingers.size) options.quality = 1;
    else options.quality = lasting;
    const wide = Math.round(over.width * options.quality), high = Math.round(over.height * options.quality);
    if (!plain && (picture.width !== wide || picture.height !== high)) {
      picture.width = wide;
      picture.height = high;
    }
    camera.update(w, h);
    options.grid = niceStep(camera.distance * 0.8, 5);
    if (!render(camera, options, w, h)) {                              // the context was lost: carry on without WebGL
      withoutGl();
      render(camera, options, w, h);
    }
    drawHomes(ctx);
    if (options.airspace) drawAirspace(ctx);
    drawAircraft(ctx);
    drawMarks(ctx);
    drawCompass(ctx, w, h);
  };
  onChange(draw, stage);
  new ResizeObserver(changed).observe(stage);

  const turn = (dx, dy) => {
    options.drift = false;
    camera.yaw += dx;
    camera.pitch = Math.min(Math.max(camera.pitch + dy, 0.03), 1.5607);
    changed();
  };
  const move = (dx, dy) => {
    options.drift = false;
    const k = 1 / camera.metre, cy = Math.cos(camera.yaw), sy = Math.sin(camera.yaw);
    camera.target[0] -= (cy * dx + sy * -dy) * k;
    camera.target[1] -= (-sy * dx + cy * -dy) * k;
    changed();
  };
  const zoom = (factor) => {
    options.drift = false;
    camera.distance = Math.min(Math.max(camera.distance * factor, bounds.size * 0.03), bounds.size * 30);
    changed();
  };
  const describe = ({ v, now }, x, y) => showTip(x, y, v.id,
    [["", "up", now[2].toFixed(2) + " m"], ["", "speed", now[3].toFixed(2) + " m/s"], ["", "east, north", now[0].toFixed(1) + ", " + now[1].toFixed(1) + " m"]]);
  const choose = (step) => {                                             // the aircraft after or before the one in focus
    const order = spots.map((s) => s.v.index).sort((a, b) => a - b), place = order.indexOf(state.focus);
    if (!order.length) return;
    const next = order[place < 0 ? (step > 0 ? 0 : order.length - 1) : (place + step + order.length) % order.length];
    const box = over.getBoundingClientRect(), spot = spots.find((s) => s.v.index === next);
    setFocus(next);
    describe(spot, box.left + spot.x, box.top + spot.y);
  };
  over.addEventListener("pointerdown", (e) => {
    over.setPointerCapture(e.pointerId);
    fingers.set(e.pointerId, [e.clientX, e.clientY]);
    hideTip();
  });
  for (const name of ["pointerup", "pointercancel"]) over.addEventListener(name, (e) => { fingers.delete(e.pointerId); changed(); });
  over.addEventListener("pointermove", (e) => {
    const before = fingers.get(e.pointerId);
    if (!before) {
      const box = over.getBoundingClientRect(), x = e.clientX - box.left, y = e.clientY - box.top;
      const mishap = RUN.marks.find((m) => { const p = m.t <= state.t && camera.project(...m.at); return p && Math.hypot(p[0] - x, p[1] - y) < 9; });
      if (mishap) return showTip(e.clientX, e.clientY, mishap.words, []);
      const hit = spots.map((s) => [Math.hypot(s.x - x, s.y - y), s]).filter((s) => s[0] < 16).sort((a, b) => a[0] - b[0])[0];
      setFocus(hit ? hit[1].v.index : -1);
      return hit ? describe(hit[1], e.clientX, e.clientY) : hideTip();
    }
    const dx = e.clientX - before[0], dy = e.clientY - before[1];
    if (fingers.size === 2) {
      const other = [...fingers].find(([id]) => id !== e.pointerId)[1];
      zoom(Math.hypot(before[0] - other[0], before[1] - other[1]) / Math.max(Math.hypot(e.clientX - other[0], e.clientY - other[1]), 1));
      move(dx / 2, dy / 2);
    } else if (e.shiftKey || e.buttons & 6) move(dx, dy);
    else turn(dx * 0.006, dy * 0.006);
    fingers.set(e.pointerId, [e.clientX, e.clientY]);
  });
  over.addEventListener("pointerleave", () => { hideTip(); setFocus(-1); });
  over.addEventListener("contextmenu", (e) => e.preventDefault());
  over.addEventListener("wheel", (e) => {
    if (document.activeElement !== over && !e.ctrlKey && !e.metaKey) return;  // the page scrolls until the scene is taken up
    e.preventDefault();
    zoom(Math.exp(Math.sign(e.deltaY) * Math.min(Math.abs(e.deltaY), 60) * 0.0022));
  }, { passive: false });
  over.addEventListener("keydown", (e) => {
    const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[e.key];
    if (step && e.shiftKey) move(step[0] * -30, step[1] * -30);
    else if (step) turn(step[0] * 0.08, step[1] * -0.08);
    else if (e.key === "+" || e.key === "=") zoom(0.88);
    else if (e.key === "-") zoom(1.14);
    else if (e.key === "Home") { camera.home(); changed(); }
    else if (e.key === " ") $("play").click();
    else if (e.key === "n" || e.key === "p") choose(e.key === "n" ? 1 : -1);
    else if (e.key === "Escape") { hideTip(); setFocus(-1); }
    else return;
    e.preventDefault();
  });
  over.addEventListener("blur", () => { hideTip(); setFocus(-1); });
  // A machine that draws in software gets a coarser picture (or fewer buildings) rather than a slow one.
  let slow = 0;
  const beat = (dt) => {
    if (options.drift) camera.yaw += Math.min(dt, 0.1) * 0.05;
    slow = dt > 0.25 ? slow + 3 : dt > 0.07 ? slow + 1 : Math.max(0, slow - 1);
    if (slow > 5 && lasting > 0.3 && scrollY < stage.offsetTop + stage.offsetHeight) {
      lasting *= 0.7;
      slow = 0;
    }
  };
  return { beat };
};
