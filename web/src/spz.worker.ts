// Worker: gzip bytes of an .spz in, arrays for Spark out (transferred, not copied).
//
// SPDX-License-Identifier: Apache-2.0
import { decodeSpz } from "./spz";

export interface SpzRequest {
  id: number;
  gzip: Uint8Array<ArrayBuffer>;
}

async function decode(gzip: Uint8Array<ArrayBuffer>) {
  const stream = new Blob([gzip]).stream().pipeThrough(new DecompressionStream("gzip"));
  return decodeSpz(new Uint8Array(await new Response(stream).arrayBuffer()));
}

self.onmessage = async (event: MessageEvent<SpzRequest>) => {
  const { id, gzip } = event.data;
  try {
    const splats = await decode(gzip);
    const arrays = [splats.extA, splats.extB, ...Object.values(splats.sh)];
    self.postMessage({ id, splats }, { transfer: arrays.map((a) => a.buffer) });
  } catch (error) {
    self.postMessage({ id, error: error instanceof Error ? error.message : String(error) });
  }
};
