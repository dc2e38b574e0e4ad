// SPZ version 3 -> the integers that the graphics card draws from (pack.ts). Runs in a worker.
//
// SPDX-License-Identifier: Apache-2.0
import { MAX_GAUSSIANS, pack, type DecodedSplats } from "./pack";

const MAGIC = 0x5053474e; // "NGSP"
const HEADER_BYTES = 16;
const FLAG_ANTIALIASED = 1;
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

// Decompressed SPZ bytes -> what the card holds; `offset` is added to the positions. Throws with what is wrong.
export function decodeSpz(
  raw: Uint8Array<ArrayBuffer>,
  offset: readonly number[] = [0, 0, 0],
): DecodedSplats {
  const data = new DataView(raw.buffer, raw.byteOffset, raw.byteLength);
  const { count, shDegree, coefs, flags, unit } = readHeader(raw, data);
  const alpha = HEADER_BYTES + 9 * count;
  const color = alpha + count;
  const scale = color + 3 * count;
  const rotation = scale + 3 * count;
  const steps = new Int32Array(3 * count);
  for (let i = 0, at = HEADER_BYTES; i < steps.length; i++, at += 3)
    steps[i] = ((raw[at]! | (raw[at + 1]! << 8) | (raw[at + 2]! << 16)) << 8) >> 8;
  const colors = new Uint8Array(4 * count);
  for (let i = 0; i < count; i++) {
    for (let c = 0; c < 3; c++) colors[4 * i + c] = raw[color + 3 * i + c]!;
    colors[4 * i + 3] = raw[alpha + i]!;
  }
  const rotations = Uint32Array.from({ length: count }, (_, i) => data.getUint32(rotation + 4 * i, true));
  const scales = raw.subarray(scale, rotation);
  const start = rotation + 4 * count;
  const sh = raw.subarray(start, start + 3 * coefs * count);
  const fields = { steps, colors, scales, rotations, sh };
  return pack({ count, shDegree, antialiased: flags !== 0, unit, ...fields, embedding: null }, offset);
}
