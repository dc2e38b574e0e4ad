// Every block of code of docs/clients.md, as it is printed: a page of another origin than the server's draws what the server
// draws from the same camera, and a command ends well. Only the words in braces are filled in.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { mkdirSync, readdirSync, readFileSync, statSync, symlinkSync, writeFileSync } from "node:fs";
import { createServer } from "node:http";
import { createRequire } from "node:module";
import { dirname, extname, join, normalize, resolve } from "node:path";
import { after, before, test } from "node:test";
import { fileURLToPath } from "node:url";

import { findFaults } from "./lib/axe.mjs";
import { openPage, useWholeBrowser } from "./lib/browser.mjs";
import { rmsDifference } from "./lib/checks.mjs";
import { BLUE_TOP, makeCity, ORIGIN } from "./lib/city.mjs";
import { applyMatrix, ecefFrom, enuToEcef, placeFrom, placeOfEnu, project } from "./lib/geo.mjs";
import { decodePng } from "./lib/png.mjs";
import { blocks, snippets } from "./lib/snippets.mjs";
import { ATTRIBUTION, BIN, firstDataSet, getBytes, getJson, GIVEN_TILES, MOCK, openSource } from "./lib/source.mjs";
import { ssim } from "./lib/ssim.mjs";
import { listContents } from "./lib/tileset.mjs";

useWholeBrowser();

const HERE = dirname(fileURLToPath(import.meta.url));
const DOC = "clients.md";
const SIZE = { width: 320, height: 240 };
const TIMEOUT_MS = 120000;
const LEAST = { city: 0.95, map: 0.98 }; // SSIM of what is not background, to the server's picture
const SHARE_LEAST = 0.05; // of the picture: something is in sight
const skip = { skip: MOCK || GIVEN_TILES ? "needs the test city" : false };
const NPM = ["../../web/node_modules", "node_modules"].map((name) => join(HERE, name));
const TYPES = { ".html": "text/html", ".js": "text/javascript", ".mjs": "text/javascript", ".css": "text/css", ".json": "application/json" };
const NORTH_M = 70; // so far from the origin the city lies in one tile
const CAMERA = { from: [60, 90, 160 - NORTH_M], to: [0, 5, -NORTH_M] }; // metres east, up, south
const FOV = 50; // as the recipes have it
const ZOOM = 18; // of the map tiles that the recipes show
const TILE = 256;
const BOX = 512; // pixels of what GDAL is asked for

let source;
let pages;
let dir; // the files of the other origin, and where commands run
let words; // in braces
let tile; // { url, transform } of the tile that holds the whole city

before(async () => {
    if (skip.skip) return;
    const gaussians = makeCity().map(({ pos: [e, n, u], ...more }) => ({ ...more, pos: [e, n + NORTH_M, u] }));
    source = await openSource({ edgeM: 400, gaussians });
    dir = join(source.dir, "recipes");
    mkdirSync(dir);
    pages = createServer(answer);
    await new Promise((done) => pages.listen(0, "127.0.0.1", done));
    const ds = await firstDataSet(source.url);
    const contents = await listContents(`${source.url}/d/${ds}/tileset.json`, getJson);
    const { url, transform } = contents.at(-1);
    tile = { url: url.replace(/(\.lowpass)?\.glb$/, ""), transform };
    const files = `http://127.0.0.1:${pages.address().port}`;
    words = { host: source.url, ds, tile: tile.url, viewer: `${source.url}/viewer.js`, npm: `${files}/npm`, files };
    // Commands: the program, its store and npm's programs are at hand.
    mkdirSync(join(dir, "bin"));
    symlinkSync(resolve(BIN), join(dir, "bin/citysplat"));
    symlinkSync(NPM[1], join(dir, "node_modules"));
    symlinkSync(join(source.dir, "city.tiles"), join(dir, "city.tiles"));
});
after(async () => {
    pages?.close();
    await source?.close();
});

