// Gaussians as the graphics card holds them, in rows of 1024 along the tile's order: neighbours in space, which share an
// origin and the range of their harmonics. So a Gaussian takes 16 bytes, and its harmonics as many bits as those of its
// row need; nothing of what the tile says is lost. Runs in a worker.
//
//   base   16 bytes a Gaussian: x, z in 14 bits, y in 12 (steps from the row's origin); three bytes of ln sigma; rotation,
//          SPZ's smallest three; red, green, blue, opacity
//   heads  32 bytes a row: origin x, y, z, size of a step (a power of two, flags in its lowest bits); first row in `more`
//          of wide positions, and of harmonics; least byte of each band and their kind; their shifts, 4 bits each
//   more   rows of 1024 words, one for each Gaussian of a row: the upper bits of wide positions (x, z 10 bits, y 12); the
//          words of the harmonics
//
// SPDX-License-Identifier: Apache-2.0
import { findOutline, type Outline } from "./outline";

export const ROW = 1024; // Gaussians in a row
export const MAX_GAUSSIANS = 1 << 22;
export const HEAD_WORDS = 8;
export const LANES = 4; // rows of `more` in a line of its texture
const ANTIALIASED = 1; // flags
const WIDE = 2;
const X_BITS = 14;
const Y_BITS = 12;
const ZERO = 128; // the byte of a harmonic that is none

// Bits of a harmonic of each band, by kind: a row has the first kind that holds it. 0 has none.
const KINDS = [[], [4, 4, 3], [6, 5, 5], [8, 8, 8]] as const;
const BANDS = [9, 15, 21]; // harmonics of a band, three colours

// What the appearance network reads: number d of a Gaussian is least[d] + step[d] * its byte.
export interface Embedding {
  length: number;
  least: Float32Array<ArrayBuffer>;
  step: Float32Array<ArrayBuffer>;
  planes: Uint32Array<ArrayBuffer>[]; // 16 bytes a texel
}

// As a file has them.
export interface LooseSplats {
  count: number;
  shDegree: number;
  antialiased: boolean;
  unit: number; // metres of a step, a power of two
  steps: Int32Array; // x, y, z
  colors: Uint8Array; // red, green, blue, opacity
  scales: Uint8Array; // three
  rotations: Uint32Array;
  sh: Uint8Array; // [coefficient][r g b] of the bands of this degree
  embedding: Embedding | null;
}

export interface DecodedSplats {
  count: number;
  shDegree: number;
  antialiased: boolean;
  base: Uint32Array<ArrayBuffer>;
  heads: Uint32Array<ArrayBuffer>;
  more: Uint32Array<ArrayBuffer>;
  embedding: Embedding | null; // of tiles whose colours are as they were trained
  // 5th and 95th percentile of the centres along x, y, z: the scene without its strays
  core: { min: [number, number, number]; max: [number, number, number]; outline: Outline };
}

function bitsOf(degree: number, kind: number): [bit: number, width: number][] {
  let bit = 0;
  return BANDS.slice(0, degree).flatMap((length, band) =>
    Array.from({ length }, () => {
      const width = KINDS[kind]![band] ?? 0;
      bit += width;
      return [bit - width, width] as [number, number];
    }),
  );
}

// `more`, while it grows.
class Rows {
  readonly all: Uint32Array<ArrayBuffer>[] = [];

  add(count: number): number {
    for (let i = 0; i < count; i++) this.all.push(new Uint32Array(ROW));
    return this.all.length - count;
  }

  whole(): Uint32Array<ArrayBuffer> {
    const out = new Uint32Array(Math.ceil(this.all.length / LANES) * LANES * ROW);
    this.all.forEach((row, i) => out.set(row, i * ROW));
    return out;
  }
}

interface Range {
  least: number;
  shift: number;
  width: number; // bits that the row needs
}

// Bytes [from, to) of each Gaussian from `first` to `last`: zero stays exact, so steps are counted from there.
function rangeOf(sh: Uint8Array, all: number, from: number, to: number, first: number, last: number): Range {
  let [least, most, bits] = [255, 0, 256];
  for (let i = first; i < last; i++)
    for (let k = all * i + from; k < all * i + to; k++) {
      const value = sh[k]!;
      if (value < least) least = value;
      if (value > most) most = value;
      bits |= value ^ ZERO;
    }
  const shift = 31 - Math.clz32(bits & -bits);
  return { least, shift, width: 32 - Math.clz32((most - least) >> shift) };
}

