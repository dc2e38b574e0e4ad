// Which tiles the web client shows, against tests/vectors/pick.json, which tests/lod/test_pick.c runs
// through the server's level selection (lod/choose/pick.c): 3d-tiles-renderer itself, the version that
// web/ ships, walks a tileset of the same tiles with the same cameras.
//
// Clients of others know boundingVolume alone and measure distance to that box; the server measures to
// the core, where nearly all of a tile is. Where the two are one, both show the same tiles; where the
// core is smaller, the client may show finer ones, never coarser. The viewer measures to the core too (web/src/
// screenerror.ts), which the tileset tells, and shows the same tiles.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { test } from "node:test";

// What the library takes from a browser before anything is drawn.
globalThis.window ??= { location: { href: "http://localhost/" } };
globalThis.requestAnimationFrame ??= (callback) => setTimeout(callback, 0);
globalThis.cancelAnimationFrame ??= (handle) => clearTimeout(handle);

const MODULES = new URL("../../web/node_modules/", import.meta.url);
const { TilesRenderer } = await import(new URL("3d-tiles-renderer/build/index.three.js", MODULES));
const { Group, PerspectiveCamera, Matrix4 } = await import(
    new URL("three/build/three.module.js", MODULES)
);

const SCREEN_ERROR = new URL("../../web/src/screenerror.ts", import.meta.url);
const { code } = createRequire(MODULES)("esbuild").transformSync(readFileSync(SCREEN_ERROR, "utf8"), { loader: "ts" });
const { screenError } = await import(`data:text/javascript,${encodeURIComponent(code)}`);
class CoredTiles extends TilesRenderer {
    calculateTileViewError(tile, target) {
        super.calculateTileViewError(tile, target);
        const [{ position, sseDenominator }] = this.cameraInfo;
        target.error = screenError(tile, position, sseDenominator) ?? target.error;
    }
}

const PX_PER_SIGMA = 16; // errorTarget of a pixel of sigma: web/src/viewer.ts starts with it
const FRAMES_MAX = 200;

const VECTORS = JSON.parse(readFileSync(new URL("../vectors/pick.json", import.meta.url), "utf8"));

const nameOf = ([z, x, y]) => `${z}/${x}/${y}`;
function isBelow([z, x, y], [Z, X, Y]) {
    return z > Z && x >> (z - Z) === X && y >> (z - Z) === Y;
}

// The tileset of a scene, as lod/export/tileset.c writes one: geometric error 0 at leaves, REPLACE.
function makeTileset(rows) {
    const nodes = rows.map((row) => {
        const [lo, hi] = [row.slice(3, 6), row.slice(6, 9)];
        const center = lo.map((v, k) => (v + hi[k]) / 2);
        const half = lo.map((v, k) => (hi[k] - v) / 2);
        return {
            boundingVolume: { box: [...center, half[0], 0, 0, 0, half[1], 0, 0, 0, half[2]] },
            geometricError: row[15],
            extras: { core: row.slice(9, 15) },
            content: { uri: `${nameOf(row)}.splats` },
            children: [],
        };
    });
    rows.forEach((row, i) => {
        if (i === 0) return;
        const above = rows.findLastIndex((other) => isBelow(row, other));
        nodes[above].children.push(nodes[i]);
    });
    for (const node of nodes) if (!node.children.length) node.geometricError = 0;
    nodes[0].refine = "REPLACE";
    return { asset: { version: "1.1" }, geometricError: 4 * rows[0][15], root: nodes[0] };
}

// OpenGL cameras look along -z with y up, those of the vectors along z with y down.
function makeCamera(test, eye) {
    const [width, height] = VECTORS.size_px;
    const fov = (2 * Math.atan(height / 2 / VECTORS.focal_px) * 180) / Math.PI;
    const camera = new PerspectiveCamera(fov, width / height, 0.1, 1e5);
    const r = test.rot;
    const world = new Matrix4().set(
        ...[r[0], -r[3], -r[6], eye[0]],
        ...[r[1], -r[4], -r[7], eye[1]],
        ...[r[2], -r[5], -r[8], eye[2]],
        ...[0, 0, 0, 1],
    );
    world.decompose(camera.position, camera.quaternion, camera.scale);
    camera.updateMatrixWorld();
    return camera;
}

class Client {
    constructor(rows, Tiles = TilesRenderer) {
        const tileset = JSON.stringify(makeTileset(rows));
        this.tiles = new Tiles("http://localhost/tileset.json");
        this.tiles.registerPlugin({
            name: "TEST",
            fetchData: async (url) =>
                url.endsWith(".json") ? new Response(tileset) : new Response(new Uint8Array(4)),
            parseToMesh: async () => new Group(),
        });
    }

