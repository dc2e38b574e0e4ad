// Sky, horizon and level ground behind the city: a full-screen pass that knows where the ground is. Their colours
// follow the light in which the city is shown.
//
// SPDX-License-Identifier: Apache-2.0
import {
  Box3,
  GLSL3,
  Matrix4,
  Mesh,
  NoBlending,
  RawShaderMaterial,
  Vector3,
  Vector4,
  type BufferGeometry,
  type PerspectiveCamera,
  type Texture,
} from "three";

import { makeCover } from "./quads";

const VERTEX = `
in vec3 position;
uniform mat4 worldFromClip;
uniform vec3 eye;
out vec3 ray;
void main() {
  vec4 far = worldFromClip * vec4(position.xy, 1.0, 1.0);
  ray = far.xyz / far.w - eye;
  gl_Position = vec4(position.xy, 1.0, 1.0);
}`;

// Ground goes over into the horizon: from a city's length on, or from as far as it takes from high above.
export const HAZE = `
uniform vec3 eye, skyLow;
uniform float ground, reach;
uniform sampler2D base;
uniform vec4 baseAt; // middle x, z; 1 / side; brightness, 0: there is none
vec3 based(vec3 color, vec2 at) {
  if (baseAt.w == 0.0) return color;
  vec2 uv = vec2(at.x - baseAt.x, baseAt.y - at.y) * baseAt.z + 0.5;
  vec4 own = texture(base, uv);
  return mix(color, own.rgb * baseAt.w, own.a * (1.0 - smoothstep(0.75, 1.0, 2.0 * length(uv - 0.5))));
}
vec3 hazed(vec3 color, vec2 at) {
  float most = 8.0 * max(reach, eye.y - ground);
  return mix(color, skyLow, smoothstep(0.25, 1.0, length(at - eye.xz) / most));
}`;

const FRAGMENT = `
precision highp float;
in vec3 ray;
uniform vec3 skyTop, groundColor;
out vec4 result;
${HAZE}
void main() {
  vec3 d = normalize(ray);
  vec3 color = mix(skyLow, skyTop, pow(clamp(d.y, 0.0, 1.0), 0.45));
  float above = eye.y - ground;
  if (d.y < 0.0 && above > 0.0) {
    vec2 at = eye.xz + d.xz * (above / -d.y);
    color = hazed(based(groundColor, at), at);
  }
  result = vec4(color, 1.0);
}`;

const TOP = [0.36, 0.56, 0.82]; // of a sky by day
const LOW = [0.82, 0.88, 0.93]; // at its horizon
const GROUND: [number, number, number] = [0.52, 0.53, 0.5]; // until the city's own colours are known
const NIGHT = 0.1; // what is left of them by night
const LIT: [number, number] = [0.04, 0.3]; // brightness of a city by night, and of one by day
const TINGE = 0.35; // of the city's light in the horizon
const DIMMED = 0.45; // of the sky, where the page is dark

export class Backdrop {
  readonly mesh: Mesh<BufferGeometry, RawShaderMaterial>;
  // Of all that goes over into the horizon.
  readonly haze = {
    eye: { value: new Vector3() },
    skyLow: { value: new Vector3() },
    ground: { value: 0 },
    reach: { value: 100 },
    base: { value: null as Texture | null },
    baseAt: { value: new Vector4() },
  };
  private day = 1; // how bright it is
  private square: readonly [x: number, z: number, side: number] | null = null; // of the map on the ground
  private light: readonly number[] = GROUND;
  private dim = 1;

  constructor() {
    this.mesh = new Mesh(
      makeCover(),
      new RawShaderMaterial({
        glslVersion: GLSL3,
        vertexShader: VERTEX,
        fragmentShader: FRAGMENT,
        uniforms: {
          ...this.haze,
          worldFromClip: { value: new Matrix4() },
          skyTop: { value: new Vector3() },
          groundColor: { value: new Vector3(...GROUND) },
        },
        depthTest: false,
        depthWrite: false,
        blending: NoBlending,
      }),
    );
    this.mesh.frustumCulled = false;
    this.mesh.renderOrder = -1;
    this.colour();
  }

  set visible(on: boolean) {
    this.mesh.visible = on;
  }

  get visible(): boolean {
    return this.mesh.visible;
  }

  setTheme(theme: "dark" | "light") {
    this.dim = theme === "dark" ? DIMMED : 1;
    this.colour();
  }

  // The city's mean colour from above, and that of the ground far from it, from 0 to 1.
  setLight(light: readonly number[], ground: readonly number[]) {
    this.light = light;
    this.mesh.material.uniforms["groundColor"]!.value.fromArray(ground);
    this.colour();
  }

  private colour() {
    const [r, g, b] = this.light as [number, number, number];
    const bright = 0.2126 * r + 0.7152 * g + 0.0722 * b;
    const t = Math.min(1, Math.max(0, (bright - LIT[0]) / (LIT[1] - LIT[0])));
    const day = (this.day = this.dim * (NIGHT + (1 - NIGHT) * t * t * (3 - 2 * t)));
    this.laySquare();
    const tinge = [r, g, b].map((v) => 1 + TINGE * (Math.min(2, v / Math.max(0.02, bright)) - 1));
    const { uniforms } = this.mesh.material;
    const set = (name: string, color: number[]) => (uniforms[name]!.value as Vector3).fromArray(color);
    set("skyTop", TOP.map((v) => v * day));
    set("skyLow", LOW.map((v, c) => Math.min(1, v * day * tinge[c]!)));
  }

  // A picture on the ground, north above; null: none.
  setBase(texture: Texture | null, square: readonly [x: number, z: number, side: number] | null) {
    this.haze.base.value = texture;
    this.square = square;
    this.laySquare();
  }

  private laySquare() {
    const [x, z, side] = this.square ?? [0, 0, 1];
    this.haze.baseAt.value.set(x, z, 1 / side, this.square ? this.day : 0);
  }

  setExtent(box: Box3) {
    const size = box.getSize(new Vector3());
    this.haze.reach.value = Math.max(20, Math.hypot(size.x, size.z) / 2);
    this.setLevel(box.min.y);
  }

  // Height of the ground far from the city.
  setLevel(height: number) {
    this.haze.ground.value = height;
  }

  update(camera: PerspectiveCamera) {
    const { worldFromClip } = this.mesh.material.uniforms;
    (worldFromClip!.value as Matrix4).copy(camera.matrixWorld).multiply(camera.projectionMatrixInverse);
    this.haze.eye.value.copy(camera.position);
  }

  dispose() {
    this.mesh.geometry.dispose();
    this.mesh.material.dispose();
  }
}
