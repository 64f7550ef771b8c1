// Tools for WebGL 2: programs, buffers, and rows of numbers as textures.
const TEXTURE_WIDTH = 1024;
const ATTRIBUTES = { p: 0, q: 1, slot: 2 };

/** @typedef {{use: () => void, float: (name: string, value: number) => void, pair: (name: string, x: number, y: number) => void, triple: (name: string, value: ArrayLike<number>) => void, whole: (name: string, value: number) => void, matrix: (name: string, value: Float32Array) => void}} Program */

/** @param {WebGL2RenderingContext} gl @param {[string, string]} sources @returns {Program} */
export const compileProgram = (gl, sources) => {
  const made = gl.createProgram();
  [gl.VERTEX_SHADER, gl.FRAGMENT_SHADER].forEach((kind, i) => {
    const shader = gl.createShader(kind);
    if (!shader) throw new Error("no shader");
    gl.shaderSource(shader, "#version 300 es\nprecision highp float;\nprecision highp sampler2D;\n" + sources[i]);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader) || "a shader does not compile");
    gl.attachShader(made, shader);
  });
  for (const [name, place] of Object.entries(ATTRIBUTES)) gl.bindAttribLocation(made, place, name);
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made) || "a program does not link");
  /** @type {Map<string, WebGLUniformLocation | null>} */
  const places = new Map();
  const at = (/** @type {string} */ name) => {
    if (!places.has(name)) places.set(name, gl.getUniformLocation(made, name));
    return places.get(name) ?? null;
  };
  return {
    use: () => gl.useProgram(made),
    float: (name, value) => gl.uniform1f(at(name), value),
    pair: (name, x, y) => gl.uniform2f(at(name), x, y),
    triple: (name, value) => gl.uniform3f(at(name), value[0], value[1], value[2]),
    whole: (name, value) => gl.uniform1i(at(name), value),
    matrix: (name, value) => gl.uniformMatrix4fv(at(name), false, value),
  };
};

/** Corners in a buffer with their attributes: names and how many numbers each has, one after the other. */
export class VertexBuffer {
  /** @param {WebGL2RenderingContext} gl @param {Float32Array} data @param {[keyof typeof ATTRIBUTES, number][]} layout */
  constructor(gl, data, layout) {
    const floats = layout.reduce((sum, [, size]) => sum + size, 0);
    this.gl = gl;
    this.count = data.length / floats;
    this.array = gl.createVertexArray();
    this.buffer = gl.createBuffer();
    gl.bindVertexArray(this.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
    let offset = 0;
    for (const [name, size] of layout) {
      gl.enableVertexAttribArray(ATTRIBUTES[name]);
      gl.vertexAttribPointer(ATTRIBUTES[name], size, gl.FLOAT, false, floats * 4, offset);
      offset += size * 4;
    }
    gl.bindVertexArray(null);
  }

  /** @param {number} mode */
  draw(mode) {
    if (!this.count) return;
    this.gl.bindVertexArray(this.array);
    this.gl.drawArrays(mode, 0, this.count);
  }

  free() {
    this.gl.deleteBuffer(this.buffer);
    this.gl.deleteVertexArray(this.array);
  }
}

/** Rows of numbers in a texture, four numbers a texel, read by their place. */
export class DataTexture {
  /** @param {WebGL2RenderingContext} gl @param {number} unit */
  constructor(gl, unit) {
    this.gl = gl;
    this.unit = unit;
    this.height = 0;
    this.texture = gl.createTexture();
  }

  bind() {
    this.gl.activeTexture(this.gl.TEXTURE0 + this.unit);
    this.gl.bindTexture(this.gl.TEXTURE_2D, this.texture);
  }

  /** @param {Float32Array} data @param {number} floats that are used @param {number} [from] the first that is new */
  upload(data, floats, from = 0) {
    const { gl } = this, line = TEXTURE_WIDTH * 4, lines = Math.ceil(floats / line);
    this.bind();
    if (lines > this.height) {
      const most = gl.getParameter(gl.MAX_TEXTURE_SIZE);
      this.height = Math.min(Math.max(lines, this.height * 2, 1), most);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, TEXTURE_WIDTH, this.height, 0, gl.RGBA, gl.FLOAT, null);
      for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
      from = 0;
    }
    const first = Math.floor(from / line), last = Math.min(lines, this.height), whole = Math.min(Math.floor(floats / line), last), rest = whole < last ? Math.ceil((floats - whole * line) / 4) : 0;
    if (whole > first) gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, first, TEXTURE_WIDTH, whole - first, gl.RGBA, gl.FLOAT, data, first * line);
    if (rest) gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, whole, rest, 1, gl.RGBA, gl.FLOAT, data.subarray(whole * line, whole * line + rest * 4));
  }
}

/** Two triangles for each four corners, in one list that all share; the corners know their number only. */
export class QuadIndex {
  /** @param {WebGL2RenderingContext} gl */
  constructor(gl) {
    this.gl = gl;
    this.room = 0;
    this.array = gl.createVertexArray();
    this.buffer = gl.createBuffer();
  }

  /** @param {number} first @param {number} until */
  draw(first, until) {
    const { gl } = this;
    if (until <= first) return;
    gl.bindVertexArray(this.array);
    if (until > this.room) {
      this.room = Math.max(until, this.room * 2, 1024);
      const order = new Uint32Array(this.room * 6);
      for (let i = 0, k = 0, corner = 0; i < this.room; i++, corner += 4) {
        order[k++] = corner;
        order[k++] = corner + 1;
        order[k++] = corner + 2;
        order[k++] = corner + 2;
        order[k++] = corner + 1;
        order[k++] = corner + 3;
      }
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.buffer);
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, order, gl.STATIC_DRAW);
    }
    gl.drawElements(gl.TRIANGLES, (until - first) * 6, gl.UNSIGNED_INT, first * 24);
  }
}
