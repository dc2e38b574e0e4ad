// The part of Draco that our .drc is made of: point clouds in sequential encoding with integer
// attributes, bitstream 2.x. Written after Draco's published bitstream specification; no WebAssembly,
// so a page needs no permission for it. Every count is checked against the bytes at hand. Runs in a
// worker.
//
// SPDX-License-Identifier: Apache-2.0

const FLAG_METADATA = 0x8000;
const PREDICTION_NONE = -2;
const PREDICTION_DIFFERENCE = 0;
const TRANSFORM_WRAP = 1;
const UINT8 = 2;
const SCHEME_TAGGED = 0;
const SCHEME_RAW = 1;
const METADATA_DEPTH_MAX = 4;
const ATTRIBUTES_MAX = 64;
const COMPONENTS_MAX = 64; // of an attribute: those of an embedding
const VALUES_PER_BYTE_MAX = 1024; // of all attributes together

export type Metadata = Map<string, Uint8Array>;

export interface DracoAttribute {
  id: number;
  components: number;
  values: Int32Array | Uint8Array; // [point][component]
  metadata: Metadata;
}
export interface DracoCloud {
  count: number;
  attributes: Map<number, DracoAttribute>;
  metadata: Metadata;
}

class Reader {
  at = 0;
  private readonly view: DataView;

  constructor(readonly bytes: Uint8Array) {
    this.view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  }

  take(length: number): Uint8Array {
    const from = this.at;
    if (length < 0 || from + length > this.bytes.length) throw new Error("Draco: truncated");
    this.at += length;
    return this.bytes.subarray(from, this.at);
  }
  u8 = () => this.take(1)[0]!;
  i8 = () => (this.u8() << 24) >> 24;
  u16 = () => (this.take(2), this.view.getUint16(this.at - 2, true));
  i32 = () => (this.take(4), this.view.getInt32(this.at - 4, true));

  varint(): number {
    let value = 0;
    for (let scale = 1; scale < 2 ** 42; scale *= 128) {
      const byte = this.u8();
      value += (byte & 127) * scale;
      if (byte < 128) return value;
    }
    throw new Error("Draco: a number is too long");
  }
}

const ascii = (bytes: Uint8Array) => String.fromCharCode(...bytes);

function readMetadata(from: Reader, depth = 0): Metadata {
  if (depth > METADATA_DEPTH_MAX) throw new Error("Draco: metadata is nested too deep");
  const out: Metadata = new Map();
  for (let left = from.varint(); left > 0; left--) {
    const key = ascii(from.take(from.u8()));
    out.set(key, from.take(from.varint()));
  }
  for (let left = from.varint(); left > 0; left--) {
    from.take(from.u8());
    readMetadata(from, depth + 1);
  }
  return out;
}

// ---- entropy coding ----

// Symbols of a rANS stream: frequencies, then its bytes, which are read from the end.
class Symbols {
  private readonly bits: number;
  private readonly symbolOf: Uint32Array;
  private readonly share: Uint32Array;
  private readonly first: Uint32Array;
  private state = 0;
  private at = 0;
  private data: Uint8Array = new Uint8Array();

  constructor(from: Reader, symbolBits: number) {
    this.bits = Math.min(20, Math.max(12, Math.floor((3 * symbolBits) / 2)));
    const total = 2 ** this.bits;
    const count = from.varint();
    if (count > total) throw new Error("Draco: too many symbols");
    this.share = new Uint32Array(count);
    this.first = new Uint32Array(count);
    this.symbolOf = new Uint32Array(total);
    for (let i = 0; i < count; i++) {
      const head = from.u8();
      const more = head & 3;
      if (more === 3) {
        i += head >> 2; // a run of symbols that do not occur
        continue;
      }
      let share = head >> 2;
      for (let b = 0; b < more; b++) share |= from.u8() << (8 * (b + 1) - 2);
      this.share[i] = share;
    }
    let sum = 0;
    for (let i = 0; i < count; i++) {
      this.first[i] = sum;
      const end = sum + this.share[i]!;
      if (end > total) throw new Error("Draco: damaged frequencies");
      this.symbolOf.fill(i, sum, end);
      sum = end;
    }
    if (sum !== total) throw new Error("Draco: damaged frequencies");
    this.begin(from.take(from.varint()));
  }

  private begin(data: Uint8Array) {
    const last = data.at(-1);
    if (last === undefined || data.length < (last >> 6) + 1) throw new Error("Draco: truncated");
    const more = last >> 6;
    let state = last & 63;
    for (let b = 1; b <= more; b++) state = state * 256 + data[data.length - 1 - b]!;
    this.data = data;
    this.at = data.length - 1 - more;
    this.state = state + 4 * 2 ** this.bits;
    if (this.state >= 1024 * 2 ** this.bits) throw new Error("Draco: damaged symbols");
  }

  // The next ones into out, every `step`-th place.
  read(out: Int32Array, step = 1) {
    const { bits, symbolOf, share, first, data } = this;
    const mask = (1 << bits) - 1;
    const least = 4 << bits;
    let { state, at } = this;
    for (let i = 0; i < out.length; i += step) {
      while (state < least && at > 0) state = (state << 8) | data[--at]!;
      const low = state & mask;
      const symbol = symbolOf[low]!;
      state = (state >>> bits) * share[symbol]! + low - first[symbol]!;
      out[i] = symbol;
    }
    this.state = state;
    this.at = at;
  }
}

