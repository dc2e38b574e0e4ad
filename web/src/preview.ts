// An appearance at once where a whole frame takes long: the picture on the screen, plus what the
// appearance changes in a small picture of the coarsest tiles. What the network adds to colours is
// blended like colours, so the difference of two pictures is that of the appearances, but for opacities
// and for what the coarse tiles blur. The exact picture follows when the choice rests.
//
// SPDX-License-Identifier: Apache-2.0
import {
  FramebufferTexture,
  GLSL3,
  Mesh,
  NoBlending,
  OrthographicCamera,
  RawShaderMaterial,
  Vector2,
  WebGLRenderTarget,
  type BufferGeometry,
  type PerspectiveCamera,
  type WebGLRenderer,
} from "three";

import type { Block } from "./block";
import type { Gaussians } from "./gaussians";
import { makeCover } from "./quads";
import { PREVIEW_FRAGMENT, PREVIEW_VERTEX } from "./shaders";

const SCALE_MOST = 0.2; // of the picture's sides
const PIXELS_MOST = 15_000; // of a small picture
const GAUSSIANS_MOST = 60_000;

export class Preview {
  private picture: FramebufferTexture | null = null; // as it was drawn, whole
  kept = false; // it is of this camera, these tiles and this size
  private begun = false; // `before` is of its appearance
  private readonly size = new Vector2();
  private readonly before = new WebGLRenderTarget(1, 1, { depthBuffer: false });
  private readonly after = new WebGLRenderTarget(1, 1, { depthBuffer: false });
  private readonly mesh: Mesh<BufferGeometry, RawShaderMaterial>;
  private readonly flat = new OrthographicCamera();

  constructor(
    private readonly renderer: WebGLRenderer,
    private readonly engine: Gaussians,
  ) {
    const material = new RawShaderMaterial({
      glslVersion: GLSL3,
      vertexShader: PREVIEW_VERTEX,
      fragmentShader: PREVIEW_FRAGMENT,
      uniforms: {
        picture: { value: null },
        before: { value: this.before.texture },
        after: { value: this.after.texture },
      },
      depthTest: false,
      depthWrite: false,
      blending: NoBlending,
    });
    this.mesh = new Mesh(makeCover(), material);
    this.mesh.frustumCulled = false;
  }

  // The canvas holds a whole picture now, and the caller has not left the task that drew it.
  keep() {
    const { renderer, size } = this;
    renderer.getDrawingBufferSize(size);
    const image = this.picture?.image as { width: number; height: number } | undefined;
    if (image?.width !== size.x || image.height !== size.y) {
      this.picture?.dispose();
      this.picture = new FramebufferTexture(size.x, size.y);
      this.mesh.material.uniforms["picture"]!.value = this.picture;
      const scale = Math.min(SCALE_MOST, Math.sqrt(PIXELS_MOST / (size.x * size.y)));
      const [width, height] = size.toArray().map((side) => Math.max(1, Math.round(scale * side)));
      for (const target of [this.before, this.after]) target.setSize(width!, height!);
    }
    renderer.copyFramebufferToTexture(this.picture!);
    this.kept = true;
    this.begun = false;
  }

  // The camera or the tiles are others.
  drop() {
    this.kept = false;
  }

  // Before an appearance changes: false where there is nothing to go by.
  begin(blocks: Block[], camera: PerspectiveCamera): boolean {
    const count = blocks.reduce((sum, block) => sum + block.splats.count, 0);
    if (!this.kept || !count || count > GAUSSIANS_MOST) return false;
    if (!this.begun) this.engine.drawSome(blocks, camera, this.before);
    this.begun = true;
    return true;
  }

  // After it has changed: onto the canvas.
  show(blocks: Block[], camera: PerspectiveCamera) {
    this.engine.drawSome(blocks, camera, this.after);
    this.renderer.render(this.mesh, this.flat);
  }

  dispose() {
    this.picture?.dispose();
    this.before.dispose();
    this.after.dispose();
    this.mesh.geometry.dispose();
    this.mesh.material.dispose();
  }
}
