// Sky, horizon and ground behind the city: a full-screen pass that knows where the ground plane is,
// with a grid of metres that fades towards the horizon.
//
// SPDX-License-Identifier: Apache-2.0
import {
  Box3,
  BufferAttribute,
  BufferGeometry,
  GLSL3,
  Matrix4,
  Mesh,
  NoBlending,
  RawShaderMaterial,
  Vector2,
  Vector3,
  type PerspectiveCamera,
} from "three";

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

const FRAGMENT = `
precision highp float;
in vec3 ray;
uniform vec3 eye, skyTop, skyLow, groundColor;
uniform vec2 center;
uniform float ground, reach, cell;
out vec4 result;
float lines(vec2 p, float size, float width) {
  vec2 w = width * fwidth(p / size);
  vec2 g = abs(fract(p / size - 0.5) - 0.5);
  vec2 on = 1.0 - smoothstep(w, w * 2.0, g);
  return max(on.x, on.y) * (1.0 - smoothstep(0.15, 0.5, max(w.x, w.y)));
}
void main() {
  vec3 d = normalize(ray);
  float up = d.y;
  vec3 sky = mix(skyLow, skyTop, pow(clamp(up, 0.0, 1.0), 0.45));
  vec3 color = sky;
  float above = eye.y - ground;
  if (up < 0.0 && above > 0.0) {
    vec2 at = eye.xz + d.xz * (above / -up);
    float far = length(at - center) / reach;
    float near = 1.0 - smoothstep(0.8, 4.0, far);
    float grid = max(0.5 * lines(at, cell, 1.0), lines(at, cell * 10.0, 1.2));
    vec3 floor_ = groundColor + 0.07 * grid * near;
    float haze = smoothstep(1.0, 7.0, far);
    color = mix(floor_, skyLow, max(haze, smoothstep(-0.05, 0.0, up)));
  }
  result = vec4(color, 1.0);
}`;

const COLORS = {
  dark: { skyTop: [0.04, 0.06, 0.1], skyLow: [0.2, 0.25, 0.32], groundColor: [0.12, 0.14, 0.16] },
  light: { skyTop: [0.36, 0.56, 0.82], skyLow: [0.82, 0.88, 0.93], groundColor: [0.6, 0.62, 0.6] },
};

export class Backdrop {
  readonly mesh: Mesh<BufferGeometry, RawShaderMaterial>;

  constructor() {
    const geometry = new BufferGeometry();
    const corners = new Float32Array([-1, -1, 0, 3, -1, 0, -1, 3, 0]);
    geometry.setAttribute("position", new BufferAttribute(corners, 3));
    this.mesh = new Mesh(
      geometry,
      new RawShaderMaterial({
        glslVersion: GLSL3,
        vertexShader: VERTEX,
        fragmentShader: FRAGMENT,
        uniforms: {
          worldFromClip: { value: new Matrix4() },
          eye: { value: new Vector3() },
          center: { value: new Vector2() },
          ground: { value: 0 },
          reach: { value: 100 },
          cell: { value: 10 },
          skyTop: { value: new Vector3() },
          skyLow: { value: new Vector3() },
          groundColor: { value: new Vector3() },
        },
        depthTest: false,
        depthWrite: false,
        blending: NoBlending,
      }),
    );
    this.mesh.frustumCulled = false;
    this.mesh.renderOrder = -1;
    this.setTheme("dark");
  }

  set visible(on: boolean) {
    this.mesh.visible = on;
  }

  get visible(): boolean {
    return this.mesh.visible;
  }

  setTheme(theme: "dark" | "light") {
    for (const [name, value] of Object.entries(COLORS[theme]))
      (this.mesh.material.uniforms[name]!.value as Vector3).fromArray(value);
  }

  setExtent(box: Box3) {
    const size = box.getSize(new Vector3());
    const middle = box.getCenter(new Vector3());
    const reach = Math.max(20, Math.hypot(size.x, size.z) / 2);
    const uniforms = this.mesh.material.uniforms;
    (uniforms["center"]!.value as Vector2).set(middle.x, middle.z);
    uniforms["ground"]!.value = box.min.y;
    uniforms["reach"]!.value = reach;
    uniforms["cell"]!.value = 10 ** Math.max(0, Math.round(Math.log10(reach / 12)));
  }

  update(camera: PerspectiveCamera) {
    const uniforms = this.mesh.material.uniforms;
    (uniforms["worldFromClip"]!.value as Matrix4)
      .copy(camera.matrixWorld)
      .multiply(camera.projectionMatrixInverse);
    (uniforms["eye"]!.value as Vector3).copy(camera.position);
  }

  dispose() {
    this.mesh.geometry.dispose();
    this.mesh.material.dispose();
  }
}
