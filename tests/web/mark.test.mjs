// The page of `citysplat mark`: points of a procedural city are marked in its photographs by mouse, touch and keys. Places
// are expected where they are, residuals tell a wrong mark, every change is in the file, and `ingest --gcp` makes of it
// the city where it lies.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { spawn, spawnSync } from "node:child_process";
import { cpSync, mkdtempSync, readFileSync, renameSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";

import { closeAll, openPage } from "./lib/browser.mjs";
import { placeOfEnu } from "./lib/geo.mjs";
import { BIN, GIVEN_TILES, MOCK } from "./lib/source.mjs";

const skip = { skip: MOCK || GIVEN_TILES ? "needs the program" : false };
const PLACES = { north: [6, 24, 0], "south-west": [-20, -22, 0], east: [25, -4, 0], roof: [-4, 4, 8], west: [-24, 10, 3] };
const RAISED_M = 30; // heights of the list count from another surface than the photographs'

const TIMEOUT_MS = 120000;

let dir;
let truth; // the scene by GPS without errors
let opened;
let server;

function run(...args) {
    const done = spawnSync(BIN, args, { encoding: "utf8", cwd: dir });
    assert.equal(done.status, 0, `citysplat ${args.join(" ")}\n${done.stdout}${done.stderr}`);
    return done.stdout + done.stderr;
}

const started = [];
const startMark = (...args) => start("city/images", "city/sparse/0", ...args);

function start(...args) {
    const child = spawn(BIN, ["mark", ...args, "--port", "0"], { cwd: dir });
    started.push(child);
    let said = "";
    return new Promise((resolve, reject) => {
        const hear = (chunk) => {
            said += chunk;
            const url = /http:\S+#[0-9a-f]{32}/.exec(said)?.[0];
            if (url) resolve({ url, child, close: () => new Promise((done) => (child.once("exit", done), child.kill("SIGINT"))) });
        };
        child.stdout.on("data", hear);
        child.stderr.on("data", hear);
        child.once("exit", (code) => reject(new Error(`citysplat mark: exit ${code}\n${said}`)));
    });
}

// Where a place is in a photograph of the scene; null: outside.
function pixel(image, enu) {
    const { world_to_camera: m, fx, fy, cx, cy, width, height } = image.camera;
    const t = [0, 1, 2].map((i) => m[4 * i] * enu[0] + m[4 * i + 1] * enu[1] + m[4 * i + 2] * enu[2] + m[4 * i + 3]);
    const at = [(fx * t[0]) / t[2] + cx, (fy * t[1]) / t[2] + cy];
    return t[2] > 0 && at[0] > 4 && at[1] > 4 && at[0] < width - 4 && at[1] < height - 4 ? at : null;
}

const list = () => readFileSync(join(dir, "gcp.csv"), "utf8").trim().split("\n").filter((line) => !line.startsWith("#"));
const state = () =>
    opened.page.evaluate(() => {
        const { desk, photo, view } = window.mark;
        return { point: desk.point, points: desk.points, spots: desk.spots, photo, mark: view.mark, expected: view.expected, photographs: desk.photographs };
    });
const settled = () =>
    opened.page.waitForFunction(() => window.mark?.ready && window.mark.photo >= 0, null, { timeout: TIMEOUT_MS });
const trueAt = (name, photo, photographs) => pixel(truth.images.find((one) => one.name === photographs[photo].name), PLACES[name]);
const distance = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]);

// A click at a pixel of the photograph, near enough that a pixel of the screen is little.
async function click(at, tap = false) {
    const { page } = opened;
    const where = await page.evaluate((at) => {
        const { view } = window.mark;
        view.look(at, 0.1);
        const [x, y] = view.toScreen(at);
        const box = document.getElementById("photo").getBoundingClientRect();
        return [x + box.left, y + box.top];
    }, at);
    await (tap ? page.touchscreen.tap(...where) : page.mouse.click(...where));
    await settled();
}