// A file of npm's packages or of dir, or a range of it.
function answer(request, response) {
    const path = normalize(decodeURIComponent(new URL(request.url, "http://x").pathname));
    const candidates = path.startsWith("/npm/") ? NPM.map((root) => join(root, path.slice(5))) : [join(dir, path)];
    const file = candidates.find((one) => statSync(one, { throwIfNoEntry: false })?.isFile());
    if (!file) return response.writeHead(404).end();
    const bytes = readFileSync(file);
    response.setHeader("Content-Type", TYPES[extname(file)] ?? "application/octet-stream");
    const range = /^bytes=(\d+)-(\d+)$/.exec(request.headers.range ?? "");
    if (!range) return response.end(bytes);
    const [from, to] = [Number(range[1]), Math.min(Number(range[2]), bytes.length - 1)];
    response.writeHead(206, { "Content-Range": `bytes ${from}-${to}/${bytes.length}` });
    response.end(bytes.subarray(from, to + 1));
}

const used = new Set();
// The blocks of one kind below a heading.
function printed(heading, kind) {
    const found = snippets(DOC, `## ${heading}`, kind);
    for (const one of found) used.add(one);
    return found;
}

// As a reader fills it in.
function fill(text, more = {}) {
    const known = { ...words, ...more };
    return text.replace(/\{(\w+)\}/g, (word, name) => known[name] ?? word);
}

const degrees = (radians) => (radians * 180) / Math.PI;

// Where a camera stands whose numbers are metres east, up, south of a frame.
function poseIn(transform, { from, to }) {
    const ecef = ([x, y, z]) => applyMatrix(transform, [x, -z, y]);
    const place = placeFrom(ecef(from));
    const frame = enuToEcef(place);
    const ahead = ecef(to).map((v, i) => v - ecefFrom(place)[i]);
    const [e, n, u] = [0, 1, 2].map((axis) => [0, 1, 2].reduce((sum, i) => sum + frame[4 * axis + i] * ahead[i], 0));
    return { ...place, heading: (degrees(Math.atan2(e, n)) + 360) % 360, pitch: degrees(Math.atan2(u, Math.hypot(e, n))) };
}

async function servedView({ lon, lat, h, heading, pitch }, fov) {
    const place = `${lon.toFixed(9)},${lat.toFixed(9)},${h.toFixed(4)}@${heading.toFixed(6)},${pitch.toFixed(6)},${fov.toFixed(6)}`;
    return decodePng(await getBytes(`${source.url}/d/${words.ds}/static/${place}/${SIZE.width}x${SIZE.height}.png`));
}

const pixelOf = ({ lon, lat }, zoom) => {
    const n = TILE * 2 ** zoom;
    const y = 0.5 - Math.asinh(Math.tan((lat * Math.PI) / 180)) / (2 * Math.PI);
    return [n * (lon / 360 + 0.5), n * y].map(Math.round);
};
const placeAt = ([x, y], zoom) => {
    const n = TILE * 2 ** zoom;
    return { lon: (x / n - 0.5) * 360, lat: degrees(Math.atan(Math.sinh(Math.PI * (1 - (2 * y) / n)))) };
};

// Pictures of a kind that the browser reads.
async function decode(bytes, type) {
    if (type === "png") return decodePng(bytes);
    const { page, close } = await openPage("about:blank", SIZE);
    const png = await page.evaluate(async (url) => {
        const bitmap = await createImageBitmap(await (await fetch(url)).blob());
        const canvas = Object.assign(document.createElement("canvas"), { width: bitmap.width, height: bitmap.height });
        canvas.getContext("2d").drawImage(bitmap, 0, 0);
        return canvas.toDataURL("image/png").split(",")[1];
    }, `data:image/${type};base64,${bytes.toString("base64")}`);
    await close();
    return decodePng(Buffer.from(png, "base64"));
}

// The server's map about a pixel, of the tiles themselves, in the form that the client takes: what it does is judged, not
// what WebP does (0.977 to PNG here).
async function servedMap([x, y], zoom, type, { width, height } = SIZE) {
    const [west, north] = [x - width / 2, y - height / 2];
    const tiles = new Map();
    for (let i = Math.floor(west / TILE); i <= Math.floor((west + width - 1) / TILE); i++)
        for (let j = Math.floor(north / TILE); j <= Math.floor((north + height - 1) / TILE); j++) {
            const bytes = await getBytes(`${source.url}/d/${words.ds}/map/${zoom}/${i}/${j}.${type}`);
            tiles.set(`${i}/${j}`, bytes.length ? await decode(bytes, type) : null); // 204: nothing is there
        }
    const at = (px, py) => {
        const [gx, gy] = [west + px, north + py];
        const of = tiles.get(`${Math.floor(gx / TILE)}/${Math.floor(gy / TILE)}`);
        const [tx, ty] = [gx % TILE, gy % TILE];
        return of && of.alpha(tx, ty) ? of.at(tx, ty) : [0, 0, 0];
    };
    return { width, height, at };
}

