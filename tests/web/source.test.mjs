// Where the client takes a scene from (web/src/source.ts), with answers made up here: the network of the
// tileset's own revision, and baked tiles where there is no network to be had.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { test } from "node:test";

import { importSource } from "./lib/bundle.mjs";

const { openScene, useUnfilteredTiles } = await importSource("source.ts");

const NEW = "0123456789ab";
const OLD = "ba9876543210";
const NETWORK = {
    format: "citysplat-appearance-1",
    gaussianLength: 1,
    imageLength: 1,
    hidden: 1,
    weights: Buffer.alloc(4 * 11).toString("base64url"),
    default: Buffer.alloc(4).toString("base64url"),
};

function tilesetOf(tilesetVersion) {
    const transform = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
    const boundingVolume = { box: [0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1] };
    const content = { uri: `r/${tilesetVersion}/t/14/0/0.glb` };
    const children = [{ content: { uri: `r/${tilesetVersion}/t/15/0/0.glb?appearance=none` } }];
    return { asset: { tilesetVersion }, root: { transform, boundingVolume, content, children } };
}

// Opens the scene below `base` whose catalogue is of revision OLD; network: answers by address.
async function open(base, network, more = {}) {
    const asked = [];
    const link = {
        async json(url) {
            asked.push(String(url));
            if (url.pathname.endsWith("tileset.json")) return tilesetOf(NEW);
            const found = network[url.href];
            if (found === undefined) throw new Error(`404 ${url}`);
            return found;
        },
    };
    const entry = {
        attribution: "",
        tileset: new URL("tileset.json", base),
        network: new URL(`r/${OLD}/appearance.json`, base),
        ...more,
    };
    const info = await openScene(link, entry, "dusk", () => true);
    return { asked, info };
}

for (const base of ["http://city.test/d/fcity/", "http://city.test/d/r/", "http://city.test/r/x/d/r/"])
    test(`${base}: the network is that of the tileset's revision`, async () => {
        const { info } = await open(base, { [`${base}r/${NEW}/appearance.json`]: NETWORK });
        assert.equal(info.network?.hidden, 1);
        assert.equal(info.url, `${base}tileset.json?appearance=none`);
        const { content, children } = info.document.root;
        assert.match(content.uri, /\/14\/0\/0\.drc\?preset=preview&sh=0$/); // the draft
        assert.match(children[0].content.uri, /\/15\/0\/0\.drc\?appearance=none$/);
    });

test("a network that is not there or not readable leaves baked tiles", async () => {
    const base = "http://city.test/d/fcity/";
    const own = `${base}r/${NEW}/appearance.json`;
    for (const network of [{}, { [own]: { ...NETWORK, format: "another" } }, { [own]: null }]) {
        const { asked, info } = await open(base, network);
        assert.equal(info.network, null);
        assert.equal(info.url, `${base}tileset.json?appearance=dusk`);
        assert.equal(asked.at(-1), info.url);
        assert.match(info.document.root.content.uri, /\.glb$/);
    }
});

test("packed tiles are asked for where the server has them, with the first one as a draft", async () => {
    const base = "http://city.test/d/fcity/";
    const { info } = await open(base, {}, { packed: true });
    assert.equal(info.network, null);
    assert.match(info.document.root.content.uri, /\/0\.drc\?preset=preview&sh=0$/);
    assert.match(info.document.root.children[0].content.uri, /\.drc\?appearance=none$/);
});

test("a name that the server keeps is asked for, each time; photographs are known", async () => {
    const base = "http://127.0.0.1/d/toy/";
    const own = `${base}r/${NEW}/appearance.json`;
    const one = Buffer.from(Float32Array.of(3).buffer).toString("base64url");
    const table = { embeddings: one, photographs: [{ name: "dawn" }] };
    const kept = `${base}appearance?appearance=evening`;
    const { info, asked } = await open(base, {
        [own]: NETWORK,
        [`${base}r/${NEW}/appearances.json`]: table,
        [kept]: { appearance: "dawn", embedding: [0.25] },
        [`${base}appearance?appearance=wrong`]: { embedding: [1, 2] },
    });
    assert.deepEqual([...(await info.network.find("dawn"))], [1]);
    assert.equal(asked.filter((url) => url.includes("?appearance=")).length, 1); // the tileset
    for (let i = 0; i < 2; i++) assert.deepEqual([...(await info.network.find("evening"))], [0.25]);
    assert.equal(asked.filter((url) => url === kept).length, 2);
    await assert.rejects(info.network.find("wrong"), /no photograph/);
    await assert.rejects(info.network.find("noon"), /404/);
});