before(async () => {
    if (skip.skip) return;
    dir = mkdtempSync(join(tmpdir(), "citysplat-mark-"));
    run(..."synth -q -o city --photos 10 --width-px 320 --height-px 240 --extent-m 80 --points 3000".split(" "));
    run(..."ingest -q city/images city/sparse/0 -o by-gps --no-exposure".split(" "));
    truth = JSON.parse(readFileSync(join(dir, "by-gps/scene.json"), "utf8"));
    const { lon_deg: lon, lat_deg: lat, h_m: h } = truth.origin;
    const rows = Object.entries(PLACES).map(([name, enu]) => {
        const at = placeOfEnu({ lon, lat, h }, enu);
        return `${name},${at.lon.toFixed(10)},${at.lat.toFixed(10)},${(at.h + RAISED_M).toFixed(4)}`;
    });
    writeFileSync(join(dir, "points.csv"), ["name,lon,lat,height", ...rows].join("\n"));
    server = await startMark("--points", "points.csv", "-o", "gcp.csv");
    opened = await openPage(server.url, { width: 1400, height: 800, hasTouch: true });
    await settled();
});
after(async () => {
    await closeAll(opened, server);
    for (const child of started) child.kill("SIGKILL"); // of tests that failed
    if (dir) rmSync(dir, { recursive: true, force: true });
});

test("points are expected by their coordinates, and after two marks where they are", skip, async () => {
    let now = await state();
    assert.deepEqual(now.points.map((one) => one.name), Object.keys(PLACES));
    assert.ok(now.spots.length > 3 && now.points[0].source === "frame");
    const middle = ({ expected: [x, y] }) => distance([x, y], [160, 120]);
    const order = now.spots.map(middle);
    assert.deepEqual(order, [...order].sort((a, b) => a - b), "the nearest to the middle first");
    const first = trueAt("north", now.photo, now.photographs);
    assert.ok(distance(now.expected, first) > 3, "heights from another surface");
    for (let k = 0; k < 2; k++) {
        now = await state();
        await click(trueAt("north", now.photo, now.photographs), k === 1);
        await opened.page.keyboard.press("n");
        await settled();
    }
    now = await state();
    assert.equal(now.points[0].source, "marks");
    assert.ok(distance(now.expected, trueAt("north", now.photo, now.photographs)) < 1.5);
    await opened.page.locator("#points button").nth(1).click(); // by the frame, which the first has moved
    await settled();
    now = await state();
    assert.equal(now.points[1].source, "frame");
    const off = distance(now.expected, trueAt("south-west", now.photo, now.photographs));
    assert.ok(off < 1.5, `${off} px`);
    assert.equal(list().length, 3, "a head and two marks");
});

test("a mark that is 30 px off shows at once; undo, redo, keys, delete", skip, async () => {
    const { page } = opened;
    for (let k = 0; k < 4; k++) {
        const { photo, photographs } = await state();
        const [x, y] = trueAt("south-west", photo, photographs);
        await click(k === 3 ? [x + 20, y - 22] : [x, y]);
        if (k < 3) await page.keyboard.press("n");
        await settled();
    }
    let now = await state();
    const wrong = now.spots.find((one) => one.photo === now.photo);
    assert.ok(wrong.suspect && Math.abs(wrong.residual - 29.7) < 2, JSON.stringify(wrong));
    assert.ok(now.spots.filter((one) => one.mark && one !== wrong).every((one) => one.residual < 1));
    assert.match(await page.textContent("#photos [aria-current]"), /⚠ (29|30|31)\.\d px, contradicts/);
    assert.match(await page.textContent("#points [aria-current]"), /4 marks.*contradicts/);
    await page.keyboard.press("Control+z");
    await settled();
    assert.equal((await state()).points[1].marks, 3);
    assert.match(await page.textContent("#points [aria-current]"), /3 marks.*✓ done/);
    await page.keyboard.press("Control+y");
    await settled();
    assert.equal((await state()).points[1].marks, 4);
    assert.equal(list().length, 7);
    await page.locator("#photo").focus();
    await page.keyboard.press("Delete");
    await settled();
    assert.deepEqual([(await state()).points[1].marks, list().length], [3, 6]);
    await page.keyboard.press("Enter"); // at the cross, where the point is expected
    await page.waitForFunction(() => window.mark.ready && window.mark.view.mark, null, { timeout: TIMEOUT_MS });
    const before = (await state()).mark;
    await page.evaluate(() => { // at once: a busy machine would make two changes of two presses
        for (const more of [{ key: "ArrowRight" }, { key: "ArrowUp", shiftKey: true }]) dispatchEvent(new KeyboardEvent("keydown", more));
    });
    await settled();
    const { mark, spots, photo } = await state();
    assert.ok(Math.abs(mark[0] - before[0] - 1) < 2e-3 && Math.abs(mark[1] - before[1] + 0.1) < 2e-3, `${before} ${mark}`);
    assert.ok(spots.find((one) => one.photo === photo).residual < 1.5);
    assert.match(list().at(-1), new RegExp(`^south-west,.*,${mark[0]},${mark[1]},`));
    await page.keyboard.press("Control+z"); // both presses were one change
    await settled();
    assert.deepEqual((await state()).mark, before);
});

