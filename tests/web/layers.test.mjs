// Layers of others over the city: models, 3D Tiles and GeoJSON, by address and from files. They stand
// where they should, hide behind the city, stay in the link, go away, and what is broken or hostile is
// named and harms nothing.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { after, afterEach, before, test } from "node:test";
import { pathToFileURL } from "node:url";

import { barePicture, closeAll, nextFrames, openPage, openViewer, waitForViewer } from "./lib/browser.mjs";
import { importSource } from "./lib/bundle.mjs";
import { measureContent, SOUTH } from "./lib/checks.mjs";
import { ORIGIN, RED_TOP } from "./lib/city.mjs";
import {
    makeB3dm,
    makeBoxGlb,
    makeBoxTileset,
    makeDracoBox,
    makeMeshoptBox,
    openForeign,
} from "./lib/foreign.mjs";
import { enuToEcef, placeOfEnu, project } from "./lib/geo.mjs";
import { GIVEN_TILES, openSource } from "./lib/source.mjs";

const SIZE = { width: 800, height: 520 };
const skip = { skip: GIVEN_TILES ? "needs the test city" : false };
const AXE = readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");
const CYAN = [0, 1, 1];
const HALF = [5, 6, 5]; // of the box: east, up, south
const OPEN_GROUND = [25, -45, 6]; // its middle, nothing in front
const BEHIND_TOWER = [0, 22, 6]; // behind the blue tower, seen from the south

// The encoders that others pack their models with.
async function packedBoxes() {
    const draco = await createRequire(import.meta.url)("draco3d").createEncoderModule({});
    const own = createRequire(new URL("../../web/package.json", import.meta.url));
    const { MeshoptEncoder } = await import(pathToFileURL(own.resolve("meshoptimizer")));
    await MeshoptEncoder.ready;
    return {
        "/draco.glb": { body: makeDracoBox(draco, HALF, CYAN) },
        "/meshopt.glb": { body: makeMeshoptBox(MeshoptEncoder, HALF, CYAN) },
    };
}

let source;
let foreign;
let viewer;
let page;
before(async () => {
    if (skip.skip) return;
    source = await openSource();
    const box = makeBoxGlb(HALF, CYAN);
    const far = enuToEcef(placeOfEnu(ORIGIN, OPEN_GROUND));
    const long = (json) => (json.accessors[0].count = 2 ** 30);
    const ring = (json) => (json.nodes = [{ mesh: 0, children: [1] }, { children: [0] }]);
    const beside = (json) => (json.images = [{ uri: "elsewhere.png" }]);
    const splats = (json) => json.extensionsUsed.push("KHR_gaussian_splatting");
    const strange = (json) => (json.extensionsRequired = ["ACME_magic"]);
    const nowhere = (json) => (json.meshes[0].primitives[0].attributes.POSITION = 7);
    const ktx2 = (json) => (json.extensionsRequired = ["KHR_texture_basisu"]);
    const ecef = far.slice(12, 15);
    const earth = (json) => (json.nodes[0].translation = [ecef[0], ecef[2], -ecef[1]]);
    const rtc = (json) => {
        json.extensions = { CESIUM_RTC: { center: ecef } };
        json.extensionsRequired = ["CESIUM_RTC"];
    };
    const packed = await packedBoxes();
    const cut = packed["/draco.glb"].body.subarray(0, -24);
    foreign = await openForeign({
        ...packed,
        "/box.glb": { body: box },
        "/box.b3dm": { body: makeB3dm(packed["/draco.glb"].body) },
        "/old/tileset.json": { body: makeBoxTileset("../box.b3dm", [HALF[0], HALF[2], HALF[1]], far) },
        "/ktx2.glb": { body: makeBoxGlb(HALF, CYAN, ktx2) },
        "/cut-draco.glb": { body: Buffer.concat([cut, Buffer.alloc(24)]) },
        "/tiles/tileset.json": { body: makeBoxTileset("../box.glb", [HALF[0], HALF[2], HALF[1]], far) },
        "/adrift/tileset.json": { body: makeBoxTileset("../box.glb", HALF, null) },
        "/broken/tileset.json": { body: makeBoxTileset("none.glb", [5, 5, 6], far) },
        "/mad/tileset.json": {
            body: { asset: { version: "1.1" }, geometricError: 1, root: { transform: "x", children: 7 } },
        },
        "/earth.glb": { body: makeBoxGlb(HALF, CYAN, earth) },
        "/rtc.glb": { body: makeBoxGlb(HALF, CYAN, rtc) },
        "/closed.glb": { body: box, cors: false },
        "/page.glb": { body: "<!doctype html><title>Sign in</title>" },
        "/cut.glb": { body: box.subarray(0, 700) },
        "/long.glb": { body: makeBoxGlb(HALF, CYAN, long) },
        "/ring.glb": { body: makeBoxGlb(HALF, CYAN, ring) },
        "/beside.glb": { body: makeBoxGlb(HALF, CYAN, beside) },
        "/splats.glb": { body: makeBoxGlb(HALF, CYAN, splats) },
        "/strange.glb": { body: makeBoxGlb(HALF, CYAN, strange) },
        "/nowhere.glb": { body: makeBoxGlb(HALF, CYAN, nowhere) },
        "/cut.geojson": { body: '{"type": "Feature", ' },
        "/metres.geojson": { body: { type: "Point", coordinates: [500000, 5700000] } },
        "/refused.glb": { body: "no", status: 403 },
    });
    viewer = await openViewer(source.url, SIZE, SOUTH);
    page = viewer.page;
});
after(() => closeAll(viewer, source, foreign));
afterEach(async () => {
    if (page)
        await page.evaluate(() => {
            const { layers } = window.citysplat.viewer;
            for (const { id } of layers.list) layers.remove(id);
        });
});

