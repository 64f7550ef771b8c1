// Shaders of the renderer: each a pair of programs for corners and for pixels.
const FETCH = "vec4 pull(sampler2D from, int i){ return texelFetch(from, ivec2(i & 1023, i >> 10), 0); }\n";
const PASS = "in vec4 c; out vec4 o; void main(){ o = c; }";
const WIDE = `uniform mat4 m; uniform vec2 view;
vec4 wide(vec3 a, vec3 b, float width, int corner, out float along){
  vec4 A = m * vec4(a, 1.), B = m * vec4(b, 1.); float near = .05;
  along = 0.;
  if (A.w < near && B.w < near) return vec4(2., 2., 2., 1.);
  if (A.w < near) A = mix(A, B, (near - A.w) / (B.w - A.w));
  if (B.w < near) B = mix(B, A, (near - B.w) / (A.w - B.w));
  vec2 d = (B.xy / B.w - A.xy / A.w) * view; float l = length(d); d = l > 1e-4 ? d / l : vec2(1., 0.);
  bool end = (corner & 1) == 1; vec4 P = end ? B : A; float side = (corner & 2) == 2 ? .5 : -.5;
  along = end ? l : 0.;
  P.xy += vec2(-d.y, d.x) * side * width / view * P.w; P.z -= .0006 * P.w;
  return P; }
`;