// The picture that a page comes to rest at, and the bytes that it had of the city. What it says is an error.
// prepare: in the page, once it has a picture. watch: for each answer.
async function show(name, recipe, { hide = "", prepare = null, watch = null } = {}) {
    const [frame] = printed("The page of a recipe", "html");
    writeFileSync(join(dir, `${name}.html`), fill(frame, { recipe }).replace("<meta", '<link rel="icon" href="data:,"><meta'));
    const { page, log, close } = await openPage("about:blank", SIZE);
    try {
        const sizes = [];
        page.on("console", (m) => m.type() === "warning" && m.text().includes(source.url) && log.push(m.text()));
        const data = (url) => url.startsWith(source.url) || /\/(public\/city\/|city\.pmtiles)/.test(url);
        page.on("requestfinished", (request) => {
            if (data(request.url())) sizes.push(request.sizes());
        });
        if (watch) page.on("response", watch);
        await page.goto(`${words.files}/${name}.html`);
        if (prepare) await prepare(page);
        if (hide) await page.addStyleTag({ content: `${hide} { display: none !important }` });
        let [last, same] = [null, 0];
        const end = Date.now() + TIMEOUT_MS;
        while (same < 3 && Date.now() < end && !log.length) {
            await page.waitForTimeout(250);
            const path = process.env.RECIPES_SHOTS && join(process.env.RECIPES_SHOTS, `${name}.png`);
            const picture = decodePng(await page.screenshot({ timeout: TIMEOUT_MS, ...(path && { path }) }));
            const lit = picture.mean(SIZE.width / 2, SIZE.height / 2, 20).some((v) => v > 8);
            same = last && lit && rmsDifference(picture, last) === 0 ? same + 1 : 0;
            last = picture;
        }
        assert.deepEqual(log, [], `${name}'s console`);
        assert.ok(same >= 3, `${name}: no picture that stays`);
        const bytes = (await Promise.all(sizes)).reduce((sum, { responseBodySize }) => sum + responseBodySize, 0);
        return { picture: last, bytes };
    } finally {
        await close();
    }
}

function score(t, name, form, { picture, bytes }, want, least) {
    const { covered, share } = ssim(picture, want);
    const of = bytes ? `${(bytes / 1000).toFixed(0)} kB` : "";
    t.diagnostic(`| ${name} | ${form} | ${covered.toFixed(3)} | ${of} |`);
    assert.ok(share > SHARE_LEAST, `${name}: nothing is in sight`);
    assert.ok(covered >= least, `${name}: ${covered}`);
}

const numbers = (list) => list.join(", ");
const CAMERA_WORDS = { from: numbers(CAMERA.from), to: numbers(CAMERA.to) };
const eyeWords = ({ lon, lat, h, heading, pitch }) => ({ eye_lon: lon, eye_lat: lat, eye_h: h, heading, pitch });