test("a mark is dragged, the wheel keeps what is below it, and a tablet's button goes on", skip, async () => {
    const { page } = opened;
    const places = () => page.evaluate(() => {
        const { view } = window.mark;
        const box = document.getElementById("photo").getBoundingClientRect();
        const [x, y] = view.toScreen(view.mark);
        return [x + box.left, y + box.top];
    });
    const from = await places();
    await page.mouse.move(...from);
    await page.mouse.wheel(0, -240);
    const near = await places();
    assert.ok(distance(from, near) < 1, "the wheel zooms about the pointer");
    const before = (await state()).mark;
    await page.mouse.down();
    await page.mouse.move(near[0] + 60, near[1] + 20, { steps: 4 });
    await page.mouse.up();
    await settled();
    const moved = (await state()).mark;
    assert.ok(moved[0] > before[0] + 1 && moved[1] > before[1] + 0.3, `${before} ${moved}`);
    await page.locator("#undo").click();
    await settled();
    assert.deepEqual((await state()).mark, before);
    const { photo } = await state();
    await page.locator("#set").click(); // it is marked: to the next
    await settled();
    assert.notEqual((await state()).photo, photo);
});

test("two fingers zoom, and both stay on what they hold", skip, async () => {
    const { page } = opened;
    const box = await page.locator("#photo").boundingBox();
    const touch = await page.context().newCDPSession(page);
    const send = (type, points) =>
        touch.send("Input.dispatchTouchEvent", { type, touchPoints: points.map(([x, y], id) => ({ x: box.x + x, y: box.y + y, id })) });
    const held = (points) =>
        page.evaluate((points) => {
            const { view } = window.mark;
            const [x0, y0] = view.toScreen([0, 0]);
            const unit = view.toScreen([1, 0])[0] - x0;
            return { unit, at: points.map(([x, y]) => [(x - x0) / unit, (y - y0) / unit]) };
        }, points);
    const marks = (await state()).points.map((one) => one.marks);
    await page.evaluate(() => window.mark.view.fit());
    const from = [[300, 300], [420, 360]];
    const to = [[240, 270], [520, 410]];
    const before = await held(from);
    await send("touchStart", [from[0]]);
    await send("touchStart", from);
    for (let k = 1; k <= 6; k++)
        await send("touchMove", from.map(([x, y], i) => [x + ((to[i][0] - x) * k) / 6, y + ((to[i][1] - y) * k) / 6]));
    await send("touchEnd", []);
    const now = await held(to);
    const grown = distance(...to) / distance(...from);
    assert.ok(Math.abs(now.unit / before.unit / grown - 1) < 0.05, `${before.unit} ${now.unit}`);
    for (const k of [0, 1]) assert.ok(distance(before.at[k], now.at[k]) * now.unit < 6, `finger ${k}: ${before.at[k]} ${now.at[k]}`);
    await settled();
    assert.deepEqual((await state()).points.map((one) => one.marks), marks, "a pinch marks nothing");
});

