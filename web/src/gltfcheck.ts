// What must hold before a glTF of somebody else is given to three.js: nothing in it may make the loader
// wait for ever, take memory without end, or ask servers that it should not. Throws with what is wrong.
//
// SPDX-License-Identifier: Apache-2.0

const BYTES_MAX = 512 * 2 ** 20; // of all accessors, unpacked
const DEPTH_MAX = 256; // of the tree of nodes
const COUNT_MAX = 200_000; // nodes, accessors, images …
const CHUNK_JSON = 0x4e4f534a;
const MAGIC_GLB = 0x46546c67;
const COMPONENTS: Record<string, number> = {
  SCALAR: 1,
  VEC2: 2,
  VEC3: 3,
  VEC4: 4,
  MAT2: 4,
  MAT3: 9,
  MAT4: 16,
};
const WIDTHS: Record<number, number> = { 5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4 };
const SPLATS = "KHR_gaussian_splatting";
// What three.js' loader knows of the extensions that a file may insist on.
const KNOWN = new Set([
  "CESIUM_RTC",
  "EXT_mesh_features",
  "EXT_mesh_gpu_instancing",
  "EXT_meshopt_compression",
  "EXT_structural_metadata",
  "EXT_texture_avif",
  "EXT_texture_webp",
  "KHR_draco_mesh_compression",
  "KHR_lights_punctual",
  "KHR_materials_anisotropy",
  "KHR_materials_clearcoat",
  "KHR_materials_dispersion",
  "KHR_materials_emissive_strength",
  "KHR_materials_ior",
  "KHR_materials_iridescence",
  "KHR_materials_sheen",
  "KHR_materials_specular",
  "KHR_materials_transmission",
  "KHR_materials_unlit",
  "KHR_materials_volume",
  "KHR_mesh_quantization",
  "KHR_texture_transform",
]);

interface Accessor {
  count?: unknown;
  type?: unknown;
  componentType?: unknown;
}
interface Gltf {
  asset?: { version?: unknown };
  extensionsRequired?: unknown;
  extensionsUsed?: unknown;
  accessors?: unknown;
  nodes?: unknown;
  images?: unknown;
  buffers?: unknown;
  meshes?: unknown;
}

export class GltfFault extends Error {
  // extension: what the file insists on and nothing here reads.
  constructor(
    message: string,
    readonly extension = "",
  ) {
    super(message);
  }
}

// The JSON of a .gltf or a .glb.
export function readGltfJson(file: ArrayBuffer): unknown {
  const data = new DataView(file);
  let text = new Uint8Array(file);
  if (file.byteLength >= 20 && data.getUint32(0, true) === MAGIC_GLB) {
    const version = data.getUint32(4, true);
    if (version !== 2) throw new GltfFault(`binary glTF of version ${version}`);
    if (data.getUint32(8, true) > file.byteLength) throw new GltfFault("the file is cut off");
    const length = data.getUint32(12, true);
    if (data.getUint32(16, true) !== CHUNK_JSON || 20 + length > file.byteLength)
      throw new GltfFault("its first chunk is no JSON");
    text = text.subarray(20, 20 + length);
  }
  try {
    return JSON.parse(new TextDecoder().decode(text));
  } catch {
    throw new GltfFault("its JSON cannot be read");
  }
}

function list(value: unknown, what: string): unknown[] {
  if (value === undefined) return [];
  if (!Array.isArray(value)) throw new GltfFault(`${what} is no list`);
  if (value.length > COUNT_MAX) throw new GltfFault(`${value.length} ${what}`);
  if (value.some((one) => typeof one !== "object" || one === null))
    throw new GltfFault(`${what} holds something else`);
  return value;
}

function checkSizes(accessors: Accessor[]) {
  let bytes = 0;
  for (const { count, type, componentType } of accessors) {
    const each = (COMPONENTS[String(type)] ?? 0) * (WIDTHS[Number(componentType)] ?? 0);
    if (!each || !Number.isInteger(count) || (count as number) < 0)
      throw new GltfFault("an accessor is damaged");
    bytes += (count as number) * each;
  }
  if (bytes > BYTES_MAX) throw new GltfFault(`its geometry takes ${Math.round(bytes / 2 ** 20)} MB`);
}

