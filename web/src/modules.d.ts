// Parts of packages that have no types of their own.
//
// SPDX-License-Identifier: Apache-2.0
// What the build makes of a worker: its script as text.
declare module "*.worker.ts?text" {
  const text: string;
  export default text;
}

declare module "*/meshopt_decoder_reference.js" {
  export const MeshoptDecoder: {
    decodeGltfBuffer(
      target: Uint8Array,
      count: number,
      size: number,
      source: Uint8Array,
      mode: string,
      filter?: string,
    ): void;
  };
}
