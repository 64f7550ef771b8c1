// Renderer with WebGL 2: about ten draw calls a frame, however many aircraft there are.
import { LINE_FLOATS, SYMBOL_FLOATS } from "./batches.js";
import { buildCity, unpackBuildings } from "./city.js";
import { BODY_FLOATS, MAX_GHOSTS } from "./frame.js";
import { compileProgram, DataTexture, QuadIndex, VertexBuffer } from "./gl-tools.js";
import { roundStep } from "./page-parts.js";
import { SHADERS } from "./shaders.js";
import { fixedWing, gridLines, groundDisc, multirotor, smallMultirotor } from "./shapes.js";
import { rgb } from "./theme.js";
import { TRAIL_S } from "./trails.js";
import { volumeMeshes } from "./volumes.js";
/** @import { Camera } from "./camera.js" */
/** @import { Frame } from "./frame.js" */
/** @import { Program } from "./gl-tools.js" */
/** @import { Buildings, Scene } from "./scene.js" */
/** @import { Store } from "./store.js" */
/** @import { Theme } from "./theme.js" */
/** @import { TrailSet } from "./trails.js" */
const GRID_LINES = 40;
const DETAILED_BODIES = 240;

/** @typedef {{draw: (frame: Frame, camera: Camera) => boolean, setScene: (scene: Scene) => void, calls: () => number}} Renderer draw returns false where it cannot any more */

/**
 * @param {HTMLCanvasElement} canvas @param {Store} store @param {Theme} theme @param {TrailSet[]} trails of each arm
 * @returns {Renderer | null} null where there is no WebGL 2
 */
