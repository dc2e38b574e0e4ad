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

function boxOf(info: SceneInfo, frame: Frame, center: Vector3, half: Vector3): Box3 {
  const box = new Box3();
  const toWorld = frame.worldFromEcef.clone().multiply(info.transform);
  for (let i = 0; i < 8; i++) {
    const corner = new Vector3(i & 1 ? 1 : -1, i & 2 ? 1 : -1, i & 4 ? 1 : -1).multiply(half);
    box.expandByPoint(corner.add(center).applyMatrix4(toWorld));
  }
  return box;
}

// Where most Gaussians are by the documents of a scene; null where they do not tell, or tell of a place beyond all of them.
// The server's pictures have their sky and ground by the same box.
function toldOf(info: SceneInfo, frame: Frame): Box3 | null {
  if (!info.most) return null;
  const [low, high] = [new Vector3().fromArray(info.most), new Vector3().fromArray(info.most, 3)];
  const half = high.clone().sub(low).multiplyScalar(0.5);
  const box = boxOf(info, frame, low.add(half), half);
  return boxOf(info, frame, info.center, info.half).expandByScalar(1).containsBox(box) ? box : null;
}

// As the documents of a scene have it, before any tile.
export function extentOf(info: SceneInfo, frame: Frame): Box3 {
  return toldOf(info, frame) ?? boxOf(info, frame, info.center, info.half);
}

// Of the coarsest tiles, which hold all of a scene.
export class Extent {
  readonly box = new Box3();
  readonly corners: Vector3[] = []; // of outlines, below and above
  private readonly told: Box3 | null;

  constructor(info: SceneInfo, frame: Frame) {
    this.told = toldOf(info, frame);
  }

  // Heights are those of the tiles: a few Gaussians far below the ground would lower what the documents tell.
  add({ min, max, outline }: { min: number[]; max: number[]; outline: Outline }): this {
    const [low, high] = [new Vector3(...min), new Vector3(...max)];
    this.box.union(new Box3(low, high));
    if (this.told) {
      this.box.min.setX(this.told.min.x).setZ(this.told.min.z);
      this.box.max.setX(this.told.max.x).setZ(this.told.max.z);
    }
    for (let i = 0; i < 8; i += 2)
      for (const y of [low.y, high.y]) this.corners.push(new Vector3(outline[i], y, outline[i + 1]));
    return this;
  }
}
