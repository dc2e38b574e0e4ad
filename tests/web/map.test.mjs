// The city as a map: places by click, lengths, areas and heights, GeoJSON out and in, labels, walking.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { after, before, test } from "node:test";

import { barePicture, closeAll, lookViewer, nextFrames, openViewer, waitForViewer } from "./lib/browser.mjs";
import { measureContent, rmsDifference, SOUTH } from "./lib/checks.mjs";
import { ORIGIN, RED_TOP } from "./lib/city.mjs";
import { placeOfEnu, project } from "./lib/geo.mjs";
import { decodePng } from "./lib/png.mjs";
import { MOCK, GIVEN_TILES, openSource } from "./lib/source.mjs";

const SIZE = { width: 1000, height: 640 };
const skip = { skip: GIVEN_TILES ? "needs the test city" : false };
const M_PER_DEG = 111_320;

let source;
let viewer;
let page;
before(async () => {
    if (skip.skip) return;
    source = await openSource();
    viewer = await openViewer(source.url, SIZE, SOUTH);
    page = viewer.page;
});
after(() => closeAll(viewer, source));

const pixelOf = (enu) => project(ORIGIN, SOUTH, enu, SIZE.width, SIZE.height);

async function clickOn(enu) {
    const [x, y] = pixelOf(enu);
    await page.mouse.click(x, y);
    await nextFrames(page);
}

test("a click tells latitude, longitude and height of what is seen there", skip, async () => {
    const roof = [RED_TOP[0], RED_TOP[1], RED_TOP[2] + 0.5];
    await clickOn(roof);
    const text = await page.textContent("#place-text");
    assert.match(text, /^lat [\d.]+°, lon [\d.]+°, [\d.]+ m above the ellipsoid, about \d+ m above the ground$/);
    const [lat, lon, h, above] = text.match(/[\d.]+/g).map(Number);
    assert.ok(Math.abs(above - roof[2]) < 5, `${above} m above the ground, the roof is ${roof[2]} m high`);
    const want = placeOfEnu(ORIGIN, roof);
    const east = (lon - want.lon) * M_PER_DEG * Math.cos((want.lat * Math.PI) / 180);
    const north = (lat - want.lat) * M_PER_DEG;
    assert.ok(Math.hypot(east, north) < 2, `${text}: ${Math.hypot(east, north)} m beside`);
    assert.ok(Math.abs(h - want.h) < 1.5, `${text}, want ${want.h} m`);
    await page.click("#place-close");
    assert.equal(await page.isVisible("#place"), false);
});

test("a length and an area, and both as GeoJSON", skip, async () => {
    await page.keyboard.press("m");
    const corners = [
        [-20, -50, 0],
        [15, -50, 0],
        [15, -25, 0],
        [-20, -25, 0],
    ];
    await clickOn(corners[0]);
    await clickOn(corners[1]);
    const said = await page.textContent("#measure-text");
    assert.ok(Math.abs(parseFloat(said) - 35) < 3, `${said}, want 35 m`);
    await clickOn(corners[2]);
    await clickOn(corners[3]);
    await page.check('input[name="measure"][value="area"]', { force: true });
    const words = (await page.textContent("#measure-text")).replace(/,(\d{3})/g, "$1");
    assert.ok(Math.abs(parseFloat(words) - 875) < 90, `${words}, want 875 m²`);
    // Each side has its length, and the whole its area.
    const labels = (await page.locator(".citysplat-label").allTextContents()).sort((a, b) => parseFloat(a) - parseFloat(b));
    assert.equal(labels.length, 5, labels.join());
    [25, 25, 35, 35].forEach((want, i) => assert.ok(Math.abs(parseFloat(labels[i]) - want) < 3, `${labels}, want ${want} m`));
    // The server adds the volume, with what it may be wrong by.
    if (!MOCK) await page.click("#measure-volume");
    if (!MOCK) await page.waitForFunction(() => /volume [\d,.]+ m³ above and [\d,.]+ m³ below .*, ± [\d,.]+ m³/.test(document.getElementById("measure-text").textContent));
    const coming = page.waitForEvent("download");
    await page.click("#measure-save");
    const file = await (await coming).path();
    const { type, features } = JSON.parse(readFileSync(file, "utf8"));
    assert.deepEqual([type, features[0].geometry.type], ["FeatureCollection", "Polygon"]);
    assert.equal(features[0].geometry.coordinates[0].length, 5);
    assert.ok(Math.abs(features[0].properties.area_m2 - 875) < 90);
    if (!MOCK) assert.ok(features[0].properties.volume_error_m3 >= 0);
    await page.click("#measure-close");
    assert.equal(await page.evaluate(() => window.citysplat.viewer.overlay.group.children.length), 0);
});

