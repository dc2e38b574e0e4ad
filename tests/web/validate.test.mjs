// Every served glTF tile through Khronos' validator and through the rules that Cesium, ArcGIS and
// our own client need; the tileset document through the rules of 3D Tiles 1.1; the style through
// MapLibre's own validator.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { createRequire } from "node:module";
import { after, before, test } from "node:test";

import { validateStyleMin } from "@maplibre/maplibre-gl-style-spec";

import { makeCity } from "./lib/city.mjs";
import { decodeGlb, EXT, EXT_SPZ, findSpz } from "./lib/glb.mjs";
import { firstDataSet, getBytes, getJson, GIVEN_TILES, MOCK, openSource } from "./lib/source.mjs";
import { decodeSpz } from "./lib/spz.mjs";
import { checkTileset, listContents } from "./lib/tileset.mjs";

const validator = createRequire(import.meta.url)("gltf-validator");
// The validator predates the extension: it refuses the colon in the names that the extension gives to attributes, says that
// it does not know the extension, and sees SPZ's buffer view, which only the extension names, as unused. Anything else is ours.
const OWN = {
    MESH_PRIMITIVE_INVALID_ATTRIBUTE: ({ pointer }) => pointer.includes(`/attributes/${EXT}:`),
    UNSUPPORTED_EXTENSION: ({ message }) => message.includes(`'${EXT}`),
    UNUSED_OBJECT: ({ pointer }, form) => form === "glb" && pointer === "/bufferViews/0",
};
const FORMS = MOCK ? ["glb"] : ["glb", "plain.glb"];
const POSITION_TOLERANCE_M = 1 / 4096; // one step of the fixed-point positions

let source;
let tilesetUrl;
let tileset;
let tiles;
before(async () => {
    source = await openSource();
    tilesetUrl = `${source.url}/d/${await firstDataSet(source.url)}/tileset.json`;
    tileset = await getJson(tilesetUrl);
    tiles = [];
    for (const content of await listContents(tilesetUrl, getJson)) {
        tiles.push({ ...content, bytes: await getBytes(content.url) });
    }
});
after(() => source?.close());

test("tileset.json keeps the rules", () => {
    assert.deepEqual(checkTileset(tileset), []);
});

test("MapLibre's validator has nothing against style.json", { skip: MOCK }, async () => {
    const style = await getJson(tilesetUrl.replace("tileset.json", "style.json"));
    assert.deepEqual(validateStyleMin(style), []);
    // it does see what is wrong
    assert.equal(validateStyleMin({ ...style, terrain: { source: 1 } }).length, 1);
});

test("the glTF validator finds only what it cannot know, in every form", async (t) => {
    assert.ok(tiles.length > 0);
    for (const form of FORMS) {
        for (const tile of tiles) {
            const url = tile.url.replace(/\.glb/, `.${form}`);
            const bytes = form === "glb" ? tile.bytes : await getBytes(url);
            const report = await validator.validateBytes(new Uint8Array(bytes), { maxIssues: 1000 });
            const bad = report.issues.messages.filter((message) => !OWN[message.code]?.(message, form));
            const colon = report.issues.messages.filter((m) => m.code === "MESH_PRIMITIVE_INVALID_ATTRIBUTE");
            const names = Object.keys(decodeGlb(bytes).json.meshes[0].primitives[0].attributes);
            assert.deepEqual(bad, [], url);
            assert.equal(colon.length, names.filter((n) => n.includes(":")).length, url);
        }
        t.diagnostic(`${tiles.length} tiles as .${form}`);
    }
});

function attributeNames(shDegree) {
    const names = ["COLOR_0", "POSITION", `${EXT}:ROTATION`, `${EXT}:SCALE`];
    for (let l = 1; l <= shDegree; l++) {
        for (let n = 0; n <= 2 * l; n++) names.push(`${EXT}:SH_DEGREE_${l}_COEF_${n}`);
    }
    return names.sort();
}

