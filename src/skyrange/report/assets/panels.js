// Panels of operators: a box of axes with the positions that the ground station received; dragging turns it.
const PANEL = { yaw: -1.05, pitch: 0.45 };
const buildPanel = (figure) => {
  const place = Number(figure.dataset.op), own = RUN.vehicles.filter((v) => v.op === place);
  if (!own.some((v) => v.belief.size)) return;
  const canvas = make("canvas", { tabIndex: 0, role: "img", "aria-label": `Positions that ${RUN.operators[place].id}'s ground station received, axes in metres. Arrow keys turn.` });
  figure.querySelector(".still")?.setAttribute("hidden", "");
  figure.append(canvas);
  const low = [Infinity, Infinity, 0], high = [-Infinity, -Infinity, 1];
  for (const { belief: b } of own)
    for (let i = 0; i < b.size; i++) [b.e[i], b.n[i], b.u[i]].forEach((x, k) => { low[k] = Math.min(low[k], x); high[k] = Math.max(high[k], x); });
  const half = Math.max(high[0] - low[0], high[1] - low[1], 4) * 0.55;
  for (const k of [0, 1]) {
    const mid = (low[k] + high[k]) / 2;
    low[k] = mid - half;
    high[k] = mid + half;
  }
  high[2] = low[2] + Math.max((high[2] - low[2]) * 1.1, 2);
  const rise = Math.max((high[2] - low[2]) / (2 * half), 0.5) * 2 * half / (high[2] - low[2]);
  const middle = low.map((x, k) => (x + high[k]) / 2);

  const draw = () => {
    const fitted = fit(canvas);
    if (!fitted) return;
    const { ctx, w, h } = fitted, { yaw, pitch } = PANEL;
    const right = [-Math.sin(yaw), Math.cos(yaw), 0], up = [-Math.sin(pitch) * Math.cos(yaw), -Math.sin(pitch) * Math.sin(yaw), Math.cos(pitch) * rise];
    const extent = (axis) => axis.reduce((s, x, k) => s + Math.abs(x) * (high[k] - low[k]), 0);
    const scale = Math.min((w - 110) / extent(right), (h - 96) / extent(up));
    const put = (p) => {
      const d = p.map((x, k) => x - middle[k]);
      return [w / 2 + (d[0] * right[0] + d[1] * right[1]) * scale, h / 2 - 4 - (d[0] * up[0] + d[1] * up[1] + d[2] * up[2]) * scale];
    };
    const line = (...points) => {
      ctx.beginPath();
      points.forEach((p, i) => ctx[i ? "lineTo" : "moveTo"](...put(p)));
      ctx.stroke();
    };
    const farE = Math.cos(yaw) > 0 ? low[0] : high[0], nearE = low[0] + high[0] - farE;
    const farN = Math.sin(yaw) > 0 ? low[1] : high[1], nearN = low[1] + high[1] - farN;
    const steps = low.map((x, k) => niceStep(high[k] - x, k < 2 ? 5 : 4));
    const each = (k) => {
      const out = [];
      for (let i = Math.ceil(low[k] / steps[k] - 1e-6); i * steps[k] <= high[k] + 1e-6; i++) out.push(i * steps[k]);
      return out;
    };
    ctx.font = "11px system-ui,sans-serif";
    ctx.strokeStyle = theme.rule;
    ctx.fillStyle = theme.dim;
    ctx.lineWidth = 1;
    ctx.textBaseline = "middle";
    const label = (p, away, text) => {
      const a = put(p), c = put([middle[0], middle[1], low[2]]), l = Math.hypot(a[0] - c[0], a[1] - c[1]) || 1;
      const side = (a[0] - c[0]) / l;
      ctx.textAlign = away < 20 || Math.abs(side) < 0.35 ? "center" : side > 0 ? "left" : "right";
      ctx.fillText(text, a[0] + side * away, a[1] + Math.abs(a[1] - c[1]) / l * away + 5);
    };
    for (const e of each(0)) {
      line([e, nearN, low[2]], [e, farN, low[2]], [e, farN, high[2]]);
      label([e, nearN, low[2]], 15, tickText(e, steps[0]));
    }
    for (const n of each(1)) {
      line([nearE, n, low[2]], [farE, n, low[2]], [farE, n, high[2]]);
      label([nearE, n, low[2]], 15, tickText(n, steps[1]));
    }
    // Heights stand at the corner that lies furthest left on the picture.
    const corner = [[nearE, farN], [farE, nearN]].sort((a, b) => put([...a, 0])[0] - put([...b, 0])[0])[0];
    ctx.textAlign = "right";
    for (const u of each(2)) {
      line([nearE, farN, u], [farE, farN, u], [farE, nearN, u]);
      const p = put([...corner, u]);
      ctx.fillText(tickText(u, steps[2]), p[0] - 7, p[1]);
    }
    line([low[0], low[1], low[2]], [high[0], low[1], low[2]], [high[0], high[1], low[2]], [low[0], high[1], low[2]], [low[0], low[1], low[2]]);
    for (const [e, n] of [[farE, farN], [nearE, farN], [farE, nearN]]) line([e, n, low[2]], [e, n, high[2]]);
    line([nearE, farN, high[2]], [farE, farN, high[2]], [farE, nearN, high[2]]);
    ctx.fillStyle = theme.ink0;
    label([middle[0], nearN, low[2]], 36, "east, m");
    label([nearE, middle[1], low[2]], 36, "north, m");
    const top = put([...corner, high[2]]);
    ctx.textAlign = "center";
    ctx.fillText("up, m", top[0], top[1] - 12);
    if (rise > 1.05) {
      ctx.textAlign = "right";
      ctx.fillStyle = theme.dim;
      ctx.fillText("up drawn ×" + rise.toFixed(1), w - 12, h - 10);
    }

    ctx.lineJoin = ctx.lineCap = "round";
    for (const v of own) {
      const b = v.belief, until = rowAt(b, state.t), near = state.focus < 0 || state.focus === v.index;
      const trace = (first, last, ground) => {
        ctx.beginPath();
        for (let i = first; i <= last; i++) ctx.lineTo(...put([b.e[i], b.n[i], ground ? low[2] : b.u[i]]));
        ctx.stroke();
      };
      ctx.strokeStyle = ink(v);
      ctx.globalAlpha = 0.2 * (near ? 1 : 0.4);
      ctx.lineWidth = 1;
      trace(0, b.size - 1, true);
      ctx.globalAlpha = 0.28 * (near ? 1 : 0.4);
      ctx.lineWidth = 1.6;
      trace(Math.max(until, 0), b.size - 1);
      ctx.globalAlpha = near ? 1 : 0.4;
      ctx.lineWidth = state.focus === v.index ? 3 : 1.9;
      trace(0, until);
      if (until >= 0) {                                               // the newest position received, not interpolated
        const p = put([b.e[until], b.n[until], b.u[until]]);
        ctx.beginPath();
        ctx.arc(p[0], p[1], own.length > 30 ? 3 : 4.5, 0, 7);
        ctx.fillStyle = ink(v);
        ctx.fill();
        ctx.strokeStyle = theme.card;
        ctx.lineWidth = 1.5;
        ctx.stroke();
        if (own.length <= 12 || state.focus === v.index) {
          ctx.textAlign = "left";
          ctx.fillStyle = theme.ink0;
          ctx.fillText(v.short, p[0] + 8, p[1] - 8);
        }
      }
      ctx.globalAlpha = 1;
    }
  };
  onChange(draw, canvas);
  new ResizeObserver(changed).observe(canvas);
  const turn = (dx, dy) => {
    PANEL.yaw -= dx;
    PANEL.pitch = Math.min(Math.max(PANEL.pitch + dy, 0.05), 1.5);
    changed();
  };
  let last = null;
  canvas.addEventListener("pointerdown", (e) => { last = [e.clientX, e.clientY]; canvas.setPointerCapture(e.pointerId); });
  canvas.addEventListener("pointermove", (e) => {
    if (!last) return;
    turn((e.clientX - last[0]) * 0.008, (e.clientY - last[1]) * 0.006);
    last = [e.clientX, e.clientY];
  });
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, () => { last = null; });
  canvas.addEventListener("keydown", (e) => {
    const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[e.key];
    if (!step) return;
    turn(step[0] * 0.1, step[1] * 0.08);
    e.preventDefault();
  });
};
