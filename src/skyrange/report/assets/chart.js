// One quantity of every aircraft over time, with a read-out under the pointer; a click sets the clock.
const MEASURES = [
  ["Altitude", "true height above the origin, m", (v) => [v.truth, v.truth.u], "m"],
  ["Speed", "true speed, m/s", (v) => [v.truth, v.truth.x], "m/s"],
  ["From home", "true distance from home over ground, m", (v) => [v.truth, v.away], "m"],
  ["Belief off by", "belief against truth at reception, m", (v) => [v.belief, v.belief.x], "m"],
];
const buildChart = (figure) => {
  for (const v of RUN.vehicles) {
    const [e0, n0] = v.home || [v.truth.e[0], v.truth.n[0]];
    v.away = v.truth.e.map((e, i) => Math.hypot(e - e0, v.truth.n[i] - n0));
  }
  let measure = MEASURES[0], hover = null;
  const said = figure.querySelector("figcaption .dim");
  const choice = make("div", { className: "seg", role: "group", "aria-label": "Quantity" });
  for (const one of MEASURES) {
    if (!RUN.vehicles.some((v) => one[2](v)[0].size)) continue;
    const button = make("button", { type: "button", textContent: one[0], "aria-pressed": String(one === measure) });
    button.addEventListener("click", () => {
      measure = one;
      for (const other of choice.children) other.setAttribute("aria-pressed", String(other === button));
      said.textContent = one[1];
      changed();
    });
    choice.append(button);
  }
  figure.querySelector("figcaption").append(choice);
  figure.querySelector(".still")?.setAttribute("hidden", "");
  const canvas = make("canvas", { tabIndex: 0, role: "img", "aria-label": "Quantities over simulated time, one line per aircraft. Left and right arrow keys move the clock." });
  figure.append(make("div", { className: "plot" }, canvas));
  const still = make("canvas");                                        // all but the cursors, redrawn only when it differs
  let drawn = "";
  const edge = { left: 50, right: 14, top: 10, bottom: 38 };
  let frame = null;
  const drawStill = (ctx, w, h) => {
    let low = 0, high = 1e-3;
    for (const v of RUN.vehicles) if (visible(v)) for (const y of measure[2](v)[1]) { if (y > high) high = y; if (y < low) low = y; }
    if (low > -0.02 * high) low = 0;
    high += (high - low) * 0.06;
    const X = (t) => edge.left + (t - RUN.start) / (RUN.end - RUN.start) * (w - edge.left - edge.right);
    const Y = (y) => h - edge.bottom - (y - low) / (high - low) * (h - edge.top - edge.bottom);
    frame = { X, Y, time: (x) => RUN.start + (x - edge.left) / (w - edge.left - edge.right) * (RUN.end - RUN.start) };
    ctx.font = FONT;
    ctx.fillStyle = theme.dim;
    ctx.strokeStyle = theme.rule;
    ctx.lineWidth = 1;
    ctx.textBaseline = "middle";
    ctx.textAlign = "right";
    const dy = niceStep(high - low, 5), dx = niceStep(RUN.end - RUN.start, Math.max(3, w / 90));
    for (let i = Math.ceil(low / dy); i * dy <= high; i++) {
      ctx.beginPath();
      ctx.moveTo(edge.left, Y(i * dy));
      ctx.lineTo(w - edge.right, Y(i * dy));
      ctx.stroke();
      ctx.fillText(tickText(i * dy, dy), edge.left - 8, Y(i * dy));
    }
    ctx.textAlign = "center";
    for (let i = Math.ceil(RUN.start / dx); i * dx <= RUN.end; i++) ctx.fillText(tickText(i * dx, dx), X(i * dx), h - edge.bottom + 15);
    ctx.fillText("simulated time, s", (edge.left + w - edge.right) / 2, h - 8);
    ctx.lineJoin = "round";
    for (const v of [...RUN.vehicles].sort((a, b) => (a.index === state.focus) - (b.index === state.focus))) {
      if (!visible(v)) continue;
      const [track, column] = measure[2](v);
      ctx.strokeStyle = ink(v);
      ctx.globalAlpha = state.focus < 0 ? (RUN.vehicles.length > 30 ? 0.6 : 0.95) : state.focus === v.index ? 1 : 0.15;
      ctx.lineWidth = state.focus === v.index ? 2.6 : 1.7;
      ctx.beginPath();
      for (let i = 0; i < track.size; i++) ctx.lineTo(X(track.t[i]), Y(column[i]));
      ctx.stroke();
    }
    ctx.globalAlpha = 1;
  };
  const draw = () => {
    const fitted = fit(canvas);
    if (!fitted) return;
    const { ctx, w, h } = fitted;
    const now = [canvas.width, canvas.height, theme.dark, measure[0], state.focus, ...state.shown].join();
    if (now !== drawn) {
      drawn = now;
      still.width = canvas.width;
      still.height = canvas.height;
      const behind = still.getContext("2d");
      behind.scale(canvas.width / w, canvas.height / h);
      drawStill(behind, w, h);
    }
    ctx.drawImage(still, 0, 0, w, h);
    const cursor = (t, colour, dash) => {
      ctx.strokeStyle = colour;
      ctx.lineWidth = 1.5;
      ctx.setLineDash(dash);
      ctx.beginPath();
      ctx.moveTo(frame.X(t), edge.top);
      ctx.lineTo(frame.X(t), h - edge.bottom);
      ctx.stroke();
      ctx.setLineDash([]);
    };
    cursor(state.t, theme.accent, []);
    if (hover === null) return;
    cursor(hover, theme.dim, [3, 3]);
    for (const { v, y } of values(hover)) {
      ctx.fillStyle = ink(v);
      ctx.beginPath();
      ctx.arc(frame.X(hover), frame.Y(y), 3.2, 0, 7);
      ctx.fill();
    }
  };
  const values = (t) => RUN.vehicles.filter(visible).flatMap((v) => {
    const [track, column] = measure[2](v);
    if (!track.size) return [];
    const i = Math.max(rowAt(track, t), 0), j = Math.min(i + 1, track.size - 1);
    const f = Math.min(Math.max((t - track.t[i]) / (track.t[j] - track.t[i] || 1), 0), 1);
    return [{ v, y: column[i] + (column[j] - column[i]) * f }];
  });
  canvas.addEventListener("pointermove", (e) => {
    if (!frame) return;
    const box = canvas.getBoundingClientRect(), y = e.clientY - box.top;
    hover = Math.min(Math.max(frame.time(e.clientX - box.left), RUN.start), RUN.end);
    const rows = values(hover).sort((a, b) => Math.abs(frame.Y(a.y) - y) - Math.abs(frame.Y(b.y) - y));
    setFocus(rows.length && Math.abs(frame.Y(rows[0].y) - y) < 12 && RUN.vehicles.length > 1 ? rows[0].v.index : -1);
    const shown = rows.slice(0, 10).sort((a, b) => b.y - a.y);
    const lines = shown.map(({ v, y: value }) => [ink(v), v.id, value.toFixed(2) + " " + measure[3]]);
    if (rows.length > 10) lines.push(["", "nearest 10 of " + rows.length, ""]);
    showTip(e.clientX, e.clientY, seconds(hover), lines);
    if (e.buttons & 1) setTime(hover);
    changed();
  });
  canvas.addEventListener("pointerdown", (e) => { if (frame) setTime(frame.time(e.clientX - canvas.getBoundingClientRect().left)); });
  canvas.addEventListener("pointerleave", () => { hover = null; hideTip(); setFocus(-1); changed(); });
  canvas.addEventListener("keydown", (e) => {
    const step = { ArrowLeft: -1, ArrowRight: 1 }[e.key];
    if (!step) return;
    setTime(state.t + step * (RUN.end - RUN.start) / 100);
    e.preventDefault();
  });
  onChange(draw, canvas);
  new ResizeObserver(changed).observe(canvas);
};