// The attribution is on the picture, and a click is answered by the server with what the pixel shows.
test("CesiumJS", skip, async (t) => {
    const [[recipe], [pick]] = [printed("CesiumJS", "html"), printed("CesiumJS", "js")];
    const pose = poseIn(enuToEcef(ORIGIN), CAMERA);
    const fov = degrees(2 * Math.atan((Math.tan(Math.PI / 6) * SIZE.height) / SIZE.width)); // Cesium's own: 60 across
    const both = fill(recipe, eyeWords(pose)).replace(/<\/script>\s*$/, `${fill(pick)}window.shown = viewer;</script>`);
    let [credit, told, asked] = ["", "", null];
    const prepare = async (page) => {
        await page.waitForFunction((words) => document.querySelector(".cesium-credit-textContainer")?.textContent.includes(words), ATTRIBUTION, { timeout: TIMEOUT_MS, polling: 500 });
        credit = await page.textContent(".cesium-credit-textContainer");
        await page.waitForFunction(() => {
            window.shown.scene.requestRender();
            return window.shown.scene.primitives.get(0).tilesLoaded;
        }, null, { timeout: TIMEOUT_MS, polling: 500 });
        page.on("request", (request) => request.url().endsWith("/pick") && (asked = JSON.parse(request.postData())));
        await page.mouse.click(SIZE.width / 2, SIZE.height / 2);
        await page.waitForFunction(() => / m$|sky/.test(document.title), null, { timeout: TIMEOUT_MS });
        told = await page.title();
    };
    const shown = await show("cesium", both, { hide: ".cesium-widget-credits", prepare });
    score(t, "CesiumJS", "tileset", shown, await servedView(pose, fov), LEAST.city);
    assert.ok(credit.includes(ATTRIBUTION), credit);
    for (const key of ["lon", "lat", "heading", "pitch"]) assert.ok(Math.abs(asked.pose[key] - pose[key]) < 1e-5, key);
    assert.ok(Math.abs(asked.pose.height - pose.h) < 1e-3 && Math.abs(asked.pose.fov - fov) < 1e-6);
    const [lon, lat, height] = told.match(/-?[\d.]+/g).map(Number);
    const target = placeOfEnu(ORIGIN, [CAMERA.to[0], -CAMERA.to[2], CAMERA.to[1]]);
    assert.ok(Math.hypot((lon - target.lon) * 7e4, (lat - target.lat) * 1.1e5, height - target.h) < 30, `${told}: not what the camera looks at`);
});

// The city streams, by levels; the place that it looks at is one of the city.
test("three.js, the tileset by Spark", skip, async (t) => {
    const [recipe] = printed("three.js: Spark", "html");
    const at = placeOfEnu(ORIGIN, [CAMERA.to[0], -CAMERA.to[2], CAMERA.to[1]]);
    const stand = numbers(CAMERA.from.map((v, i) => v - CAMERA.to[i]));
    const shown = await show("spark-tiles", fill(recipe, { lon: at.lon, lat: at.lat, height: at.h, stand }));
    score(t, "three.js by 3d-tiles-renderer and Spark", "tileset", shown, await servedView(poseIn(enuToEcef(ORIGIN), CAMERA), FOV), LEAST.city);
});

// three.js r187 ends each Gaussian at 2 sigma, where it still has 13 % of its opacity.
const FILES = [
    ["three.js", "three.js by itself", ".plain.glb", 0.93],
    ["Spark", "three.js: Spark", ".spz", LEAST.city],
    ["PlayCanvas", "PlayCanvas and SuperSplat", ".sog", LEAST.city],
];
for (const [name, heading, form, least] of FILES)
    test(name, skip, async (t) => {
        const recipe = printed(heading, "html").at(-1);
        const shown = await show(name, fill(recipe, CAMERA_WORDS));
        score(t, name, form, shown, await servedView(poseIn(tile.transform, CAMERA), FOV), least);
    });

// city.js of a page, as its readers build it.
function build(script) {
    const { buildSync } = createRequire(join(HERE, "../../web/package.json"))("esbuild");
    const stdin = { contents: script, resolveDir: HERE };
    buildSync({ stdin, bundle: true, format: "esm", external: ["http://*"], logLevel: "error", outfile: join(dir, "city.js") });
}

test("Babylon.js", skip, async (t) => {
    const [[script], [recipe]] = [printed("Babylon.js", "js"), printed("Babylon.js", "html")];
    build(fill(script, CAMERA_WORDS));
    const shown = await show("babylon", recipe);
    score(t, "Babylon.js", ".spz", shown, await servedView(poseIn(tile.transform, CAMERA), FOV), LEAST.city);
});

// A command as printed, in a folder with the store.
function runCommands(text, more = {}) {
    const env = { ...process.env, PATH: `${join(dir, "bin")}:${process.env.PATH}`, npm_config_offline: "true" };
    const run = spawnSync("sh", ["-e", "-c", fill(text, more)], { cwd: dir, env, encoding: "utf8" });
    assert.equal(run.status, 0, `${text}\n${run.stdout}${run.stderr}`);
}

test("splat-transform", skip, () => {
    runCommands(printed("PlayCanvas and SuperSplat", "sh")[0]);
    assert.ok(statSync(join(dir, "city.ply")).size > 0);
});

