// SPZ version 3 -> the integers that the graphics card draws from, in rows of a texture.
//
// Nothing is converted: positions become float32, every other field stays the bytes of the file and
// the shader reads them by SPZ's own rules. Runs in a worker.
//
// SPDX-License-Identifier: Apache-2.0

const MAGIC = 0x5053474e; // "NGSP"
const HEADER_BYTES = 16;
const FLAG_ANTIALIASED = 1;
export const MAX_GAUSSIANS = 1 << 22;

export const ROW = 1024; // Gaussians in a row of the textures

export const SH_NONE = 0x80808080; // four coefficients that are zero

// What the appearance network reads: number d of a Gaussian is least[d] + step[d] * its byte.
export interface Embedding {
  length: number;
  least: Float32Array<ArrayBuffer>;
  step: Float32Array<ArrayBuffer>;
  planes: Uint32Array<ArrayBuffer>[]; // 16 bytes a texel
}

export interface DecodedSplats {
  count: number;
  shDegree: number;
  antialiased: boolean;
  place: Uint32Array<ArrayBuffer>; // x, y, z as float32 bits | r, g, b, opacity as bytes
  shape: Uint32Array<ArrayBuffer>; // three bytes of ln sigma, flags | rotation, smallest three
  sh: Uint32Array<ArrayBuffer>[]; // bytes [coefficient][r g b], 16 a texel; 0, 1, 2 or 3 arrays
  embedding: Embedding | null; // of tiles whose colours are as they were trained
  // 5th and 95th percentile of the centres along x, y, z: the scene without its strays
  core: { min: [number, number, number]; max: [number, number, number] };
}

// Trained Gaussians are many where the photographs saw much, and few and large around it.
export function findCore(place: Uint32Array<ArrayBuffer>, count: number): DecodedSplats["core"] {
  const centres = new Float32Array(place.buffer);
  const step = Math.max(1, Math.floor(count / 20000));
  const along = (axis: number): [number, number] => {
    const length = Math.ceil(count / step);
    const values = Float32Array.from({ length }, (_, i) => centres[4 * i * step + axis]!).sort();
    const at = (share: number) => values[Math.round(share * (length - 1))]!;
    return [at(0.05), at(0.95)];
  };
  const [x, y, z] = [along(0), along(1), along(2)];
  return { min: [x[0], y[0], z[0]], max: [x[1], y[1], z[1]] };
}

function readHeader(raw: Uint8Array, data: DataView) {
  if (raw.length < HEADER_BYTES) throw new Error("SPZ: shorter than its header");
  if (data.getUint32(0, true) !== MAGIC) throw new Error("SPZ: wrong magic number");
  const version = data.getUint32(4, true);
  if (version !== 3) throw new Error(`SPZ: version ${version}, this client reads 3`);
  const count = data.getUint32(8, true);
  const shDegree = raw[12]!;
  if (count === 0 || count > MAX_GAUSSIANS || shDegree > 3) {
    throw new Error(`SPZ: ${count} Gaussians of degree ${shDegree}`);
  }
  const coefs = (shDegree + 1) ** 2 - 1;
  if (raw.length < HEADER_BYTES + count * (20 + 3 * coefs)) throw new Error("SPZ: truncated");
  return { count, shDegree, coefs, flags: raw[14]! & FLAG_ANTIALIASED, unit: 2 ** -raw[13]! };
}

// Decompressed SPZ bytes -> texture rows; `offset` is added to the positions. Throws with what is
// wrong.
export function decodeSpz(
  raw: Uint8Array<ArrayBuffer>,
  offset: readonly number[] = [0, 0, 0],
): DecodedSplats {
  const data = new DataView(raw.buffer, raw.byteOffset, raw.byteLength);
  const { count, shDegree, coefs, flags, unit } = readHeader(raw, data);
  const rows = Math.ceil(count / ROW) * ROW;
  const place = new Uint32Array(4 * rows);
  const shape = new Uint32Array(2 * rows);
  const centres = new Float32Array(place.buffer);
  const alpha = HEADER_BYTES + 9 * count;
  const color = alpha + count;
  const scale = color + 3 * count;
  const rotation = scale + 3 * count;
  for (let i = 0; i < count; i++) {
    for (let axis = 0; axis < 3; axis++) {
      const at = HEADER_BYTES + 9 * i + 3 * axis;
      const fixed = ((raw[at]! | (raw[at + 1]! << 8) | (raw[at + 2]! << 16)) << 8) >> 8;
      centres[4 * i + axis] = fixed * unit + offset[axis]!;
    }
    const c = color + 3 * i;
    const s = scale + 3 * i;
    place[4 * i + 3] =
      (raw[c]! | (raw[c + 1]! << 8) | (raw[c + 2]! << 16) | (raw[alpha + i]! << 24)) >>> 0;
    shape[2 * i] = (raw[s]! | (raw[s + 1]! << 8) | (raw[s + 2]! << 16) | (flags << 24)) >>> 0;
    shape[2 * i + 1] = data.getUint32(rotation + 4 * i, true);
  }

  // A texel holds 16 bytes of a Gaussian's 3, 9, 24 or 45.
  const bytes = 3 * coefs;
  const start = rotation + 4 * count;
  const sh = Array.from({ length: Math.ceil(bytes / 16) }, (_, k) => {
    const out = new Uint32Array(4 * rows).fill(SH_NONE);
    const view = new Uint8Array(out.buffer);
    const length = Math.min(16, bytes - 16 * k);
    for (let i = 0; i < count; i++) {
      const from = start + bytes * i + 16 * k;
      for (let j = 0; j < length; j++) view[16 * i + j] = raw[from + j]!;
    }
    return out;
  });
  const antialiased = flags !== 0;
  const core = findCore(place, count);
  return { count, shDegree, antialiased, place, shape, sh, embedding: null, core };
}
