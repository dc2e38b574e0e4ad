// Shapes that the engine draws: a quad for each Gaussian, stripes of its textures, one triangle over
// everything.
//
// SPDX-License-Identifier: Apache-2.0
import { BufferAttribute, BufferGeometry, InstancedBufferGeometry } from "three";

export const QUADS = 128; // of one instance

function geometryOf(corners: Float32Array): BufferGeometry {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(corners, 3));
  return geometry;
}

// One instance: QUADS quads whose corners the vertex shader finds by number.
export function makeQuads(): InstancedBufferGeometry {
  const geometry = new InstancedBufferGeometry();
  const corners = new Float32Array(QUADS * 4 * 3);
  const index = new Uint16Array(QUADS * 6);
  for (let q = 0; q < QUADS; q++) {
    [-1, -1, 1, -1, 1, 1, -1, 1].forEach((v, i) => {
      corners[12 * q + 3 * (i >> 1) + (i & 1)] = v;
    });
    for (let i = 0; i < 4; i++) corners[12 * q + 3 * i + 2] = q;
    [0, 1, 2, 0, 2, 3].forEach((v, i) => (index[6 * q + i] = 4 * q + v));
  }
  geometry.setAttribute("position", new BufferAttribute(corners, 3));
  geometry.setIndex(new BufferAttribute(index, 1));
  geometry.instanceCount = 0;
  return geometry;
}

// Rectangles over these rows of a texture, in rows.
export function makeStripes(blocks: readonly { row: number; rows: number }[]): BufferGeometry {
  const corners = new Float32Array(blocks.length * 18);
  blocks.forEach(({ row, rows }, b) => {
    const [low, high] = [row, row + rows];
    [0, low, 1, low, 1, high, 0, low, 1, high, 0, high].forEach((v, i) => {
      corners[18 * b + 3 * (i >> 1) + (i & 1)] = v;
    });
  });
  return geometryOf(corners);
}

// The whole target.
export function makeCover(): BufferGeometry {
  return geometryOf(new Float32Array([-1, -1, 0, 3, -1, 0, -1, 3, 0]));
}
