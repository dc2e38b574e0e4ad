// Shapes laid onto the city: drawn once as a picture from straight above, and in every frame put onto
// whatever surface the Gaussians make, by its depth. So they lie on roofs and trees of any level of detail.
//
// SPDX-License-Identifier: Apache-2.0
import {
  Box3,
  BufferAttribute,
  BufferGeometry,
  CanvasTexture,
  CustomBlending,
  DepthTexture,
  GLSL3,
  LinearFilter,
  LinearMipmapLinearFilter,
  Matrix4,
  Mesh,
  NearestFilter,
  OneFactor,
  OneMinusSrcAlphaFactor,
  OrthographicCamera,
  RawShaderMaterial,
  UnsignedIntType,
  Vector2,
  Vector3,
  Vector4,
  WebGLRenderTarget,
  type PerspectiveCamera,
  type WebGLRenderer,
} from "three";

import type { Frame } from "./geo";
import type { Shape } from "./overlay";
import { TOUCH } from "./touch";

const SIDE_PX = TOUCH ? 2048 : 4096;
const TEXEL_LEAST_M = 0.05;
const LINE_M = [0.3, 3] as const;
const MARGIN_M = 30; // beyond the city
const FILL = 0.3;

const VERTEX = `
in vec3 position;
out vec2 at;
void main() {
  at = 0.5 + 0.5 * position.xy;
  gl_Position = vec4(position.xy, 0.0, 1.0);
}`;

// Where the city is not, shapes lie on the ground behind it. The depth goes on to what is drawn next.
const FRAGMENT = `
precision highp float;
precision highp sampler2D;
in vec2 at;
uniform sampler2D depth, picture;
uniform mat4 worldFromClip;
uniform vec4 area; // west, north; 1 / width, 1 / height
uniform vec3 eye;
uniform float ground, texels; // of the picture in a metre, times a pixel at one metre
out vec4 result;
void main() {
  float d = texelFetch(depth, ivec2(gl_FragCoord.xy), 0).x;
  vec4 p = worldFromClip * vec4(vec3(at, d) * 2.0 - 1.0, 1.0);
  vec3 world = p.xyz / p.w;
  if (d >= 1.0) {
    vec3 ray = world - eye;
    float t = (ground - eye.y) / ray.y;
    world = t > 0.0 ? eye + t * ray : vec3(1e9);
  }
  vec2 uv = (world.xz - area.xy) * area.zw;
  float lod = log2(max(1.0, texels * distance(world, eye)));
  bool inside = all(greaterThan(uv, vec2(0.0))) && all(lessThan(uv, vec2(1.0)));
  gl_FragDepth = d;
  result = inside ? textureLod(picture, uv, lod) : vec4(0.0);
}`;

export class Drape {
  private readonly target = new WebGLRenderTarget(1, 1);
  private readonly mesh: Mesh<BufferGeometry, RawShaderMaterial>;
  private readonly flat = new OrthographicCamera();
  private picture: CanvasTexture | null = null;
  private perMetre = 0; // texels

  constructor() {
    this.target.depthTexture = new DepthTexture(1, 1, UnsignedIntType);
    this.target.depthTexture.minFilter = this.target.depthTexture.magFilter = NearestFilter;
    const geometry = new BufferGeometry();
    const corners = new Float32Array([-1, -1, 0, 3, -1, 0, -1, 3, 0]); // one triangle over everything
    geometry.setAttribute("position", new BufferAttribute(corners, 3));
    const material = new RawShaderMaterial({
      glslVersion: GLSL3,
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
      uniforms: {
        depth: { value: this.target.depthTexture },
        picture: { value: null },
        worldFromClip: { value: new Matrix4() },
        area: { value: new Vector4() },
        eye: { value: new Vector3() },
        ground: { value: 0 },
        texels: { value: 0 },
      },
      transparent: true,
      blending: CustomBlending,
      blendSrc: OneFactor,
      blendDst: OneMinusSrcAlphaFactor,
    });
    this.mesh = new Mesh(geometry, material);
    this.mesh.frustumCulled = false;
  }

  get empty(): boolean {
    return this.picture === null;
  }

