// Where a ray meets the city: the depth at which half of its light is taken, from the Gaussians that
// are drawn, by the same opacities.
//
// SPDX-License-Identifier: Apache-2.0
import { Ray, Vector3 } from "three";

import type { Block } from "./block";
import { centresOf } from "./pack";

const ALPHA_LEAST = 1 / 255;
const REACH_SIGMA = 3.33; // where an opaque Gaussian falls below 1/255
const SIGMA = Float32Array.from({ length: 256 }, (_, byte) => Math.exp(byte / 16 - 10));

// Gaussians that rays are to meet.
export interface Cloud {
  count: number;
  base: Uint32Array; // as in pack.ts
  centres: Float32Array;
}

const cloudOf = ({ splats }: Block): Cloud => ({ count: splats.count, base: splats.base, centres: centresOf(splats) });

interface Hit {
  depth: number;
  alpha: number;
}

// Rows of the rotation of SPZ's "smallest three", into out.
function rotation(packed: number, out: Float64Array) {
  const largest = packed >>> 30;
  const q = [0, 0, 0, 0];
  let sum = 0;
  for (let i = 0, shift = 20; i < 4; i++) {
    if (i === largest) continue;
    const field = (packed >>> shift) & 1023;
    const value = ((field & 511) * (field & 512 ? -Math.SQRT1_2 : Math.SQRT1_2)) / 511;
    q[i] = value;
    sum += value * value;
    shift -= 10;
  }
  q[largest] = Math.sqrt(Math.max(0, 1 - sum));
  const [x, y, z, w] = q as [number, number, number, number];
  out[0] = 1 - 2 * (y * y + z * z);
  out[1] = 2 * (x * y - w * z);
  out[2] = 2 * (x * z + w * y);
  out[3] = 2 * (x * y + w * z);
  out[4] = 1 - 2 * (x * x + z * z);
  out[5] = 2 * (y * z - w * x);
  out[6] = 2 * (x * z - w * y);
  out[7] = 2 * (y * z + w * x);
  out[8] = 1 - 2 * (x * x + y * y);
}

// All Gaussians of a block that the ray meets. A pixel's footprint widens the thin ones, as the
// low-pass of the picture does.
function meet({ base, count, centres }: Cloud, ray: Ray, perMetre: number, hits: Hit[]) {
  const { origin, direction } = ray;
  const [ox, oy, oz] = [origin.x, origin.y, origin.z];
  const [dx, dy, dz] = [direction.x, direction.y, direction.z];
  const r = new Float64Array(9);
  for (let i = 0; i < count; i++) {
    const px = centres[3 * i]! - ox;
    const py = centres[3 * i + 1]! - oy;
    const pz = centres[3 * i + 2]! - oz;
    const along = px * dx + py * dy + pz * dz;
    if (along <= 0) continue;
    const apart2 = px * px + py * py + pz * pz - along * along;
    const sizes = base[4 * i + 1]!;
    const pixel = perMetre * along;
    let a = SIGMA[(sizes >>> 8) & 255]!;
    let b = SIGMA[(sizes >>> 16) & 255]!;
    let c = SIGMA[sizes >>> 24]!;
    const reach = REACH_SIGMA * (Math.max(a, b, c) + pixel);
    if (apart2 > reach * reach) continue;
    a = Math.hypot(a, 0.55 * pixel);
    b = Math.hypot(b, 0.55 * pixel);
    c = Math.hypot(c, 0.55 * pixel);
    rotation(base[4 * i + 2]!, r);
    // In the Gaussian's own axes, in sigmas: the nearest point of the ray and its distance.
    const ux = (r[0]! * px + r[3]! * py + r[6]! * pz) / a;
    const uy = (r[1]! * px + r[4]! * py + r[7]! * pz) / b;
    const uz = (r[2]! * px + r[5]! * py + r[8]! * pz) / c;
    const vx = (r[0]! * dx + r[3]! * dy + r[6]! * dz) / a;
    const vy = (r[1]! * dx + r[4]! * dy + r[7]! * dz) / b;
    const vz = (r[2]! * dx + r[5]! * dy + r[8]! * dz) / c;
    const vv = vx * vx + vy * vy + vz * vz;
    const depth = (ux * vx + uy * vy + uz * vz) / vv;
    const d2 = ux * ux + uy * uy + uz * uz - depth * depth * vv;
    const alpha = ((base[4 * i + 3]! >>> 24) / 255) * Math.exp(-0.5 * Math.max(0, d2));
    if (alpha >= ALPHA_LEAST && depth > 0) hits.push({ depth, alpha });
  }
}

// The point, or null where more than half of the light passes. perMetre: the size of a pixel at one
// metre.
export function pickMedian(blocks: readonly Block[], ray: Ray, perMetre: number): Vector3 | null {
  return pickIn(blocks.map(cloudOf), ray, perMetre);
}

