// MapLibre, which knows nothing of Gaussians, shows the city by its map tiles and raises it by its terrain tiles, by the
// recipes of docs/clients.md as printed: what lies where, how high, no seam, and no error in the console. (Whether its
// pixels and those of other maps are the server's: the test recipes.)
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { createServer } from "node:http";
import { dirname, join, normalize } from "node:path";
import { after, before, test } from "node:test";
import { fileURLToPath } from "node:url";

import { openPage, useWholeBrowser } from "./lib/browser.mjs";
import { measureContent } from "./lib/checks.mjs";
import { BLUE_TOP, fCellCenter, ORIGIN, RED_TOP } from "./lib/city.mjs";
import { placeOfEnu } from "./lib/geo.mjs";
import { decodePng } from "./lib/png.mjs";
import { snippets } from "./lib/snippets.mjs";
import { firstDataSet, getBytes, getJson, GIVEN_TILES, openSource } from "./lib/source.mjs";

useWholeBrowser();

const MODULES = join(dirname(fileURLToPath(import.meta.url)), "node_modules");
const SIZE = { width: 640, height: 560 };
const TIMEOUT_MS = 90000;
const skip = { skip: GIVEN_TILES ? "needs the test city" : false };
const HEAD = `<!doctype html><meta charset="utf-8"><link rel="icon" href="data:,">
<style>html,body,#city{margin:0;height:100%;background:#fff!important}.maplibregl-ctrl-attrib{display:none!important}</style>`;
const TYPES = { mjs: "text/javascript", js: "text/javascript", css: "text/css" };

