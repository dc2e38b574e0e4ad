// The ground that a city lies on and that goes on around it: its own colours, seen from above in the light of now,
// over its own terrain. Comes after the first picture.
//
// SPDX-License-Identifier: Apache-2.0
import {
  BufferAttribute,
  BufferGeometry,
  CanvasTexture,
  ClampToEdgeWrapping,
  DataTexture,
  GLSL3,
  LinearFilter,
  Mesh,
  NoBlending,
  PerspectiveCamera,
  RawShaderMaterial,
  RGBAFormat,
  UnsignedByteType,
  Vector3,
  Vector4,
  WebGLRenderTarget,
  type Box3,
  type WebGLRenderer,
} from "three";

import { HAZE, type Backdrop } from "./backdrop";
import type { Block } from "./block";
import type { Gaussians } from "./gaussians";
import type { Frame } from "./geo";
import { findHeights, HEIGHT_CELLS, isObject, MAP_PX, mapGround, SPAN, type Square } from "./groundmap";

const BASE_SPAN = 3; // squares that a map on the ground covers, a side
const NEAR_M = 25; // of a place
const ABOVE = 40; // halves of the square: so far that all is seen from straight above

const VERTEX = `
in vec3 position;
uniform mat4 viewMatrix, projectionMatrix;
out vec3 at;
void main() {
  at = position;
  gl_Position = projectionMatrix * viewMatrix * vec4(position, 1.0);
}`;

const FRAGMENT = `
precision highp float;
in vec3 at;
uniform sampler2D map;
uniform vec4 square; // middle x, z; 1 / side
out vec4 result;
${HAZE}
void main() {
  vec2 uv = vec2(at.x - square.x, square.y - at.z) * square.z + 0.5;
  result = vec4(hazed(based(texture(map, uv).rgb, at.xz), at.xz), 1.0);
}`;

export class Surroundings {
  readonly mesh: Mesh<BufferGeometry, RawShaderMaterial>;
  readonly map: DataTexture;
  readonly square = new Vector4();
  ready = false;
  private heights: Float32Array | null = null; // of the corners of its terrain
  private key = "";
  private terrainKey = "";
  private readonly above = new WebGLRenderTarget(MAP_PX, MAP_PX, { depthBuffer: false });
  private base: CanvasTexture | null = null;
  private baseKey = "";
  private asking = new AbortController();
  onChange: () => void = () => {}; // a map is on the ground, or gone
  private readonly camera = new PerspectiveCamera();

  constructor(
    private readonly renderer: WebGLRenderer,
    private readonly engine: Gaussians,
    private readonly backdrop: Backdrop,
  ) {
    this.map = new DataTexture(new Uint8Array(4 * MAP_PX ** 2), MAP_PX, MAP_PX, RGBAFormat, UnsignedByteType);
    this.map.minFilter = this.map.magFilter = LinearFilter;
    this.map.wrapS = this.map.wrapT = ClampToEdgeWrapping;
    const material = new RawShaderMaterial({
      glslVersion: GLSL3,
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
      uniforms: { ...backdrop.haze, map: { value: this.map }, square: { value: this.square } },
      blending: NoBlending,
    });
    this.mesh = new Mesh(new BufferGeometry(), material);
    this.mesh.frustumCulled = false;
    this.mesh.renderOrder = -0.5; // over the sky, behind all else
    this.mesh.onAfterRender = (gl) => gl.clearDepth(); // and never in front of anything
    this.mesh.visible = false;
  }

  set shown(on: boolean) {
    this.mesh.visible = on && this.heights !== null;
  }

  private keyOf(blocks: readonly Block[]): string {
    return blocks.map(({ id, tint }) => `${id}:${tint?.versions[0] ?? 0}`).join();
  }

  // Another scene comes.
  forget() {
    this.ready = false;
    this.key = this.terrainKey = "";
  }

  // It is that of these tiles, in their light of now.
  isOf(blocks: readonly Block[]): boolean {
    return this.key === this.keyOf(blocks);
  }

  // The coarsest tiles, which hold all of the scene. box: where most Gaussians are.
  follow(blocks: readonly Block[], box: Box3) {
    if (this.isOf(blocks)) return;
    this.key = this.keyOf(blocks);
    const size = box.getSize(new Vector3());
    const middle = box.getCenter(new Vector3());
    const square = { x: middle.x, z: middle.z, half: (SPAN * Math.max(size.x, size.z, 1)) / 2 };
    this.square.set(square.x, square.z, 1 / (2 * square.half), 0);
    const map = mapGround(this.look(blocks, square, middle.y), isObject(size));
    if (!map) return;
    this.map.image.data!.set(map.texels);
    this.map.needsUpdate = true;
    this.backdrop.setLight(map.light, map.far);
    const terrainKey = blocks.map(({ id }) => id).join();
    if (terrainKey !== this.terrainKey) this.raise(findHeights(blocks, square, map), square);
    this.terrainKey = terrainKey;
    this.ready = true;
  }