function packHarmonics(loose: LooseSplats, first: number, last: number, head: Uint32Array, more: Rows) {
  const { shDegree, sh } = loose;
  const lengths = BANDS.slice(0, shDegree);
  const all = lengths.reduce((sum, n) => sum + n, 0);
  let from = 0;
  const ranges = lengths.map((length) => rangeOf(sh, all, from, (from += length), first, last));
  if (ranges.every(({ least, width }) => least === ZERO && width === 0)) return;
  const kind = KINDS.findIndex((widths, k) => k > 0 && ranges.every(({ width }, b) => width <= widths[b]!));
  const places = bitsOf(shDegree, kind);
  const [lastBit, lastWidth] = places.at(-1)!;
  const start = more.add(Math.ceil((lastBit + lastWidth) / 32));
  const bands = lengths.flatMap((length, b) => new Array<Range>(length).fill(ranges[b]!));
  for (let k = 0; k < all; k++) {
    const [bit, width] = places[k]!;
    const { least, shift } = bands[k]!;
    const [low, by] = [more.all[start + (bit >> 5)]!, bit & 31];
    const high = by + width > 32 ? more.all[start + (bit >> 5) + 1]! : null;
    for (let i = first, x = 0; i < last; i++, x++) {
      const code = (sh[all * i + k]! - least) >> shift;
      low[x]! |= code << by;
      if (high) high[x]! |= code >>> (32 - by);
    }
  }
  head[5] = start;
  head[6] = ranges.reduce((word, { least }, b) => word | (least << (8 * b)), kind << 24) >>> 0;
  head[7] = ranges.reduce((word, { shift }, b) => word | (shift << (4 * b)), 0);
}

function packPlaces(
  loose: LooseSplats,
  offset: readonly number[],
  first: number,
  last: number,
  base: Uint32Array,
  head: Uint32Array,
  more: Rows,
) {
  const { steps, scales, unit } = loose;
  const least = [Infinity, Infinity, Infinity];
  const most = [-Infinity, -Infinity, -Infinity];
  for (let i = first; i < last; i++)
    for (let axis = 0; axis < 3; axis++) {
      const v = steps[3 * i + axis]!;
      if (v < least[axis]!) least[axis] = v;
      if (v > most[axis]!) most[axis] = v;
    }
  const [ox, oy, oz] = least as [number, number, number];
  const fits = (axis: number, bits: number) => most[axis]! - least[axis]! < 2 ** bits;
  const wide = !(fits(0, X_BITS) && fits(1, Y_BITS) && fits(2, X_BITS));
  const floats = new Float32Array(head.buffer, head.byteOffset, 4);
  for (let axis = 0; axis < 3; axis++) floats[axis] = least[axis]! * unit + offset[axis]!;
  floats[3] = unit;
  head[3]! |= (loose.antialiased ? ANTIALIASED : 0) | (wide ? WIDE : 0);
  if (wide) head[4] = more.add(1);
  const upper = wide ? more.all[head[4]!]! : null;
  for (let i = first, x = 0; i < last; i++, x++) {
    const [dx, dy, dz] = [steps[3 * i]! - ox, steps[3 * i + 1]! - oy, steps[3 * i + 2]! - oz];
    base[4 * i] = (dx & 0x3fff) | ((dz & 0x3fff) << 14) | (dy << 28);
    base[4 * i + 1] =
      ((dy >> 4) & 255) | (scales[3 * i]! << 8) | (scales[3 * i + 1]! << 16) | (scales[3 * i + 2]! << 24);
    if (upper) upper[x] = (dx >> X_BITS) | ((dz >> X_BITS) << 10) | ((dy >> Y_BITS) << 20);
  }
}

