// The SPZ bytes of a splat tile in binary glTF. Runs in a worker.
//
// SPDX-License-Identifier: Apache-2.0
const EXT = "KHR_gaussian_splatting";
const EXT_SPZ = "KHR_gaussian_splatting_compression_spz_2";
const CHUNK_JSON = 0x4e4f534a;
const CHUNK_BIN = 0x004e4942;

interface Gltf {
  meshes?: {
    primitives?: {
      extensions?: Record<string, { extensions?: Record<string, { bufferView?: number }> }>;
    }[];
  }[];
  bufferViews?: { byteOffset?: number; byteLength?: number }[];
}

// The chunks of a file, checked against its length.
function chunks(file: Uint8Array): { json: Uint8Array; bin: Uint8Array } {
  const data = new DataView(file.buffer, file.byteOffset, file.byteLength);
  if (file.length < 20 || data.getUint32(0, true) !== 0x46546c67)
    throw new Error("not a binary glTF file");
  if (data.getUint32(8, true) > file.length) throw new Error("glTF: cut off");
  let json: Uint8Array | null = null;
  let bin: Uint8Array | null = null;
  for (let at = 12; at + 8 <= file.length; ) {
    const length = data.getUint32(at, true);
    const type = data.getUint32(at + 4, true);
    if (at + 8 + length > file.length) throw new Error("glTF: a chunk is cut off");
    const body = file.subarray(at + 8, at + 8 + length);
    if (type === CHUNK_JSON) json ??= body;
    if (type === CHUNK_BIN) bin ??= body;
    at += 8 + length;
  }
  if (!json || !bin) throw new Error("glTF: without its two chunks");
  return { json, bin };
}

// .glb bytes -> gzip bytes of its .spz. Throws with what is wrong.
export function spzOfGlb(file: Uint8Array): Uint8Array {
  const { json, bin } = chunks(file);
  const gltf = JSON.parse(new TextDecoder().decode(json)) as Gltf;
  const splats = gltf.meshes?.[0]?.primitives?.[0]?.extensions?.[EXT];
  if (!splats) throw new Error(`glTF without ${EXT}: this client draws splats only`);
  const index = splats.extensions?.[EXT_SPZ]?.bufferView;
  if (index === undefined) throw new Error(`${EXT} without ${EXT_SPZ}: this client reads SPZ tiles`);
  const view = gltf.bufferViews?.[index];
  const from = view?.byteOffset ?? 0;
  const length = view?.byteLength ?? -1;
  if (length < 0 || from < 0 || from + length > bin.length)
    throw new Error("glTF: its SPZ lies outside of the file");
  return bin.subarray(from, from + length);
}
