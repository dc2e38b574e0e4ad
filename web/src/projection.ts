// Where the Gaussians of an order are on the screen: a pass that computes it once a Gaussian and frame
// into two textures, from which the corners of the quads read.
//
// SPDX-License-Identifier: Apache-2.0
import {
  GLSL3,
  Matrix4,
  Mesh,
  NearestFilter,
  NoBlending,
  OrthographicCamera,
  RawShaderMaterial,
  RGBAIntegerFormat,
  UnsignedIntType,
  Vector2,
  type Vector3,
  Vector4,
  WebGLRenderTarget,
  type BufferGeometry,
  type DataTexture,
  type PerspectiveCamera,
  type Texture,
  type WebGLRenderer,
} from "three";

import { makeCover } from "./quads";
import { PROJECT_FRAGMENT, PROJECT_VERTEX } from "./shaders";

export const ORDER_ROW = 1024; // Gaussians in a row of an order's texture

// What is to be projected: Gaussians by number, from far to near, and where their numbers lead.
export interface Order {
  order: DataTexture;
  count: number;
  base: Texture; // these three as pack.ts says
  heads: Texture;
  more: Texture;
  colors: Texture;
  shares: Vector3; // of their opacity: of Gaussians that stay, come and go
}

// Shares of opacity seen from above, in the texture's alpha. square: its middle x, z and 1 / side.
export interface Edge {
  map: Texture;
  square: Vector4;
}

export class Projection {
  private target: WebGLRenderTarget | null = null;

  // The two textures, once there was a pass.
  get textures(): readonly Texture[] {
    return this.target?.textures ?? [];
  }

  // Rows of the order; what the textures held is gone where their size changes.
  fit(rows: number): WebGLRenderTarget {
    if (this.target?.height === rows) return this.target;
    this.target?.dispose();
    this.target = new WebGLRenderTarget(ORDER_ROW, rows, {
      count: 2,
      format: RGBAIntegerFormat,
      type: UnsignedIntType,
      minFilter: NearestFilter,
      magFilter: NearestFilter,
      depthBuffer: false,
    });
    for (const texture of this.target.textures) texture.internalFormat = "RGBA32UI";
    return this.target;
  }

  dispose() {
    this.target?.dispose();
    this.target = null;
  }
}

export class Projector {
  edge: Edge | null = null;
  private readonly mesh: Mesh<BufferGeometry, RawShaderMaterial>;
  private readonly flat = new OrthographicCamera();

  constructor(private readonly renderer: WebGLRenderer) {
    const material = new RawShaderMaterial({
      glslVersion: GLSL3,
      vertexShader: PROJECT_VERTEX,
      fragmentShader: PROJECT_FRAGMENT,
      uniforms: {
        view: { value: new Matrix4() },
        projection: { value: new Matrix4() },
        base: { value: null },
        heads: { value: null },
        more: { value: null },
        colors: { value: null },
        order: { value: null },
        shares: { value: null },
        count: { value: 0 },
        viewport: { value: new Vector2(1, 1) },
        near: { value: 0.1 },
        fades: { value: false },
        map: { value: null },
        square: { value: new Vector4() },
      },
      depthTest: false,
      depthWrite: false,
      blending: NoBlending,
    });
    this.mesh = new Mesh(makeCover(), material);
    this.mesh.frustumCulled = false;
  }

  // Leaves the render target changed; nothing is cleared. The camera's matrices are those of now.
  run(into: Projection, order: Order, camera: PerspectiveCamera, viewport: Vector2) {
    const { uniforms } = this.mesh.material;
    (uniforms["view"]!.value as Matrix4).copy(camera.matrixWorldInverse);
    (uniforms["projection"]!.value as Matrix4).copy(camera.projectionMatrix);
    (uniforms["viewport"]!.value as Vector2).copy(viewport);
    uniforms["near"]!.value = camera.near;
    uniforms["fades"]!.value = this.edge !== null;
    uniforms["map"]!.value = this.edge?.map ?? null;
    if (this.edge) (uniforms["square"]!.value as Vector4).copy(this.edge.square);
    for (const [name, value] of Object.entries(order)) uniforms[name]!.value = value as unknown;
    this.mesh.material.uniformsNeedUpdate = true;
    this.renderer.setRenderTarget(into.fit(order.order.image.height));
    this.renderer.render(this.mesh, this.flat);
  }

  dispose() {
    this.mesh.geometry.dispose();
    this.mesh.material.dispose();
  }
}