test("who has not the address is refused, and another page's change is told", skip, async () => {
    const url = new URL(server.url);
    const token = url.hash.slice(1);
    const ask = (path, init = {}) => fetch(new URL(`mark/${path}`, url), init);
    const put = (body, headers) => ask("marks", { method: "PUT", body: JSON.stringify(body), headers });
    const mine = { Authorization: `Bearer ${token}` };
    assert.equal((await ask("survey")).status, 401);
    assert.equal((await ask("photographs/0", { headers: { Authorization: `Bearer ${"0".repeat(32)}` } })).status, 401);
    assert.equal((await ask("photographs/..%2f..%2fpoints.csv", { headers: mine })).status, 400);
    assert.equal((await ask("photographs/10", { headers: mine })).status, 404);
    assert.equal((await put({}, { ...mine, Origin: "http://example.org" })).status, 401);
    assert.equal((await put({ revision: 0, point: 0, photo: 0 }, mine)).status, 400);
    const photo = await ask("photographs/0", { headers: mine });
    assert.equal(photo.headers.get("content-type"), "image/jpeg");
    assert.ok(!Buffer.from(await photo.arrayBuffer()).subarray(0, 4096).includes("Exif"), "without EXIF, which would turn it");
    const { revision } = await (await ask("survey", { headers: mine })).json();
    assert.equal((await put({ revision: revision - 1, point: 2, photo: 0, at: [10, 10] }, mine)).status, 409);
    assert.equal((await put({ revision, point: 2, photo: 0, at: [10, 1000] }, mine)).status, 422);
    assert.equal((await put({ revision, point: 2, photo: 0, at: [10, 10] }, mine)).status, 200);
    const { page } = opened;
    await page.keyboard.press("Enter");
    await page.waitForSelector(".banner");
    assert.match(await page.textContent(".banner"), /changed elsewhere/);
    await page.locator(".banner button").click();
    await settled();
    assert.equal((await state()).points[2].marks, 1);
    opened.log.splice(0); // the refusal, as the browser tells it
    const { revision: now } = await (await ask("survey", { headers: mine })).json();
    assert.equal((await put({ revision: now, point: 2, photo: 0, at: null }, mine)).status, 200);
    await page.reload();
    await settled();
});

test("ingest reads the list as it is, and the city lies where the points say", skip, async () => {
    for (const [k, name] of Object.keys(PLACES).entries()) {
        await opened.page.evaluate((k) => window.mark.choose(k), k);
        await settled();
        for (let i = 0; i < 3; i++) {
            const { spots, photographs } = await state();
            const { photo } = spots[i];
            const at = trueAt(name, photo, photographs);
            await opened.page.evaluate(([photo, at]) => window.mark.desk.set(photo, at), [photo, at]);
        }
    }
    assert.deepEqual(opened.log, []);
    const said = run(..."ingest -q city/images city/sparse/0 -o by-gcp --gcp gcp.csv --no-exposure".split(" "));
    const report = JSON.parse(readFileSync(join(dir, "by-gcp/report.json"), "utf8"));
    assert.ok(report.ground_control, said);
    const scene = JSON.parse(readFileSync(join(dir, "by-gcp/scene.json"), "utf8"));
    const eye = ({ world_to_camera: m }) => [0, 1, 2].map((i) => -(m[i] * m[3] + m[4 + i] * m[7] + m[8 + i] * m[11]));
    for (const [i, image] of scene.images.entries()) {
        const place = (s, one, up) => {
            const at = eye(one.camera);
            return placeOfEnu({ lon: s.origin.lon_deg, lat: s.origin.lat_deg, h: s.origin.h_m + up }, at);
        };
        const [is, was] = [place(scene, image, 0), place(truth, truth.images[i], RAISED_M)];
        const off = [(is.lon - was.lon) * 75000, (is.lat - was.lat) * 111000, is.h - was.h];
        assert.ok(Math.hypot(...off) < 0.15, `${image.name}: ${off}`);
    }
});

test("a second start goes on with the list, as gcp_list.txt too", skip, async () => {
    const marks = list().length - 1;
    await server.close();
    const again = await startMark("--points", "gcp.csv", "-o", "gcp_list.txt");
    const refused = spawnSync(BIN, ["mark", "city/images", "city/sparse/0", "-o", "none.txt"], { encoding: "utf8", cwd: dir });
    assert.match(refused.stderr, /--points FILE/);
    const url = new URL(again.url);
    const headers = { Authorization: `Bearer ${url.hash.slice(1)}` };
    const survey = await (await fetch(new URL("mark/survey", url), { headers })).json();
    assert.equal(survey.points.reduce((sum, one) => sum + one.marks, 0), marks);
    const body = JSON.stringify({ revision: 0, point: 0, photo: 0, at: null });
    await fetch(new URL("mark/marks", url), { method: "PUT", body, headers });
    await again.close();
    const lines = readFileSync(join(dir, "gcp_list.txt"), "utf8").trim().split("\n");
    assert.equal(lines[0], "EPSG:4326");
    assert.match(lines[1], /^7\.\d+\t47\.\d+\t[\d.]+\t[\d.]+\t[\d.]+\tIMG_\d+\.jpg\tnorth$/);
});