const list = () => page.evaluate(() => window.citysplat.viewer.layers.list);
const standing = (enu) => ({ ...placeOfEnu(ORIGIN, enu), heading: 0, scale: 1 });

// Of the list afterwards: the last one, shown or failed.
async function add(options) {
    await page.evaluate((o) => window.citysplat.viewer.layers.add(o).catch(() => {}), options);
    await page.waitForFunction(() => !window.citysplat.viewer.layers.loading);
    await nextFrames(page);
    return (await list()).at(-1);
}

async function cyan() {
    const png = await barePicture(page);
    let [n, x0, y0] = [0, 0, 0];
    for (let y = 0; y < png.height; y++)
        for (let x = 0; x < png.width; x++) {
            const [r, g, b] = png.at(x, y);
            if (r < 70 && g > 190 && b > 190) [n, x0, y0] = [n + 1, x0 + x, y0 + y];
        }
    return { n, x: x0 / n, y: y0 / n };
}

function nearTo({ n, x, y }, enu) {
    const want = project(ORIGIN, SOUTH, enu, SIZE.width, SIZE.height);
    assert.ok(n > 300, `${n} pixels of the box`);
    const off = Math.hypot(x - want[0], y - want[1]);
    assert.ok(off < 5, `${off.toFixed(1)} px beside ${want.map(Math.round)}`);
}

test("a model stands where it is told to, and hides behind the city", skip, async (t) => {
    const layer = await add({ url: `${foreign.url}/box.glb`, place: standing(OPEN_GROUND) });
    assert.deepEqual([layer.kind, layer.state, layer.name], ["model", "shown", "box.glb"]);
    const open = await cyan();
    nearTo(open, OPEN_GROUND);
    const [x, y] = project(ORIGIN, SOUTH, [OPEN_GROUND[0], OPEN_GROUND[1], 12], SIZE.width, SIZE.height);
    const top = await page.evaluate(([a, b]) => window.citysplat.viewer.pick(a, b).h, [x, y]);
    assert.ok(Math.abs(top - (ORIGIN.h + 12)) < 1.5, `a click on its top says ${top} m`);
    const to = standing(BEHIND_TOWER);
    await page.evaluate(([id, place]) => window.citysplat.viewer.layers.change(id, { place }), [layer.id, to]);
    await nextFrames(page);
    const behind = await cyan();
    t.diagnostic(`${open.n} pixels in the open, ${behind.n} behind the tower`);
    assert.ok(behind.n < 0.35 * open.n, `${behind.n} of ${open.n} pixels are seen through the tower`);
});

