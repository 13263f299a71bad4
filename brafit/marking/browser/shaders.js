// Three passes: every point as a small disc (its normal and depth), the picture of them with light and shade, and lines
// and handles over it, fainter where they are hidden.

const DISCS_VERTEX = `#version 300 es
layout(location = 0) in vec3 place;
layout(location = 1) in vec2 folded;
uniform mat3 rows;
uniform vec3 centre;
layout(location = 2) in float size;
uniform float extent, depth, radius, pixels;
uniform vec2 scale;
out vec3 normal;
out float rise;
void main() {
  vec3 n = vec3(folded, 1.0 - abs(folded.x) - abs(folded.y));
  if (n.z < 0.0) n.xy = (1.0 - abs(n.yx)) * vec2(n.x < 0.0 ? -1.0 : 1.0, n.y < 0.0 ? -1.0 : 1.0);
  normal = normalize(rows * n);
  if (normal.z < 0.0) normal = -normal;
  vec3 seen = rows * (extent * place - centre);
  gl_Position = vec4(scale * seen.xy, -seen.z / depth, 1.0);
  gl_PointSize = max(2.0, 2.0 * radius * size * pixels);
  rise = radius * size / (2.0 * depth);
}`;

const DISCS_FRAGMENT = `#version 300 es
precision highp float;
in vec3 normal;
in float rise;
out vec4 colour;
void main() {
  vec2 c = vec2(2.0, -2.0) * gl_PointCoord + vec2(-1.0, 1.0);
  float slope = -dot(normal.xy, c) / max(normal.z, 0.25);
  if (dot(c, c) + slope * slope > 1.0) discard;
#ifdef FINE
  gl_FragDepth = gl_FragCoord.z - rise * slope;
#endif
  colour = vec4(0.5 * normal + 0.5, 1.0);
}`;

const WHOLE_VERTEX = `#version 300 es
void main() {
  gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0);
}`;

// Normals smoothed along one direction of the picture, across no step in depth; pinholes between discs are closed.
const SMOOTH_FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D normals;
uniform highp sampler2D depths;
uniform float deep, reach;
uniform vec2 stride;
out vec4 colour;
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy), last = textureSize(normals, 0) - 1;
  vec4 here = texelFetch(normals, at, 0);
  float z = texelFetch(depths, at, 0).r, beside = 0.0;
  vec3 sum = here.a * (2.0 * here.rgb - 1.0);
  for (int k = 1; k <= 3; k++) for (int way = -1; way <= 1; way += 2) {
    ivec2 there = clamp(at + ivec2(round(float(way * k) * stride)), ivec2(0), last);
    vec4 next = texelFetch(normals, there, 0);
    float away = here.a > 0.5 ? deep * (texelFetch(depths, there, 0).r - z) / reach : 0.0;
    sum += next.a * exp(-float(k * k) / 6.0 - away * away) * (2.0 * next.rgb - 1.0);
    if (k == 1) beside += next.a;
  }
  float covered = max(here.a, beside > 1.5 ? 1.0 : 0.0);
  colour = covered * vec4(0.5 * normalize(sum + vec3(0.0, 0.0, 1e-6)) + 0.5, 1.0);
}`;

// Light comes from the viewer's left, above and behind, as in the pictures of results. Hollows are darker: where normals
// on two sides of a place lean to each other, and beside what is much nearer to the viewer.
const SHADE_FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D normals;
uniform highp sampler2D depths;
uniform float deep, pixel;
uniform int rings;
out vec4 colour;
ivec2 last;
float depthAt(ivec2 at) { return -deep * texelFetch(depths, clamp(at, ivec2(0), last), 0).r; }
vec4 normalAt(ivec2 at) { vec4 n = texelFetch(normals, clamp(at, ivec2(0), last), 0); return vec4(2.0 * n.xyz - 1.0, n.a); }
float hollow(ivec2 at) {
  float sum = 0.0, z = depthAt(at);
  if (z < -0.999 * deep) return 0.0;
  for (int k = 0; k < 4 * rings; k++) {
    float turn = 0.7854 * (float(k) + 0.5), mm = k < 4 ? 5.0 : 12.0;
    vec2 way = vec2(cos(turn), sin(turn));
    ivec2 aside = ivec2(round(mm / pixel * way));
    vec4 one = normalAt(at + aside), other = normalAt(at - aside);
    float lean = one.a * other.a * dot(other.xy - one.xy, way);
    float over = max(depthAt(at + aside), depthAt(at - aside)) - z;
    sum += over < 2.0 * mm ? clamp(0.5 * lean, -0.1, 0.5) : 0.25 * clamp(over / mm - 2.0, 0.0, 1.0);
  }
  return sum / float(4 * max(rings, 1));
}
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  last = textureSize(normals, 0) - 1;
  vec4 here = normalAt(at);
  if (here.a < 0.5) {
    colour = vec4(mix(vec3(0.925, 0.925, 0.918), vec3(0.985), gl_FragCoord.y / float(last.y + 1)), 1.0);
    return;
  }
  vec3 n = normalize(here.xyz);
  float key = max(dot(n, normalize(vec3(-0.35, 0.55, 0.76))), 0.0), fill = max(dot(n, normalize(vec3(0.7, -0.1, 0.7))), 0.0);
  vec3 lit = vec3(0.93, 0.80, 0.725) * (0.30 + 0.56 * key + 0.15 * fill);
  lit += 0.03 * pow(max(dot(n, normalize(vec3(-0.19, 0.29, 0.94))), 0.0), 24.0);
  lit *= mix(0.80, 1.0, smoothstep(0.0, 0.55, n.z));
  lit *= 1.0 - clamp(2.2 * hollow(at), -0.05, 0.5);
  colour = vec4(lit, 1.0);
}`;

const COPY_FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D shaded;
uniform vec2 size;
out vec4 colour;
void main() { colour = vec4(texture(shaded, gl_FragCoord.xy / size).rgb, 1.0); }`;

const STROKES_VERTEX = `#version 300 es
layout(location = 0) in vec3 place;
layout(location = 1) in vec3 shape;
layout(location = 2) in vec4 tint;
uniform float round;
out vec3 form;
out vec4 paint;
void main() {
  gl_Position = vec4(place, 1.0);
  gl_PointSize = shape.x;
  form = shape;
  paint = tint;
}`;

// A line's shape: across from -1 to 1, its half width; a dot's: its diameter, whether it is filled.
const STROKES_FRAGMENT = `#version 300 es
precision highp float;
in vec3 form;
in vec4 paint;
uniform float round, bias;
uniform highp sampler2D depths;
uniform vec2 share;
out vec4 colour;
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy * share);
  float hidden = step(texelFetch(depths, at, 0).r + bias, gl_FragCoord.z);
  vec4 own = paint;
  if (round > 0.5) {
    float away = form.x * length(gl_PointCoord - 0.5), edge = 0.5 * form.x - 1.0;
    own.a *= 1.0 - smoothstep(edge - 0.7, edge + 0.7, away);
    if (form.y < 0.5) own.rgb = mix(vec3(1.0), own.rgb, smoothstep(0.58 * edge - 0.7, 0.58 * edge + 0.7, away));
    else own.rgb = mix(own.rgb, vec3(1.0), smoothstep(0.78 * edge - 0.7, 0.78 * edge + 0.7, away));
  } else {
    own.a *= 1.0 - smoothstep(form.y - 1.0, form.y, abs(form.x) * form.y);
  }
  own.a *= mix(1.0, 0.28, hidden);
  if (own.a < 0.01) discard;
  colour = own;
}`;