/** @type {Record<string, [string, string]>} */
export const SHADERS = {
  ground: [
    "in vec3 p; uniform mat4 m; uniform vec3 span, base, fog; out vec4 c; void main(){ c = vec4(mix(base, fog, p.z), 1.); gl_Position = m * vec4(span.xy + p.xy * span.z, 0., 1.); }",
    PASS,
  ],
  grid: [
    "in vec2 p; uniform mat4 m; uniform vec3 span, ink; uniform vec2 mid; uniform float reach; out vec4 c; void main(){ vec2 at = span.xy + p * span.z; float a = (mod(p.x, 5.) == 0. && mod(p.y, 5.) == 0. ? .5 : .3) * (1. - smoothstep(.3, .9, length(at - mid) / reach)); c = vec4(ink * a, a); gl_Position = m * vec4(at, 0.05, 1.); }",
    PASS,
  ],
  city: [
    `in vec3 p; in vec2 q; uniform mat4 m; uniform vec3 wall, roof, fog, eye; uniform float reach; out vec4 c;
    void main(){ float away = smoothstep(.45, 1.2, length(p - eye) / reach), odd = fract(p.z * 7.31) * .05;
      vec3 k = q.y > .5 ? roof * (.96 + odd) : wall * q.x * (p.z > .01 ? 1.04 : .86);
      c = vec4(mix(k, fog, away * .85), 1.); gl_Position = m * vec4(p, 1.); }`,
    PASS,
  ],
  edge: [
    "in vec3 p; uniform mat4 m; uniform vec3 edge, eye; uniform float reach; out vec4 c; void main(){ float a = .6 * (1. - smoothstep(.2, .75, length(p - eye) / reach)); c = vec4(edge * a, a); gl_Position = m * vec4(p, 1.); gl_Position.z -= .0004 * gl_Position.w; }",
    PASS,
  ],
  body: [
    FETCH + `in vec4 p; in float slot; uniform mat4 m; uniform sampler2D bodies; uniform float focal, through; uniform vec3 tip; out vec4 c; flat out float dashed;
    void main(){ int i = int(slot) * 3; vec4 at = pull(bodies, i), ink = pull(bodies, i + 1), more = pull(bodies, i + 2);
      if (ink.a <= 0.) { gl_Position = vec4(2., 2., 2., 1.); return; }
      float s = sin(at.w), k = cos(at.w), w = m[0].w * at.x + m[1].w * at.y + m[2].w * at.z + m[3].w;
      float size = max(.6, more.y * w / focal);
      vec3 q = vec3(p.x * k + p.y * s, p.y * k - p.x * s, p.z) * size;
      vec3 shade = p.w > 1.5 ? mix(ink.rgb, tip, .75) : ink.rgb * p.w; float a = ink.a * through; dashed = more.z;
      c = vec4(shade * a, a); gl_Position = m * vec4(at.xyz + q, 1.); }`,
    "in vec4 c; flat in float dashed; out vec4 o; void main(){ if (dashed > .5 && mod(gl_FragCoord.x + gl_FragCoord.y, 5.) < 2.) discard; o = c; }",
  ],
  trail: [
    FETCH + WIDE + `uniform sampler2D bodies, rows; uniform float now, span, width, through; uniform int base; out vec4 c;
    void main(){ int i = gl_VertexID >> 2, corner = gl_VertexID & 3; vec4 a = pull(rows, i * 2), b = pull(rows, i * 2 + 1);
      float vehicle = floor(b.w), lasts = (b.w - vehicle) * 8., end = a.w + lasts; int slot = (base + int(vehicle)) * 3;
      float alpha = pull(bodies, slot + 2).x;
      if (a.w >= now || end < now - span || alpha <= 0.) { gl_Position = vec4(2., 2., 2., 1.); c = vec4(0.); return; }
      vec3 from = mix(a.xyz, b.xyz, clamp((now - span - a.w) / lasts, 0., 1.)), to = mix(a.xyz, b.xyz, clamp((now - a.w) / lasts, 0., 1.)); float along;
      gl_Position = wide(from, to, width, corner, along);
      float age = (now - clamp((corner & 1) == 1 ? end : a.w, now - span, now)) / span, k = through * alpha * (1. - age) * (1. - .3 * age);
      c = vec4(pull(bodies, slot + 1).rgb * k, k); }`,
    PASS,
  ],
  line: [
    FETCH + WIDE + `uniform sampler2D rows; uniform float through; out vec4 c; out vec2 way; flat out float dash;
    void main(){ int i = (gl_VertexID >> 2) * 3; vec4 a = pull(rows, i), b = pull(rows, i + 1), k = pull(rows, i + 2);
      float along; gl_Position = wide(a.xyz, b.xyz, a.w, gl_VertexID & 3, along); way = vec2(along, 1.) * gl_Position.w; dash = b.w; k.a *= through; c = vec4(k.rgb * k.a, k.a); }`,
    "in vec4 c; in vec2 way; flat in float dash; out vec4 o; void main(){ if (dash > 0. && fract(way.x / way.y / dash / 1.7) > .6) discard; o = c; }",
  ],
  symbol: [
    FETCH + `uniform mat4 m; uniform vec2 view; uniform sampler2D rows; uniform float through; out vec4 c; out vec2 at; flat out vec2 kind;
    void main(){ int i = (gl_VertexID >> 2) * 3, corner = gl_VertexID & 3; vec4 p = pull(rows, i), k = pull(rows, i + 1);
      vec4 P = m * vec4(p.xyz, 1.); if (P.w < .05) { gl_Position = vec4(2., 2., 2., 1.); return; }
      at = vec2(float(corner & 1) * 2. - 1., float(corner & 2) - 1.) * (p.w + 1.5); kind = vec2(pull(rows, i + 2).x, p.w);
      P.xy += at / view * P.w; P.z -= .001 * P.w; gl_Position = P; c = vec4(k.rgb, k.a * through); }`,
    `in vec4 c; in vec2 at; flat in vec2 kind; out vec4 o;
    void main(){ float r = kind.y, d = kind.x < 1.5 || kind.x > 3.5 ? length(at) - r : kind.x < 2.5 ? (abs(at.x) + abs(at.y)) * .75 - r * .8 : max(-at.y - r * .8, (abs(at.x) * .87 + at.y * .5) - r * .55);
      float a = kind.x > .5 && kind.x < 1.5 || kind.x > 3.5 ? 1. - clamp(abs(d) - .4, 0., 1.) : 1. - clamp(d + .5, 0., 1.);
      if (kind.x > 3.5 && fract(atan(at.y, at.x) * 1.9098593) > .58) discard;
      a *= c.a; if (a < .01) discard; o = vec4(c.rgb * a, a); }`,
  ],
  volume: [
    FETCH + `in vec3 p; in vec3 q; uniform mat4 m; uniform sampler2D bodies; uniform float now, alpha, selected; uniform vec3 closed; out vec4 c;
    void main(){ float shown = now >= q.x && now <= q.y ? alpha : 0.; vec3 ink = closed; if (q.z >= 0.) { vec4 k = pull(bodies, int(q.z) * 3 + 1); ink = k.rgb; shown *= k.a > 0. ? (selected < 0. ? .7 : selected == q.z ? 1. : .12) : 0.; } else shown *= 1.6;
      gl_Position = shown > 0. ? m * vec4(p, 1.) : vec4(2., 2., 2., 1.); c = vec4(ink * shown, shown); }`,
    PASS,
  ],
};
