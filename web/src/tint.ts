// The appearance network on the graphics card: a pass that writes, for every Gaussian of a tile, what
// the appearance adds to its colour and opacity. It runs once a tile and appearance, not once a frame.
//
// SPDX-License-Identifier: Apache-2.0
import {
  BufferAttribute,
  BufferGeometry,
  GLSL3,
  Mesh,
  NoBlending,
  OrthographicCamera,
  RawShaderMaterial,
  Vector2,
  type DataTexture,
  type WebGLRenderer,
} from "three";

import { quadsOf, type Network } from "./network";
import { TINT_VERTEX, tintFragment } from "./shaders";
import type { Embedding } from "./pack";

const OTHER_UNIFORMS = 4; // of the fragment shader, beside the network

// Vectors of four that the pass needs of the fragment shader's uniforms.
function uniformsOf({ gaussian, hidden }: Network): number {
  return quadsOf(hidden) + 2 * quadsOf(gaussian) + OTHER_UNIFORMS;
}

export class Tint {
  // Of the appearance, and of the second one: tiles with another one are to be computed anew. 0: none.
  readonly versions: [number, number] = [0, 0];
  readonly names: [string, string | null] = ["", null]; // of the two
  private readonly biases: [Float32Array | null, Float32Array | null] = [null, null];
  private readonly mesh: Mesh<BufferGeometry, RawShaderMaterial>;
  private readonly flat = new OrthographicCamera();
  private readonly quads: number;
  private count = 0;

  static fits(network: Network, renderer: WebGLRenderer): boolean {
    return uniformsOf(network) <= renderer.capabilities.maxFragmentUniforms;
  }

  constructor(readonly network: Network) {
    this.quads = quadsOf(network.gaussian);
    const planes = Array.from({ length: Math.ceil(network.gaussian / 16) }, (_, k) => `embed${k}`);
    const material = new RawShaderMaterial({
      glslVersion: GLSL3,
      vertexShader: TINT_VERTEX,
      fragmentShader: tintFragment(network.constants),
      uniforms: {
        ...Object.fromEntries(planes.map((name) => [name, { value: null }])),
        span: { value: new Vector2() },
        bias: { value: null },
        least: { value: null },
        steps: { value: null },
      },
      depthTest: false,
      depthWrite: false,
      blending: NoBlending,
    });
    const geometry = new BufferGeometry();
    const corners = new Float32Array([0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 0, 0, 1, 1, 0, 0, 1, 0]);
    geometry.setAttribute("position", new BufferAttribute(corners, 3));
    this.mesh = new Mesh(geometry, material);
    this.mesh.frustumCulled = false;
  }

  // From now on this appearance.
  set(image: Float32Array, name: string) {
    this.biases[0] = this.network.biasOf(image);
    this.names[0] = name;
    this.versions[0] = ++this.count;
  }

  // The one on the right of a divided picture; null: none.
  setSecond(image: Float32Array | null, name: string | null) {
    this.biases[1] = image && this.network.biasOf(image);
    this.versions[1] = image ? ++this.count : 0;
    this.names[1] = image && name;
  }

  // Into the current target, rows [from, from + count) of `height`; side 1 is the second appearance.
  draw(
    renderer: WebGLRenderer,
    side: 0 | 1,
    planes: DataTexture[],
    embedding: Embedding,
    from: number,
    count: number,
    height: number,
  ) {
    const { uniforms } = this.mesh.material;
    const pad = (v: Float32Array) => {
      const out = new Float32Array(4 * this.quads);
      out.set(v);
      return out;
    };
    uniforms["bias"]!.value = this.biases[side];
    planes.forEach((plane, k) => {
      const uniform = uniforms[`embed${k}`];
      if (uniform) uniform.value = plane;
    });
    uniforms["least"]!.value = pad(embedding.least);
    uniforms["steps"]!.value = pad(embedding.step);
    (uniforms["span"]!.value as Vector2).set(from / height, (from + count) / height);
    this.mesh.material.uniformsNeedUpdate = true;
    renderer.render(this.mesh, this.flat);
  }

  dispose() {
    this.mesh.geometry.dispose();
    this.mesh.material.dispose();
  }
}