test("3D Tiles stand where their transform says, and can be raised and hidden", skip, async () => {
    const layer = await add({ url: `${foreign.url}/tiles/tileset.json` });
    assert.deepEqual([layer.kind, layer.state, layer.why, layer.name], ["tiles", "shown", "", "tiles"]);
    await page.waitForFunction(() => !window.citysplat.viewer.layers.loading);
    nearTo(await cyan(), OPEN_GROUND);
    const change = (how) =>
        page.evaluate(([id, c]) => window.citysplat.viewer.layers.change(id, c), [layer.id, how]);
    await change({ up: 15 });
    await nextFrames(page);
    nearTo(await cyan(), [OPEN_GROUND[0], OPEN_GROUND[1], OPEN_GROUND[2] + 15]);
    await change({ visible: false });
    await nextFrames(page);
    assert.equal((await cyan()).n, 0);
});

test("a model in coordinates of the earth stands where these say", skip, async () => {
    for (const name of ["earth.glb", "rtc.glb"]) {
        const layer = await add({ url: `${foreign.url}/${name}` });
        assert.deepEqual([layer.state, layer.why, layer.place], ["shown", "", null], name);
        nearTo(await cyan(), OPEN_GROUND);
        await page.evaluate((id) => window.citysplat.viewer.layers.remove(id), layer.id);
    }
});

test("compressed models and batched tiles of 3D Tiles 1.0 stand like plain ones", skip, async () => {
    for (const name of ["draco.glb", "meshopt.glb"]) {
        const layer = await add({ url: `${foreign.url}/${name}`, place: standing(OPEN_GROUND) });
        assert.deepEqual([layer.kind, layer.state, layer.why], ["model", "shown", ""], name);
        nearTo(await cyan(), OPEN_GROUND);
        await page.evaluate((id) => window.citysplat.viewer.layers.remove(id), layer.id);
    }
    const layer = await add({ url: `${foreign.url}/old/tileset.json` });
    assert.deepEqual([layer.kind, layer.state, layer.why], ["tiles", "shown", ""]);
    await page.waitForFunction(() => !window.citysplat.viewer.layers.loading);
    nearTo(await cyan(), OPEN_GROUND);
});

test("GeoJSON without heights lies on the roofs, and above them where it is told to stand", skip, async () => {
    const at = (e, n) => {
        const { lon, lat } = placeOfEnu(ORIGIN, [RED_TOP[0] + e, RED_TOP[1] + n, 0]);
        return [lon, lat];
    };
    const ring = [at(-6, -6), at(6, -6), at(6, 6), at(-6, 6), at(-6, -6)];
    const hole = [at(-2, -2), at(-2, 2), at(2, 2), at(2, -2), at(-2, -2)];
    const feature = {
        type: "Feature",
        properties: { name: "the roof", color: "#00ffff" },
        geometry: { type: "Polygon", coordinates: [ring, hole] },
    };
    const roof = project(ORIGIN, SOUTH, [RED_TOP[0] + 4, RED_TOP[1] - 4, RED_TOP[2] + 0.5], SIZE.width, SIZE.height);
    const middle = project(ORIGIN, SOUTH, [RED_TOP[0], RED_TOP[1], RED_TOP[2] + 0.5], SIZE.width, SIZE.height);
    const before = await barePicture(page);
    const bluer = async (p) => {
        const png = await barePicture(page);
        const [now, old] = [png, before].map((one) => one.mean(p[0], p[1], 1));
        return now[2] - old[2];
    };
    const box = page.locator("#layer-file");
    await box.setInputFiles({
        name: "roof.geojson",
        mimeType: "application/geo+json",
        buffer: Buffer.from(JSON.stringify(feature)),
    });
    await page.waitForFunction(() => window.citysplat.viewer.layers.list[0]?.state === "shown");
    await nextFrames(page);
    const [layer] = await list();
    assert.deepEqual([layer.kind, layer.drape, layer.url], ["geojson", true, null]);
    assert.ok((await bluer(roof)) > 40, "nothing lies on the roof");
    assert.ok(Math.abs(await bluer(middle)) < 12, "the hole is filled");
    assert.equal(await page.textContent(".citysplat-label"), "the roof");
    await page.click("#layers .how input[type=checkbox]"); // not laid onto the city
    await nextFrames(page);
    assert.ok(Math.abs(await bluer(roof)) < 12, "it is still on the roof");
});

