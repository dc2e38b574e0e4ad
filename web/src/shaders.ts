// Shaders of the Gaussians. Projection, low-pass and the cut at 1/255 are those of the server's own
// renderer (render/common.cl, render/project.cl), so both draw one picture.
//
// SPDX-License-Identifier: Apache-2.0

import type { Weights } from "./network";
import { harmonicsOf } from "./pack";

const COMMON = `
precision highp float;
precision highp int;
precision highp usampler2D;
precision highp isampler2D;
uvec4 byte4(uint w) { return (uvec4(w) >> uvec4(0u, 8u, 16u, 24u)) & 255u; }
`;

// Reads what pack.ts writes.
const PACKED = `
uniform usampler2D base, heads, more;

uint wordOf(uint row, int x) {
  return texelFetch(more, ivec2(int(row & 3u) * 1024 + x, int(row >> 2)), 0).x;
}
vec3 centreOf(uvec4 own, uvec4 head, ivec2 at) {
  uvec3 steps = uvec3(own.x & 0x3fffu, (own.x >> 28) | ((own.y & 255u) << 4), (own.x >> 14) & 0x3fffu);
  if ((head.w & 2u) != 0u) {
    uint upper = wordOf(texelFetch(heads, ivec2(1, at.y), 0).x, at.x);
    steps |= uvec3((upper & 1023u) << 14, (upper >> 20) << 12, ((upper >> 10) & 1023u) << 14);
  }
  return uintBitsToFloat(head.xyz) + uintBitsToFloat(head.w & 0xff800000u) * vec3(steps);
}
`;

export const COLOR_VERTEX = `${COMMON}
in vec3 position;
uniform float rowCount;
void main() {
  gl_Position = vec4(position.x * 2.0 - 1.0, position.y / rowCount * 2.0 - 1.0, 0.0, 1.0);
}`;

// Spherical harmonics after the constant one, in the order of the tiles.
const BASIS = [
  ["-0.4886025119029199 * y", "0.4886025119029199 * z", "-0.4886025119029199 * x"],
  [
    "1.0925484305920792 * x * y",
    "-1.0925484305920792 * y * z",
    "0.31539156525252005 * (2.0 * zz - xx - yy)",
    "-1.0925484305920792 * x * z",
    "0.5462742152960396 * (xx - yy)",
  ],
  [
    "-0.5900435899266435 * y * (3.0 * xx - yy)",
    "2.890611442640554 * x * y * z",
    "-0.4570457994644658 * y * (4.0 * zz - xx - yy)",
    "0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy)",
    "-0.4570457994644658 * x * (4.0 * zz - xx - yy)",
    "1.445305721320277 * z * (xx - yy)",
    "-0.5900435899266435 * x * (xx - 3.0 * yy)",
  ],
];

