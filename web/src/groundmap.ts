// Ground for a city that ends somewhere: how it looks from above goes on outside of it, softer and softer,
// until it is its mean colour; its terrain goes on and becomes level. Numbers alone, no graphics card.
//
// SPDX-License-Identifier: Apache-2.0
import type { Block } from "./block";
import { centresOf } from "./pack";

export const MAP_PX = 128; // a side of the picture from above
export const HEIGHT_CELLS = 64; // a side of the terrain
export const SPAN = 2.5; // half a side of both, in halves of the city's longer side
const EDGE = 0.07; // of that half: the strip in which the city's edge fades
const RIM = 4; // of these strips: whose mean colour the ground takes
const COVERED = 0.4; // what is covered less from above is not city
const FLAT = 0.6; // a scene that is higher, by its narrower side, is an object: its edge is no fault
const MEAN_FROM = 1.1; // in halves of the city: from here on
const MEAN_TO = 2.3; // to here its own colours and heights go over into their means
const SOLID = 77; // of 255: opacity of what counts as ground
const LOW = 0.1; // of a cell's heights, from below: the ground
const ROOF_M = 15; // half of the width of roofs below which the ground passes
const REACH_MOST = 4; // of it, in cells
const STRAY = 0.02; // of the cells, from below: deeper than those is nothing

export interface Square {
  x: number; // its middle, in world metres
  z: number;
  half: number; // of a side
}

// Colours of the ground [red, green, blue, share], rows from south to north; share: of a Gaussian's opacity that is
// left there.
export interface GroundMap {
  texels: Uint8Array<ArrayBuffer>;
  far: Color; // what they become far from the city: the mean of its edge
  light: Color; // the mean of the city
}

type Color = [red: number, green: number, blue: number]; // from 0 to 1

const smooth = (from: number, to: number, v: number) => {
  const t = Math.min(1, Math.max(0, (v - from) / (to - from)));
  return t * t * (3 - 2 * t);
};

interface Level {
  size: number;
  values: Float32Array; // of each cell `channels`, times its weight, and the weight
}

function halve({ size, values }: Level, all: number): Level {
  const half = size >> 1;
  const out = new Float32Array(half * half * all);
  for (let y = 0; y < half; y++)
    for (let x = 0; x < half; x++) {
      const to = all * (y * half + x);
      const low = all * (2 * y * size + 2 * x);
      const high = low + all * size;
      const sum = (c: number) => values[low + c]! + values[low + all + c]! + values[high + c]! + values[high + all + c]!;
      const weight = Math.max(1, sum(all - 1));
      for (let c = 0; c < all; c++) out[to + c] = sum(c) / weight;
    }
  return { size: half, values: out };
}

// What a level lacks comes from the coarser one, between its cells.
function pour({ size: width, values: coarse }: Level, { size, values }: Level, all: number) {
  const clamp = (i: number) => Math.min(width - 1, Math.max(0, i));
  for (let y = 0; y < size; y++) {
    const row = Math.floor(y / 2 - 0.25);
    const fy = y % 2 ? 0.25 : 0.75;
    const [low, high] = [clamp(row) * width, clamp(row + 1) * width];
    for (let x = 0; x < size; x++) {
      const to = all * (y * size + x);
      const lack = 1 - values[to + all - 1]!;
      if (lack <= 0) continue;
      const column = Math.floor(x / 2 - 0.25);
      const fx = x % 2 ? 0.25 : 0.75;
      const west = clamp(column);
      const east = clamp(column + 1);
      for (let n = 0; n < all; n++) {
        const south = coarse[all * (low + west) + n]! * (1 - fx) + coarse[all * (low + east) + n]! * fx;
        const north = coarse[all * (high + west) + n]! * (1 - fx) + coarse[all * (high + east) + n]! * fx;
        values[to + n]! += lack * (south * (1 - fy) + north * fy);
      }
    }
  }
}