// offset: added to the positions.
export function pack(loose: LooseSplats, offset: readonly number[]): DecodedSplats {
  const { count, shDegree, antialiased, embedding, colors, rotations } = loose;
  const rows = Math.ceil(count / ROW);
  const base = new Uint32Array(4 * ROW * rows);
  const heads = new Uint32Array(HEAD_WORDS * rows);
  const more = new Rows();
  for (let row = 0; row < rows; row++) {
    const [first, last] = [ROW * row, Math.min(count, ROW * (row + 1))];
    const head = heads.subarray(HEAD_WORDS * row, HEAD_WORDS * (row + 1));
    packPlaces(loose, offset, first, last, base, head, more);
    packHarmonics(loose, first, last, head, more);
  }
  const bytes = new Uint8Array(base.buffer);
  for (let i = 0; i < count; i++) {
    base[4 * i + 2] = rotations[i]!;
    for (let c = 0; c < 4; c++) bytes[16 * i + 12 + c] = colors[4 * i + c]!;
  }
  const packed = { count, shDegree, antialiased, base, heads, more: more.whole(), embedding };
  return { ...packed, core: findCore(centresOf(packed)) };
}

// x, y, z of each Gaussian, to the last bit what the shaders compute.
export function centresOf({
  count,
  base,
  heads,
  more,
}: Pick<DecodedSplats, "count" | "base" | "heads" | "more">): Float32Array<ArrayBuffer> {
  const out = new Float32Array(3 * count);
  const floats = new Float32Array(heads.buffer);
  for (let i = 0; i < count; i++) {
    const head = HEAD_WORDS * Math.floor(i / ROW);
    const [w0, w1] = [base[4 * i]!, base[4 * i + 1]!];
    let x = w0 & 0x3fff;
    let y = (w0 >>> 28) | ((w1 & 255) << 4);
    let z = (w0 >>> 14) & 0x3fff;
    const flags = heads[head + 3]!;
    if (flags & WIDE) {
      const upper = more[heads[head + 4]! * ROW + (i % ROW)]!;
      x |= (upper & 1023) << X_BITS;
      z |= ((upper >>> 10) & 1023) << X_BITS;
      y |= (upper >>> 20) << Y_BITS;
    }
    const unit = 2 ** (((flags >>> 23) & 255) - 127);
    out[3 * i] = floats[head]! + x * unit;
    out[3 * i + 1] = floats[head + 1]! + y * unit;
    out[3 * i + 2] = floats[head + 2]! + z * unit;
  }
  return out;
}

// Trained Gaussians are many where the photographs saw much, and few and large around it.
function findCore(centres: Float32Array): DecodedSplats["core"] {
  const count = centres.length / 3;
  const step = Math.max(1, Math.floor(count / 20000));
  const along = (axis: number): [number, number] => {
    const length = Math.ceil(count / step);
    const values = Float32Array.from({ length }, (_, i) => centres[3 * i * step + axis]!).sort();
    const at = (share: number) => values[Math.round(share * (length - 1))]!;
    return [at(0.05), at(0.95)];
  };
  const [x, y, z] = [along(0), along(1), along(2)];
  return { min: [x[0], y[0], z[0]], max: [x[1], y[1], z[1]], outline: findOutline(centres) };
}

// Rows on end whose harmonics one shader reads: its number, and rows from the tile's first.
export interface Stripe {
  kind: number;
  row: number;
  rows: number;
}

const kindOf = (degree: number, kind: number) => degree * KINDS.length + kind;

// The degree and [bit, width] of each harmonic in the words of a Gaussian, of a stripe's number.
export function harmonicsOf(kind: number): { degree: number; places: [bit: number, width: number][] } {
  const degree = Math.floor(kind / KINDS.length);
  return { degree, places: bitsOf(degree, kind % KINDS.length) };
}

export function stripesOf({ heads, shDegree }: DecodedSplats): Stripe[] {
  const out: Stripe[] = [];
  for (let row = 0; row < heads.length / HEAD_WORDS; row++) {
    const own = heads[HEAD_WORDS * row + 6]! >>> 24;
    const kind = own && kindOf(shDegree, own);
    const last = out.at(-1);
    if (last?.kind === kind) last.rows++;
    else out.push({ kind, row, rows: 1 });
  }
  return out;
}