// Maps: about a pixel, so that theirs are the server's.
const CITY = placeOfEnu(ORIGIN, [0, NORTH_M, 0]);
const MIDDLE = pixelOf(CITY, ZOOM);

// As MapLibre sees it from a place: its heights count from the map's ground.
const lookFrom = (pose) => async (page) => {
    await page.waitForFunction(() => window.city?.state.ready, null, { timeout: TIMEOUT_MS });
    await page.evaluate((p) => {
        const { map, city } = window;
        map.setMaxPitch(80); // or it stops at 60
        map.setVerticalFieldOfView(p.fov);
        map.jumpTo(map.calculateCameraOptionsFromCameraLngLatAltRotation([p.lon, p.lat], p.h - city.lower, p.heading, 90 + p.pitch));
    }, pose);
};

test("MapLibre, the city in 3-D", skip, async (t) => {
    const [recipe] = printed("MapLibre", "html");
    const pose = { ...poseIn(enuToEcef(ORIGIN), CAMERA), fov: FOV };
    const shown = fill(recipe, placeAt(MIDDLE, ZOOM)).replace(/const (map|city) =/g, "const $1 = window.$1 =");
    const picture = await show("maplibre-3d", shown, { hide: ".maplibregl-control-container", prepare: lookFrom(pose) });
    score(t, "MapLibre, in 3-D", "our module", picture, await servedView(pose, FOV), LEAST.city);
});

test("MapLibre, with a style of one's own", skip, async (t) => {
    const recipe = printed("MapLibre", "html")[2];
    const shown = await show("maplibre", fill(recipe, placeAt(MIDDLE, ZOOM)), { hide: ".maplibregl-control-container" });
    score(t, "MapLibre", "`map.json`", shown, await servedMap(MIDDLE, ZOOM, "webp"), LEAST.map);
});

// A style has a view, a relief and a background of its own: flat, from straight above, before black, it is the server's map. What
// the relief raises where: the test raster.
test("MapLibre, by one address", skip, async (t) => {
    const recipe = printed("MapLibre", "html")[1].replace("new maplibregl.Map(", "window.shown = new maplibregl.Map(");
    const flatten = async (page) => {
        await page.waitForFunction(() => window.shown?.isStyleLoaded());
        await page.evaluate((view) => {
            const map = window.shown;
            map.setPaintProperty("background", "background-color", "#000");
            map.removeLayer("hillshade");
            map.setTerrain(null);
            map.jumpTo(view);
        }, { center: placeAt(MIDDLE, ZOOM), zoom: ZOOM - 1, pitch: 0, bearing: 0 }); // its zooms count tiles of 512 pixels
    };
    const hide = ".maplibregl-control-container";
    const flat = await show("style-flat", fill(recipe), { hide, prepare: flatten });
    score(t, "MapLibre", "`style.json`", flat, await servedMap(MIDDLE, ZOOM, "webp"), LEAST.map);
    await show("style", fill(recipe), { hide }); // in its own view
});

test("MapLibre, raised by its terrain", skip, async () => {
    const [terrain] = printed("MapLibre", "js");
    const recipe = printed("MapLibre", "html")[2].replace("</script>", `${terrain}</script>`);
    await show("maplibre-terrain", fill(recipe, placeAt(MIDDLE, ZOOM))); // what lies where: the test raster
});

// A column behind the blue tower: what is above the tower is seen, what is below its roof is not. Then the city alone.
const TOWER = [BLUE_TOP[0], BLUE_TOP[1] + NORTH_M];
test("deck.gl", skip, async (t) => {
    const [east, , south] = CAMERA.from;
    const away = Math.hypot(TOWER[0] - east, TOWER[1] + south);
    const column = [0, 1].map((i) => TOWER[i] + (25 / away) * (TOWER[i] - [east, -south][i]));
    const [[script], [recipe]] = [printed("deck.gl", "js"), printed("deck.gl", "html")];
    const shown = script.replace(/const (map|city|overlay) =/g, "const $1 = window.$1 =");
    build(fill(shown, placeOfEnu(ORIGIN, [...column, 0])));
    const pose = { ...poseIn(enuToEcef(ORIGIN), CAMERA), fov: FOV };
    const look = (without) => async (page) => {
        await page.waitForFunction(() => window.overlay);
        await lookFrom(pose)(page);
        if (without) await page.evaluate(() => window.overlay.setProps({ layers: [] }));
    };
    const hide = ".maplibregl-control-container";
    const both = await show("deck", fill(recipe), { hide, prepare: look(false) });
    const at = (up) => both.picture.mean(...project(ORIGIN, pose, [...column, up], SIZE.width, SIZE.height), 1);
    const [[r, g, b], [dr, dg, db]] = [at(52), at(20)];
    assert.ok(g > r + 60 && b > r + 60, `the column above the tower: ${[r, g, b]}`);
    assert.ok(db > dr + 60 && db > dg + 60, `the tower in front of it: ${[dr, dg, db]}`);
    const alone = await show("deck-alone", fill(recipe), { hide, prepare: look(true) });
    score(t, "deck.gl over MapLibre", "our module", alone, await servedView(pose, FOV), LEAST.city);
});

