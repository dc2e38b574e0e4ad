// Our .drc (docs/formats.md) -> the integers that the graphics card draws from (pack.ts). The same that an
// .spz of the tile gives, and the embeddings, which only this format has. Runs in a worker.
//
// SPDX-License-Identifier: Apache-2.0
import { readDraco, type DracoAttribute, type Metadata } from "./draco";
import { MAX_GAUSSIANS, pack, ROW, type DecodedSplats } from "./pack";

const ID = {
  position: 0,
  opacity: 1,
  scale: 2,
  rotation: 3,
  rotationIndex: 4,
  colorG: 5,
  sh1G: 7,
  embedding: 13,
};
const CRC_BYTES = 4;
const POSITION_OFFSET = 2 ** 23;
const MAGNITUDE_MAX = 511;
const EMBEDDING_MAX = 64;

let crcTable: Uint32Array | null = null;

function crc32(bytes: Uint8Array): number {
  crcTable ??= Uint32Array.from({ length: 256 }, (_, n) => {
    for (let k = 0; k < 8; k++) n = n & 1 ? (n >>> 1) ^ 0xedb88320 : n >>> 1;
    return n;
  });
  let crc = -1;
  for (let i = 0; i < bytes.length; i++) crc = crcTable[(crc ^ bytes[i]!) & 255]! ^ (crc >>> 8);
  return ~crc >>> 0;
}

function intOf(metadata: Metadata, name: string): number {
  const bytes = metadata.get(name);
  if (bytes?.length !== 4) throw new Error(`.drc: without ${name}`);
  return new DataView(bytes.buffer, bytes.byteOffset, 4).getInt32(0, true);
}

const textOf = (metadata: Metadata, name: string) =>
  new TextDecoder().decode(metadata.get(name) ?? new Uint8Array());

function numbersOf(metadata: Metadata, name: string, count: number): Float32Array<ArrayBuffer> {
  const out = Float32Array.from(textOf(metadata, name).split(" "), Number);
  if (out.length !== count || !out.every(Number.isFinite)) throw new Error(`.drc: without ${name}`);
  return out;
}

// An attribute with the shape that it must have, and how many low bits of it were left out.
function field(all: Map<number, DracoAttribute>, id: number, components: number, most = 7) {
  const found = all.get(id);
  if (found?.components !== components) throw new Error(`.drc: without attribute ${id}`);
  const shift = intOf(found.metadata, "shift");
  if (shift < 0 || shift > most) throw new Error(`.drc: attribute ${id} is damaged`);
  return { values: found.values, shift };
}

// Step numbers to bytes: the last step may reach one beyond the largest.
function bytes(all: Map<number, DracoAttribute>, id: number, components: number): Uint8Array {
  const { values, shift } = field(all, id, components);
  const out = new Uint8Array(values.length);
  for (let i = 0; i < out.length; i++) out[i] = Math.min(255, values[i]! << shift);
  return out;
}

// Coefficients of a band, red and blue about green: each at out(i, coefficient, channel).
function triples(
  all: Map<number, DracoAttribute>,
  id: number,
  width: number,
  put: (row: number, at: number, value: number) => void,
) {
  const green = field(all, id, width);
  const others = field(all, id + 1, 2 * width);
  const count = green.values.length / width;
  const { shift } = green;
  for (let i = 0, k = 0; i < count; i++)
    for (let c = 0; c < width; c++, k++) {
      const g = green.values[k]!;
      put(i, 3 * c, Math.min(255, ((others.values[2 * k]! + 128 + g) & 255) << shift));
      put(i, 3 * c + 1, Math.min(255, g << shift));
      put(i, 3 * c + 2, Math.min(255, ((others.values[2 * k + 1]! + 128 + g) & 255) << shift));
    }
}

