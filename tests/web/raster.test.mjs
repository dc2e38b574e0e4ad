// MapLibre, which knows nothing of Gaussians, shows the city by its map tiles and raises it by its
// terrain tiles: what lies where, how high, and no error in the console.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { createServer } from "node:http";
import { dirname, join, normalize } from "node:path";
import { after, before, test } from "node:test";
import { fileURLToPath } from "node:url";

import { openPage } from "./lib/browser.mjs";
import { BLUE_TOP, fCellCenter, ORIGIN, RED_TOP } from "./lib/city.mjs";
import { placeOfEnu } from "./lib/geo.mjs";
import { decodePng } from "./lib/png.mjs";
import { firstDataSet, getJson, GIVEN_TILES, openSource } from "./lib/source.mjs";

const DIST = join(dirname(fileURLToPath(import.meta.url)), "node_modules/maplibre-gl/dist");
const SIZE = { width: 640, height: 560 };
const TIMEOUT_MS = 90000;
const skip = { skip: GIVEN_TILES ? "needs the test city" : false };
const PAGE = `<!doctype html><meta charset="utf-8"><link rel="icon" href="data:,">
<link rel="stylesheet" href="/maplibre-gl.css">
<style>html,body,#map{margin:0;height:100%;background:#fff}</style><div id="map"></div>`;
const TYPES = { mjs: "text/javascript", css: "text/css" };

let source;
let pages;
let opened;
before(async () => {
    if (skip.skip) return;
    source = await openSource();
    pages = createServer((request, response) => {
        const path = normalize(request.url.split("?")[0]);
        if (path === "/") {
            response.setHeader("Content-Type", "text/html");
            return response.end(PAGE);
        }
        response.setHeader("Content-Type", TYPES[path.split(".").pop()] ?? "text/plain");
        try {
            response.end(readFileSync(join(DIST, path)));
        } catch {
            response.writeHead(404).end();
        }
    });
    await new Promise((done) => pages.listen(0, "127.0.0.1", done));
    opened = await openPage(`http://127.0.0.1:${pages.address().port}/`, SIZE);
});
after(async () => {
    await opened?.close();
    pages?.close();
    await source?.close();
});

// A source of a style: TileJSON with the addresses of its tiles resolved against its own.
async function tileSource(type, file) {
    const url = `${source.url}/d/${await firstDataSet(source.url)}/${file}`;
    const json = await getJson(url);
    const { minzoom, maxzoom, bounds, tileSize, encoding, attribution } = json;
    // URL would encode the braces of the template
    const tiles = json.tiles.map((tile) => new URL("./", url).href + tile);
    return { type, tiles, minzoom, maxzoom, bounds, tileSize, attribution, ...(encoding && { encoding }) };
}

async function showMap(view, terrain) {
    const sources = { city: await tileSource("raster", "map.json") };
    if (terrain) sources.dem = await tileSource("raster-dem", "terrain.json");
    const style = {
        version: 8,
        sources,
        layers: [{ id: "city", type: "raster", source: "city", paint: { "raster-fade-duration": 0 } }],
        ...(terrain && { terrain: { source: "dem", exaggeration: 1 } }),
    };
    await opened.page.evaluate(
        async ([style, view, timeout]) => {
            const { Map: MapView } = await import("/maplibre-gl.mjs");
            window.shown?.remove();
            window.shown = new MapView({ container: "map", style, attributionControl: false, ...view });
            await new Promise((done, fail) => {
                window.shown.once("idle", done);
                window.shown.on("error", (e) => fail(e.error));
                setTimeout(() => fail(new Error("never idle")), timeout);
            });
        },
        [style, view, TIMEOUT_MS],
    );
    return decodePng(await opened.page.screenshot({ path: process.env.RASTER_SHOT }));
}

const lonLat = (enu) => {
    const { lon, lat } = placeOfEnu(ORIGIN, enu);
    return [lon, lat];
};
const MIDDLE = lonLat([0, 0, 0]);

async function colorAt(picture, enu) {
    const { x, y } = await opened.page.evaluate((at) => window.shown.project(at), lonLat(enu));
    return picture.at(Math.round(x), Math.round(y));
}

test("MapLibre shows the map: the city lies where it is", skip, async () => {
    const picture = await showMap({ center: MIDDLE, zoom: 17.4 }, false);
    const red = await colorAt(picture, RED_TOP);
    const blue = await colorAt(picture, BLUE_TOP);
    const yellow = await colorAt(picture, fCellCenter(3, 1));
    const ground = await colorAt(picture, [25, -25, 0]);
    assert.ok(red[0] > red[1] + 80 && red[0] > red[2] + 80, `red tower: ${red}`);
    assert.ok(blue[2] > blue[0] + 80 && blue[2] > blue[1] + 40, `blue tower: ${blue}`);
    assert.ok(yellow[0] > 180 && yellow[1] > 140 && yellow[2] < 110, `yellow F: ${yellow}`);
    assert.ok(Math.max(...ground) - Math.min(...ground) < 30 && ground[0] < 160, `ground: ${ground}`);
    assert.deepEqual(opened.log, []);
});

test("MapLibre raises the map by the terrain: towers are as high as they are", skip, async () => {
    await showMap({ center: MIDDLE, zoom: 17, pitch: 60, bearing: 20 }, true);
    const heights = await opened.page.evaluate(
        (places) => places.map((at) => window.shown.queryTerrainElevation(at)),
        [RED_TOP, BLUE_TOP, [25, -25, 0]].map(lonLat),
    );
    // MapLibre tells heights above that of the map's centre or above zero: differences hold for both
    const [red, blue, ground] = heights;
    assert.ok(Math.abs(red - ground - RED_TOP[2]) < 4, `red tower ${red}, ground ${ground}`);
    assert.ok(Math.abs(blue - ground - BLUE_TOP[2]) < 4, `blue tower ${blue}, ground ${ground}`);
    assert.deepEqual(opened.log, []);
});
