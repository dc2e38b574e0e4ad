// The city as a layer of a MapLibre map, by the example page: where it belongs from a camera that the
// map was given, equal to the server's picture of that view, at one place with the map's own tiles,
// hidden by what stands before it and hiding what stands behind, and gone without a trace.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { after, before, test } from "node:test";

import { closeAll, openPage, useWholeBrowser } from "./lib/browser.mjs";
import { checkNorth, checkSouth, NORTH, rmsDifference, SOUTH } from "./lib/checks.mjs";
import { BLUE_TOP, fCellCenter, makeCity, ORIGIN, RED_TOP } from "./lib/city.mjs";
import { placeOfEnu, project } from "./lib/geo.mjs";
import { decodePng } from "./lib/png.mjs";
import { firstDataSet, getJson, GIVEN_TILES, MOCK, openSource } from "./lib/source.mjs";

useWholeBrowser();

const SIZE = { width: 640, height: 480 };
const TIMEOUT_MS = 120000;
const SAME_RMS = 4; // levels of 255, as of our viewer: a shift by 5 pixels gives 10
const M_PER_DEG = 111_320;
const skip = { skip: MOCK || GIVEN_TILES ? "needs the test city and a server" : false };

let source;
let opened;
let page;
before(async () => {
    if (skip.skip) return;
    source = await openSource({ signed: true });
    opened = await openPage(`${source.url}/examples/maplibre.html`, SIZE);
    page = opened.page;
    await page.waitForFunction(() => window.layer?.state.ready, null, { timeout: TIMEOUT_MS });
    await page.addStyleTag({ content: "#note,.maplibregl-control-container{display:none!important}" });
});
after(() => closeAll(opened, source));

// Everything of the map and of the layer is drawn.
async function settle() {
    await page.evaluate(
        (timeout) =>
            new Promise((done, fail) => {
                setTimeout(() => fail(new Error(`not settled: ${JSON.stringify(window.layer.state)}`)), timeout);
                const { map, layer } = window;
                const look = () => {
                    if (map.getLayer("citysplat") && !layer.state.ready) map.once("render", look);
                    else map.once("idle", done);
                    map.triggerRepaint();
                };
                map.once("render", look); // of the camera of now
                map.triggerRepaint();
            }),
        TIMEOUT_MS,
    );
}

const idle = () =>
    page.evaluate(() => new Promise((done) => (window.map.once("idle", done), window.map.triggerRepaint())));

// The map's camera to a pose, whose height is above the ellipsoid.
async function look(pose) {
    await page.evaluate((p) => {
        const { map, layer } = window;
        map.setVerticalFieldOfView(p.fov);
        const turn = [p.heading, 90 + p.pitch];
        map.jumpTo(map.calculateCameraOptionsFromCameraLngLatAltRotation([p.lon, p.lat], p.h - layer.lower, ...turn));
    }, pose);
    await settle();
}

async function picture(name = "") {
    const folder = process.env.MAPLIBRE_SHOTS;
    return decodePng(await page.screenshot(folder && name ? { path: `${folder}/${name}.png` } : {}));
}

const paper = (color) =>
    page.evaluate((c) => window.map.setPaintProperty("paper", "background-color", c), color);

const lonLat = (enu) => {
    const { lon, lat } = placeOfEnu(ORIGIN, enu);
    return [lon, lat];
};

test("the page shows the whole city, from the map's camera", skip, async () => {
    const { bounds, state } = await page.evaluate(() => ({ bounds: window.layer.bounds, state: window.layer.state }));
    assert.deepEqual([state.ready, state.error, state.link], [true, null, "ok"]);
    const [west, south, east, north] = bounds;
    for (const [lon, lat] of [[-85, -85, 0], [85, 85, 0]].map(lonLat))
        assert.ok(west < lon && lon < east && south < lat && lat < north, `${lon}, ${lat}: ${bounds}`);
    assert.equal(await page.textContent(".maplibregl-ctrl-bottom-right .citysplat-credit"), "Test city, drawn by code");
    await picture("page");
    assert.deepEqual(opened.log, []);
});