function readRotations(all: Map<number, DracoAttribute>): Uint32Array {
  const { values, shift } = field(all, ID.rotation, 3, 8);
  const largest = field(all, ID.rotationIndex, 1, 0).values;
  const zero = (MAGNITUDE_MAX + (1 << shift) - 1) >> shift;
  const out = new Uint32Array(largest.length);
  for (let i = 0; i < out.length; i++) {
    let packed = largest[i]! & 3;
    for (let k = 0; k < 3; k++) {
      const v = values[3 * i + k]!;
      const size = Math.min(MAGNITUDE_MAX, Math.abs(v - zero) << shift);
      packed = (packed << 10) | (v < zero ? 512 : 0) | size;
    }
    out[i] = packed;
  }
  return out;
}

function readHarmonics(all: Map<number, DracoAttribute>, degree: number, count: number): Uint8Array {
  const width = 3 * ((degree + 1) ** 2 - 1);
  const out = new Uint8Array(width * count);
  for (let band = 1, first = 0; band <= degree; first += 3 * (2 * band + 1), band++) {
    const at = first;
    triples(all, ID.sh1G + 2 * (band - 1), 2 * band + 1, (row, k, value) => (out[width * row + at + k] = value));
  }
  return out;
}

function readEmbedding(all: Map<number, DracoAttribute>, metadata: Metadata, rows: number) {
  const length = all.get(ID.embedding)?.components ?? 0;
  if (!length) return null;
  if (length > EMBEDDING_MAX) throw new Error(`.drc: embeddings of ${length} numbers`);
  const values = bytes(all, ID.embedding, length);
  const least = numbersOf(metadata, "embed_min", length);
  const most = numbersOf(metadata, "embed_max", length);
  const out = Array.from({ length: Math.ceil(length / 16) }, () => new Uint32Array(4 * rows));
  out.forEach((plane, k) => {
    const view = new Uint8Array(plane.buffer);
    const width = Math.min(16, length - 16 * k);
    for (let i = 0, from = 16 * k; from < values.length; i++, from += length)
      for (let j = 0; j < width; j++) view[16 * i + j] = values[from + j]!;
  });
  return { length, least, step: most.map((v, d) => (v - least[d]!) / 255), planes: out };
}

// A whole file -> what the card holds; `offset` is added to the positions. Throws with what is wrong.
export function decodeDrc(
  file: Uint8Array,
  offset: readonly number[] = [0, 0, 0],
): DecodedSplats {
  const end = file.length - CRC_BYTES;
  if (end < 0) throw new Error(".drc: truncated");
  const stream = file.subarray(0, end);
  const check = new DataView(file.buffer, file.byteOffset + end, 4).getUint32(0, true);
  if (crc32(stream) !== check) throw new Error(".drc: damaged or truncated, its check value differs");
  const { count, attributes, metadata } = readDraco(stream, MAX_GAUSSIANS);
  if (textOf(metadata, "format") !== "citysplat-2") throw new Error(".drc: not a splat tile");
  const shDegree = intOf(metadata, "sh_degree");
  if (shDegree < 0 || shDegree > 3) throw new Error(`.drc: harmonics of degree ${shDegree}`);
  const antialiased = intOf(metadata, "antialiased") !== 0;
  const position = field(attributes, ID.position, 3, 22);
  const unit = 2 ** (position.shift - intOf(metadata, "frac_bits"));
  const steps = Int32Array.from(position.values, (v) => v - POSITION_OFFSET);
  const colors = new Uint8Array(4 * count);
  triples(attributes, ID.colorG, 1, (row, k, value) => (colors[4 * row + k] = value));
  const opacity = bytes(attributes, ID.opacity, 1);
  for (let i = 0; i < count; i++) colors[4 * i + 3] = opacity[i]!;
  const scales = bytes(attributes, ID.scale, 3);
  const rotations = readRotations(attributes);
  const sh = readHarmonics(attributes, shDegree, count);
  const embedding = readEmbedding(attributes, metadata, Math.ceil(count / ROW) * ROW);
  const fields = { steps, colors, scales, rotations, sh };
  return pack({ count, shDegree, antialiased, unit, ...fields, embedding }, offset);
}