// A forest: the loader follows children, and waits for ever on a node above itself.
function checkTree(nodes: { children?: unknown }[]) {
  const parent = new Int32Array(nodes.length).fill(-1);
  nodes.forEach(({ children = [] }, i) => {
    if (!Array.isArray(children)) throw new GltfFault("a node is damaged");
    for (const child of children) {
      if (!Number.isInteger(child) || child < 0 || child >= nodes.length || parent[child]! >= 0)
        throw new GltfFault("its nodes are no tree");
      parent[child] = i;
    }
  });
  for (let i = 0; i < nodes.length; i++) {
    let depth = 0;
    for (let up = parent[i]!; up >= 0; up = parent[up]!)
      if (++depth > DEPTH_MAX) throw new GltfFault("its nodes are no tree, or too deep a one");
  }
}

// base: where the file comes from; null where it was dropped, and everything must be in it.
function checkAddresses(parts: { uri?: unknown }[], base: URL | null) {
  for (const { uri } of parts) {
    if (uri === undefined) continue;
    if (typeof uri !== "string") throw new GltfFault("an address is damaged");
    if (/^data:/i.test(uri)) continue;
    if (!base) throw new GltfFault(`it needs ${uri.slice(0, 80)} beside it: a .glb holds everything`);
    const { protocol } = new URL(uri, base);
    if (!/^https?:$/.test(protocol)) throw new GltfFault(`it asks for ${uri.slice(0, 80)}`);
  }
}

export function checkGltf(json: unknown, base: URL | null) {
  const gltf = (typeof json === "object" && json !== null ? json : {}) as Gltf;
  const version = String(gltf.asset?.version ?? "");
  if (!/^2\./.test(version)) throw new GltfFault(`glTF of version ${version || "none"}`);
  const required = Array.isArray(gltf.extensionsRequired) ? gltf.extensionsRequired : [];
  const used = Array.isArray(gltf.extensionsUsed) ? gltf.extensionsUsed : [];
  const strange = used.includes(SPLATS) ? SPLATS : required.find((name) => !KNOWN.has(String(name)));
  if (strange) throw new GltfFault(`it needs ${String(strange)}`, String(strange));
  checkSizes(list(gltf.accessors, "accessors") as Accessor[]);
  checkTree(list(gltf.nodes, "nodes") as { children?: unknown }[]);
  list(gltf.meshes, "meshes");
  const parts = [...list(gltf.images, "images"), ...list(gltf.buffers, "buffers")];
  checkAddresses(parts as { uri?: unknown }[], base);
}

// Width and height that a PNG, JPEG or WebP says of itself; null where it is none of them.
export function sizeOfImage(bytes: Uint8Array): [number, number] | null {
  const data = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const tag = (at: number) => String.fromCharCode(...bytes.subarray(at, at + 4));
  if (bytes.length >= 24 && data.getUint32(0) === 0x89504e47)
    return [data.getUint32(16), data.getUint32(20)];
  if (bytes.length >= 30 && tag(0) === "RIFF" && tag(8) === "WEBP") {
    const u24 = (at: number) => data.getUint16(at, true) | (bytes[at + 2]! << 16);
    if (tag(12) === "VP8X") return [u24(24) + 1, u24(27) + 1];
    if (tag(12) === "VP8L") {
      const bits = data.getUint32(21, true);
      return [(bits & 16383) + 1, ((bits >> 14) & 16383) + 1];
    }
    return [data.getUint16(26, true) & 16383, data.getUint16(28, true) & 16383];
  }
  if (bytes.length < 4 || data.getUint16(0) !== 0xffd8) return null;
  for (let at = 2; at + 9 < bytes.length; ) {
    if (bytes[at] !== 0xff) return null;
    const kind = bytes[at + 1]!;
    if (kind >= 0xc0 && kind <= 0xcf && ![0xc4, 0xc8, 0xcc].includes(kind))
      return [data.getUint16(at + 7), data.getUint16(at + 5)];
    at += 2 + data.getUint16(at + 2);
  }
  return null;
}