test("a scene knows its photographs, its model and its control; Metashape's XML is read by ingest", skip, async () => {
    const marks = list().length - 1;
    const survey = async (server) => {
        const url = new URL(server.url);
        const headers = { Authorization: `Bearer ${url.hash.slice(1)}` };
        return { url, headers, ...(await (await fetch(new URL("mark/survey", url), { headers })).json()) };
    };
    const scene = await start("by-gcp", "-o", "markers.xml"); // its own list of points and marks
    const { url, headers, points, photographs, revision } = await survey(scene);
    assert.deepEqual(points.map((one) => one.name), Object.keys(PLACES));
    assert.equal(points.reduce((sum, one) => sum + one.marks, 0), marks);
    assert.equal(photographs.length, 10);
    const one = await (await fetch(new URL("mark/points/0", url), { headers })).json();
    const free = one.spots.find((spot) => !spot.mark);
    const body = JSON.stringify({ revision, point: 0, photo: free.photo, at: free.expected });
    assert.equal((await fetch(new URL("mark/marks", url), { method: "PUT", body, headers })).status, 200);
    await scene.close();
    const xml = readFileSync(join(dir, "markers.xml"), "utf8");
    assert.equal(xml.split("<location ").length - 1, marks + 1);
    assert.match(xml, /<camera id="\d+" label="IMG_\d+"\/>/);
    run(..."ingest -q city/images city/sparse/0 -o by-xml --gcp markers.xml --no-exposure".split(" "));
    const { control } = JSON.parse(readFileSync(join(dir, "by-xml/report.json"), "utf8")).ground_control;
    assert.ok(control.points === 5 && control.rmse_plan_m < 0.1, JSON.stringify(control));
    const fresh = await start("by-gps", "--points", "points.csv", "-o", "fresh.txt");
    assert.equal((await survey(fresh)).points.length, 5);
    await fresh.close();
    renameSync(join(dir, "city/images"), join(dir, "city/elsewhere"));
    const gone = spawnSync(BIN, ["mark", "by-gps", "--points", "points.csv"], { encoding: "utf8", cwd: dir });
    renameSync(join(dir, "city/elsewhere"), join(dir, "city/images"));
    assert.equal(gone.status, 1);
    assert.match(gone.stderr, /folder of photographs.*citysplat mark PHOTOGRAPHS MODEL --scene by-gps/);
    const nothing = spawnSync(BIN, ["mark", "city"], { encoding: "utf8", cwd: dir });
    assert.match(nothing.stderr, /city: no scene/);
});

// The photograph in 22 megapixels, with squares of two pixels where a point is.
async function enlarge(page, bytes, at) {
    const url = await page.evaluate(
        async ([bytes, [width, height], [x, y]]) => {
            const bitmap = await createImageBitmap(new Blob([new Uint8Array(bytes)], { type: "image/jpeg" }));
            const canvas = Object.assign(document.createElement("canvas"), { width, height });
            const c = canvas.getContext("2d");
            c.drawImage(bitmap, 0, 0, width, height);
            for (let row = 0; row < 64; row++)
                for (let column = 0; column < 64; column++) {
                    c.fillStyle = (row + column) % 2 ? "#fff" : "#000";
                    c.fillRect(Math.round(x) - 64 + 2 * column, Math.round(y) - 64 + 2 * row, 2, 2);
                }
            return canvas.toDataURL("image/jpeg", 0.95);
        },
        [[...bytes], LARGE, at],
    );
    const large = Buffer.from(url.slice(url.indexOf(",") + 1), "base64");
    let app1 = 2; // its EXIF, with GPS
    while (bytes[app1 + 1] !== 0xe1) app1 += 2 + bytes.readUInt16BE(app1 + 2);
    return Buffer.concat([large.subarray(0, 2), bytes.subarray(app1, app1 + 2 + bytes.readUInt16BE(app1 + 2)), large.subarray(2)]);
}
const LARGE = [5472, 4104];