test("layers by address are in the link, those from files are not, and both can be removed", skip, async () => {
    await page.evaluate(() => void (document.getElementById("layers-box").open = true));
    const { lon, lat, h } = placeOfEnu(ORIGIN, OPEN_GROUND);
    await page.fill("#layer-url", `${foreign.url}/box.glb#at=${lon},${lat},${h},30,1`);
    await page.press("#layer-url", "Enter");
    await page.waitForFunction(() => window.citysplat.viewer.layers.list[0]?.state === "shown");
    await page.locator("#layer-file").setInputFiles({
        name: "own.glb",
        mimeType: "model/gltf-binary",
        buffer: makeBoxGlb([1, 1, 1], CYAN),
    });
    await page.waitForFunction(() => window.citysplat.viewer.layers.list[1]?.state === "shown");
    await page.waitForFunction(() => new URL(location.href).searchParams.getAll("overlay").length === 1);
    const [kept] = await page.evaluate(() => new URL(location.href).searchParams.getAll("overlay"));
    assert.match(kept, /\/box\.glb#at=13\.4\d+,52\.\d+,8\d\.\d+,30,1$/);
    await page.reload();
    await waitForViewer(page);
    await page.waitForFunction(() => window.citysplat.viewer.layers.list[0]?.state === "shown");
    const [again] = await list();
    assert.ok(Math.abs(again.place.lon - lon) < 1e-6 && again.place.heading === 30);
    nearTo(await cyan(), OPEN_GROUND);
    await page.click("#layers button[title=Remove]");
    await page.waitForFunction(() => !location.search.includes("overlay"));
    assert.equal((await cyan()).n, 0);
    assert.equal(await page.isVisible("#layers"), false);
});

test("a click puts a model elsewhere, a number turns it", skip, async () => {
    await add({ url: `${foreign.url}/box.glb`, place: standing([-20, -60, 6]) });
    await page.click("#layers button[aria-pressed=false]:text('Move')");
    const spot = [30, -20, 0];
    await page.mouse.click(...project(ORIGIN, SOUTH, spot, SIZE.width, SIZE.height));
    await nextFrames(page);
    nearTo(await cyan(), [spot[0], spot[1], 3]); // half of it is in the ground
    await page.fill("#layers .how label:has-text('Turn') input", "45");
    await page.press("#layers .how label:has-text('Turn') input", "Enter");
    assert.equal((await list())[0].place.heading, 45);
    await page.click("#place-close");
});

test("what does not come or is not what it says is named, and harms nothing", skip, async (t) => {
    const faults = {
        "/none.glb": /nothing at this address \(404\)/,
        "/closed.glb": /CORS/,
        "/refused.glb": /says no \(403\)/,
        "/page.glb": /none of GeoJSON, glTF 2.0 and 3D Tiles/,
        "/cut.glb": /cut off/,
        "/long.glb": /geometry takes/,
        "/ring.glb": /no tree/,
        "/splats.glb": /KHR_gaussian_splatting/,
        "/strange.glb": /ACME_magic/,
        "/ktx2.glb": /KHR_texture_basisu/,
        "/cut-draco.glb": /cannot be shown: .*Decoding failed/,
        "/nowhere.glb": /parts do not fit together/,
        "/adrift/tileset.json": /no place on the earth/,
        "/mad/tileset.json": /parts do not fit together/,
        "/cut.geojson": /JSON is damaged/,
        "/metres.geojson": /no longitude and latitude/,
    };
    for (const [path, why] of Object.entries(faults)) {
        const layer = await add({ url: foreign.url + path });
        assert.equal(layer.state, "failed", `${path} is ${layer.state}`);
        assert.match(layer.why, why, path);
        t.diagnostic(`${path}: ${layer.why}`);
        await page.evaluate((id) => window.citysplat.viewer.layers.remove(id), layer.id);
    }
    const gone = await add({ url: "http://127.0.0.1:9/box.glb" });
    assert.match(gone.why, /127\.0\.0\.1:9 does not answer/);
    const dropped = await page.evaluate(async (bytes) => {
        const file = new File([new Uint8Array(bytes)], "beside.glb");
        return window.citysplat.viewer.layers.add({ file }).catch((error) => error.message);
    }, [...makeBoxGlb(HALF, CYAN, (json) => (json.images = [{ uri: "https://elsewhere.example/a.png" }]))]);
    assert.match(dropped, /elsewhere\.example.*\.glb holds everything/);
    assert.equal(await page.isVisible("#layers .warn"), true);
    // A tileset whose only tile is not there: named as well.
    const broken = await add({ url: `${foreign.url}/broken/tileset.json` });
    await page.waitForFunction((id) => window.citysplat.viewer.layers.list.find((one) => one.id === id).state === "failed", broken.id);
    assert.ok(measureContent(await barePicture(page)).share > 0.1, "the city is gone");
    assert.equal((await page.evaluate(() => window.citysplat.state)).ready, true);
    const uncaught = viewer.log.filter((line) => /uncaught/.test(line));
    assert.deepEqual(uncaught, []);
});

test("what is not there at first can be asked for again", skip, async () => {
    let there = false;
    await page.route("**/late.glb", (route) =>
        there
            ? route.fulfill({ body: makeBoxGlb(HALF, CYAN), headers: { "access-control-allow-origin": "*" } })
            : route.fulfill({ status: 404, headers: { "access-control-allow-origin": "*" } }),
    );
    const layer = await add({ url: `${foreign.url}/late.glb`, place: standing(OPEN_GROUND) });
    assert.equal(layer.state, "failed");
    there = true;
    await page.click("#layers button:text('Try again')");
    await page.waitForFunction(() => window.citysplat.viewer.layers.list[0]?.state === "shown");
    nearTo(await cyan(), OPEN_GROUND);
    await page.unroute("**/late.glb");
});

test("the list of layers and the dialog of pictures: named, large enough on a phone, axe clean", skip, async () => {
    const size = { width: 390, height: 780, hasTouch: true, isMobile: true, bypassCSP: true };
    const { lon, lat, h } = standing(OPEN_GROUND);
    const given = ["box.glb", "none.glb"].map((name) => `overlay=${foreign.url}/${name}%23at=${lon},${lat},${h}`);
    const phone = await openPage(`${source.url}/?${given.join("&")}`, size);
    try {
        await waitForViewer(phone.page);
        await phone.page.waitForFunction(() =>
            window.citysplat.viewer.layers.list.map(({ state }) => state).join() === "shown,failed",
        );
        await phone.page.click("#fold");
        const small = await phone.page.$$eval("#layers :is(button, input[type=number])", (all) =>
            all
                .filter((node) => node.checkVisibility())
                .map((node) => [node.getBoundingClientRect(), node.title || node.textContent])
                .filter(([{ width, height, right }]) => width < 43.5 || height < 43.5 || right > innerWidth)
                .map(([{ width, height }, name]) => `${name}: ${width} x ${height}`),
        );
        assert.deepEqual(small, []);
        await phone.page.addScriptTag({ content: AXE });
        const faults = () =>
            phone.page.evaluate(async () => {
                const { violations } = await window.axe.run(document);
                return violations.map(({ id, nodes }) => `${id}: ${nodes.map((n) => n.target).join(" ")}`);
            });
        assert.deepEqual(await faults(), [], "layers");
        await phone.page.click("#shot-button");
        await phone.page.waitForSelector("#shot[open]");
        assert.deepEqual(await faults(), [], "the dialog of pictures");
    } finally {
        await phone.close();
    }
});

test("sizes of images are read before they are unpacked", async () => {
    const { sizeOfImage } = await importSource("gltfcheck.ts");
    const png = Buffer.alloc(33);
    png.write("\x89PNG\r\n\x1a\n", 0, "latin1");
    png.writeUInt32BE(70000, 16);
    png.writeUInt32BE(3, 20);
    assert.deepEqual(sizeOfImage(png), [70000, 3]);
    const jpg = Buffer.from([0xff, 0xd8, 0xff, 0xe0, 0, 4, 1, 2, 0xff, 0xc2, 0, 17, 8, 1, 44, 2, 88, 3, 0]);
    assert.deepEqual(sizeOfImage(jpg), [600, 300]);
    const webp = Buffer.alloc(30);
    webp.write("RIFF", 0);
    webp.write("WEBPVP8X", 8);
    webp.writeUIntLE(1999, 24, 3);
    webp.writeUIntLE(999, 27, 3);
    assert.deepEqual(sizeOfImage(webp), [2000, 1000]);
    assert.equal(sizeOfImage(Buffer.from("<svg>")), null);
});