export const makeRenderer = (canvas, store, theme, trails) => {
  const gl = canvas.getContext("webgl2", { antialias: true, alpha: false, powerPreference: "high-performance" });
  if (!gl) return null;
  /** @type {Record<string, Program>} */
  const programs = {};
  try {
    for (const [name, sources] of Object.entries(SHADERS)) programs[name] = compileProgram(gl, sources);
  } catch (error) {
    console.warn("The viewer draws without WebGL:", error);
    return null;
  }
  const ground = new VertexBuffer(gl, groundDisc(), [["p", 3]]), grid = new VertexBuffer(gl, gridLines(GRID_LINES), [["p", 2]]), quads = new QuadIndex(gl);
  const bodies = new DataTexture(gl, 0), lines = new DataTexture(gl, 1), symbols = new DataTexture(gl, 1);
  /** @type {DataTexture[]} */
  let trailRows = [];
  /** @type {VertexBuffer[]} the solid city, its edges, bodies, volumes and their edges */
  let meshes = [];
  let lost = false, calls = 0, slots = 0, shapeKey = "";
  canvas.addEventListener("webglcontextlost", () => {
    lost = true;
    store.changed();
  });

  /** @param {Scene} scene */
  const bodyMesh = (scene) => {
    const rotors = slots - MAX_GHOSTS > DETAILED_BODIES ? smallMultirotor() : multirotor(), wing = fixedWing();
    const shapes = Array.from({ length: slots }, (_, slot) => (slot < slots - MAX_GHOSTS && scene.vehicles[slot % scene.vehicles.length].winged ? wing : rotors));
    const data = new Float32Array(shapes.reduce((sum, shape) => sum + (shape.length / 4) * 5, 0));
    let at = 0;
    shapes.forEach((shape, slot) => {
      for (let i = 0; i < shape.length; i += 4) {
        data[at++] = shape[i];
        data[at++] = shape[i + 1];
        data[at++] = shape[i + 2];
        data[at++] = shape[i + 3];
        data[at++] = slot;
      }
    });
    return data;
  };
  /** @type {Buildings | null} */
  let built = null;
  /** @param {Scene} scene */
  const setScene = (scene) => {
    const keep = built !== null && built.heights.length === scene.buildings.heights.length && built.outlines.length === scene.buildings.outlines.length;
    const wanted = scene.arms.length * scene.vehicles.length + MAX_GHOSTS, shape = scene.vehicles.map((one) => Number(one.winged)).join(""), same = wanted === slots && shape === shapeKey;
    meshes.forEach((mesh, i) => (i < 2 ? keep : i === 2 && same) || mesh.free());
    slots = wanted;
    shapeKey = shape;
    const volumes = volumeMeshes(scene), city = keep ? null : buildCity(unpackBuildings(scene.buildings));
    meshes = [
      city ? new VertexBuffer(gl, city.solid, [["p", 3], ["q", 2]]) : meshes[0], city ? new VertexBuffer(gl, city.edges, [["p", 3]]) : meshes[1],
      same ? meshes[2] : new VertexBuffer(gl, bodyMesh(scene), [["p", 4], ["slot", 1]]), new VertexBuffer(gl, volumes.faces, [["p", 3], ["q", 3]]), new VertexBuffer(gl, volumes.edges, [["p", 3], ["q", 3]]),
    ];
    built = scene.buildings;
    trailRows = scene.arms.map((_, arm) => trailRows[arm] ?? new DataTexture(gl, 1));
  };

  /** Draw, and what buildings hide of it faintly, unless there is too much. @param {Program} program @param {() => void} draw */
  const shineThrough = (program, draw) => {
    if (slots <= DETAILED_BODIES && store.view.layers.buildings && meshes[0].count) {
      program.float("through", 0.4);
      gl.depthFunc(gl.GREATER);
      draw();
      gl.depthFunc(gl.LEQUAL);
      calls++;
    }
    program.float("through", 1);
    draw();
    calls++;
  };
  /** @param {string} name @param {Camera} camera */
  const use = (name, camera) => {
    const program = programs[name];
    program.use();
    program.matrix("m", camera.matrix);
    return program;
  };
  /** @param {Camera} camera @param {number} reach */
  const drawGround = (camera, reach) => {
    const step = roundStep(camera.distance * 0.09), [east, north] = camera.target;
    const floor = use("ground", camera);
    floor.triple("span", [east, north, reach]);
    floor.triple("base", rgb(theme.ground));
    floor.triple("fog", rgb(theme.sky));
    ground.draw(gl.TRIANGLES);
    calls += 2;
    const net = use("grid", camera);
    net.triple("span", [Math.round(east / step / 5) * step * 5, Math.round(north / step / 5) * step * 5, step]);
    net.pair("mid", east, north);
    net.float("reach", step * GRID_LINES);
    net.triple("ink", rgb(theme.grid));
    grid.draw(gl.LINES);
  };
  /** @param {Camera} camera @param {number} reach */
  const drawCity = (camera, reach) => {
    const solid = use("city", camera);
    for (const name of /** @type {const} */ (["wall", "roof"])) solid.triple(name, rgb(theme[name]));
    solid.triple("fog", rgb(theme.sky));
    solid.triple("eye", camera.eye);
    solid.float("reach", reach);
    gl.enable(gl.CULL_FACE);
    meshes[0].draw(gl.TRIANGLES);
    calls += 2;
    gl.disable(gl.CULL_FACE);
    const edge = use("edge", camera);
    edge.triple("edge", rgb(theme.edge));
    edge.triple("eye", camera.eye);
    edge.float("reach", reach);
    gl.depthMask(false);
    meshes[1].draw(gl.LINES);
  };
  /** @param {Camera} camera */
  const drawVolumes = (camera) => {
    const { selected, time } = store.view, program = use("volume", camera);
    program.whole("bodies", 0);
    program.float("now", time);
    program.triple("closed", rgb(theme.bad));
    program.float("selected", selected < (store.scene?.vehicles.length ?? 0) ? selected : -1);
    program.float("alpha", 0.07);
    meshes[3].draw(gl.TRIANGLES);
    program.float("alpha", 0.34);
    meshes[4].draw(gl.LINES);
    calls += 2;
  };
  /** @param {Camera} camera @param {number} vehicles */
  const drawTrails = (camera, vehicles) => {
    const program = use("trail", camera), { time } = store.view;
    program.whole("bodies", 0);
    program.whole("rows", 1);
    program.float("now", time);
    program.float("span", TRAIL_S);
    program.float("width", vehicles > DETAILED_BODIES ? 1.2 : 2.2);
    program.pair("view", camera.width / 2, camera.height / 2);
    trails.forEach((set, arm) => {
      if (!store.view.arms[arm] || !trailRows[arm]) return;
      if (set.stale) set.rebuild(store.arms[arm].tracks.truth);
      if (set.fresh < set.size) trailRows[arm].upload(set.data, set.size * 8, set.fresh * 8);
      set.fresh = set.size;
      trailRows[arm].bind();
      program.whole("base", arm * vehicles);
      const [first, until] = set.window(time);
      if (until > first) shineThrough(program, () => quads.draw(first, until));
    });
  };

  return {
    setScene,
    calls: () => calls,
    draw: (frame, camera) => {
      const scene = store.scene;
      if (lost || gl.isContextLost()) return false;
      if (!scene || !meshes.length) return true;
      calls = 0;
      const reach = Math.max(camera.distance * 3.4, camera.size * 1.8), { layers } = store.view;
      gl.viewport(0, 0, canvas.width, canvas.height);
      gl.clearColor(...rgb(theme.sky), 1);
      gl.depthMask(true);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      gl.enable(gl.BLEND);
      gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
      gl.disable(gl.DEPTH_TEST);
      drawGround(camera, reach);
      gl.enable(gl.DEPTH_TEST);
      gl.depthFunc(gl.LEQUAL);
      if (layers.buildings && meshes[0].count) drawCity(camera, reach);
      gl.depthMask(false);
      bodies.upload(frame.bodies, frame.slots * BODY_FLOATS);
      if (layers.volumes && meshes[3].count) drawVolumes(camera);
      if (layers.trails) drawTrails(camera, scene.vehicles.length);
      if (frame.lines.size) {
        const line = use("line", camera);
        line.whole("rows", 1);
        line.pair("view", camera.width / 2, camera.height / 2);
        lines.upload(frame.lines.data, frame.lines.size * LINE_FLOATS);
        shineThrough(line, () => quads.draw(0, frame.lines.size));
      }
      const body = use("body", camera);
      body.whole("bodies", 0);
      body.float("focal", camera.focal);
      body.triple("tip", theme.dark ? [1, 1, 1] : [0.06, 0.08, 0.12]);
      gl.depthMask(true);
      shineThrough(body, () => meshes[2].draw(gl.TRIANGLES));
      gl.depthMask(false);
      if (frame.symbols.size) {
        const symbol = use("symbol", camera);
        symbol.whole("rows", 1);
        symbol.pair("view", camera.width / 2, camera.height / 2);
        symbols.upload(frame.symbols.data, frame.symbols.size * SYMBOL_FLOATS);
        shineThrough(symbol, () => quads.draw(0, frame.symbols.size));
      }
      gl.bindVertexArray(null);
      return true;
    },
  };
};