const redPixels = (png) => {
    let n = 0;
    for (let y = 0; y < png.height; y++)
        for (let x = 0; x < png.width; x++) {
            const [r, g, b] = png.at(x, y);
            if (r > 200 && g < 60 && b > 200) n++;
        }
    return n;
};

test("dropped GeoJSON is drawn where it is, and hides behind the city", skip, async () => {
    const line = (north, up) => ({
        type: "Feature",
        properties: { color: "#ff00ff", name: `line ${north}` },
        geometry: {
            type: "LineString",
            coordinates: [-15, 15].map((east) => {
                const { lon, lat, h } = placeOfEnu(ORIGIN, [east, north, up]);
                return [lon, lat, h];
            }),
        },
    });
    const drop = (feature) =>
        page.evaluate((text) => {
            const data = new DataTransfer();
            data.items.add(new File([text], "lines.geojson"));
            window.dispatchEvent(new DragEvent("drop", { dataTransfer: data, cancelable: true }));
        }, JSON.stringify(feature));
    const before = redPixels(await barePicture(page));
    await drop(line(-60, 3));
    await page.waitForFunction(() => /1 shapes/.test(document.getElementById("toast").textContent));
    await page.waitForSelector(".citysplat-label");
    const front = redPixels(await barePicture(page)) - before;
    assert.ok(front > 60, `${front} pixels of a line in front of the city`);
    await drop(line(0, -12)); // below the ground
    await page.waitForFunction(() => window.citysplat.viewer.overlay.group.children.length === 2);
    const both = redPixels(await barePicture(page)) - before;
    assert.ok(both < 1.3 * front, `${both} pixels: the line below the ground is seen`);
    await drop({ type: "FeatureCollection", features: [] });
    await page.waitForFunction(() => /not GeoJSON/.test(document.getElementById("toast").textContent));
});

const HOSTILE = 'A roof <img src=x onerror="window.harmed = 1"> of some words';

test("a label is text, over its place, and whole inside of the picture", skip, async () => {
    await lookViewer(page, SOUTH);
    await page.evaluate(([place, label]) => void (window.added = window.citysplat.viewer.overlay.add({ kind: "point", places: [place], label })), [placeOfEnu(ORIGIN, RED_TOP), HOSTILE]);
    await nextFrames(page);
    const label = page.locator(".citysplat-label", { hasText: "A roof" });
    const [x, y] = pixelOf(RED_TOP);
    const box = await label.boundingBox();
    assert.ok(Math.abs(box.x + box.width / 2 - x) < 12 && box.y < y && y - box.y < 120, JSON.stringify({ box, x, y }));
    // Turned until the label is at the right edge.
    const edge = await page.evaluate(async ([pose, w]) => {
        const { viewer } = window.citysplat;
        for (let heading = pose.heading; heading > pose.heading - 60; heading -= 0.25) {
            viewer.lookAt({ ...pose, heading });
            await new Promise((done) => { const end = viewer.on("frame", () => (end(), done())); });
            const one = [...document.querySelectorAll(".citysplat-label")].find(({ textContent }) => textContent.startsWith("A roof"));
            const { left, right, top, bottom } = one.getBoundingClientRect();
            if (one.hidden) return { none: heading };
            if (right >= w - 5) return { left, right, top, bottom };
        }
        return null;
    }, [SOUTH, SIZE.width]);
    assert.ok(edge && edge.right <= SIZE.width - 3 && edge.left > 0 && edge.top > 0 && edge.bottom < SIZE.height, JSON.stringify(edge));
    assert.equal(await page.evaluate(() => window.harmed), undefined);
    await page.evaluate(() => window.citysplat.viewer.overlay.remove(window.added));
});

test("a link of before, with a tour behind its view, opens the view", skip, async () => {
    const { lon, lat, h, pitch } = SOUTH;
    await page.goto("about:blank");
    await page.goto(`${source.url}/#${lon},${lat},${h},40,${pitch}&story=abcdef`);
    await waitForViewer(page);
    assert.ok(Math.abs((await page.evaluate(() => window.citysplat.pose().heading)) - 40) < 0.05);
    await page.waitForFunction(() => location.hash && !location.hash.includes("story"));
});

