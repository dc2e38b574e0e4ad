// Where most Gaussians of a scene are: what home shows.
//
// SPDX-License-Identifier: Apache-2.0
import { Box3, Vector3 } from "three";

import type { Frame } from "./geo";
import type { Outline } from "./outline";
import type { SceneInfo } from "./source";

export function cornersOf({ min, max }: Box3): Vector3[] {
  return Array.from({ length: 8 }, (_, i) => new Vector3(i & 1 ? max.x : min.x, i & 2 ? max.y : min.y, i & 4 ? max.z : min.z));
}

// As the documents of a scene have it, before any tile.
export function extentOf(info: SceneInfo, frame: Frame): Box3 {
  const box = new Box3();
  const toWorld = frame.worldFromEcef.clone().multiply(info.transform);
  for (let i = 0; i < 8; i++) {
    const corner = new Vector3(i & 1 ? 1 : -1, i & 2 ? 1 : -1, i & 4 ? 1 : -1).multiply(info.half);
    box.expandByPoint(corner.add(info.center).applyMatrix4(toWorld));
  }
  return box;
}

// Of the coarsest tiles, which hold all of a scene.
export class Extent {
  readonly box = new Box3();
  readonly corners: Vector3[] = []; // of outlines, below and above

  add({ min, max, outline }: { min: number[]; max: number[]; outline: Outline }): this {
    const [low, high] = [new Vector3(...min), new Vector3(...max)];
    this.box.union(new Box3(low, high));
    for (let i = 0; i < 8; i += 2)
      for (const y of [low.y, high.y]) this.corners.push(new Vector3(outline[i], y, outline[i + 1]));
    return this;
  }
}
