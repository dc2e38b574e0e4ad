// Whether a view has anything of the city in it: a link from far away or into the sky has not.
//
// SPDX-License-Identifier: Apache-2.0
import { Frustum, Matrix4, Ray, Vector3, type Box3, type PerspectiveCamera } from "three";

import type { Block } from "./block";
import { centresOf } from "./pack";
import { pickMedian } from "./pick";

const LEAST_PX = 8; // of the whole city: less is a dot
const SAMPLES = 4096;
const RAYS = [[0, 0], [-0.6, -0.6], [0.6, -0.6], [-0.6, 0.6], [0.6, 0.6]]; // of the picture, from its middle

// blocks: what is drawn; none where the server draws, and the box alone tells.
export function seesAny(camera: PerspectiveCamera, box: Box3, heightPx: number, blocks: readonly Block[]): boolean {
  camera.updateMatrixWorld();
  const seen = new Frustum().setFromProjectionMatrix(new Matrix4().multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse));
  const perMetre = (2 * Math.tan((camera.fov * Math.PI) / 360)) / Math.max(1, heightPx);
  const distance = box.distanceToPoint(camera.position);
  if (!seen.intersectsBox(box) || box.getSize(new Vector3()).length() < LEAST_PX * perMetre * distance) return false;
  if (!blocks.length || distance > 0) return true;
  // Amidst the city its box is always in view. Some of the Gaussians, then some rays: a wall near by may have few.
  const count = blocks.reduce((sum, { splats }) => sum + splats.count, 0);
  const step = Math.ceil(count / SAMPLES);
  const point = new Vector3();
  for (const { splats } of blocks) {
    const centres = centresOf(splats);
    for (let i = 0; i < splats.count; i += step) if (seen.containsPoint(point.fromArray(centres, 3 * i))) return true;
  }
  return RAYS.some(([x, y]) => {
    const ahead = new Vector3(x, y, 0.5).unproject(camera).sub(camera.position).normalize();
    return pickMedian(blocks, new Ray(camera.position.clone(), ahead), perMetre) !== null;
  });
}