test("sky and ground instead of a void", skip, async () => {
    await lookViewer(page, { ...SOUTH, pitch: 5 });
    await page.evaluate(() => (document.documentElement.dataset.ui = "off"));
    const png = decodePng(await page.screenshot());
    await page.evaluate(() => (document.documentElement.dataset.ui = "on"));
    const { share } = measureContent(png);
    assert.ok(share > 0.99, `${(100 * (1 - share)).toFixed(1)} % of the picture is black`);
    const bare = await barePicture(page);
    assert.ok(rmsDifference(png, bare) > 5);
});

test("walking keeps the eyes above the ground, dragging looks around", skip, async () => {
    await lookViewer(page, { ...SOUTH, pitch: -5 });
    await page.click("#walk");
    await page.click("#walk");
    await page.waitForFunction((h) => window.citysplat.pose().h < h, SOUTH.h - 100); // in the next frame
    await waitForViewer(page);
    const start = await page.evaluate(() => window.citysplat.pose());
    assert.ok(start.h < SOUTH.h - 100, `eyes at ${start.h} m`);
    await page.mouse.move(500, 320);
    await page.mouse.down();
    await page.mouse.move(600, 320, { steps: 4 });
    await page.mouse.up();
    await waitForViewer(page);
    const turned = await page.evaluate(() => window.citysplat.pose());
    const turn = ((turned.heading - start.heading + 540) % 360) - 180;
    assert.ok(Math.abs(turn) > 5 && Math.abs(turned.lon - start.lon) < 1e-6, "it did not look around");
    await page.click("#walk");
});

test("dragging holds the ground under the pointer, the wheel nears what it points at", skip, async () => {
    await lookViewer(page, SOUTH);
    const from = pixelOf([0, -60, 0]);
    const to = [from[0] + 60, from[1] + 30];
    const place = (x, y) => page.evaluate(([a, b]) => window.citysplat.viewer.pick(a, b), [x, y]);
    const held = await place(...from);
    await page.mouse.move(...from);
    await page.mouse.down();
    await page.mouse.move(...to, { steps: 6 });
    await page.waitForTimeout(100); // held, not thrown
    await page.mouse.up();
    await waitForViewer(page);
    const now = await place(...to);
    assert.ok(Math.abs(now.lon - held.lon) * M_PER_DEG < 3, `east ${JSON.stringify([held, now])}`);
    assert.ok(Math.abs(now.lat - held.lat) * M_PER_DEG < 3, "north");
    const high = await page.evaluate(() => window.citysplat.pose().h);
    await page.mouse.wheel(0, -300);
    await page.waitForFunction((h) => window.citysplat.pose().h < h, high);
    await waitForViewer(page);
    const near = await place(...to);
    assert.ok((await page.evaluate(() => window.citysplat.pose().h)) < high - 5);
    assert.ok(Math.abs(near.lon - held.lon) * M_PER_DEG < 4, "zooms past the pointer");
});

test("two fingers near, turn and tilt; a gamepad turns and moves", skip, async () => {
    await lookViewer(page, SOUTH);
    const pose = () => page.evaluate(() => window.citysplat.pose());
    const turned = (a, b) => ((b.heading - a.heading + 540) % 360) - 180;
    const session = await page.context().newCDPSession(page);
    await session.send("Emulation.setTouchEmulationEnabled", { enabled: true, maxTouchPoints: 2 });
    const touch = (type, ...points) =>
        session.send("Input.dispatchTouchEvent", { type, touchPoints: points.map(([x, y], id) => ({ x, y, id })) });
    const fingers = async (from, to) => {
        const before = await pose();
        await touch("touchStart", ...from);
        for (let i = 1; i <= 4; i++)
            await touch("touchMove", ...from.map((p, f) => p.map((v, k) => v + ((to[f][k] - v) * i) / 4)));
        await nextFrames(page);
        const after = await pose();
        await touch("touchEnd");
        return [before, after];
    };
    const [far, near] = await fingers([[450, 330], [550, 330]], [[400, 330], [600, 330]]);
    assert.ok(near.h < far.h - 20 && Math.abs(turned(far, near)) < 1, "apart is not nearer");
    const [straight, round] = await fingers([[400, 330], [600, 330]], [[420, 270], [580, 390]]);
    assert.ok(turned(straight, round) < -20 && turned(straight, round) > -60, "the picture does not turn with them");
    assert.ok(Math.abs(round.pitch - straight.pitch) < 5, "it tilts as well");
    const [low, high] = await fingers([[450, 400], [550, 400]], [[450, 350], [550, 350]]);
    assert.ok(high.pitch > low.pitch + 5, "up together does not tilt");
    await session.send("Emulation.setTouchEmulationEnabled", { enabled: false });
    await session.detach();

    await lookViewer(page, SOUTH);
    const pad = (axes) =>
        page.evaluate((held) => {
            navigator.getGamepads = () => (held ? [{ connected: true, axes: held, buttons: [] }] : []);
            window.dispatchEvent(new Event(held ? "gamepadconnected" : "gamepaddisconnected"));
        }, axes);
    const start = await pose();
    await pad([0, 0, 1, 0]);
    await page.waitForFunction((h) => Math.abs(window.citysplat.pose().heading - h) > 3, start.heading);
    await pad([0, -1, 0, 0]);
    const there = await pose();
    await page.waitForFunction(({ lon, lat }) => Math.abs(window.citysplat.pose().lat - lat) + Math.abs(window.citysplat.pose().lon - lon) > 1e-5, there);
    await pad(null);
    await waitForViewer(page);
});

