// Renderer with WebGL 2: ground grid, solid city with storeys, thick lines with a time at each vertex.
const GLSL = {
  ground: [`in vec2 p; uniform mat4 m; uniform vec3 span; out vec2 at; void main(){ at = span.xy + p * span.z; gl_Position = m * vec4(at, 0., 1.); }`,
    `in vec2 at; uniform vec3 line, base, fog; uniform float fine, reach; uniform vec2 mid; out vec4 o;
    float grid(float s){ vec2 g = at / s; vec2 w = fwidth(g); vec2 d = abs(fract(g - .5) - .5) / max(w, 1e-5); float k = 1. - min(min(d.x, d.y), 1.); return k * clamp(.6 / max(max(w.x, w.y), 1e-4) - .8, 0., 1.); }
    void main(){ float away = length(at - mid) / reach; float k = max(grid(fine) * .28, grid(fine * 5.) * .6); vec3 c = mix(base, line, k); float a = 1. - smoothstep(.35, 1., away); o = vec4(c * a, a); }`],
  city: [`in vec3 p; in vec2 q; uniform mat4 m; out vec3 at; out vec2 k; void main(){ at = p; k = q; gl_Position = m * vec4(p, 1.); }`,
    `in vec3 at; in vec2 k; uniform vec3 wall, roof, fog, eye; uniform float reach, dark; out vec4 o;
    void main(){ vec3 c; if (k.y > .5) c = roof; else { float f = fract(at.z / 3.6); float w = fwidth(at.z / 3.6);
      float storey = (1. - smoothstep(.0, .0 + max(w, .02) * 1.5, min(f, 1. - f))) * clamp(1.2 - w * 5., 0., 1.);
      c = wall * k.x * 1.22 * mix(.72, 1., smoothstep(0., 16., at.z)); c *= 1. - storey * mix(.07, .16, dark); }
      float away = length(at - eye) / reach; c = mix(c, fog, smoothstep(.5, 1.25, away) * .92); o = vec4(c, 1.); }`],
  edge: [`in vec3 p; uniform mat4 m; uniform vec3 eye; out float away; void main(){ away = length(p - eye); gl_Position = m * vec4(p, 1.); gl_Position.z -= .0004 * gl_Position.w; }`,
    `in float away; uniform vec3 edge; uniform float reach; out vec4 o; void main(){ float a = .55 * (1. - smoothstep(.25, .9, away / reach)); o = vec4(edge * a, a); }`],
  line: [`in vec2 c; in vec4 a, b; uniform mat4 m; uniform vec2 view; uniform float wide, flat_; out float t; out float side;
    void main(){ vec3 pa = vec3(a.xy, mix(a.z, .05, flat_)), pb = vec3(b.xy, mix(b.z, .05, flat_));
      vec4 A = m * vec4(pa, 1.), B = m * vec4(pb, 1.); float near = .05;
      if (A.w < near && B.w < near) { gl_Position = vec4(2., 2., 2., 1.); t = 0.; side = 0.; return; }
      if (A.w < near) A = mix(A, B, (near - A.w) / (B.w - A.w)); if (B.w < near) B = mix(B, A, (near - B.w) / (A.w - B.w));
      vec2 d = (B.xy / B.w - A.xy / A.w) * view; float l = length(d); d = l > 1e-4 ? d / l : vec2(1., 0.);
      vec4 P = c.x < .5 ? A : B; vec2 off = vec2(-d.y, d.x) * c.y + d * (c.x - .5) * .9;
      P.xy += off * wide / view * P.w; P.z -= .0008 * P.w * (1. - flat_); gl_Position = P; t = mix(a.w, b.w, c.x); side = c.y; }`,
    `in float t, side; uniform vec4 ink; uniform float now, later, dash; out vec4 o;
    void main(){ float a = ink.a * (t <= now ? 1. : later); if (dash > 0. && fract(t / dash) > .55) discard; a *= 1. - smoothstep(.72, 1., abs(side)); if (a < .01) discard; o = vec4(ink.rgb * a, a); }`],
};
const glRenderer = (canvas) => {
  const gl = canvas.getContext("webgl2", { antialias: true, alpha: true, premultipliedAlpha: true });
  if (!gl) return null;
  const program = ([vertex, fragment]) => {
    const made = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, "#version 300 es\nprecision highp float;\n" + text);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader) || "no shader");
      gl.attachShader(made, shader);
    }
    gl.linkProgram(made);
    if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made) || "no program");
    const cache = {};
    return { made, at: (name) => gl.getAttribLocation(made, name), u: (name) => (cache[name] ??= gl.getUniformLocation(made, name)) };
  };
  let tools;
  try {
    tools = Object.fromEntries(Object.entries(GLSL).map(([name, source]) => [name, program(source)]));
  } catch {
    return null;
  }
  const buffer = (data, target = gl.ARRAY_BUFFER) => {
    const made = gl.createBuffer();
    gl.bindBuffer(target, made);
    gl.bufferData(target, data, gl.STATIC_DRAW);
    return made;
  };
  const mesh = cityMesh(RUN.buildings);
  const square = buffer(new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]));
  const solid = buffer(mesh.solid), edges = buffer(mesh.edges);
  // Two triangles per segment: four corners, each with both ends. Renderers in software are slow with instances.
  const strip = (track) => {
    const count = Math.max(0, track.size - 1), data = new Float32Array(count * 40);
    for (let i = 0, k = 0; i < count; i++)
      for (let corner = 0; corner < 4; corner++) {
        for (const j of [i, i + 1]) {
          data[k++] = track.e[j];
          data[k++] = track.n[j];
          data[k++] = track.u[j];
          data[k++] = track.t[j];
        }
        data[k++] = corner & 1;
        data[k++] = corner & 2 ? 1 : -1;
      }
    return { count, buffer: buffer(data) };
  };
  const lines = RUN.vehicles.map((v) => ({ v, truth: strip(v.truth), belief: strip(v.belief) }));
  const longest = lines.reduce((most, one) => Math.max(most, one.truth.count, one.belief.count), 0);
  const order = new Uint32Array(longest * 6);
  for (let i = 0; i < longest; i++) order.set([0, 1, 2, 2, 1, 3].map((k) => i * 4 + k), i * 6);
  const corners = buffer(order, gl.ELEMENT_ARRAY_BUFFER);
  let lost = false;
  canvas.addEventListener("webglcontextlost", () => { lost = true; });

  const attribute = (place, size, stride, offset) => {
    if (place < 0) return;
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, size, gl.FLOAT, false, stride, offset);
  };
  const use = (name, camera) => {
    gl.useProgram(tools[name].made);
    gl.uniformMatrix4fv(tools[name].u("m"), false, camera.matrix);
    return tools[name];
  };
  const drawStrip = (tool, { buffer: data, count }) => {
    if (!count) return;
    gl.bindBuffer(gl.ARRAY_BUFFER, data);
    attribute(tool.at("a"), 4, 40, 0);
    attribute(tool.at("b"), 4, 40, 16);
    attribute(tool.at("c"), 2, 40, 32);
    gl.drawElements(gl.TRIANGLES, count * 6, gl.UNSIGNED_INT, 0);
  };
  const drawCity = (camera, reach) => {
    const city = use("city", camera);
    gl.uniform3fv(city.u("wall"), rgb(theme.wall));
    gl.uniform3fv(city.u("roof"), rgb(theme.roof));
    gl.uniform3fv(city.u("fog"), rgb(theme.sky1));
    gl.uniform3fv(city.u("eye"), camera.eye);
    gl.uniform1f(city.u("reach"), reach);
    gl.uniform1f(city.u("dark"), theme.dark ? 1 : 0);
    gl.bindBuffer(gl.ARRAY_BUFFER, solid);
    attribute(city.at("p"), 3, 20, 0);
    attribute(city.at("q"), 2, 20, 12);
    gl.drawArrays(gl.TRIANGLES, 0, mesh.solid.length / 5);
    const edge = use("edge", camera);
    gl.uniform3fv(edge.u("edge"), rgb(theme.edge));
    gl.uniform3fv(edge.u("eye"), camera.eye);
    gl.uniform1f(edge.u("reach"), reach);
    gl.bindBuffer(gl.ARRAY_BUFFER, edges);
    attribute(edge.at("p"), 3, 12, 0);
    gl.disableVertexAttribArray(tools.city.at("q") === edge.at("p") ? 15 : tools.city.at("q"));
    gl.depthMask(false);
    gl.drawArrays(gl.LINES, 0, mesh.edges.length / 3);
    gl.depthMask(true);
  };
  return (camera, options, w, h) => {
    if (lost) return false;
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    for (let i = 0; i < 8; i++) gl.disableVertexAttribArray(i);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, corners);
    const reach = Math.max(camera.distance * 4.2, options.size * 1.6);
    gl.disable(gl.DEPTH_TEST);
    const ground = use("ground", camera);
    gl.uniform3f(ground.u("span"), camera.target[0], camera.target[1], reach);
    gl.uniform2f(ground.u("mid"), camera.target[0], camera.target[1]);
    gl.uniform1f(ground.u("reach"), reach);
    gl.uniform1f(ground.u("fine"), options.grid / 5);
    gl.uniform3fv(ground.u("line"), rgb(theme.gridline));
    gl.uniform3fv(ground.u("base"), rgb(theme.ground));
    gl.bindBuffer(gl.ARRAY_BUFFER, square);
    attribute(ground.at("p"), 2, 8, 0);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    if (options.city && mesh.solid.length) drawCity(camera, reach);
    for (let i = 0; i < 8; i++) gl.disableVertexAttribArray(i);
    const line = use("line", camera);
    gl.uniform2f(line.u("view"), w / 2, h / 2);
    const pass = (which, wide, alpha, later, flat = 0, dash = 0) => {
      gl.uniform1f(line.u("later"), later);
      gl.uniform1f(line.u("flat_"), flat);
      gl.uniform1f(line.u("dash"), dash);
      for (const one of lines) {
        if (!visible(one.v)) continue;
        const near = state.focus < 0 || state.focus === one.v.index;
        gl.uniform1f(line.u("wide"), wide * (state.focus === one.v.index ? 1.7 : 1));
        gl.uniform1f(line.u("now"), state.t);
        gl.uniform4f(line.u("ink"), ...rgb(ink(one.v)), alpha * (near ? 1 : 0.35));
        drawStrip(line, one[which]);
      }
    };
    const full = options.quality > 0.6;                                // shadows and what shines through cost half the work
    gl.depthMask(false);
    if (full) pass("truth", 1.2, 0.3, 0.5, 1);
    gl.depthMask(true);
    gl.depthFunc(gl.LESS);
    pass("truth", 2, 1, 0.3);
    if (options.belief) pass("belief", 1.5, 0.85, 0, 0, options.dash);
    gl.disable(gl.DEPTH_TEST);  // what a building hides shines through it
    if (full) pass("truth", 1.2, 0.2, 0.3);
    return true;
  };
};
