// Somebody else's file server, and what may lie on it: a box as binary glTF, plain and compressed, and
// as 3D Tiles, and files that are not what they say.
//
// SPDX-License-Identifier: Apache-2.0
import { createServer } from "node:http";

const CORNERS = [-1, 1].flatMap((x) => [-1, 1].flatMap((y) => [-1, 1].map((z) => [x, y, z])));
// Two triangles a side, corners numbered as above.
const SIDES = [
    [0, 1, 3, 2],
    [4, 6, 7, 5],
    [0, 4, 5, 1],
    [2, 3, 7, 6],
    [0, 2, 6, 4],
    [1, 5, 7, 3],
].flatMap(([a, b, c, d]) => [a, b, c, a, c, d]);

const HEAD_B3DM = 28;
const pad = (bytes, fill) => Buffer.concat([bytes, Buffer.alloc((4 - (bytes.length % 4)) % 4, fill)]);
const words = (...all) => Buffer.from(new Uint32Array(all).buffer);

function writeGlb(json, bin) {
    const parts = [
        [0x4e4f534a, pad(Buffer.from(JSON.stringify(json)), 0x20)],
        [0x004e4942, pad(bin, 0)],
    ];
    const chunks = parts.flatMap(([type, body]) => [words(body.length, type), body]);
    const length = 12 + chunks.reduce((sum, one) => sum + one.length, 0);
    return Buffer.concat([words(0x46546c67, 2, length), ...chunks]);
}

// A box of one colour, in glTF's axes.
function describeBox(half, rgb) {
    const positions = new Float32Array(CORNERS.flatMap((p) => p.map((v, i) => v * half[i])));
    const index = new Uint16Array(SIDES);
    const json = {
        asset: { version: "2.0" },
        extensionsUsed: ["KHR_materials_unlit"],
        scene: 0,
        scenes: [{ nodes: [0] }],
        nodes: [{ mesh: 0 }],
        meshes: [{ primitives: [{ attributes: { POSITION: 0 }, indices: 1, material: 0 }] }],
        materials: [
            {
                doubleSided: true,
                pbrMetallicRoughness: { baseColorFactor: [...rgb, 1] },
                extensions: { KHR_materials_unlit: {} },
            },
        ],
        accessors: [
            {
                bufferView: 0,
                componentType: 5126,
                count: 8,
                type: "VEC3",
                min: half.map((v) => -v),
                max: half,
            },
            { bufferView: 1, componentType: 5123, count: SIDES.length, type: "SCALAR" },
        ],
        bufferViews: [
            { buffer: 0, byteOffset: 0, byteLength: positions.byteLength },
            { buffer: 0, byteOffset: positions.byteLength, byteLength: index.byteLength },
        ],
        buffers: [{ byteLength: positions.byteLength + index.byteLength }],
    };
    return { json, positions, index };
}

function needs(json, extension) {
    json.extensionsUsed.push(extension);
    json.extensionsRequired = [extension];
}

// edit: changes the JSON before it is written.
export function makeBoxGlb(half, rgb, edit = () => {}) {
    const { json, positions, index } = describeBox(half, rgb);
    edit(json);
    return writeGlb(json, Buffer.concat([Buffer.from(positions.buffer), Buffer.from(index.buffer)]));
}

// With KHR_draco_mesh_compression; draco: the module of draco3d's createEncoderModule.
export function makeDracoBox(draco, half, rgb) {
    const { json, positions, index } = describeBox(half, rgb);
    const [encoder, builder, mesh, out] = ["Encoder", "MeshBuilder", "Mesh", "DracoInt8Array"].map(
        (name) => new draco[name](),
    );
    builder.AddFacesToMesh(mesh, index.length / 3, index);
    const id = builder.AddFloatAttributeToMesh(mesh, draco.POSITION, positions.length / 3, 3, positions);
    encoder.SetAttributeQuantization(draco.POSITION, 12);
    const length = encoder.EncodeMeshToDracoBuffer(mesh, out);
    const bin = Buffer.from(Array.from({ length }, (_, i) => out.GetValue(i) & 255));
    [encoder, builder, mesh, out].forEach((object) => draco.destroy(object));
    const name = "KHR_draco_mesh_compression";
    needs(json, name);
    json.meshes[0].primitives[0].extensions = { [name]: { bufferView: 0, attributes: { POSITION: id } } };
    for (const accessor of json.accessors) delete accessor.bufferView;
    json.bufferViews = [{ buffer: 0, byteOffset: 0, byteLength: length }];
    json.buffers = [{ byteLength: length }];
    return writeGlb(json, bin);
}

// With EXT_meshopt_compression; encoder: meshoptimizer's, ready.
export function makeMeshoptBox(encoder, half, rgb) {
    const { json, positions, index } = describeBox(half, rgb);
    const parts = [
        [positions, positions.length / 3, 12, "ATTRIBUTES"],
        [index, index.length, 2, "TRIANGLES"],
    ];
    const name = "EXT_meshopt_compression";
    needs(json, name);
    let bin = Buffer.alloc(0);
    parts.forEach(([array, count, byteStride, mode], i) => {
        const bytes = encoder.encodeGltfBuffer(new Uint8Array(array.buffer), count, byteStride, mode);
        const at = { buffer: 0, byteOffset: bin.length, byteLength: bytes.length };
        json.bufferViews[i] = {
            ...json.bufferViews[i],
            ...(mode === "ATTRIBUTES" && { byteStride }),
            buffer: 1,
            extensions: { [name]: { ...at, byteStride, count, mode } },
        };
        bin = pad(Buffer.concat([bin, bytes]), 0);
    });
    const [{ byteLength }] = json.buffers;
    json.buffers = [{ byteLength: bin.length }, { byteLength, extensions: { [name]: { fallback: true } } }];
    return writeGlb(json, bin);
}

// A batched model of 3D Tiles 1.0, without batches.
export function makeB3dm(glb) {
    let table = '{"BATCH_LENGTH":0}';
    table = table.padEnd(8 * Math.ceil((HEAD_B3DM + table.length) / 8) - HEAD_B3DM);
    const length = HEAD_B3DM + table.length + glb.length;
    return Buffer.concat([Buffer.from("b3dm"), words(1, length, table.length, 0, 0, 0), Buffer.from(table), glb]);
}

// One tile that is a box; transform: from its metres to ECEF.
export function makeBoxTileset(uri, half, transform) {
    const tile = {
        boundingVolume: { box: [0, 0, 0, half[0], 0, 0, 0, half[1], 0, 0, 0, half[2]] },
        geometricError: 0,
        refine: "REPLACE",
        ...(transform ? { transform } : {}),
        content: { uri },
    };
    return { asset: { version: "1.1" }, geometricError: 100, root: tile };
}

// files: { "/path": { body, cors, status } }. { url, asked, close }.
export async function openForeign(files) {
    const asked = [];
    const server = createServer((request, response) => {
        const path = request.url.split("?")[0];
        asked.push(path);
        const { body, cors = true, status = 200 } = files[path] ?? { status: 404, body: "no" };
        response.writeHead(status, cors ? { "access-control-allow-origin": "*" } : {});
        response.end(typeof body === "string" || Buffer.isBuffer(body) ? body : JSON.stringify(body));
    });
    await new Promise((done) => server.listen(0, "127.0.0.1", done));
    const close = () => {
        server.closeAllConnections();
        return new Promise((done) => server.close(done));
    };
    return { url: `http://127.0.0.1:${server.address().port}`, asked, close };
}
