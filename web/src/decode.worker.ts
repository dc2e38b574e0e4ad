// Worker: bytes of a tile in, what the card holds out (transferred, not copied).
//
// SPDX-License-Identifier: Apache-2.0
import { decodeDrc } from "./drc";
import { spzOfGlb } from "./glb";
import type { DecodedSplats } from "./pack";
import { decodeSpz } from "./spz";

export interface DecodeRequest {
  id: number;
  file: ArrayBuffer;
  offset: [number, number, number];
}
export interface DecodeReply {
  id: number;
  splats?: DecodedSplats;
  error?: string;
}

const INFLATED_MAX = 512 * 2 ** 20; // a hostile gzip stream may promise anything

async function inflate(gzip: Uint8Array): Promise<Uint8Array<ArrayBuffer>> {
  const stream = new Blob([gzip as Uint8Array<ArrayBuffer>])
    .stream()
    .pipeThrough(new DecompressionStream("gzip"));
  const parts: Uint8Array[] = [];
  let length = 0;
  const reader = stream.getReader();
  for (let part = await reader.read(); !part.done; part = await reader.read()) {
    length += part.value.length;
    if (length > INFLATED_MAX) throw new Error("SPZ: inflates to more than 512 MiB");
    parts.push(part.value);
  }
  const out = new Uint8Array(length);
  let at = 0;
  for (const part of parts) {
    out.set(part, at);
    at += part.length;
  }
  return out;
}

async function decode(file: Uint8Array, offset: [number, number, number]): Promise<DecodedSplats> {
  if (file[0] === 0x44) return decodeDrc(file, offset); // "DRACO"
  return decodeSpz(await inflate(spzOfGlb(file)), offset);
}

self.onmessage = async (event: MessageEvent<DecodeRequest>) => {
  const { id, file, offset } = event.data;
  try {
    const splats = await decode(new Uint8Array(file), offset);
    const { base, heads, more, embedding } = splats;
    const buffers = [base, heads, more, ...(embedding?.planes ?? [])].map((a) => a.buffer);
    self.postMessage({ id, splats } satisfies DecodeReply, { transfer: buffers });
  } catch (error) {
    const text = error instanceof Error ? error.message : String(error);
    self.postMessage({ id, error: text } satisfies DecodeReply);
  }
};