test("PMTiles in MapLibre", skip, async (t) => {
    const [commands] = printed("PMTiles", "sh");
    runCommands(commands);
    const [recipe] = printed("PMTiles", "html");
    const shown = await show("pmtiles", fill(recipe, placeAt(MIDDLE, ZOOM)), { hide: ".maplibregl-control-container" });
    score(t, "MapLibre", "PMTiles", shown, await servedMap(MIDDLE, ZOOM, "webp"), LEAST.map);
});

const MAPS = [
    ["Leaflet", 0, "`map.json`", "webp", ".leaflet-control-container", ".leaflet-control-attribution"],
    ["OpenLayers", 0, "`map.json`", "webp", ".ol-control", ".ol-attribution"],
    ["OpenLayers", 1, "`wmts.xml`", "png", ".ol-control", ".ol-attribution"],
];
for (const [name, i, form, type, hide, credits] of MAPS)
    test(`${name} by ${form}`, skip, async (t) => {
        const recipe = printed(name, "html")[i];
        const types = new Set();
        const watch = (response) => /\/map\/\d/.test(response.url()) && response.status() === 200 && types.add(response.headers()["content-type"]);
        const credited = (page) => page.waitForFunction(([where, words]) => document.querySelector(where)?.textContent.includes(words), [credits, ATTRIBUTION]);
        const shown = await show(`map-${name}-${i}`, fill(recipe, placeAt(MIDDLE, ZOOM)), { hide, watch, prepare: credited });
        assert.deepEqual([...types], [`image/${type}`], "one form of tiles");
        score(t, name, form, shown, await servedMap(MIDDLE, ZOOM, type), LEAST.map);
    });

test("GDAL", skip, async (t) => {
    const { maxzoom } = await getJson(`${source.url}/d/${words.ds}/map.json`);
    const [x, y] = pixelOf(CITY, maxzoom);
    const metres = 40075016.685578488 / (TILE * 2 ** maxzoom); // EPSG:3857's, of a pixel
    const half = BOX / 2;
    const at = (px, of) => metres * (px - (TILE * 2 ** maxzoom) / 2) * of;
    const box = { west: at(x - half, 1), east: at(x + half, 1), north: at(y - half, -1), south: at(y + half, -1) };
    const want = await servedMap([x, y], maxzoom, "png", { width: BOX, height: BOX });
    runCommands(printed("GDAL and QGIS", "sh")[0], box);
    runCommands("gdal_translate -q -of PNG -b 1 -b 2 -b 3 city.tif city.png");
    score(t, "GDAL", "`wmts.xml`", { picture: decodePng(readFileSync(join(dir, "city.png"))) }, want, LEAST.map);
});

test("curl", skip, () => {
    const [commands] = printed("curl", "sh");
    const pose = poseIn(enuToEcef(ORIGIN), CAMERA);
    const words = Object.fromEntries(Object.entries(eyeWords(pose)).map(([name, value]) => [name, value.toFixed(6)]));
    runCommands(commands, { ...words, lon: CITY.lon.toFixed(6), lat: CITY.lat.toFixed(6) });
    runCommands(`citysplat export -q city.tiles -o exported.sog`);
    assert.ok(readFileSync(join(dir, "city.sog")).equals(readFileSync(join(dir, "exported.sog"))), "not what export writes");
    assert.ok(statSync(join(dir, "view.jpg")).size > 1000);
});

