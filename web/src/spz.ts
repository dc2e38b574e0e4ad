// SPZ version 3 -> the textures Spark draws from ("extended splats": float32 centres, half-float
// colour and scale, 10+10+12-bit rotation).
//
// Spark can read .spz itself, but its compact form keeps centres as half floats (3 cm steps at 50
// m) and its extended form, filled by its own loader, rounds each harmonic down to a power of two.
// Filling the extended arrays here keeps both exact and takes the antialiasing flag from the
// header. Runs in a worker.
//
// SPDX-License-Identifier: Apache-2.0

const MAGIC = 0x5053474e; // "NGSP"
const HEADER_BYTES = 16;
const FLAG_ANTIALIASED = 1;
const SH_C0 = 0.28209479177387814;
const TEXTURE_WIDTH = 2048; // Spark's: array lengths are whole rows
const MAX_GAUSSIANS = 1 << 22;

export interface DecodedSplats {
  count: number;
  shDegree: number;
  antialiased: boolean;
  extA: Uint32Array<ArrayBuffer>; // x, y, z as float32 bits, opacity as half
  extB: Uint32Array<ArrayBuffer>; // r g | b ln sx | ln sy ln sz as halves | rotation
  sh: Record<string, Uint32Array<ArrayBuffer>>; // sh1, sh2, sh3a, sh3b as far as the degree goes
  // 5th and 95th percentile of the centres along x, y, z: the scene without its strays
  core: { min: [number, number, number]; max: [number, number, number] };
}

const words = new Uint32Array(1);
const float = new Float32Array(words.buffer);

function halfFrom(value: number): number {
  float[0] = value;
  const bits = words[0]!;
  const sign = (bits >>> 16) & 0x8000;
  const exponent = ((bits >>> 23) & 0xff) - 112;
  const fraction = bits & 0x7fffff;
  if (exponent >= 31) return sign | 0x7bff; // largest finite: no value here comes near
  if (exponent <= 0) {
    if (exponent < -10) return sign;
    const shift = 14 - exponent;
    return sign | (((fraction | 0x800000) + (1 << (shift - 1))) >>> shift);
  }
  return sign | (((exponent << 10) | (fraction >>> 13)) + ((fraction >>> 12) & 1));
}

// Every field but position, rotation and harmonics is one byte: 256 halves each.
const table = (f: (byte: number) => number) =>
  Uint16Array.from({ length: 256 }, (_, i) => halfFrom(f(i)));
const ALPHA = table((v) => v / 255);
const COLOR = table((v) => 0.5 + (SH_C0 * (v / 255 - 0.5)) / 0.15);
const SCALE = table((v) => v / 16 - 10);

// Unit quaternion -> octahedral axis (10 + 10 bits) and angle (12 bits).
function packRotation(x: number, y: number, z: number, w: number): number {
  const flip = w < 0 ? -1 : 1;
  const norm = Math.hypot(x, y, z);
  const angle = 2 * Math.atan2(norm, Math.abs(w));
  const scale = norm < 1e-6 ? 0 : flip / norm;
  const ax = norm < 1e-6 ? 1 : x * scale;
  const ay = y * scale;
  const az = z * scale;
  const sum = Math.abs(ax) + Math.abs(ay) + Math.abs(az);
  let u = ax / sum;
  let v = ay / sum;
  if (az < 0) {
    const folded = (1 - Math.abs(v)) * (u >= 0 ? 1 : -1);
    v = (1 - Math.abs(u)) * (v >= 0 ? 1 : -1);
    u = folded;
  }
  const quantU = Math.round((u * 0.5 + 0.5) * 1023);
  const quantV = Math.round((v * 0.5 + 0.5) * 1023);
  return ((Math.round((angle * 4095) / Math.PI) << 20) | (quantV << 10) | quantU) >>> 0;
}

// "Smallest three": index of the largest in the top bits, then sign and 9-bit magnitude of the
// others.
function convertRotation(packed: number): number {
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
  return packRotation(q[0]!, q[1]!, q[2]!, q[3]!);
}

