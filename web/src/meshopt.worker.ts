// Worker: unpacks buffers of EXT_meshopt_compression, by meshoptimizer's decoder without WebAssembly,
// which the page's policy does not allow. Damaged bytes may keep it busy for ever: it is ended then.
//
// SPDX-License-Identifier: Apache-2.0
import { MeshoptDecoder } from "../node_modules/meshoptimizer/meshopt_decoder_reference.js";

export interface MeshoptRequest {
  count: number;
  size: number;
  source: Uint8Array;
  mode: string;
  filter: string | undefined;
}
export interface MeshoptReply {
  target?: Uint8Array<ArrayBuffer>;
  error?: string;
}

self.onmessage = ({ data }: MessageEvent<MeshoptRequest>) => {
  const { count, size, source, mode, filter } = data;
  try {
    const target = new Uint8Array(count * size);
    MeshoptDecoder.decodeGltfBuffer(target, count, size, source, mode, filter);
    self.postMessage({ target } satisfies MeshoptReply, { transfer: [target.buffer] });
  } catch (error) {
    self.postMessage({ error: String(error) } satisfies MeshoptReply);
  }
};