  // Of the ground at a place: the lowest near by, for roofs may raise it.
  heightAt(x: number, z: number): number | null {
    if (!this.heights) return null;
    const steps = [-NEAR_M, 0, NEAR_M];
    return Math.min(...steps.flatMap((i) => steps.map((k) => this.cornerHeight(x + i, z + k))));
  }

  private cornerHeight(x: number, z: number): number {
    const side = HEIGHT_CELLS + 1;
    const { square } = this;
    const heights = this.heights!;
    const along = (offset: number) => Math.min(HEIGHT_CELLS, Math.max(0, (offset * square.z + 0.5) * HEIGHT_CELLS));
    const [column, row] = [along(x - square.x), along(square.y - z)];
    const [i, k] = [Math.min(HEIGHT_CELLS - 1, Math.floor(column)), Math.min(HEIGHT_CELLS - 1, Math.floor(row))];
    const [fx, fy] = [column - i, row - k];
    const at = (north: number, east: number) => heights[(k + north) * side + i + east]!;
    const low = at(0, 0) * (1 - fx) + at(0, 1) * fx;
    return low * (1 - fy) + (at(1, 0) * (1 - fx) + at(1, 1) * fx) * fy;
  }

  // A map of somebody else on the ground, by its address; "": none.
  lay(template: string, frame: Frame) {
    const { x, y: z, z: scale } = this.square;
    const square = { x, z, half: BASE_SPAN / (2 * scale) };
    const key = template && `${template} ${x} ${z} ${scale}`;
    if (!this.ready || key === this.baseKey) return;
    this.baseKey = key;
    this.asking.abort();
    this.asking = new AbortController();
    this.setBase(null, square);
    if (!template) return;
    const { signal } = this.asking;
    void import("./basemap").then(async ({ drawBasemap }) => {
      const canvas = await drawBasemap(template, square, frame, signal);
      if (canvas && !signal.aborted) this.setBase(canvas, square);
    }, () => {});
  }

  private setBase(canvas: HTMLCanvasElement | null, { x, z, half }: Square) {
    this.base?.dispose();
    this.base = canvas && new CanvasTexture(canvas);
    if (this.base) this.base.anisotropy = 4;
    this.backdrop.setBase(this.base, canvas && [x, z, 2 * half]);
    this.onChange();
  }

  // From above.
  private look(blocks: readonly Block[], { x, z, half }: Square, y: number): Uint8Array {
    const { camera, renderer, above } = this;
    const high = ABOVE * half;
    camera.fov = (2 * Math.atan(1 / ABOVE) * 180) / Math.PI;
    camera.near = high / 2;
    camera.far = 2 * high;
    camera.up.set(0, 0, -1);
    camera.position.set(x, y + high, z);
    camera.lookAt(x, y, z);
    camera.updateProjectionMatrix();
    camera.updateMatrixWorld();
    this.engine.drawAbove(blocks, camera, above);
    const bytes = new Uint8Array(4 * MAP_PX ** 2);
    renderer.readRenderTargetPixels(above, 0, 0, MAP_PX, MAP_PX, bytes);
    return bytes;
  }

  private raise(heights: Float32Array | null, { x, z, half }: Square) {
    this.heights = heights;
    if (!heights) return;
    const side = HEIGHT_CELLS + 1;
    const places = new Float32Array(3 * side * side);
    const at = (i: number) => half * ((2 * i) / HEIGHT_CELLS - 1);
    heights.forEach((height, i) => {
      places.set([x + at(i % side), height, z - at(Math.floor(i / side))], 3 * i);
    });
    const index = new Uint16Array(6 * HEIGHT_CELLS ** 2);
    for (let cell = 0; cell < HEIGHT_CELLS ** 2; cell++) {
      const corner = cell + Math.floor(cell / HEIGHT_CELLS);
      index.set([0, 1, side + 1, 0, side + 1, side].map((step) => corner + step), 6 * cell);
    }
    this.mesh.geometry.dispose();
    this.mesh.geometry = new BufferGeometry();
    this.mesh.geometry.setAttribute("position", new BufferAttribute(places, 3));
    this.mesh.geometry.setIndex(new BufferAttribute(index, 1));
    this.backdrop.setLevel(heights.at(-1)!);
  }

  dispose() {
    this.asking.abort();
    this.base?.dispose();
    this.map.dispose();
    this.above.dispose();
    this.mesh.geometry.dispose();
    this.mesh.material.dispose();
  }
}