// One harmonic coefficient (r, g, b bytes about 128) -> shared exponent and three 8-bit magnitudes.
// The exponent is the one above the largest value, so nothing saturates.
function packHarmonic(r: number, g: number, b: number): number {
  const [vr, vg, vb] = [r - 128, g - 128, b - 128];
  const largest = Math.max(Math.abs(vr), Math.abs(vg), Math.abs(vb));
  if (largest === 0) return 0;
  const exponent = Math.ceil(Math.log2(largest / 128)) + 15;
  const unit = 255 / (128 * 2 ** (exponent - 15));
  const signs = (vr < 0 ? 1 : 0) | (vg < 0 ? 2 : 0) | (vb < 0 ? 4 : 0);
  const magnitude = (v: number) => Math.round(Math.abs(v) * unit);
  return (
    ((exponent << 27) |
      (signs << 24) |
      (magnitude(vb) << 16) |
      (magnitude(vg) << 8) |
      magnitude(vr)) >>>
    0
  );
}

// Where coefficient k (0-based, without DC) of a Gaussian goes: which array and which of its four
// words.
function harmonicSlot(k: number): [string, number] {
  if (k < 3) return ["sh1", k];
  if (k === 3) return ["sh1", 3];
  if (k < 8) return ["sh2", k - 4];
  return k < 12 ? ["sh3a", k - 8] : ["sh3b", k - 12];
}

// Trained Gaussians are many where the photographs saw much, and few and large around it.
function findCore(extA: Uint32Array<ArrayBuffer>, count: number): DecodedSplats["core"] {
  const centres = new Float32Array(extA.buffer);
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

// Decompressed SPZ bytes -> arrays for Spark. Throws with what is wrong.
export function decodeSpz(raw: Uint8Array<ArrayBuffer>): DecodedSplats {
  if (raw.length < HEADER_BYTES) throw new Error("SPZ: shorter than its header");
  const data = new DataView(raw.buffer, raw.byteOffset, raw.byteLength);
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

  const rows = Math.ceil(count / TEXTURE_WIDTH) * TEXTURE_WIDTH;
  const extA = new Uint32Array(4 * rows);
  const extB = new Uint32Array(4 * rows);
  const centres = new Float32Array(extA.buffer);
  const unit = 2 ** -raw[13]!;
  const alpha = HEADER_BYTES + 9 * count;
  const color = alpha + count;
  const scale = color + 3 * count;
  const rotation = scale + 3 * count;
  for (let i = 0; i < count; i++) {
    for (let axis = 0; axis < 3; axis++) {
      const at = HEADER_BYTES + 9 * i + 3 * axis;
      const fixed = ((raw[at]! | (raw[at + 1]! << 8) | (raw[at + 2]! << 16)) << 8) >> 8;
      centres[4 * i + axis] = fixed * unit;
    }
    const c = color + 3 * i;
    const s = scale + 3 * i;
    extA[4 * i + 3] = ALPHA[raw[alpha + i]!]!;
    extB[4 * i] = COLOR[raw[c]!]! | (COLOR[raw[c + 1]!]! << 16);
    extB[4 * i + 1] = COLOR[raw[c + 2]!]! | (SCALE[raw[s]!]! << 16);
    extB[4 * i + 2] = SCALE[raw[s + 1]!]! | (SCALE[raw[s + 2]!]! << 16);
    extB[4 * i + 3] = convertRotation(data.getUint32(rotation + 4 * i, true));
  }

  const sh: DecodedSplats["sh"] = {};
  const start = rotation + 4 * count;
  for (let k = 0; k < coefs; k++) {
    const [name, word] = harmonicSlot(k);
    const out = (sh[name] ??= new Uint32Array(4 * rows));
    for (let i = 0; i < count; i++) {
      const at = start + 3 * (i * coefs + k);
      out[4 * i + word] = packHarmonic(raw[at]!, raw[at + 1]!, raw[at + 2]!);
    }
  }
  const antialiased = (raw[14]! & FLAG_ANTIALIASED) !== 0;
  return { count, shDegree, antialiased, extA, extB, sh, core: findCore(extA, count) };
}
