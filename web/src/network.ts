// The appearance network of a scene, as far as it is the same for all Gaussians: weights, the
// photographs' embeddings, and what an appearance's text stands for (docs/appearance.md).
//
// SPDX-License-Identifier: Apache-2.0
import { HttpError, type Link } from "./link";

export const NAME_DEFAULT = "default";
const LENGTH_MAX = 64;
const BLEND_MAX = 16;
const KEPT = /^[a-z0-9][a-z0-9_-]*$/; // a name that the server may keep

// What the server tells of a photograph. The pose is where there is one.
export interface Photograph {
  name: string;
  time: string; // ISO 8601 without a zone, as the camera said it; "" when it is not known
  thumbnail: string; // URL; "" without
  place: { lon: number; lat: number; h: number; heading: number; pitch: number } | null;
}

// What is the same for all appearances, as rows of four for the graphics card.
export interface Weights {
  quads: number; // of the Gaussian's embedding
  hidden: number;
  w1: Float32Array; // [hidden][quads]
  w2: Float32Array; // [hidden]: what a unit adds to the four outputs
  b2: Float32Array;
}

export function quadsOf(length: number): number {
  return Math.ceil(length / 4);
}

// float32, little-endian, in base64url.
function numbers(text: unknown, count: number): Float32Array {
  const raw = atob(String(text).replace(/-/g, "+").replace(/_/g, "/"));
  const bytes = Uint8Array.from(raw, (c) => c.charCodeAt(0));
  const data = new DataView(bytes.buffer);
  const out = new Float32Array(Math.floor(bytes.length / 4));
  for (let i = 0; i < out.length; i++) out[i] = data.getFloat32(4 * i, true);
  if (out.length !== count || !out.every(Number.isFinite)) throw new Error("appearance: damaged");
  return out;
}

function unit(v: Float32Array): Float32Array {
  const length = Math.max(Math.hypot(...v), 1e-12);
  return v.map((x) => x / length);
}

function isLength(v: unknown): v is number {
  return Number.isInteger(v) && (v as number) >= 1 && (v as number) <= LENGTH_MAX;
}

const notThere = (name: string) => new HttpError(404, "", `no photograph is called '${name}'`);

/** @internal */
export class Network {
  readonly gaussian: number; // lengths
  readonly image: number;
  readonly hidden: number;
  private readonly weights: Float32Array;
  private readonly standard: Float32Array;
  private photographs: Promise<Photograph[]> | null = null;
  private rows = new Map<string, Float32Array>();

  // document: .../r/REV/appearance.json. Throws with what is wrong.
  constructor(
    document: unknown,
    private readonly table: URL,
    private readonly link: Link,
  ) {
    const { format, gaussianLength, imageLength, hidden, weights, ...rest } = document as Record<
      string,
      unknown
    >;
    if (format !== "citysplat-appearance-1") throw new Error("appearance: an unknown format");
    if (!isLength(gaussianLength) || !isLength(imageLength) || !isLength(hidden))
      throw new Error("appearance: lengths out of range");
    [this.gaussian, this.image, this.hidden] = [gaussianLength, imageLength, hidden];
    const inputs = gaussianLength + imageLength;
    this.weights = numbers(weights, hidden * inputs + hidden + 4 * hidden + 4);
    this.standard = numbers(rest["default"], imageLength);
  }

  // Every photograph; fetched when somebody asks for the first time.
  list(): Promise<Photograph[]> {
    this.photographs ??= this.fetchTable().catch((error: unknown) => {
      this.photographs = null;
      throw error;
    });
    return this.photographs;
  }