test("tiles that another client needs filtered are taken as they are", async () => {
    const leaf = (uri) => ({ geometricError: 4, content: { uri: `${uri}.lowpass.glb?sh=0` }, children: [{ geometricError: 0, content: { uri: `${uri}.glb?sh=0` } }] });
    const document = { root: { geometricError: 9, content: { uri: "0.lowpass.glb?sh=0" }, children: [leaf("1"), leaf("2")] } };
    useUnfilteredTiles(document);
    const plain = (uri) => ({ geometricError: 0, content: { uri: `${uri}.glb?sh=0` } });
    assert.deepEqual(document.root, { geometricError: 9, content: { uri: "0.glb?sh=0" }, children: [plain("1"), plain("2")] });
    const before = structuredClone(document);
    useUnfilteredTiles(document); // a tileset without them stays as it is
    assert.deepEqual(document, before);
});

test("what is saved says what its heights count from, as the scene does", async () => {
    const measures = await importSource("measure.ts"), profiles = await importSource("profile.ts");
    const at = (lat) => ({ lon: 7.5, lat, h: 300, distance: lat });
    const way = [at(47.5), at(47.6)];
    const values = { length: 1, straight: 1, rise: 0, area: 0 };
    for (const text of [measures.toGeoJson(way, "path", values, "EPSG:7837"), profiles.toGeoJson(way, "EPSG:7837")]) {
        const [{ geometry, properties }] = JSON.parse(text).features;
        assert.equal(properties.heights, "EPSG:7837");
        assert.equal(geometry.coordinates.flat(2)[2], 300);
    }
});

test("a tileset alone says what its heights count from", async () => {
    for (const [verticalDatum, heights] of [
        [undefined, "ellipsoid"],
        ["WGS 84 ellipsoid", "ellipsoid"],
        ["sea level by EXIF (no geoid known)", "sea"],
        ["NAP", "unknown"],
    ]) {
        const document = tilesetOf(NEW);
        document.asset.extras = { verticalDatum };
        const entry = { attribution: "", tileset: new URL("http://city.test/city/tileset.json"), network: null, catalogue: null, heights: "ellipsoid" };
        await openScene({ json: async () => document }, entry, "", () => true);
        assert.equal(entry.heights, heights);
    }
});

test("where most Gaussians are is taken from documents where it is in the box of all", async () => {
    const { Extent } = await importSource("extent.ts");
    const { Frame } = await importSource("geo.ts");
    const tile = { min: [-0.9, -0.7, -0.9], max: [0.9, 0.5, 0.9], outline: [0, 0, 1, 0, 1, 1, 0, 1] };
    const boxOf = async (extent) => {
        const document = tilesetOf(NEW);
        document.root.extras = { extent };
        document.root.transform[12] = 6378137; // on the equator: east, north and up are y, z and x of ECEF
        document.root.transform.splice(0, 12, 0, 1, 0, 0, 0, 0, 1, 0, 1, 0, 0, 0);
        const entry = { attribution: "", tileset: new URL("http://city.test/city/tileset.json"), network: null, catalogue: null, heights: "" };
        const info = await openScene({ json: async () => document }, entry, "", () => true);
        const { min, max } = new Extent(info, new Frame(info.transform)).add(tile).box;
        return [min.x, min.y, min.z, max.x, max.y, max.z].map((v) => Math.round(1e6 * v) / 1e6 + 0);
    };
    // x east, y up, z south; heights are the tile's
    assert.deepEqual(await boxOf([-0.5, -0.4, -1, 0.6, 0.3, 1]), [-0.5, -0.7, -0.3, 0.6, 0.5, 0.4]);
    const measured = [-0.9, -0.7, -0.9, 0.9, 0.5, 0.9];
    for (const none of [undefined, [7.5, 47.5, 7.6, 47.6, 250, 300], [1, 2, 3], "all"]) assert.deepEqual(await boxOf(none), measured);
});