test("every part of the city is where it belongs, as the server draws it", skip, async (t) => {
    await paper("#000");
    await page.evaluate(() => (window.layer.city.errorTarget = 0.1));
    const name = await firstDataSet(source.url);
    for (const [pose, check, side] of [[SOUTH, checkSouth, "south"], [NORTH, checkNorth, "north"]]) {
        await look(pose);
        const own = await picture(side);
        assert.deepEqual(check(own), []);
        const place = `${pose.lon.toFixed(7)},${pose.lat.toFixed(7)},${pose.h.toFixed(3)}`;
        const url = `${source.url}/d/${name}/static/${place}@${pose.heading},${pose.pitch},${pose.fov}/640x480.png`;
        const response = await fetch(url);
        if (response.status === 501 || response.status === 503) continue;
        assert.equal(response.status, 200, url);
        const rms = rmsDifference(own, decodePng(Buffer.from(await response.arrayBuffer())));
        t.diagnostic(`from the ${side}: ${rms.toFixed(2)} of 255 from the server's picture`);
        assert.ok(rms < SAME_RMS, `${rms} of 255`);
    }
    assert.equal(await page.evaluate(() => window.layer.state.gaussians), makeCity().length);
});

test("a click tells the place", skip, async () => {
    await look(SOUTH);
    for (const top of [RED_TOP, BLUE_TOP]) {
        const roof = [top[0], top[1], top[2] + 0.5];
        const [x, y] = project(ORIGIN, SOUTH, roof, SIZE.width, SIZE.height);
        const place = await page.evaluate((point) => window.layer.pick(point), { x, y });
        const want = placeOfEnu(ORIGIN, roof);
        const off = [(place.lon - want.lon) * 0.61, place.lat - want.lat].map((v) => v * M_PER_DEG);
        assert.ok(Math.hypot(...off) < 2 && Math.abs(place.h - want.h) < 1.5, JSON.stringify([place, want]));
    }
});

test("the city lies on the map: its own map tiles show the same at the same pixels", skip, async () => {
    const url = `${source.url}/d/${await firstDataSet(source.url)}/map.json`;
    const { tiles, minzoom, maxzoom, bounds, tileSize } = await getJson(url);
    const levels = { minzoom, maxzoom: Math.min(maxzoom, 17) }; // few tiles: the server draws each when asked
    const raster = { type: "raster", tiles, ...levels, bounds, tileSize };
    await page.evaluate((spec) => {
        window.map.addSource("flat", spec);
        const layer = { id: "flat", type: "raster", source: "flat", paint: { "raster-fade-duration": 0 } };
        window.map.addLayer(layer, "citysplat");
    }, raster);
    const center = lonLat([-40, -50, 0]);
    await page.evaluate((c) => window.map.jumpTo({ center: c, zoom: 18, pitch: 40, bearing: -25 }), center);
    const yellow = async (layerShown) => {
        await page.evaluate((on) => window.map.setLayoutProperty("citysplat", "visibility", on), layerShown);
        await (layerShown === "visible" ? settle() : idle());
        const png = await picture(`flat-${layerShown}`);
        let [x, y, n] = [0, 0, 0];
        for (let j = 0; j < SIZE.height; j++)
            for (let i = 0; i < SIZE.width; i++) {
                const [r, g, b] = png.at(i, j);
                if (r > 170 && g > 130 && b < 110) [x, y, n] = [x + i, y + j, n + 1];
            }
        assert.ok(n > 1000, `${n} yellow pixels`);
        return { x: x / n, y: y / n, n };
    };
    const flat = await yellow("none");
    const solid = await yellow("visible");
    const off = Math.hypot(flat.x - solid.x, flat.y - solid.y);
    // It lies 1 m above the ground, which is 3.5 pixels up here.
    assert.ok(off < 5 && solid.y < flat.y, `the F is ${off} pixels beside the map: ${JSON.stringify([flat, solid])}`);
    await page.evaluate(() => (window.map.removeLayer("flat"), window.map.removeSource("flat")));
});