// Colour of a Gaussian seen from the eye, 1/8192 a step, and its opacity, 1/65535 a step. Written out for
// a kind of harmonics: to find one by its number takes longer than to use it.
export function colorFragment(kind: number): string {
  const { degree, places } = harmonicsOf(kind);
  const bands = BASIS.slice(0, degree);
  const words = Math.ceil((places.at(-1)?.reduce((sum, n) => sum + n) ?? 0) / 32);
  const code = (i: number) => {
    const [bit, width] = places[i]!;
    const [word, by] = [bit >> 5, bit & 31];
    const high = by + width > 32 ? ` | (w${word + 1} << ${32 - by}u)` : "";
    return `float(((w${word} >> ${by}u)${high}) & ${2 ** width - 1}u)`;
  };
  let next = 0;
  return `${COMMON}${PACKED}
uniform isampler2D tints;
uniform bool tinted;
uniform vec3 eye;
out uvec4 result;
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  uvec4 p = texelFetch(base, at, 0);
  uvec4 head = texelFetch(heads, ivec2(0, at.y), 0);
  vec3 rgb = 0.5 + 0.28209479177387814 / 0.15 * (vec3(byte4(p.w).xyz) / 255.0 - 0.5);
  uvec4 harmonics = texelFetch(heads, ivec2(1, at.y), 0); // of the row
  ${Array.from({ length: words }, (_, w) => `uint w${w} = wordOf(harmonics.y + ${w}u, at.x);`).join("\n  ")}
  vec3 d = normalize(centreOf(p, head, at) - eye);
  float x = d.x, y = d.y, z = d.z, xx = x * x, yy = y * y, zz = z * z;
  vec3 codes;
  float basis, sum, least, size;
  ${bands
    .map((terms, band) => {
      const each = terms.map((term) => {
        const v = [0, 1, 2].map(() => code(next++)).join(", ");
        return `basis = ${term}; sum += basis; codes += basis * vec3(${v});`;
      });
      return `codes = vec3(0.0);
  sum = 0.0;
  ${each.join("\n  ")}
  least = float((harmonics.z >> ${8 * band}u) & 255u) - 128.0;
  size = float(1u << ((harmonics.w >> ${4 * band}u) & 15u));
  rgb += (least * sum + size * codes) / 128.0;`;
    })
    .join("\n  ")}
  float opacity = float(byte4(p.w).w) / 255.0;
  ivec4 tint = tinted ? texelFetch(tints, at, 0) : ivec4(-1);
  if (tint.w >= 0) { // cut once, as in render/project.cl; below 0 when it is stored
    vec4 added = vec4(tint) / 32767.0;
    rgb = min(rgb + added.xyz, 1.0);
    opacity = min(opacity + added.w, 1.0);
  }
  result = uvec4(clamp(vec4(rgb * 8192.0, opacity * 65535.0) + 0.5, 0.0, 65535.0));
}`;
}

export const TINT_VERTEX = `${COMMON}
in vec3 position;
uniform vec2 span; // rows, as parts of the texture's height
void main() {
  float y = mix(span.x, span.y, position.y);
  gl_Position = vec4(position.x * 2.0 - 1.0, y * 2.0 - 1.0, 0.0, 1.0);
}`;

// What an appearance adds to red, green, blue and opacity, 1/32767 a step: the network of
// docs/appearance.md without loops, its weights as literals: of a scene they never change, and reading
// them from uniforms would take most of the time where a processor draws.
export function tintFragment(network: Weights): string {
  const { quads, hidden, w1, w2, b2 } = network;
  const each = (count: number, line: (k: number) => string, between: string) =>
    Array.from({ length: count }, (_, k) => line(k)).join(between);
  const four = (from: Float32Array, at: number) =>
    `vec4(${each(4, (k) => from[at + k]!.toExponential(8), ", ")})`;
  const planes = Math.ceil(quads / 4);
  const unit = (h: number) => {
    const sum = each(quads, (q) => `dot(${four(w1, 4 * (quads * h + q))}, g${q})`, " + ");
    return `y += ${four(w2, 4 * h)} * max(bias[${h >> 2}][${h & 3}] + unit * (${sum}), 0.0);`;
  };
  return `${COMMON}
uniform usampler2D ${each(planes, (k) => `embed${k}`, ", ")};
uniform vec4 bias[${Math.ceil(hidden / 4)}];
uniform vec4 least[${quads}], steps[${quads}];
out ivec4 result;
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  ${each(planes, (k) => `uvec4 p${k} = texelFetch(embed${k}, at, 0);`, "\n  ")}
  ${each(quads, (q) => `vec4 g${q} = least[${q}] + steps[${q}] * vec4(byte4(p${q >> 2}[${q & 3}]));`, "\n  ")}
  float unit = inversesqrt(max(${each(quads, (q) => `dot(g${q}, g${q})`, " + ")}, 1e-24));
  vec4 y = ${four(b2, 0)};
  ${each(hidden, unit, "\n  ")}
  y = 1.0 / (1.0 + exp(-y));
  result = ivec4(round(vec4(2.0 * y.xyz - 1.0, y.w) * 32767.0));
}`;
}

// No appearance: colour and opacity are what the tile says.
export const PLAIN_FRAGMENT = `${COMMON}
out ivec4 result;
void main() { result = ivec4(-1); }`;