  private async fetchTable(): Promise<Photograph[]> {
    type One = Record<"name" | "time" | "thumbnail", string | undefined> &
      Record<"lon" | "lat" | "h" | "heading" | "pitch", number>;
    const body = (await this.link.json(this.table)) as {
      embeddings: string;
      photographs: One[];
    };
    const all = numbers(body.embeddings, this.image * body.photographs.length);
    return body.photographs.map((one, i) => {
      const { name = "", time = "", thumbnail, lon, lat, h, heading, pitch } = one;
      this.rows.set(name, unit(all.subarray(this.image * i, this.image * (i + 1))));
      const posed = [lon, lat, h, heading, pitch].every(Number.isFinite);
      return {
        name,
        time,
        thumbnail: thumbnail ? new URL(thumbnail, this.table).href : "",
        place: posed ? { lon, lat, h, heading, pitch } : null,
      };
    });
  }

  // The embedding that a text names, as the server reads it: "" or "default", a photograph,
  // NAME:WEIGHT,NAME:WEIGHT, =BASE64, or a name that the server keeps. Rejects where it names none.
  async find(text: string): Promise<Float32Array> {
    if (!text || text === NAME_DEFAULT) return this.standard;
    if (text.startsWith("=")) return numbers(text.slice(1), this.image);
    await this.list();
    if (KEPT.test(text) && !this.row(text)) return this.kept(text);
    const parts = text.split(",").map((part) => this.part(part));
    const sum = parts.reduce((total, { weight }) => total + weight, 0);
    if (parts.length > BLEND_MAX || !(Math.abs(sum) > 0)) throw notThere(text);
    const out = new Float32Array(this.image);
    for (const { row, weight } of parts)
      row.forEach((x, i) => (out[i] = out[i]! + (weight / sum) * x));
    return out;
  }

  // What a name stands for is the server's to say, and may be another tomorrow.
  private async kept(name: string): Promise<Float32Array> {
    const url = new URL("../../appearance", this.table); // of .../r/REV/appearances.json
    url.searchParams.set("appearance", name);
    const { embedding } = (await this.link.json(url)) as { embedding?: unknown };
    const out = Float32Array.from(Array.isArray(embedding) ? embedding : [], Number);
    if (out.length !== this.image || !out.every(Number.isFinite)) throw notThere(name);
    return out;
  }

  private part(text: string): { row: Float32Array; weight: number } {
    const whole = this.row(text);
    if (whole) return { row: whole, weight: 1 };
    const colon = text.lastIndexOf(":");
    const row = colon > 0 ? this.row(text.slice(0, colon)) : undefined;
    const weight = Number(text.slice(colon + 1) || NaN);
    if (!row || !Number.isFinite(weight)) throw notThere(text);
    return { row, weight };
  }

  private row(name: string): Float32Array | undefined {
    return name === NAME_DEFAULT ? unit(this.standard) : this.rows.get(name);
  }

  // Without the photograph's half of the first layer.
  get constants(): Weights {
    const { gaussian, hidden, weights } = this;
    const inputs = gaussian + this.image;
    const quads = quadsOf(gaussian);
    const w1 = new Float32Array(4 * quads * hidden);
    const w2 = new Float32Array(4 * hidden);
    const w2At = hidden * inputs + hidden;
    for (let h = 0; h < hidden; h++) {
      w1.set(weights.subarray(inputs * h, inputs * h + gaussian), 4 * quads * h);
      for (let o = 0; o < 4; o++) w2[4 * h + o] = weights[w2At + hidden * o + h]!;
    }
    return { quads, hidden, w1, w2, b2: weights.slice(w2At + 4 * hidden) };
  }

  // That half, which is all that an appearance changes: it goes into the bias, [hidden], padded to fours.
  biasOf(image: Float32Array): Float32Array {
    const { gaussian, hidden, weights } = this;
    const inputs = gaussian + this.image;
    const own = unit(image);
    const bias = new Float32Array(4 * quadsOf(hidden));
    for (let h = 0; h < hidden; h++) {
      const row = weights.subarray(inputs * h + gaussian, inputs * (h + 1));
      let sum = weights[hidden * inputs + h]!;
      for (let i = 0; i < own.length; i++) sum += row[i]! * own[i]!;
      bias[h] = sum;
    }
    return bias;
  }
}