// Each point's number of bits as a symbol, the bits of its components behind all of them.
function readTagged(from: Reader, out: Int32Array, components: number) {
  new Symbols(from, 5).read(out, components);
  const { bytes } = from;
  let bit = 8 * from.at;
  for (let i = 0; i < out.length; i += components) {
    const width = out[i]!;
    if (width > 32 || bit + width * components > 8 * bytes.length)
      throw new Error("Draco: truncated");
    for (let c = 0; c < components; c++) {
      let value = 0;
      for (let got = 0; got < width;) {
        const shift = bit & 7;
        const now = Math.min(8 - shift, width - got);
        value |= ((bytes[bit >> 3]! >> shift) & ((1 << now) - 1)) << got;
        got += now;
        bit += now;
      }
      out[i + c] = value;
    }
  }
  from.take(Math.ceil(bit / 8) - from.at);
}

function readSymbols(from: Reader, out: Int32Array, components: number) {
  const scheme = from.u8();
  if (scheme === SCHEME_TAGGED) readTagged(from, out, components);
  else if (scheme === SCHEME_RAW) {
    const bits = from.u8();
    if (bits < 1 || bits > 18) throw new Error("Draco: damaged symbols");
    new Symbols(from, bits).read(out);
  } else throw new Error("Draco: an unknown coding of symbols");
}

function readPlain(from: Reader, out: Int32Array) {
  const width = from.u8();
  if (width < 1 || width > 4) throw new Error("Draco: damaged values");
  const bytes = from.take(width * out.length);
  for (let i = 0; i < out.length; i++) {
    let value = 0;
    for (let b = 0; b < width; b++) value |= bytes[width * i + b]! << (8 * b);
    out[i] = value;
  }
}

// Differences to the point before, which wrap round the range of the values.
function undoDifferences(from: Reader, out: Int32Array, components: number) {
  const least = from.i32();
  const most = from.i32();
  const span = most - least + 1;
  if (span < 1) throw new Error("Draco: damaged range");
  for (let i = 0; i < out.length; i++) {
    const before = i < components ? 0 : out[i - components]!;
    const value = Math.min(most, Math.max(least, before)) + out[i]!;
    out[i] = value > most ? value - span : value < least ? value + span : value;
  }
}

function readValues(from: Reader, count: number, components: number): Int32Array<ArrayBuffer> {
  const out = new Int32Array(count * components);
  const prediction = from.i8();
  if (prediction !== PREDICTION_NONE) {
    if (prediction !== PREDICTION_DIFFERENCE || from.i8() !== TRANSFORM_WRAP)
      throw new Error("Draco: an unknown prediction");
  }
  if (from.u8()) readSymbols(from, out, components);
  else readPlain(from, out);
  for (let i = 0; i < out.length; i++) {
    const value = out[i]!;
    out[i] = (value >>> 1) ^ -(value & 1); // signs were folded into the lowest bit
  }
  if (prediction === PREDICTION_DIFFERENCE) undoDifferences(from, out, components);
  return out;
}

// ---- the file ----

function readHead(from: Reader) {
  if (ascii(from.take(5)) !== "DRACO") throw new Error("not a Draco file");
  const [major, , type, method] = [from.u8(), from.u8(), from.u8(), from.u8()];
  if (major !== 2 || type !== 0 || method !== 0)
    throw new Error("Draco: only sequential point clouds of version 2 are read");
  const byAttribute = new Map<number, Metadata>();
  let metadata: Metadata = new Map();
  if (from.u16() & FLAG_METADATA) {
    for (let left = from.varint(); left > 0; left--) {
      const id = from.varint();
      byAttribute.set(id, readMetadata(from));
    }
    metadata = readMetadata(from);
  }
  return { byAttribute, metadata };
}

// A Draco stream, without what may follow it. Throws with what is wrong.
export function readDraco(bytes: Uint8Array, mostPoints: number): DracoCloud {
  const from = new Reader(bytes);
  const { byAttribute, metadata } = readHead(from);
  const count = from.i32();
  if (count < 1 || count > mostPoints) throw new Error(`Draco: ${count} points`);
  if (from.u8() !== 1) throw new Error("Draco: more than one set of attributes");
  const number = from.varint();
  if (number < 1 || number > ATTRIBUTES_MAX) throw new Error(`Draco: ${number} attributes`);
  const heads = Array.from({ length: number }, () => {
    from.take(1); // kind: known by the id
    const narrow = from.u8() === UINT8;
    const components = from.u8();
    from.take(1); // normalised
    if (components < 1 || components > COMPONENTS_MAX)
      throw new Error(`Draco: an attribute of ${components} components`);
    return { components, narrow, id: from.varint() };
  });
  const width = heads.reduce((sum, { components }) => sum + components, 0);
  if (count * width > VALUES_PER_BYTE_MAX * bytes.length)
    throw new Error(`Draco: ${count} points of ${width} numbers in ${bytes.length} bytes`);
  for (let i = 0; i < number; i++)
    if (from.u8() !== 1) throw new Error("Draco: an attribute that is not of integers");
  const attributes = new Map<number, DracoAttribute>();
  for (const { id, components, narrow } of heads) {
    if (attributes.has(id)) throw new Error(`Draco: attribute ${id} twice`);
    const read = readValues(from, count, components);
    const values = narrow ? new Uint8Array(read) : read;
    attributes.set(id, { id, components, values, metadata: byAttribute.get(id) ?? new Map() });
  }
  return { count, attributes, metadata };
}