export const PROJECT_VERTEX = `${COMMON}
in vec3 position;
void main() { gl_Position = vec4(position, 1.0); }`;

// Where a Gaussian of the order is on the screen, once a frame: a quad's four corners would each find it
// out anew. Opacity 0: it is not drawn.
//   first   centre x, y (of the screen, -1..1), depth along the view (m), larger axis (px, two halves)
//   second  slope of the depth (m a px, two halves), smaller axis (a half) and opacity, red and green, blue
export const PROJECT_FRAGMENT = `${COMMON}${PACKED}
uniform mat4 view, projection;
uniform usampler2D colors, order;
uniform int count;
uniform vec2 viewport;
uniform float near;
uniform vec3 shares;
uniform bool fades;
uniform sampler2D map;
uniform vec4 square;
layout(location = 0) out uvec4 first;
layout(location = 1) out uvec4 second;

// Row-major rotation of SPZ's "smallest three".
mat3 rotation(uint packed) {
  uint largest = packed >> 30;
  vec4 q = vec4(0.0);
  float sum = 0.0;
  uint shift = 20u;
  for (uint i = 0u; i < 4u; i++) {
    if (i == largest) continue;
    uint field = (packed >> shift) & 1023u;
    float v = float(field & 511u) * 0.7071067811865476 / 511.0;
    if ((field & 512u) != 0u) v = -v;
    q[i] = v;
    sum += v * v;
    shift -= 10u;
  }
  q[largest] = sqrt(max(0.0, 1.0 - sum));
  float x = q.x, y = q.y, z = q.z, w = q.w;
  return mat3(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
              2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
              2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}

void main() {
  first = uvec4(0u);
  second = uvec4(0u); // not drawn
  ivec2 rank = ivec2(gl_FragCoord.xy);
  if (rank.y * 1024 + rank.x >= count) return;
  uint index = texelFetch(order, rank, 0).x;
  ivec2 at = ivec2(int(index & 1023u), int((index >> 10) & 0xfffffu));
  uvec4 p = texelFetch(base, at, 0);
  uvec4 head = texelFetch(heads, ivec2(0, at.y), 0);
  vec3 world = centreOf(p, head, at);
  vec3 t = (view * vec4(world, 1.0)).xyz;
  float depth = -t.z;
  if (depth < near) return;
  uvec4 own = texelFetch(colors, at, 0);
  float opacity = float(own.w) / 65535.0 * shares[index >> 30];
  if (fades) opacity *= texture(map, vec2(world.x - square.x, square.y - world.z) * square.z + 0.5).a;
  vec3 sigma = exp(vec3(byte4(p.y).yzw) / 16.0 - 10.0);
  vec2 focal = vec2(projection[0][0], projection[1][1]) * viewport * 0.5;

  // The Jacobian of the projection at the centre, which is held near the frustum.
  vec2 limit = 1.3 / vec2(projection[0][0], projection[1][1]);
  vec2 ray = clamp(t.xy / depth, -limit, limit);
  mat3 turn = mat3(view) * rotation(p.z);
  vec3 u = focal.x / depth * (vec3(turn[0].x, turn[1].x, turn[2].x) +
                              ray.x * vec3(turn[0].z, turn[1].z, turn[2].z)) * sigma;
  vec3 v = focal.y / depth * (vec3(turn[0].y, turn[1].y, turn[2].y) +
                              ray.y * vec3(turn[0].z, turn[1].z, turn[2].z)) * sigma;
  float a = dot(u, u), c = dot(v, v), b = dot(u, v);
  vec3 minors = cross(u, v);
  float det0 = dot(minors, minors);
  float det = det0 + 0.3 * (a + c + 0.3);
  a += 0.3;
  c += 0.3;
  if ((head.w & 1u) != 0u) opacity *= sqrt(max(det0 / det, 2.5e-5));
  if (opacity < 1.0 / 255.0) return;
  float reach = sqrt(2.0 * log(255.0 * opacity));

  float mid = 0.5 * (a + c);
  float radius = length(vec2(0.5 * (a - c), b));
  float major = mid + radius, minor = max(det / major, 1e-4);
  if (depth < 4.0 * near && reach * sqrt(major) > 2.0 * max(viewport.x, viewport.y)) return;
  vec2 axis = abs(b) < 1e-6 * mid ? (a >= c ? vec2(1.0, 0.0) : vec2(0.0, 1.0))
                                  : normalize(vec2(b, major - a));
  vec4 clip = projection * vec4(t, 1.0);
  vec2 center = clip.xy / clip.w;
  vec2 halfSize = reach * sqrt(vec2(a, c)) / (0.5 * viewport);
  if (any(greaterThan(abs(center), 1.0 + halfSize))) return;

  // Where the Gaussian is densest along a ray: flat ones lie where their plane is.
  vec3 w = vec3(turn[0].z, turn[1].z, turn[2].z) * sigma;
  vec2 slope = vec2(c * dot(w, u) - b * dot(w, v), a * dot(w, v) - b * dot(w, u)) / det;
  first = uvec4(floatBitsToUint(vec3(center, t.z)), packHalf2x16(axis * sqrt(major)));
  second = uvec4(packHalf2x16(clamp(slope, -6e4, 6e4)),
                 packHalf2x16(vec2(sqrt(minor), 0.0)) | (uint(opacity * 65535.0 + 0.5) << 16),
                 own.x | (own.y << 16), own.z);
}`;