// Fills cells without weight from those around them, near ones first. values: `channels` times weight, and weight,
// from 0 to 1. False where nothing has any.
export function fill(values: Float32Array, size: number, channels: number): boolean {
  const all = channels + 1;
  const levels: Level[] = [{ size, values }];
  while (levels.at(-1)!.size > 1) levels.push(halve(levels.at(-1)!, all));
  const top = levels.at(-1)!.values;
  const weight = top[channels]!;
  if (!(weight > 0)) return false;
  for (let c = 0; c < all; c++) top[c]! /= weight;
  for (let k = levels.length - 1; k > 0; k--) pour(levels[k]!, levels[k - 1]!, all);
  return true;
}

// How far each cell is from what lies outside: cells that are not covered and hang together with the border. In cells.
function insideBy(covered: (cell: number) => boolean, size: number): Float32Array {
  const far = new Float32Array(size * size).fill(size);
  const open: number[] = [];
  const reach = (cell: number) => {
    if (far[cell] === 0 || covered(cell)) return;
    far[cell] = 0;
    open.push(cell);
  };
  for (let i = 0; i < size; i++) for (const cell of [i, size * (size - 1) + i, size * i, size * i + size - 1]) reach(cell);
  for (let cell = open.pop(); cell !== undefined; cell = open.pop()) {
    const x = cell % size;
    if (x > 0) reach(cell - 1);
    if (x < size - 1) reach(cell + 1);
    if (cell >= size) reach(cell - size);
    if (cell < size * (size - 1)) reach(cell + size);
  }
  const near = (cell: number, other: number, step: number) => (far[cell] = Math.min(far[cell]!, far[other]! + step));
  for (const [from, sign] of [[size + 1, 1], [size * (size - 1) - 2, -1]] as const)
    for (let n = 0, cell = from; n < size * (size - 2) - 2; n++, cell += sign) {
      near(cell, cell - sign, 1);
      near(cell, cell - sign * size, 1);
      near(cell, cell - sign * (size - 1), Math.SQRT2);
      near(cell, cell - sign * (size + 1), Math.SQRT2);
    }
  return far;
}

// How much of the own colours and heights is over at a place of a square, in parts of its half side.
function meanShare(x: number, y: number, size: number): number {
  const at = (i: number) => SPAN * Math.abs((2 * (i + 0.5)) / size - 1);
  return smooth(MEAN_FROM, MEAN_TO, Math.hypot(at(x), at(y)));
}

// above: the city from above in MAP_PX rows from south to north, bytes of red, green, blue times coverage, and coverage.
// object: nothing of its edge fades. null where nothing is to be seen.
export function mapGround(above: Uint8Array, object: boolean): GroundMap | null {
  const size = MAP_PX;
  const values = new Float32Array(above.length);
  for (let i = 0; i < above.length; i++) values[i] = above[i]! / 255;
  const inside = insideBy((cell) => above[4 * cell + 3]! > 255 * COVERED, size);
  const strip = (EDGE * size) / (2 * SPAN);
  const light = meanOf(values, () => true);
  const far = meanOf(values, (cell) => inside[cell]! > 0 && inside[cell]! < RIM * strip) ?? light;
  if (!light || !far || !fill(values, size, 3)) return null;
  const texels = new Uint8Array(4 * size * size);
  for (let cell = 0; cell < size * size; cell++) {
    const own = 1 - meanShare(cell % size, Math.floor(cell / size), size);
    for (let c = 0; c < 3; c++) {
      const value = far[c]! + own * (values[4 * cell + c]! - far[c]!);
      texels[4 * cell + c] = Math.round(255 * Math.min(1, Math.max(0, value)));
    }
    texels[4 * cell + 3] = object ? 255 : Math.round(255 * smooth(0.5, strip + 0.5, inside[cell]!));
  }
  return { texels, far, light };
}

function meanOf(values: Float32Array, counts: (cell: number) => boolean): Color | null {
  const sum = [0, 0, 0, 0];
  for (let i = 0; i < values.length; i++) if (counts(i >> 2)) sum[i & 3]! += values[i]!;
  return sum[3]! > 0 ? [sum[0]! / sum[3]!, sum[1]! / sum[3]!, sum[2]! / sum[3]!] : null;
}

