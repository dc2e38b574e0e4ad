// Binary glTF with one Gaussian primitive and an SPZ payload: written for the mock server, taken
// apart for the checks of served tiles.
//
// SPDX-License-Identifier: Apache-2.0

export const EXT = "KHR_gaussian_splatting";
export const EXT_SPZ = "KHR_gaussian_splatting_compression_spz_2";
const JSON_CHUNK = 0x4e4f534a;
const BIN_CHUNK = 0x004e4942;

function chunk(type, bytes, pad) {
    const size = Math.ceil(bytes.length / 4) * 4;
    const head = Buffer.alloc(8);
    head.writeUInt32LE(size, 0);
    head.writeUInt32LE(type, 4);
    return Buffer.concat([head, bytes, Buffer.alloc(size - bytes.length, pad)]);
}

// spz bytes -> glb. min/max are bounds of the dequantised positions in glTF axes.
export function encodeGlb(spz, count, shDegree, min, max) {
    const attributes = { POSITION: 0, COLOR_0: 1, [`${EXT}:SCALE`]: 2, [`${EXT}:ROTATION`]: 3 };
    const accessors = [
        { componentType: 5126, count, type: "VEC3", min, max },
        { componentType: 5121, normalized: true, count, type: "VEC4" },
        { componentType: 5126, count, type: "VEC3" },
        { componentType: 5126, count, type: "VEC4" },
    ];
    for (let l = 1; l <= shDegree; l++) {
        for (let n = 0; n <= 2 * l; n++) {
            attributes[`${EXT}:SH_DEGREE_${l}_COEF_${n}`] = accessors.length;
            accessors.push({ componentType: 5126, count, type: "VEC3" });
        }
    }
    const extension = {
        kernel: "ellipse",
        colorSpace: "srgb_rec709_display",
        sortingMethod: "cameraDistance",
        projection: "perspective",
        extensions: { [EXT_SPZ]: { bufferView: 0 } },
    };
    const gltf = {
        asset: { version: "2.0", generator: "citysplat tests" },
        extensionsUsed: [EXT, EXT_SPZ],
        extensionsRequired: [EXT, EXT_SPZ],
        scene: 0,
        scenes: [{ nodes: [0] }],
        nodes: [{ mesh: 0 }],
        meshes: [{ primitives: [{ mode: 0, attributes, extensions: { [EXT]: extension } }] }],
        accessors,
        bufferViews: [{ buffer: 0, byteLength: spz.length }],
        buffers: [{ byteLength: spz.length }],
    };
    const body = Buffer.concat([
        chunk(JSON_CHUNK, Buffer.from(JSON.stringify(gltf)), 0x20),
        chunk(BIN_CHUNK, spz, 0),
    ]);
    const head = Buffer.alloc(12);
    head.write("glTF", 0, "latin1");
    head.writeUInt32LE(2, 4);
    head.writeUInt32LE(12 + body.length, 8);
    return Buffer.concat([head, body]);
}

// glb -> { json, bin }. Throws on anything that is not exactly header + JSON chunk + BIN chunk.
export function decodeGlb(bytes) {
    if (bytes.toString("latin1", 0, 4) !== "glTF" || bytes.readUInt32LE(4) !== 2) {
        throw new Error("glb: bad header");
    }
    if (bytes.readUInt32LE(8) !== bytes.length) throw new Error("glb: wrong length");
    const jsonSize = bytes.readUInt32LE(12);
    if (bytes.readUInt32LE(16) !== JSON_CHUNK) throw new Error("glb: no JSON chunk");
    const json = JSON.parse(bytes.toString("utf8", 20, 20 + jsonSize));
    const at = 20 + jsonSize;
    if (bytes.readUInt32LE(at + 4) !== BIN_CHUNK) throw new Error("glb: no BIN chunk");
    const bin = bytes.subarray(at + 8, at + 8 + bytes.readUInt32LE(at));
    if (at + 8 + bin.length !== bytes.length) throw new Error("glb: bytes after the BIN chunk");
    return { json, bin };
}

// The .spz inside a splat glb.
export function findSpz(bytes) {
    const { json, bin } = decodeGlb(bytes);
    const view = json.meshes[0].primitives[0].extensions[EXT].extensions[EXT_SPZ].bufferView;
    const { byteOffset = 0, byteLength } = json.bufferViews[view];
    return bin.subarray(byteOffset, byteOffset + byteLength);
}