export const SPLAT_VERTEX = `${COMMON}
in vec3 position; // corner, number within the instance
uniform mat4 projectionMatrix;
uniform usampler2D first, second;
uniform int count;
uniform vec2 viewport;
uniform float near;
out vec2 offset; // in sigmas
flat out vec4 color;

void main() {
  gl_Position = vec4(0.0, 0.0, 2.0, 1.0); // outside: nothing is drawn
  int rank = gl_InstanceID * 128 + int(position.z);
  if (rank >= count) return;
  ivec2 at = ivec2(rank & 1023, rank >> 10);
  uvec4 own = texelFetch(second, at, 0);
  float opacity = float(own.y >> 16) / 65535.0;
  if (opacity == 0.0) return;
  uvec4 p = texelFetch(first, at, 0);
  vec3 center = uintBitsToFloat(p.xyz);
  vec2 major = unpackHalf2x16(p.w);
  vec2 minor = unpackHalf2x16(own.y & 65535u).x * normalize(vec2(-major.y, major.x));
  vec2 corner = position.xy * sqrt(max(2.0 * log(255.0 * opacity), 0.0));
  vec2 px = major * corner.x + minor * corner.y;
  float z = min(center.z + dot(unpackHalf2x16(own.x), px), -near);
  float ndc = (projectionMatrix[2][2] * z + projectionMatrix[3][2]) / -z;
  offset = corner;
  color = vec4(vec3(own.z & 65535u, own.z >> 16, own.w) / 8192.0, opacity);
  gl_Position = vec4(center.xy + px / (0.5 * viewport), clamp(ndc, -1.0, 1.0), 1.0);
}`;

export const SPLAT_FRAGMENT = `${COMMON}
in vec2 offset;
flat in vec4 color;
uniform bool solid; // for depth alone: not the faint rim
out vec4 result;
void main() {
  float alpha = color.a * exp(-0.5 * dot(offset, offset));
  if (alpha < (solid ? 0.25 : 1.0 / 255.0)) discard;
  result = vec4(color.rgb * alpha, alpha);
}`;

export const PREVIEW_VERTEX = `${COMMON}
in vec3 position;
out vec2 at;
void main() {
  at = 0.5 + 0.5 * position.xy;
  gl_Position = vec4(position, 1.0);
}`;

// The picture, and what changed in a smaller one.
export const PREVIEW_FRAGMENT = `${COMMON}
in vec2 at;
uniform sampler2D picture, before, after;
out vec4 result;
void main() {
  vec3 rgb = texelFetch(picture, ivec2(gl_FragCoord.xy), 0).rgb;
  result = vec4(rgb + texture(after, at).rgb - texture(before, at).rgb, 1.0);
}`;