test("it is hidden by what stands before it and hides what stands behind", skip, async () => {
    await look(SOUTH);
    const wall = (id, south, height, before) =>
        page.evaluate(
            ([id, ring, height, before]) => {
                const { map } = window;
                if (map.getLayer(id)) map.removeLayer(id);
                if (map.getSource(id)) map.removeSource(id);
                const data = { type: "Feature", properties: {}, geometry: { type: "Polygon", coordinates: [ring] } };
                map.addSource(id, { type: "geojson", data });
                const paint = { "fill-extrusion-color": "#00ffff", "fill-extrusion-height": height };
                map.addLayer({ id, type: "fill-extrusion", source: id, paint }, before);
            },
            [
                id,
                [[40, south, 0], [75, south, 0], [75, south + 2, 0], [40, south + 2, 0], [40, south, 0]].map(lonLat),
                height,
                before,
            ],
        );
    const at = async (enu) => (await picture("wall")).mean(...project(ORIGIN, SOUTH, enu, SIZE.width, SIZE.height), 1);
    const isCyan = ([r, g, b]) => g > r + 60 && b > r + 60;
    const isRed = ([r, g, b]) => r > 140 && g < 90 && b < 90;
    const face = [RED_TOP[0], -6, 20];
    assert.ok(isRed(await at(face)), "the red tower");
    for (const before of ["citysplat", undefined]) {
        const order = before ? "drawn before the city" : "drawn after the city";
        await wall("wall", -20, 40, before);
        await settle();
        assert.ok(isCyan(await at(face)), `a wall before the tower, ${order}: ${await at(face)}`);
        await wall("wall", 20, 34, before);
        await settle();
        assert.ok(isRed(await at(face)), `a wall behind the tower, ${order}: ${await at(face)}`);
        const beside = [72, 20, 20];
        assert.ok(isCyan(await at(beside)), `the wall beside the tower, ${order}: ${await at(beside)}`);
    }
    await page.evaluate(() => (window.map.removeLayer("wall"), window.map.removeSource("wall")));
});

test("it follows the map from the street to the globe", skip, async (t) => {
    const center = lonLat([0, 0, 0]);
    const offsets = await page.evaluate(async ([lon, lat]) => {
        const { map, layer } = window;
        const out = {};
        map.setProjection({ type: "globe" });
        for (const zoom of [17, 11.5, 6]) {
            map.jumpTo({ center: [lon + 60 / 2 ** zoom, lat], zoom, pitch: zoom > 12 ? 60 : 20, bearing: 30 });
            await new Promise((done) => (map.once("render", done), map.triggerRepaint()));
            const { projectionMatrix: p, matrixWorldInverse: v, position } = layer.camera;
            const ground = layer.lower - layer.frame.placeOf(position.clone().set(0, 0, 0)).h; // of the map
            const clip = position.clone().set(0, ground, 0).applyMatrix4(v).applyMatrix4(p);
            const { clientWidth: w, clientHeight: h } = map.getCanvas();
            const want = map.project([lon, lat]);
            out[zoom] = Math.hypot(((clip.x + 1) * w) / 2 - want.x, ((1 - clip.y) * h) / 2 - want.y);
        }
        // From the other side of the Earth: nothing is drawn through it.
        const { draw } = layer.city;
        for (const [name, side] of [["seen", 0], ["hidden", 180]]) {
            out[name] = 0;
            layer.city.draw = () => (out[name]++, draw.call(layer.city));
            map.jumpTo({ center: [lon - side, side ? -lat : lat], zoom: 1.5, pitch: 0, bearing: 0 });
            await new Promise((done) => (map.once("render", done), map.triggerRepaint()));
        }
        delete layer.city.draw;
        map.setProjection({ type: "mercator" });
        return out;
    }, center);
    t.diagnostic(JSON.stringify(offsets));
    for (const zoom of [17, 11.5, 6]) assert.ok(offsets[zoom] < 1.5, `zoom ${zoom}: ${offsets[zoom]} px beside`);
    assert.ok(offsets.seen > 0 && offsets.hidden === 0, `drawn ${offsets.seen} and ${offsets.hidden} times`);
});

test("taken away it leaves the map as it was, and it can be put back", skip, async () => {
    await look(SOUTH);
    await page.evaluate(() => window.map.removeLayer("citysplat"));
    await idle();
    const empty = await picture("removed");
    for (const [x, y] of [[10, 10], [320, 240], [600, 400]]) assert.deepEqual(empty.at(x, y), [0, 0, 0]);
    const { tiles, memory } = await page.evaluate(() => window.layer.state);
    assert.deepEqual([tiles, memory], [0, 0]);
    await page.evaluate(() => window.map.addLayer(window.layer));
    await settle();
    await page.evaluate(() => (window.layer.city.errorTarget = 0.1));
    await look(SOUTH);
    assert.deepEqual(checkSouth(await picture("again")), []);
    // MapLibre takes requests back when it looks elsewhere.
    assert.deepEqual(opened.log, []);
});
