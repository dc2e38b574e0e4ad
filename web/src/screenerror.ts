// How coarse a tile is on the screen, as the server has it (lod/choose/pick.c): by the distance to where nearly all of its
// Gaussians are, which tilesets of citysplat tell. Boxes hold every splat whole and are nearer: by them a view
// gets finer tiles than it needs, which cost more and alias.
//
// SPDX-License-Identifier: Apache-2.0
import type { Matrix4, Vector3 } from "three";

export interface CoredTile {
  geometricError: number;
  extras?: { core?: unknown };
  engineData: { transformInverse: Matrix4 };
}

// A box of a tileset's extras: its least corner, then its greatest. Null where it is none.
export function boxIn(told: unknown): number[] | null {
  if (!Array.isArray(told) || told.length !== 6 || !told.every(Number.isFinite)) return null;
  return [0, 1, 2].every((k) => told[k] <= told[k + 3]) ? (told as number[]) : null;
}

// eye: in the frame that the tileset's root stands in. perPixel: metres of a pixel at a metre. Null where the tileset
// does not tell.
export function screenError(tile: CoredTile, eye: Vector3, perPixel: number): number | null {
  const core = boxIn(tile.extras?.core);
  if (!core) return null;
  const at = eye.clone().applyMatrix4(tile.engineData.transformInverse).toArray();
  const beside = at.map((v, k) => Math.max(core[k]! - v, v - core[k + 3]!, 0));
  const distance = Math.hypot(...beside);
  return distance === 0 ? Infinity : tile.geometricError / (distance * perPixel);
}