// ---- the page of a server ----

test("a server fills all of it for a dataset", skip, async (t) => {
    const url = `${source.url}/d/${words.ds}/use`;
    const response = await fetch(url);
    assert.equal(response.status, 200);
    const { page, log, close } = await openPage(url, { width: 1024, height: 640 });
    t.after(close);
    for (const colorScheme of ["dark", "light"]) {
        await page.emulateMedia({ colorScheme });
        assert.deepEqual(await findFaults(page), [], colorScheme);
    }
    const codes = await page.locator("pre").allTextContents();
    const left = codes.flatMap((code) => [...code.matchAll(/\{(\w+)\}/g)].map((m) => m[1]));
    assert.deepEqual([...new Set(left)].filter((word) => !["files", "x", "y", "z"].includes(word)), []);
    // What is printed in the text is on the page, with this city's words.
    const headings = await page.locator("h2").allTextContents();
    for (const name of ["MapLibre", "CesiumJS", "three.js: Spark", "deck.gl", "OpenLayers", "Leaflet", "GDAL and QGIS", "curl"]) assert.ok(headings.includes(name), name);
    assert.ok(codes.some((code) => code.includes(`fromUrl("${source.url}/d/${words.ds}/tileset.json"`)));
    // The module's address is one for ever.
    const [, viewer] = /src="(http[^"]*viewer-\w+\.js)"/.exec(codes[0]);
    const module = await fetch(viewer);
    assert.equal(module.status, 200);
    assert.match(module.headers.get("cache-control"), /immutable/);
    const old = await fetch(viewer.replace(/-\w+\.js/, "-000000000000.js"), { redirect: "manual" });
    assert.equal(old.status, 307);
    assert.equal(old.headers.get("location"), "viewer.js");
    const plain = await fetch(`${source.url}/viewer.js`);
    assert.match(plain.headers.get("link"), new RegExp(viewer.split("/").at(-1)));
    // Its tile is there, its size is near, and its camera sees the city.
    const [tileUrl] = codes.flatMap((code) => code.match(/http[^"]*\/t\/\d+\/\d+\/\d+\.spz/) ?? []);
    assert.ok((await getBytes(tileUrl)).length > 100);
    const [view] = codes.flatMap((code) => code.match(/http[^' ]*\/static\/[^' ]*\.jpg/) ?? []);
    const picture = await decode(await getBytes(view), "jpeg");
    assert.ok(picture.mean(picture.width / 2, picture.height / 2, 40).some((v) => v > 8), view);
    // The page of three.js as it stands there shows the city.
    const streams = codes.find((code) => code.includes("3d-tiles-renderer/plugins")).replace(/https:\/\/cdn\.jsdelivr\.net\/npm\/((?:@[\w-]+\/)?[\w.-]+)@[\w.-]+/g, `${words.npm}/$1`);
    writeFileSync(join(dir, "use.html"), streams.replace("<meta", '<link rel="icon" href="data:,"><meta'));
    const opened = await openPage(`${words.files}/use.html`, SIZE);
    t.after(opened.close);
    const lit = async () => decodePng(await opened.page.screenshot({ timeout: TIMEOUT_MS })).mean(SIZE.width / 2, SIZE.height / 2, 20).some((v) => v > 8);
    for (let i = 0; i < 60 && !(await lit()); i++) await opened.page.waitForTimeout(500);
    assert.ok(await lit(), "nothing is in sight");
    assert.deepEqual(log, []);
});

test("3d-tiles-tools", skip, () => {
    const [commands] = printed("3d-tiles-tools", "sh");
    const [z, x, y] = tile.url.split("/").slice(-3);
    runCommands(commands, { z, x, y });
    assert.deepEqual(readdirSync(join(dir, "city")).sort(), ["t", "tiles.json", "tileset.json"]);
    for (const name of ["again.3tz", "analysed"]) assert.ok(statSync(join(dir, name)).size > 0, name);
});

test("no block of the page is left", skip, () => {
    const left = blocks(DOC).filter(({ code }) => !used.has(code)).map(({ code }) => code);
    // Its package is not among those of the tests: arcgis.mjs runs it.
    assert.deepEqual(left.filter((code) => !code.includes("GaussianSplatLayer")), []);
});