test("a height profile along a path: by the server, without it from what is drawn", skip, async (t) => {
    await lookViewer(page, SOUTH);
    await page.keyboard.press("m");
    assert.equal(await page.isDisabled("#measure-profile"), true);
    await clickOn([RED_TOP[0], RED_TOP[1], RED_TOP[2] + 0.5]);
    await clickOn([84, -24, 0]);
    const ways = { server: /by the server/, browser: /from what is drawn here/ };
    const refuse = (route) => route.fulfill({ status: 503, body: "{}" });
    const found = {};
    for (const [way, said] of Object.entries(ways)) {
        if (way === "browser") await page.route("**/profile", refuse);
        await page.click("#measure-profile");
        await page.waitForFunction((re) => new RegExp(re).test(document.getElementById("profile-text").textContent), said.source);
        const coming = page.waitForEvent("download");
        await page.click("#profile-csv");
        const rows = readFileSync(await (await coming).path(), "utf8").trim().split("\r\n");
        assert.equal(rows[0], "distance_m,lon,lat,height_m,heights");
        assert.ok(rows.slice(1).every((row) => row.endsWith(",ellipsoid")), rows[1]);
        const numbers = rows.slice(1).map((row) => row.split(",").map(Number));
        const [first, last] = [numbers[0], numbers.at(-1)];
        t.diagnostic(`${way}: ${numbers.length} heights, ${first[3]} to ${last[3]} m`);
        assert.ok(numbers.length > 100);
        assert.ok(Math.abs(first[3] - ORIGIN.h - RED_TOP[2]) < 2.5, `the roof is at ${first[3]} m`);
        assert.ok(Math.abs(last[3] - ORIGIN.h) < 1.5, `the ground is at ${last[3]} m`);
        assert.ok(Math.abs(last[0] - Math.hypot(84 - RED_TOP[0], 24)) < 4, `${last[0]} m long`);
        found[way] = numbers;
    }
    await page.unroute("**/profile", refuse);
    const apart = found.server.map(([d, , , h]) => {
        const other = found.browser.find((row) => row[0] >= d) ?? found.browser.at(-1);
        return Math.abs(other[3] - h);
    });
    apart.sort((a, b) => a - b);
    t.diagnostic(`90 % of the heights differ by at most ${apart[Math.floor(0.9 * apart.length)].toFixed(2)} m`);
    assert.ok(apart[Math.floor(0.9 * apart.length)] < 1);
    const coming = page.waitForEvent("download");
    await page.click("#profile-geojson");
    const { features } = JSON.parse(readFileSync(await (await coming).path(), "utf8"));
    assert.equal(features[0].geometry.type, "MultiLineString");
    assert.ok(features[0].properties.fall_m > 25);
    assert.equal(features[0].properties.heights, "ellipsoid");
    const pose = await page.evaluate(() => window.citysplat.pose());
    await page.focus("#profile-chart");
    await page.keyboard.press("Home");
    assert.match(await page.textContent("#profile-at"), /^At 0\.00 m: 1\d\d/);
    await page.keyboard.press("ArrowRight");
    assert.equal(await page.getAttribute("#profile-chart", "aria-valuenow"), "1");
    assert.deepEqual(await page.evaluate(() => window.citysplat.pose()), pose, "the camera moved");
    await page.click("#measure-close");
    assert.equal(await page.isVisible("#profile"), false);
});

// What this file refused or took back by itself; anything else, as of the policy, is a fault.
test("the console has nothing else", skip, () => assert.deepEqual(viewer.log.filter((line) => !/503/.test(line)), []));