test("each tile has the one form that every client draws", () => {
    for (const { url, bytes } of tiles) {
        const { json } = decodeGlb(bytes);
        const spz = decodeSpz(findSpz(bytes));
        for (const list of [json.extensionsUsed, json.extensionsRequired]) {
            assert.deepEqual([...list].sort(), [EXT, EXT_SPZ], url);
        }
        assert.deepEqual(json.scenes, [{ nodes: [0] }], url);
        assert.equal(json.nodes.length, 1, url);
        for (const key of ["translation", "rotation", "scale"])
            assert.equal(json.nodes[0][key], undefined, url);
        const primitive = json.meshes[0].primitives[0];
        assert.equal(primitive.mode, 0, url);
        assert.deepEqual(
            Object.keys(primitive.attributes).sort(),
            attributeNames(spz.shDegree),
            url,
        );
        for (const accessor of json.accessors) {
            assert.equal(accessor.count, spz.count, url);
            assert.equal(accessor.bufferView, undefined, url);
        }
        const extension = primitive.extensions[EXT];
        assert.equal(extension.kernel, "ellipse", url);
        assert.equal(extension.colorSpace, "srgb_rec709_display", url);
    }
});

test("bounds are those of the Gaussians", () => {
    for (const { url, bytes, tile } of tiles) {
        const { json } = decodeGlb(bytes);
        const { position, count, fractionBits } = decodeSpz(findSpz(bytes));
        const { min, max } = json.accessors[json.meshes[0].primitives[0].attributes.POSITION];
        const lo = [Infinity, Infinity, Infinity];
        const hi = [-Infinity, -Infinity, -Infinity];
        for (let i = 0; i < 3 * count; i++) {
            const v = position[i] * 2 ** -fractionBits;
            lo[i % 3] = Math.min(lo[i % 3], v);
            hi[i % 3] = Math.max(hi[i % 3], v);
        }
        for (let k = 0; k < 3; k++) {
            assert.ok(
                Math.abs(min[k] - lo[k]) <= POSITION_TOLERANCE_M,
                `${url}: min ${min}, have ${lo}`,
            );
            assert.ok(
                Math.abs(max[k] - hi[k]) <= POSITION_TOLERANCE_M,
                `${url}: max ${max}, have ${hi}`,
            );
        }
        const { box } = tile.boundingVolume;
        if (!box) continue;
        // glTF (x, y, z) is (east, up, -north) of the tile's frame.
        const inside = (axis, low, high) => {
            const half =
                Math.abs(box[3 + axis]) + Math.abs(box[6 + axis]) + Math.abs(box[9 + axis]);
            return (
                low >= box[axis] - half - POSITION_TOLERANCE_M &&
                high <= box[axis] + half + POSITION_TOLERANCE_M
            );
        };
        assert.ok(inside(0, lo[0], hi[0]), `${url}: east outside its box`);
        assert.ok(inside(1, -hi[2], -lo[2]), `${url}: north outside its box`);
        assert.ok(inside(2, lo[1], hi[1]), `${url}: up outside its box`);
    }
});

test("one degree of harmonics and one antialiasing flag in the whole tileset", () => {
    const kinds = new Set(
        tiles.map(({ bytes }) => {
            const { shDegree, antialiased } = decodeSpz(findSpz(bytes));
            return `degree ${shDegree}, antialiased ${antialiased}`;
        }),
    );
    assert.equal(kinds.size, 1, [...kinds].join("; "));
});

test(
    "the leaves hold every Gaussian once",
    { skip: GIVEN_TILES ? "needs the test city" : false },
    () => {
        const leaves = tiles.filter(({ tile }) => !tile.children?.length);
        const sum = leaves.reduce((n, { bytes }) => n + decodeSpz(findSpz(bytes)).count, 0);
        assert.equal(sum, makeCity().length);
    },
);