// Whether what is in a box is an object and no city.
export function isObject(size: { x: number; y: number; z: number }): boolean {
  return size.y > FLAT * Math.min(size.x, size.z);
}

// The share of Gaussians that is left at a place of the map.
function shareAt({ texels }: GroundMap, x: number, y: number): number {
  const to = (i: number) => Math.floor(((i + 0.5) * MAP_PX) / HEIGHT_CELLS);
  return texels[4 * (to(y) * MAP_PX + to(x)) + 3]!;
}

// Heights of the lowest Gaussians of each cell, those of the middle of the city's edge where there are none. Of the
// corners of HEIGHT_CELLS cells a side, rows from south to north; the last one is the level that all end in.
export function findHeights(blocks: readonly Block[], square: Square, map: GroundMap): Float32Array | null {
  const size = HEIGHT_CELLS;
  const cells: number[][] = Array.from({ length: size * size }, () => []);
  const scale = size / (2 * square.half);
  for (const { splats } of blocks) {
    const centres = centresOf(splats);
    for (let i = 0; i < splats.count; i++) {
      const x = Math.floor((centres[3 * i]! - square.x + square.half) * scale);
      const y = Math.floor((square.z - centres[3 * i + 2]! + square.half) * scale);
      const solid = splats.base[4 * i + 3]! >>> 24 >= SOLID;
      if (solid && x >= 0 && y >= 0 && x < size && y < size) cells[y * size + x]!.push(centres[3 * i + 1]!);
    }
  }
  const lows = cells.map((heights, cell) => {
    if (!heights.length || !shareAt(map, cell % size, Math.floor(cell / size))) return Infinity;
    return heights.sort((a, b) => a - b)[Math.floor(LOW * heights.length)]!;
  });
  const known = lows.filter(Number.isFinite).sort((a, b) => a - b);
  if (!known.length) return null;
  const level = known[Math.floor(known.length / 4)]!;
  const least = known[Math.floor(STRAY * known.length)]!;
  const ground = passBelow(lows, size, Math.min(REACH_MOST, Math.ceil(ROOF_M * scale)));
  const values = new Float32Array(2 * size * size);
  for (let cell = 0; cell < size * size; cell++) {
    if (lows[cell] === Infinity) continue;
    values[2 * cell] = Math.max(least, ground[cell]!) - level;
    values[2 * cell + 1] = 1;
  }
  fill(values, size, 1);
  return corners(values, size, level);
}

// A roof is no ground: the lowest of the cells around, and of those the highest, so that slopes stay what they are.
function passBelow(lows: readonly number[], size: number, reach: number): number[] {
  const pass = (from: readonly number[], best: (a: number, b: number) => number) =>
    from.map((own, cell) => {
      if (!Number.isFinite(own)) return own;
      const [x, y] = [cell % size, Math.floor(cell / size)];
      let out = own;
      for (let i = Math.max(0, y - reach); i <= Math.min(size - 1, y + reach); i++)
        for (let k = Math.max(0, x - reach); k <= Math.min(size - 1, x + reach); k++) {
          const other = from[i * size + k]!;
          if (Number.isFinite(other)) out = best(out, other);
        }
      return out;
    });
  return pass(pass(lows, Math.min), Math.max);
}

function corners(values: Float32Array, size: number, level: number): Float32Array {
  const side = size + 1;
  const out = new Float32Array(side * side);
  for (let y = 0; y < side; y++)
    for (let x = 0; x < side; x++) {
      let [sum, count] = [0, 0];
      for (let i = Math.max(0, y - 2); i < Math.min(size, y + 2); i++)
        for (let k = Math.max(0, x - 2); k < Math.min(size, x + 2); k++, count++) sum += values[2 * (i * size + k)]!;
      out[y * side + x] = level + (1 - meanShare(x - 0.5, y - 0.5, size)) * (sum / count);
    }
  return out;
}
