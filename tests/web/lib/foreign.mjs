// Somebody else's file server, and what may lie on it: a box as binary glTF and as 3D Tiles, and files
// that are not what they say.
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

// A box of one colour, in glTF's axes; edit: changes the JSON before it is written.
export function makeBoxGlb(half, rgb, edit = () => {}) {
    const positions = new Float32Array(CORNERS.flatMap((p) => p.map((v, i) => v * half[i])));
    const index = new Uint16Array(SIDES);
    const bin = Buffer.concat([Buffer.from(positions.buffer), Buffer.from(index.buffer)]);
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
            { buffer: 0, byteOffset: 0, byteLength: 96 },
            { buffer: 0, byteOffset: 96, byteLength: 2 * SIDES.length },
        ],
        buffers: [{ byteLength: bin.length }],
    };
    edit(json);
    const pad = (bytes, fill) => Buffer.concat([bytes, Buffer.alloc((4 - (bytes.length % 4)) % 4, fill)]);
    const parts = [
        [0x4e4f534a, pad(Buffer.from(JSON.stringify(json)), 0x20)],
        [0x004e4942, pad(bin, 0)],
    ];
    const head = (...words) => Buffer.from(new Uint32Array(words).buffer);
    const chunks = parts.flatMap(([type, body]) => [head(body.length, type), body]);
    const length = 12 + chunks.reduce((sum, one) => sum + one.length, 0);
    return Buffer.concat([head(0x46546c67, 2, length), ...chunks]);
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