    // What stands on the screen once everything that this view asks for is there.
    async shown(test, eye) {
        const { tiles } = this;
        const camera = makeCamera(test, eye);
        tiles.setCamera(camera);
        tiles.setResolution(camera, ...VECTORS.size_px);
        tiles.errorTarget = PX_PER_SIGMA * test.error_px;
        for (let frame = 0, calm = 0; frame < FRAMES_MAX && calm < 3; frame++) {
            tiles.update();
            await new Promise((resolve) => setTimeout(resolve, 0));
            const { queued, downloading, parsing } = tiles.stats;
            calm = tiles.root && queued + downloading + parsing === 0 ? calm + 1 : 0;
        }
        tiles.deleteCamera(camera);
        return [...tiles.visibleTiles].map((tile) => tile.content.uri.match(/\d+\/\d+\/\d+/)[0]);
    }
}

const keyOf = (name) => name.split("/").map(Number);
const clients = Object.fromEntries(
    Object.entries(VECTORS.scenes).map(([name, rows]) => [name, new Client(rows)]),
);
// The client has no budgets of its own in Gaussians or bytes of a view, and one metric.
const comparable = VECTORS.cases
    .map((c, number) => ({ ...c, number }))
    .filter((c) => c.metric === "screen" && !c.max_gaussians && !c.max_bytes);

test("the same tiles where boxes are cores", async () => {
    let count = 0;
    for (const c of comparable.filter(({ scene }) => scene !== "core"))
        for (const [at, want] of [["eye", "picked"], ["then", "picked_then"]]) {
            const shown = await clients[c.scene].shown(c, c[at]);
            assert.deepEqual(shown.sort(), [...c[want]].sort(), `case ${c.number}, ${at}`);
            count += shown.length;
        }
    assert.ok(count > 200, `${count} tiles compared`);
});

test("finer tiles or the same where cores are smaller, and all that the server shows is covered", async () => {
    let finer = 0;
    for (const c of comparable.filter(({ scene }) => scene === "core"))
        for (const [at, want] of [["eye", "picked"], ["then", "picked_then"]]) {
            const shown = (await clients.core.shown(c, c[at])).map(keyOf);
            const picked = c[want].map(keyOf);
            for (const tile of shown) {
                const same = picked.some((p) => nameOf(p) === nameOf(tile));
                const below = picked.some((p) => isBelow(tile, p));
                assert.ok(same || below, `case ${c.number}, ${at}: ${nameOf(tile)} is coarser`);
                finer += below;
            }
            for (const p of picked) {
                const covered = shown.some((t) => nameOf(t) === nameOf(p) || isBelow(t, p));
                assert.ok(covered, `case ${c.number}, ${at}: nothing at ${nameOf(p)}`);
            }
        }
    assert.ok(finer > 0, "no case tells the two distances apart");
});

test("the viewer, by cores: the same tiles, whether boxes are cores or not", async () => {
    const viewers = Object.fromEntries(Object.entries(VECTORS.scenes).map(([name, rows]) => [name, new Client(rows, CoredTiles)]));
    let count = 0;
    for (const c of comparable)
        for (const [at, want] of [["eye", "picked"], ["then", "picked_then"]]) {
            const shown = await viewers[c.scene].shown(c, c[at]);
            assert.deepEqual(shown.sort(), [...c[want]].sort(), `case ${c.number}, ${at}`);
            count += c.scene === "core" ? shown.length : 0;
        }
    assert.ok(count > 100, `${count} tiles compared`);
});

test("cores that are none are passed over", () => {
    const engineData = { transformInverse: new Matrix4() };
    const eye = new PerspectiveCamera().position.set(0, 0, 12);
    const errorOf = (core) => screenError({ geometricError: 8, extras: { core }, engineData }, eye, 0.5);
    assert.equal(errorOf([-1, -1, -1, 1, 1, 4]), 2);
    assert.equal(errorOf([-1, -1, -1, 1, 1, 12]), Infinity);
    for (const core of [undefined, null, "none", [1, 2, 3], [1, 0, 0, 0, 1, 1], [0, 0, 0, 1, 1, null], [0, 0, 0, 1, 1, "1"]])
        assert.equal(errorOf(core), null, JSON.stringify(core));
});

test("the client starts with the error the server starts with", () => {
    const source = readFileSync(new URL("../../web/src/city.ts", import.meta.url), "utf8");
    assert.match(source, new RegExp(`private target = ${PX_PER_SIGMA};`));
});
