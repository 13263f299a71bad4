// Three passes: every point as a small disc (its normal and depth), the picture of them with light and shade, and lines
// and handles over it, fainter where they are hidden.

const DISCS_VERTEX = `#version 300 es
layout(location = 0) in vec3 place;
layout(location = 1) in vec2 folded;
uniform mat3 rows;
uniform vec3 centre;
uniform float extent, depth, diameter;
uniform vec2 scale;
out vec3 normal;
void main() {
  vec3 n = vec3(folded, 1.0 - abs(folded.x) - abs(folded.y));
  if (n.z < 0.0) n.xy = (1.0 - abs(n.yx)) * vec2(n.x < 0.0 ? -1.0 : 1.0, n.y < 0.0 ? -1.0 : 1.0);
  normal = normalize(rows * n);
  if (normal.z < 0.0) normal = -normal;
  vec3 seen = rows * (extent * place - centre);
  gl_Position = vec4(scale * seen.xy, -seen.z / depth, 1.0);
  gl_PointSize = diameter;
}`;

const DISCS_FRAGMENT = `#version 300 es
precision highp float;
in vec3 normal;
uniform float radius;
out vec4 colour;
void main() {
  vec2 c = vec2(2.0, -2.0) * gl_PointCoord + vec2(-1.0, 1.0);
  float rise = -dot(normal.xy, c) / max(normal.z, 0.25);
  if (dot(c, c) + rise * rise > 1.0) discard;
  gl_FragDepth = gl_FragCoord.z - radius * rise;
  colour = vec4(0.5 * normal + 0.5, 1.0);
}`;

const WHOLE_VERTEX = `#version 300 es
void main() {
  gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0);
}`;

// Light comes from the viewer's left, above and behind, as in the pictures of results. Hollows are darker: where the
// skin on two opposite sides of a place is nearer to the viewer than the place is.
const SHADE_FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D normals;
uniform highp sampler2D depths;
uniform float deep, pixel, stride;
uniform int taps;
out vec4 colour;
ivec2 last;
float depthAt(ivec2 at) { return -deep * texelFetch(depths, clamp(at, ivec2(0), last), 0).r; }
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  last = textureSize(normals, 0) - 1;
  vec4 here = texelFetch(normals, at, 0);
  float up = gl_FragCoord.y / float(last.y + 1);
  vec3 ground = mix(vec3(0.925, 0.925, 0.918), vec3(0.985), up);
  float z = depthAt(at), covered = here.a, total = 1.0, level = z;
  vec3 sum = 2.0 * here.rgb - 1.0;
  if (taps > 0) {
    sum *= here.a; total = here.a; level = z * here.a;
    float around = 0.0;
    if (here.a < 0.5) {  // a pinhole between discs takes what is about it
      for (int j = -1; j <= 1; j++) for (int i = -1; i <= 1; i++) {
        ivec2 there = clamp(at + ivec2(i, j), ivec2(0), last);
        float a = texelFetch(normals, there, 0).a;
        around += a; if (a > 0.5) z = depthAt(there);
      }
      covered = around >= 5.0 ? 1.0 : 0.0;
    }
    if (covered > 0.5) for (int j = -taps; j <= taps; j++) for (int i = -taps; i <= taps; i++) {
      ivec2 there = clamp(at + ivec2(round(stride * vec2(i, j))), ivec2(0), last);
      vec4 next = texelFetch(normals, there, 0);
      float away = depthAt(there) - z, reach = pixel * stride * float(taps) + 0.5;
      float weight = next.a * exp(-float(i * i + j * j) / float(taps * taps)) * exp(-away * away / (2.0 * reach * reach));
      sum += weight * (2.0 * next.rgb - 1.0); total += weight; level += weight * depthAt(there);
    }
    z = level / max(total, 1e-6);
  }
  if (covered < 0.5) { colour = vec4(ground, 1.0); return; }
  vec3 n = normalize(sum);
  float hollow = 0.0;
  if (taps > 0) for (int ring = 0; ring < 3; ring++) {
    float mm = ring == 0 ? 3.0 : ring == 1 ? 7.0 : 15.0;
    for (int k = 0; k < 6; k++) {
      float turn = 0.5236 * (float(k) + 0.33 * float(ring));
      ivec2 aside = ivec2(round(mm / pixel * vec2(cos(turn), sin(turn))));
      float one = clamp(depthAt(at + aside) - z, -2.0 * mm, 2.0 * mm), other = clamp(depthAt(at - aside) - z, -2.0 * mm, 2.0 * mm);
      hollow += clamp((one + other) / (1.6 * mm), -0.35, 1.0) / 18.0;
    }
  }
  float key = max(dot(n, normalize(vec3(-0.35, 0.55, 0.76))), 0.0), fill = max(dot(n, normalize(vec3(0.7, -0.1, 0.7))), 0.0);
  vec3 skin = vec3(0.93, 0.80, 0.725);
  vec3 lit = skin * (0.30 + 0.56 * key + 0.15 * fill);
  lit += 0.03 * pow(max(dot(n, normalize(vec3(-0.19, 0.29, 0.94))), 0.0), 24.0);
  lit *= mix(0.80, 1.0, smoothstep(0.0, 0.55, n.z));
  lit *= 1.0 - clamp(1.3 * hollow, -0.06, 0.42);
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