export function pickIn(clouds: readonly Cloud[], ray: Ray, perMetre: number): Vector3 | null {
  const hits: Hit[] = [];
  for (const cloud of clouds) meet(cloud, ray, perMetre, hits);
  hits.sort((a, b) => a.depth - b.depth);
  let passes = 1;
  for (const { depth, alpha } of hits) {
    passes *= 1 - alpha;
    if (passes <= 0.5) return ray.at(depth, new Vector3());
  }
  return null;
}

function sigmaOf({ base }: Cloud, i: number): number {
  const sizes = base[4 * i + 1]!;
  return Math.max(SIGMA[(sizes >>> 8) & 255]!, SIGMA[(sizes >>> 16) & 255]!, SIGMA[sizes >>> 24]!);
}

// Some of a cloud's Gaussians, behind those that are in `to` already.
function copyInto(to: Cloud, from: Cloud, chosen: readonly number[]) {
  for (const i of chosen) {
    to.base.set(from.base.subarray(4 * i, 4 * i + 4), 4 * to.count);
    to.centres.set(from.centres.subarray(3 * i, 3 * i + 3), 3 * to.count);
    to.count++;
  }
}

const emptyCloud = (room: number): Cloud => ({ count: 0, base: new Uint32Array(4 * room), centres: new Float32Array(3 * room) });

const SLICE = 1 << 14; // Gaussians that are looked at without a pause

// Those within some metres of an upright line, for rays that stay near it. In steps: a city has millions.
export function* gatherBySteps(blocks: readonly Block[], x: number, z: number, reach: number): Generator<void, Cloud> {
  const near: { cloud: Cloud; chosen: number[] }[] = [];
  for (const block of blocks) {
    const cloud = cloudOf(block);
    const chosen: number[] = [];
    for (let i = 0; i < cloud.count; i++) {
      const most = reach + REACH_SIGMA * sigmaOf(cloud, i);
      const [dx, dz] = [cloud.centres[3 * i]! - x, cloud.centres[3 * i + 2]! - z];
      if (dx * dx + dz * dz <= most * most) chosen.push(i);
      if (i % SLICE === SLICE - 1) yield;
    }
    near.push({ cloud, chosen });
    yield;
  }
  const out = emptyCloud(near.reduce((sum, { chosen }) => sum + chosen.length, 0));
  for (const { cloud, chosen } of near)
    for (let from = 0; from < chosen.length; from += SLICE) {
      copyInto(out, cloud, chosen.slice(from, from + SLICE));
      yield;
    }
  return out;
}

export function gather(blocks: readonly Block[], x: number, z: number, reach: number): Cloud {
  const steps = gatherBySteps(blocks, x, z, reach);
  for (;;) {
    const { done, value } = steps.next();
    if (done) return value;
  }
}

const COLUMN_M = 2.5; // a side
const cellOf = (v: number) => Math.floor(v / COLUMN_M);
const keyOf = (column: number, row: number) => 65536 * column + row;

// A cloud for many upright rays within some metres of an upright line, each of which meets those of its column alone. top: where
// the rays begin; perMetre: as theirs.
export class Columns {
  private readonly members = new Map<number, number[]>();
  private readonly clouds = new Map<number, Cloud>();

  constructor(private readonly cloud: Cloud) {}

  // Before the first question, in steps.
  *fill({ x: middleX, z: middleZ }: { x: number; z: number }, within: number, top: number, perMetre: number): Generator<void, void> {
    const { cloud } = this;
    // A Gaussian of the far background would be in a million columns: only where rays are.
    const between = (v: number, middle: number) => cellOf(Math.min(middle + within, Math.max(middle - within, v)));
    for (let i = 0; i < cloud.count; i++) {
      const [x, y, z] = [cloud.centres[3 * i]!, cloud.centres[3 * i + 1]!, cloud.centres[3 * i + 2]!];
      const reach = REACH_SIGMA * (sigmaOf(cloud, i) + perMetre * Math.max(0, top - y));
      const [west, east] = [between(x - reach, middleX), between(x + reach, middleX)];
      const [north, south] = [between(z - reach, middleZ), between(z + reach, middleZ)];
      for (let column = west; column <= east; column++)
        for (let row = north; row <= south; row++) {
          const key = keyOf(column, row);
          const members = this.members.get(key);
          if (members) members.push(i);
          else this.members.set(key, [i]);
        }
      if (i % SLICE === SLICE - 1) yield;
    }
  }

  at(x: number, z: number): Cloud {
    const key = keyOf(cellOf(x), cellOf(z));
    let cloud = this.clouds.get(key);
    if (!cloud) {
      const members = this.members.get(key) ?? [];
      copyInto((cloud = emptyCloud(members.length)), this.cloud, members);
      this.clouds.set(key, cloud);
    }
    return cloud;
  }
}