test("of a photograph of 22 megapixels a smaller picture comes, and the part that is looked at", skip, async () => {
    const { page } = opened;
    const grow = LARGE[0] / 320;
    const name = truth.images.find((one) => pixel(one, PLACES.north)).name;
    const [u, v] = pixel(truth.images.find((one) => one.name === name), PLACES.north);
    const at = [u * grow, v * grow];
    cpSync(join(dir, "city/images"), join(dir, "large"), { recursive: true });
    const file = join(dir, "large", name);
    writeFileSync(file, await enlarge(page, readFileSync(file), at));
    const large = await start("large", "city/sparse/0", "--points", "points.csv", "-o", "large.csv");
    opened.log.splice(0); // of the server that has ended
    const asked = [];
    page.on("response", (response) => asked.push(response));
    await page.goto(large.url);
    await settled();
    const photo = (await state()).photographs.findIndex((one) => one.name === name);
    const about = (await state()).photographs[photo];
    assert.deepEqual([about.width, about.height], LARGE);
    await page.evaluate((photo) => window.mark.openPhoto(photo), photo);
    await settled();
    const whole = asked.filter((one) => one.url().endsWith(`/mark/photographs/${photo}`)).at(-1);
    assert.ok((await whole.body()).length < 2e6);
    const size = await page.evaluate(async (photo) => {
        const bitmap = await window.mark.bitmap(photo);
        window.mark.view.fit();
        return [bitmap.width, bitmap.height];
    }, photo);
    assert.deepEqual(size, [2048, 1536]);
    await page.waitForFunction(() => window.mark.view.sharp, null, { timeout: TIMEOUT_MS });
    const parts = () => asked.filter((one) => one.url().includes(`/mark/photographs/${photo}/`)).length;
    const contrast = () =>
        page.evaluate(async (at) => {
            for (let k = 0; k < 2; k++) await new Promise(requestAnimationFrame); // what came is drawn
            const canvas = document.getElementById("photo");
            const [x, y] = window.mark.view.toScreen(at);
            const { data } = canvas.getContext("2d").getImageData(x - 40, y - 40, 80, 80);
            let [least, most] = [255, 0];
            for (let i = 1; i < data.length; i += 4) [least, most] = [Math.min(least, data[i]), Math.max(most, data[i])];
            return most - least;
        }, [at[0] + 32, at[1] + 32]); // beside the signs
    const before = parts();
    assert.ok(before <= 4, `${before} parts for the whole photograph`); // where the mouse's loupe is
    await page.evaluate((at) => window.mark.view.look([at[0] + 32, at[1] + 32], 0.02), at);
    await page.waitForFunction(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(window.mark.view.sharp)))), null, {
        timeout: TIMEOUT_MS,
    });
    assert.ok(parts() > 0 && parts() - before <= 4, `${before}, then ${parts()} parts of 30 came`);
    assert.ok((await contrast()) > 200, `contrast ${await contrast()}`);
    await click(at);
    const { mark, spots } = await state();
    assert.ok(distance(mark, at) < 2 && spots.find((one) => one.photo === photo).mark, `${mark}`);
    const row = readFileSync(join(dir, "large.csv"), "utf8").split("\n").find((line) => line.startsWith("north,")).split(",");
    const [px, py] = [Number(row[4]), Number(row[5])]; // COLMAP's pixels
    assert.ok(distance([px, py], [u, v]) < 0.2, row.join());
    const token = { Authorization: `Bearer ${new URL(large.url).hash.slice(1)}` };
    const status = async (path) => (await fetch(new URL(`mark/photographs/${path}`, large.url), { headers: token })).status;
    assert.deepEqual([await status(`${photo}/5/4`), await status(`${photo}/6/0`), await status(`${photo}/0/5`), await status(`99/0/0`)], [200, 404, 404, 404]);
    assert.equal((await fetch(new URL(`mark/photographs/${photo}/0/0`, large.url))).status, 401);
    assert.deepEqual(opened.log, []);
    await large.close();
});
