// Renderer without WebGL: the same camera on a 2D canvas, far walls drawn before near ones.
const FLAT_BUILDINGS = 700;
const flatRenderer = (canvas) => {
  const nearest = RUN.buildings.slice(0, FLAT_BUILDINGS).map((b) => ({
    ...b, mid: b.rings[0].reduce((s, p) => [s[0] + p[0] / b.rings[0].length, s[1] + p[1] / b.rings[0].length], [0, 0]),
  }));
  const shade = (hex, k) => "rgb(" + rgb(hex).map((c) => Math.round(Math.min(1, c * k) * 255)).join(",") + ")";
  return (camera, options) => {
    const fitted = fit(canvas);
    if (!fitted) return true;
    const { ctx } = fitted, put = (e, n, u) => camera.project(e, n, u);
    const trace = (points) => {
      let open = false;
      ctx.beginPath();
      for (const p of points) {
        if (!p) { open = false; continue; }
        if (open) ctx.lineTo(p[0], p[1]); else ctx.moveTo(p[0], p[1]);
        open = true;
      }
    };
    const [cx, cy] = camera.target, step = options.grid, count = 12;
    ctx.strokeStyle = theme.gridline;
    ctx.lineWidth = 0.6;
    ctx.globalAlpha = 0.5;
    const x0 = Math.round(cx / step) * step, y0 = Math.round(cy / step) * step;
    for (let i = -count; i <= count; i++) {
      trace([put(x0 + i * step, y0 - count * step, 0), put(x0 + i * step, y0 + count * step, 0)]);
      ctx.stroke();
      trace([put(x0 - count * step, y0 + i * step, 0), put(x0 + count * step, y0 + i * step, 0)]);
      ctx.stroke();
    }
    ctx.globalAlpha = 1;
    const far = (b) => -((b.mid[0] - camera.eye[0]) ** 2 + (b.mid[1] - camera.eye[1]) ** 2);
    for (const b of options.city ? nearest.slice(0, FLAT_BUILDINGS * options.quality ** 2).sort((p, q) => far(p) - far(q)) : []) {
      ctx.strokeStyle = theme.edge;
      ctx.lineWidth = 0.5;
      const ring = wound(b.rings[0], 1);
      ring.forEach((p, i) => {
        const q = ring[(i + 1) % ring.length];
        if ((q[1] - p[1]) * (camera.eye[0] - p[0]) - (q[0] - p[0]) * (camera.eye[1] - p[1]) <= 0) return;
        const face = [put(...p, 0), put(...q, 0), put(...q, b.h), put(...p, b.h)];
        if (face.includes(null)) return;
        trace(face);
        ctx.closePath();
        ctx.fillStyle = shade(theme.wall, wallLight(p, q) * 1.2);
        ctx.fill();
      });
      const roof = ring.map((p) => put(...p, b.h));
      if (roof.includes(null) || camera.eye[2] < b.h) continue;
      trace(roof);
      ctx.closePath();
      ctx.fillStyle = theme.roof;
      ctx.fill();
      ctx.stroke();
    }
    for (const v of RUN.vehicles) {
      if (!visible(v)) continue;
      const path = (track, until, flat) => Array.from({ length: until }, (_, i) => put(track.e[i], track.n[i], flat ? 0 : track.u[i]));
      const dimmed = state.focus < 0 || state.focus === v.index ? 1 : 0.35;
      const stroke = (points, alpha, wide, dash = []) => {
        trace(points);
        ctx.setLineDash(dash);
        ctx.globalAlpha = alpha * dimmed;
        ctx.lineWidth = wide;
        ctx.stroke();
        ctx.setLineDash([]);
      };
      ctx.strokeStyle = ink(v);
      ctx.lineJoin = "round";
      stroke(path(v.truth, v.truth.size, true), 0.18, 1);
      stroke(path(v.truth, v.truth.size), 0.3, 1.6);
      stroke(path(v.truth, rowAt(v.truth, state.t) + 1), 1, state.focus === v.index ? 3.6 : 2.4);
      if (options.belief) stroke(path(v.belief, rowAt(v.belief, state.t) + 1), 0.8, 1.4, [4, 4]);
      ctx.globalAlpha = 1;
    }
    return true;
  };
};
