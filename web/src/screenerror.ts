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

function coreOf({ extras }: CoredTile): number[] | null {
  const core = extras?.core;
  if (!Array.isArray(core) || core.length !== 6 || !core.every(Number.isFinite)) return null;
  return [0, 1, 2].every((k) => core[k] <= core[k + 3]) ? (core as number[]) : null;
}

// eye: in the frame that the tileset's root stands in. perPixel: metres of a pixel at a metre. Null where the tileset
// does not tell.
export function screenError(tile: CoredTile, eye: Vector3, perPixel: number): number | null {
  const core = coreOf(tile);
  if (!core) return null;
  const at = eye.clone().applyMatrix4(tile.engineData.transformInverse).toArray();
  const beside = at.map((v, k) => Math.max(core[k]! - v, v - core[k + 3]!, 0));
  const distance = Math.hypot(...beside);
  return distance === 0 ? Infinity : tile.geometricError / (distance * perPixel);
}