let source;
let pages;
let body = ""; // of the page
let opened;
before(async () => {
    if (skip.skip) return;
    source = await openSource({ signed: true });
    pages = createServer((request, response) => {
        const path = normalize(request.url.split("?")[0]);
        if (path === "/") {
            response.setHeader("Content-Type", "text/html");
            return response.end(HEAD + body);
        }
        response.setHeader("Content-Type", TYPES[path.split(".").pop()] ?? "text/plain");
        try {
            response.end(readFileSync(join(MODULES, path)));
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

const documentUrl = async (file) => `${source.url}/d/${await firstDataSet(source.url)}/${file}`;

// A source of a style, by a TileJSON.
async function tileSource(type, file) {
    const url = await documentUrl(file);
    const json = await getJson(url);
    const { minzoom, maxzoom, bounds, tileSize, encoding, attribution } = json;
    return { type, tiles: json.tiles, minzoom, maxzoom, bounds, tileSize, attribution, ...(encoding && { encoding }) };
}

async function screenshot(name) {
    const path = process.env.RASTER_SHOTS && join(process.env.RASTER_SHOTS, `${name}.png`);
    return decodePng(await opened.page.screenshot(path ? { path } : {}));
}

const [, STYLE, SOURCES] = snippets("clients.md", "## MapLibre", "html");

// The page of a recipe, whose map is window.shown.
async function showMap(recipe) {
    const npm = `http://127.0.0.1:${pages.address().port}`;
    const { lon, lat } = placeOfEnu(ORIGIN, [0, 0, 0]);
    const words = { host: source.url, ds: await firstDataSet(source.url), npm, lon, lat };
    body = recipe
        .replace(/\{(\w+)\}/g, (word, name) => words[name] ?? word)
        .replace("new maplibregl.Map(", "window.shown = new maplibregl.Map(")
        .replace("</script>", "</script><script>window.failed = [];</script>");
    await opened.page.goto(npm);
    await opened.page.waitForFunction(() => window.shown);
    await opened.page.evaluate(() => void window.shown.on("error", ({ error }) => window.failed.push(error.message)));
}

// What a map shows from a view, or from its own where none is given, when all of it is there.
async function lookAt(name, view) {
    await opened.page.evaluate(
        async ([view, timeout]) => {
            const idle = new Promise((done, fail) => {
                window.shown.once("idle", done);
                setTimeout(() => fail(new Error("never idle")), timeout);
            });
            while (!window.shown.getLayer("city")) await window.shown.once("styledata");
            window.shown.setPaintProperty("city", "raster-fade-duration", 0); // fading is not waited for
            if (view) window.shown.jumpTo(view);
            window.shown.triggerRepaint();
            await idle;
        },
        [view, TIMEOUT_MS],
    );
    assert.deepEqual(await opened.page.evaluate(() => window.failed), []);
    return screenshot(name);
}

const lonLat = (enu) => {
    const { lon, lat } = placeOfEnu(ORIGIN, enu);
    return [lon, lat];
};
const MIDDLE = lonLat([0, 0, 0]);

const pixelOf = (enu) => opened.page.evaluate((at) => window.shown.project(at), lonLat(enu));

// Towers, the F and the ground have their colours where they are.
async function cityLies(picture, pixelOf) {
    const [red, blue, yellow, ground] = await Promise.all(
        [RED_TOP, BLUE_TOP, fCellCenter(3, 1), [25, -25, 0]].map(async (enu) => {
            const { x, y } = await pixelOf(enu);
            return picture.at(Math.round(x), Math.round(y));
        }),
    );
    assert.ok(red[0] > red[1] + 80 && red[0] > red[2] + 80, `red tower: ${red}`);
    assert.ok(blue[2] > blue[0] + 80 && blue[2] > blue[1] + 40, `blue tower: ${blue}`);
    assert.ok(yellow[0] > 180 && yellow[1] > 140 && yellow[2] < 110, `yellow F: ${yellow}`);
    assert.ok(Math.max(...ground) - Math.min(...ground) < 30 && ground[0] < 160, `ground: ${ground}`);
    assert.deepEqual(opened.log, []);
}

// Pixels of ground, about the red tower, through which the page behind is seen: white. (North-west of the
// middle nothing counts as surveyed: ground alone is coarser than most of this city.)
async function countHoles(picture) {
    const ring = await Promise.all([[2, -70], [78, -70], [78, 28], [2, 28]].map(([e, n]) => pixelOf([e, n, 0])));
    let [within, holes] = [0, 0];
    for (let y = 0; y < picture.height; y++)
        for (let x = 0; x < picture.width; x++) {
            const inside = ring.reduce((in_, a, i) => {
                const b = ring[(i + 1) % 4];
                const crosses = a.y > y !== b.y > y && x < a.x + ((y - a.y) / (b.y - a.y)) * (b.x - a.x);
                return crosses ? !in_ : in_;
            }, false);
            if (!inside) continue;
            within++;
            holes += Math.min(...picture.at(x, y)) > 250;
        }
    return { within, holes };
}

test("MapLibre shows the map: the city lies where it is, without a seam", skip, async (t) => {
    await showMap(SOURCES);
    const picture = await lookAt("maplibre", { center: MIDDLE, zoom: 17.4 });
    await cityLies(picture, pixelOf);
    const { within, holes } = await countHoles(picture);
    t.diagnostic(`${holes} of ${within} pixels show what is behind the map`);
    assert.ok(within > 20000 && holes === 0, `${holes} of ${within}`);
});

test("MapLibre opens the city by one address: in its frame, with its credit, upright", skip, async (t) => {
    await showMap(STYLE);
    const picture = await lookAt("maplibre-style");
    const { bounds, attribution } = await getJson(await documentUrl("map.json"));
    const [west, south, east, north] = bounds;
    const corners = [[west, south], [east, south], [east, north], [west, north]];
    const places = await opened.page.evaluate((all) => all.map((at) => window.shown.project(at)), corners);
    const [wide, high] = ["x", "y"].map((axis) => {
        const values = places.map((place) => place[axis]);
        const side = axis === "x" ? SIZE.width : SIZE.height;
        assert.ok(Math.min(...values) >= 0 && Math.max(...values) <= side, JSON.stringify(places));
        return (Math.max(...values) - Math.min(...values)) / side;
    });
    t.diagnostic(`the survey takes ${wide.toFixed(2)} of the width, ${high.toFixed(2)} of the height`);
    assert.ok(Math.max(wide, high) > 0.6, `${wide} of the width, ${high} of the height`);
    assert.ok(measureContent(picture).colors > 10);
    assert.match(await opened.page.textContent(".maplibregl-ctrl-attrib"), new RegExp(attribution));
    const { pitch, terrain } = await opened.page.evaluate(() => ({
        pitch: window.shown.getPitch(),
        terrain: window.shown.getTerrain(),
    }));
    assert.ok(pitch > 30 && terrain, `pitch ${pitch}, ${JSON.stringify(terrain)}`);
    assert.deepEqual(opened.log, []);
});

test("MapLibre's ground is bare in the style of the server", skip, async (t) => {
    await lookAt("maplibre-ground", { center: MIDDLE, zoom: 17, pitch: 60, bearing: 20 });
    const [red, blue, ground] = await opened.page.evaluate((places) => places.map((at) => window.shown.queryTerrainElevation(at)), [RED_TOP, BLUE_TOP, [25, -25, 0]].map(lonLat));
    t.diagnostic(`under the towers ${(red - ground).toFixed(1)} and ${(blue - ground).toFixed(1)} m above the ground beside`);
    for (const [name, height] of Object.entries({ red, blue })) assert.ok(Math.abs(height - ground) < 3, `${name} tower ${height}, ground ${ground}`);
    assert.deepEqual(opened.log, []);
});

test("MapLibre raises the map by the terrain: towers are as high as they are", skip, async (t) => {
    const { tiles, minzoom, maxzoom } = await getJson(await documentUrl("terrain.json")); // without bounds, as the style's
    await opened.page.evaluate((source) => { // terrain and hillshade as the style has them, of the surface
        const { shown } = window;
        for (const name of ["dem", "shade"]) shown.addSource(name, { type: "raster-dem", tileSize: 256, ...source });
        const { paint } = shown.getStyle().layers.find(({ id }) => id === "hillshade");
        shown.removeLayer("hillshade");
        shown.addLayer({ id: "hillshade", type: "hillshade", source: "shade", paint });
        shown.setTerrain({ source: "dem" });
    }, { tiles, minzoom, maxzoom });
    await opened.page.evaluate(() => window.shown.setPaintProperty("background", "background-color", "#fff"));
    const picture = await lookAt("maplibre-terrain", { center: MIDDLE, zoom: 17, pitch: 60, bearing: 20 });
    const heights = await opened.page.evaluate(
        (places) => places.map((at) => window.shown.queryTerrainElevation(at)),
        [RED_TOP, BLUE_TOP, [25, -25, 0]].map(lonLat),
    );
    // MapLibre tells heights above that of the map's centre or above zero: differences hold for both
    const [red, blue, ground] = heights;
    assert.ok(Math.abs(red - ground - RED_TOP[2]) < 4, `red tower ${red}, ground ${ground}`);
    assert.ok(Math.abs(blue - ground - BLUE_TOP[2]) < 4, `blue tower ${blue}, ground ${ground}`);
    // Neither cracks between tiles nor holes in their skirts, on ground that no tower hides.
    const { within, holes } = await countHoles(picture);
    t.diagnostic(`${holes} of ${within} pixels show what is behind the terrain`);
    assert.ok(within > 20000 && holes === 0, `${holes} of ${within}`);
    assert.deepEqual(opened.log, []);
});

// Tiles of one zoom around the city as the server gives them, and how colours or heights change from
// pixel to pixel: across the borders of tiles, and within them as near to the borders as can be.
async function measureSteps(file, value) {
    const { tiles, maxzoom } = await tileSource("raster", file);
    const zoom = maxzoom + 1; // for more borders
    const n = 2 ** zoom;
    const tileOf = (enu) => {
        const [lon, lat] = lonLat(enu);
        const v = 0.5 - Math.asinh(Math.tan((lat * Math.PI) / 180)) / (2 * Math.PI);
        return [Math.floor((lon / 360 + 0.5) * n), Math.floor(v * n)];
    };
    const [[west, south], [east, north]] = [tileOf([-78, -78, 0]), tileOf([78, 78, 0])];
    const rows = [];
    for (let y = north; y <= south; y++) {
        const row = [];
        for (let x = west; x <= east; x++) {
            const url = tiles[0].replace("{z}", zoom).replace("{x}", x).replace("{y}", y);
            const bytes = await getBytes(url.replace(".webp", ".png"));
            row.push(bytes.length ? decodePng(bytes) : null); // 204: nothing is there
        }
        rows.push(row);
    }
    const at = (x, y) => {
        const tile = rows[y >> 8][x >> 8];
        return tile && value(tile, x & 255, y & 255);
    };
    const [width, height] = [256 * rows[0].length, 256 * rows.length];
    const sums = { across: 0, within: 0, borders: 0 };
    const add = (key, a, b) => {
        if (a === null || b === null) return;
        sums[key] += Math.abs(a - b) / (key === "within" ? 2 : 1);
        if (key === "across") sums.borders++;
    };
    for (let x = 256; x < width; x += 256)
        for (let y = 0; y < height; y++) {
            add("across", at(x - 1, y), at(x, y));
            add("within", at(x - 2, y), at(x - 1, y));
            add("within", at(x, y), at(x + 1, y));
        }
    for (let y = 256; y < height; y += 256)
        for (let x = 0; x < width; x++) {
            add("across", at(x, y - 1), at(x, y));
            add("within", at(x, y - 2), at(x, y - 1));
            add("within", at(x, y), at(x, y + 1));
        }
    return { across: sums.across / sums.borders, within: sums.within / sums.borders, borders: sums.borders };
}

test("tiles meet as if they were one: steps across borders are no larger than those within", skip, async (t) => {
    const color = (p, x, y) => (p.alpha(x, y) ? p.at(x, y).reduce((a, b) => a + b) / 3 : null);
    const metres = (p, x, y) => {
        const [r, g, b] = p.at(x, y);
        return -10000 + 0.1 * (65536 * r + 256 * g + b);
    };
    for (const [file, value, unit] of [["map.json", color, "of 255"], ["terrain.json", metres, "m"]]) {
        const { across, within, borders } = await measureSteps(file, value);
        t.diagnostic(`${file}: ${across.toFixed(3)} ${unit} across, ${within.toFixed(3)} within, ${borders} pixels`);
        assert.ok(borders > 1000 && within > 0, `${file}: ${borders} pixels, ${within}`);
        // Other pixels of one picture: a seam would make them larger. An edge of a tower may lie beside a border.
        assert.ok(across < 1.15 * within, `${file}: ${across} across, ${within} within`);
    }
});