  // extent: of the city, in the scene's metres. What lies beyond it is left out.
  set(shapes: Shape[], frame: Frame, extent: Box3) {
    this.picture?.dispose();
    this.picture = null;
    const flat = shapes.map((shape) => ({
      shape,
      rings: [shape.places, ...(shape.holes ?? [])].map((ring) =>
        ring.map((place) => {
          const { x, z } = frame.pointOf(place);
          return new Vector2(x, z);
        }),
      ),
    }));
    const area = new Box3().setFromPoints(
      flat.flatMap(({ rings }) => rings[0]!.map(({ x, y }) => new Vector3(x, 0, y))),
    );
    area.min.y = extent.min.y;
    area.max.y = extent.max.y;
    const within = extent.clone().expandByScalar(0.5 * extent.getSize(new Vector3()).length() + MARGIN_M);
    area.expandByScalar(LINE_M[1] * 2).intersect(within);
    if (area.isEmpty()) return;
    const size = area.getSize(new Vector3());
    const texel = Math.max(TEXEL_LEAST_M, Math.max(size.x, size.z) / SIDE_PX);
    const canvas = document.createElement("canvas");
    canvas.width = Math.max(1, Math.ceil(size.x / texel));
    canvas.height = Math.max(1, Math.ceil(size.z / texel));
    const pen = canvas.getContext("2d");
    if (!pen) return;
    const width = Math.max(2 * texel, Math.min(LINE_M[1], Math.max(LINE_M[0], Math.max(size.x, size.z) / 400)));
    pen.scale(1 / texel, 1 / texel);
    pen.translate(-area.min.x, -area.min.z);
    pen.lineWidth = width;
    pen.lineJoin = pen.lineCap = "round";
    for (const { shape, rings } of flat) drawShape(pen, shape, rings, width);
    this.picture = new CanvasTexture(canvas);
    this.picture.flipY = false;
    this.picture.premultiplyAlpha = true;
    this.picture.magFilter = LinearFilter;
    this.picture.minFilter = LinearMipmapLinearFilter;
    const { uniforms } = this.mesh.material;
    uniforms["picture"]!.value = this.picture;
    const spans = [1 / (canvas.width * texel), 1 / (canvas.height * texel)] as const;
    (uniforms["area"]!.value as Vector4).set(area.min.x, area.min.z, ...spans);
    uniforms["ground"]!.value = extent.min.y;
    this.perMetre = 1 / texel;
  }

  // Over the picture on the canvas. drawDepth: draws the depth of the city into the current target.
  draw(renderer: WebGLRenderer, camera: PerspectiveCamera, drawDepth: () => void) {
    const size = renderer.getDrawingBufferSize(new Vector2());
    const { target, mesh } = this;
    if (target.width !== size.x || target.height !== size.y) target.setSize(size.x, size.y);
    const before = renderer.getRenderTarget();
    const clear = renderer.autoClear;
    renderer.setRenderTarget(target);
    renderer.autoClear = true;
    drawDepth();
    renderer.setRenderTarget(before);
    renderer.autoClear = false;
    const { uniforms } = mesh.material;
    (uniforms["worldFromClip"]!.value as Matrix4)
      .copy(camera.matrixWorld)
      .multiply(camera.projectionMatrixInverse);
    (uniforms["eye"]!.value as Vector3).copy(camera.position);
    const pixel = (2 * Math.tan((camera.fov * Math.PI) / 360)) / size.y;
    uniforms["texels"]!.value = this.perMetre * pixel;
    renderer.render(mesh, this.flat);
    renderer.autoClear = clear;
  }

  dispose() {
    this.picture?.dispose();
    this.target.depthTexture?.dispose();
    this.target.dispose();
    this.mesh.geometry.dispose();
    this.mesh.material.dispose();
  }
}

function drawShape(pen: CanvasRenderingContext2D, shape: Shape, rings: Vector2[][], width: number) {
  pen.strokeStyle = pen.fillStyle = shape.color ?? "#ffd166";
  pen.beginPath();
  if (shape.kind === "point") {
    for (const { x, y } of rings[0]!) {
      pen.moveTo(x + 2 * width, y);
      pen.arc(x, y, 2 * width, 0, 2 * Math.PI);
    }
    pen.fill();
    return;
  }
  for (const ring of rings) {
    ring.forEach(({ x, y }, i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
    if (shape.kind === "area") pen.closePath();
  }
  if (shape.kind === "area") {
    pen.globalAlpha = FILL;
    pen.fill("evenodd");
    pen.globalAlpha = 1;
  }
  pen.stroke();
}
