// What happens to somebody who visits a city: the first seconds, walking, views that see nothing, panels, keys and presses,
// and an address that is wrong.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { after, before, test } from "node:test";

import { findFaults } from "./lib/axe.mjs";
import { closeAll, lookViewer, openPage, waitForViewer } from "./lib/browser.mjs";
import { meanDifference, measureContent, rmsDifference, SOUTH } from "./lib/checks.mjs";
import { ORIGIN } from "./lib/city.mjs";
import { placeOfEnu } from "./lib/geo.mjs";
import { decodePng } from "./lib/png.mjs";
import { Proxy } from "./lib/proxy.mjs";
import { firstDataSet, getJson, GIVEN_TILES, MOCK, openSource } from "./lib/source.mjs";

const SIZE = { width: 800, height: 560 };
const PHONE = { width: 390, height: 844, hasTouch: true, isMobile: true };
const EYES_M = 1.7;
const SURFACE_M = 0.4; // between the surface that is drawn and that of /height: both are the middle of Gaussians of 0.3 m
const TOWER_M = 7; // from its middle to its walls
const M_PER_DEG = 111_320;
const WORSE_RMS = 2; // of 255, that a picture may be farther from the last one than the picture before it: rounding
const NEAR = 0.35; // of its distance, that home may be from the first view, which is chosen before a Gaussian is there
const SLOW = 40_000; // bytes a second
const skip = { skip: MOCK || GIVEN_TILES ? "needs the test city" : false };

let source;
before(async () => {
    if (!skip.skip) source = await openSource();
});
after(() => closeAll(source));

async function open(t, query = "", size = SIZE) {
    const opened = await openPage(`${source.url}/${query}`, size);
    t.after(() => opened.close());
    await waitForViewer(opened.page);
    return opened;
}

const poseOf = (page) => page.evaluate(() => window.citysplat.pose());
const until = (page, check, arg) => page.waitForFunction(check, arg, { polling: 50 });
const walks = (page) => until(page, () => document.getElementById("walk").dataset.walk === "walk"); // its module is loaded by now
const arrived = (page) => until(page, () => window.citysplat.viewer.stage.flight === null && window.citysplat.settled);
const hashOf = ({ lon, lat, h, heading, pitch }) => [lon, lat, h, heading, pitch].join();

// East and north of the origin, metres.
const metresOf = ({ lon, lat }) => [(lon - ORIGIN.lon) * M_PER_DEG * Math.cos((ORIGIN.lat * Math.PI) / 180), (lat - ORIGIN.lat) * M_PER_DEG];

// Two presses whose events are this long apart, which is what the page goes by. They are sent without waiting for the page:
// page.mouse.dblclick waits for it after every event, so on a busy machine its second press came too late.
async function pressTwice(page, x, y, apartMs, touch) {
    const cdp = await page.context().newCDPSession(page);
    const began = Date.now() / 1000 - 1.5; // a press after these is later
    const names = touch ? ["touchStart", "touchEnd"] : ["mousePressed", "mouseReleased"];
    const sent = [1, 2].flatMap((clickCount) =>
        names.map((type, up) => {
            const timestamp = began + ((clickCount - 1) * apartMs) / 1000 + 0.02 * up;
            const of = touch ? { touchPoints: up ? [] : [{ x, y }] } : { x, y, button: "left", clickCount };
            return cdp.send(touch ? "Input.dispatchTouchEvent" : "Input.dispatchMouseEvent", { type, timestamp, ...of });
        }),
    );
    await Promise.all(sent);
    await cdp.detach();
}

async function heightAt({ lon, lat }) {
    const { places } = await getJson(`${source.url}/d/${await firstDataSet(source.url)}/height?lon=${lon.toFixed(8)}&lat=${lat.toFixed(8)}`);
    return places[0].height_m;
}

test("walking begins on the nearest street, at eye height, meets walls, and ends", skip, async (t) => {
    const { page, log } = await open(t, `?lang=en#${hashOf(SOUTH)}`);
    const above = await poseOf(page);
    await page.click("#walk");
    assert.match(await page.textContent("#walk-text"), /^Flying/);
    await page.click("#walk");
    await walks(page);
    await arrived(page);
    assert.match(await page.textContent("#walk-text"), /^Walking/);
    assert.match(await page.getAttribute("#walk", "title"), /^Walking is on/);
    const start = await poseOf(page);
    const surface = await heightAt(start);
    t.diagnostic(`begins at ${metresOf(start).map((v) => v.toFixed(1))}, ${(start.h - surface).toFixed(2)} m above the surface`);
    assert.ok(Math.abs(start.h - surface - EYES_M) < SURFACE_M, `${start.h} m, the surface is at ${surface}`);
    assert.ok(Math.abs(start.pitch) < 0.1, `pitch ${start.pitch}`);
    assert.ok(surface - ORIGIN.h < 2, `on a roof, ${surface - ORIGIN.h} m above the ground`);

    // Towards the tower in the middle: its wall ends the way.
    const south = { ...placeOfEnu(ORIGIN, [0, -16, EYES_M]), heading: 0, pitch: 0, fov: 45 };
    await page.evaluate((pose) => window.citysplat.viewer.stage.fly(pose, 0), south);
    await arrived(page);
    await page.evaluate(() => (window.still = 0));
    await page.keyboard.down("w");
    await until(page, () => {
        const { lat } = window.citysplat.pose();
        window.still = lat === window.lat && lat > 0 ? window.still + 1 : 0;
        window.lat = lat;
        return window.still > 8;
    });
    await page.keyboard.up("w");
    await arrived(page);
    const wall = await poseOf(page);
    const [, north] = metresOf(wall);
    t.diagnostic(`stops ${(-north - TOWER_M).toFixed(2)} m before the wall`);
    assert.ok(north > -16 + 2 && north < -TOWER_M, `at ${north} m: the wall is at ${-TOWER_M} m`);
    assert.ok(Math.abs(wall.h - ORIGIN.h - EYES_M) < SURFACE_M, `${wall.h - ORIGIN.h} m above the ground`);

    await page.keyboard.press("Escape");
    await arrived(page);
    assert.equal(await page.isVisible("#walk-card"), false);
    assert.ok(Math.abs((await poseOf(page)).h - above.h) < 0.05, "not back where it began");
    // A flight of the page goes on in the mode of who flies; who walks does so no longer, and the card goes.
    const over = { ...above, heading: above.heading + 10 };
    const flyTo = async () => {
        await page.evaluate((pose) => window.citysplat.viewer.flyTo(pose, 0.1), over);
        await arrived(page);
    };
    await page.keyboard.press("g");
    await flyTo();
    assert.equal(await page.getAttribute("#walk", "data-walk"), "fly");
    await page.keyboard.press("g");
    await walks(page);
    await flyTo();
    assert.equal(await page.getAttribute("#walk", "data-walk"), "orbit");
    assert.equal(await page.isVisible("#walk-card"), false);
    await page.keyboard.press("g");
    await page.keyboard.press("g");
    await walks(page);
    await arrived(page);
    assert.equal(await page.isVisible("#walk-card"), true);
    await page.keyboard.press("h");
    await waitForViewer(page);
    assert.equal(await page.isVisible("#walk-card"), false);
    assert.ok((await poseOf(page)).h > ORIGIN.h + 50, "Home stays on the street");
    assert.deepEqual(log, []);
});

test("a view that sees nothing says so and leads back", skip, async (t) => {
    const far = { ...SOUTH, lat: SOUTH.lat + 1, heading: 0, pitch: 0 };
    const { page } = await open(t, `?lang=en#${hashOf(far)}`, { width: 1024, height: 640 });
    const said = page.locator("#banner-lost");
    await said.waitFor();
    assert.match(await said.textContent(), /^Nothing of the city is in this view/);
    await page.evaluate(() => window.citysplat.viewer.events.emit("slow", 3)); // the longest that is told
    await page.waitForSelector("#banner-slow");
    const [panel, tools, ...told] = await page.$$eval("#panel, #tools, .banner", (nodes) =>
        ["panel", "tools"].map((id) => nodes.find((node) => node.id === id)).concat(nodes.filter((node) => node.matches(".banner"))).map((node) => node.getBoundingClientRect().toJSON()));
    for (const one of told) assert.ok(one.left >= panel.right && one.right <= tools.left, `what is told lies at ${one.left} to ${one.right}, the panel ends at ${panel.right}`);
    await said.getByRole("button", { name: "Whole scene" }).click();
    await waitForViewer(page);
    assert.equal(await said.count(), 0);
    // Amidst the city, into the sky; then down again.
    const sky = { ...placeOfEnu(ORIGIN, [-20, -100, 3]), heading: 180, pitch: 60, fov: 45 };
    await lookViewer(page, sky);
    await said.waitFor();
    await lookViewer(page, { ...sky, heading: 0, pitch: -10 });
    await said.waitFor({ state: "detached" });
});

test("a panel of a phone leaves the camera alone, and the link is the view that was seen", skip, async (t) => {
    const { page } = await open(t, "?lang=en", { ...PHONE, permissions: ["clipboard-read", "clipboard-write"] });
    const seen = await poseOf(page);
    await page.click("#fold");
    await waitForViewer(page);
    assert.deepEqual(await poseOf(page), seen);
    await page.click("#share");
    await page.waitForSelector("#toast:not([hidden])");
    const link = await page.evaluate(() => navigator.clipboard.readText());
    const [lon, lat, h] = new URL(link).hash.slice(1).split(",").map(Number);
    assert.ok(Math.abs(lon - seen.lon) < 1e-6 && Math.abs(lat - seen.lat) < 1e-6 && Math.abs(h - seen.h) < 0.01, link);
    // Home needs the picture: the panel makes way, and home is what it was.
    await page.evaluate(() => document.getElementById("home").click());
    await waitForViewer(page);
    assert.equal(await page.getAttribute("#fold", "aria-expanded"), "false");
    const home = await poseOf(page);
    assert.ok(Math.abs(home.h - seen.h) < NEAR * seen.h, `home is ${home.h} m high, after ${seen.h} m`);
});

test("short presses of keys count, and no key is silent", skip, async (t) => {
    const { page } = await open(t, `?lang=en#${hashOf(SOUTH)}`);
    for (const [key, changes] of [["ArrowUp", "lat"], ["e", "heading"], ["+", "h"]]) {
        const from = (await poseOf(page))[changes];
        await page.keyboard.press(key); // down and up in one turn of the page
        await until(page, ([name, value]) => window.citysplat.pose()[name] !== value, [changes, from]);
        await waitForViewer(page);
    }
    for (const [key, words] of [["p", /no photographs/], ["v", /no other scene/], ["x", /Nothing is compared/]]) {
        await page.evaluate(() => (document.getElementById("toast").hidden = true));
        await page.keyboard.press(key);
        await page.waitForSelector("#toast:not([hidden])", { timeout: 10000 }).catch(() => assert.fail(`${key} is silent`));
        assert.match(await page.textContent("#toast"), words);
    }
    // Help tells of keys that do something here.
    await page.keyboard.press("?");
    assert.deepEqual(await page.$$eval("#help-p, #help-v", (rows) => rows.map(({ hidden }) => hidden)), [true, true]);
    await page.keyboard.press("Escape");
    assert.equal(await page.getAttribute("#detail", "aria-valuetext"), "1 px");
});

test("two clicks or two taps of a place go nearer to it", skip, async (t) => {
    for (const size of [SIZE, PHONE]) {
        const { page } = await open(t, `#${hashOf(SOUTH)}`, size);
        const [x, y] = [size.width / 2, size.height / 2];
        const distance = () => page.evaluate(([a, b]) => {
            const { stage } = window.citysplat.viewer;
            window.target ??= stage.under(a, b);
            return window.target.distanceTo(stage.camera.position);
        }, [x, y]);
        const before = await distance();
        await page.evaluate(() => {
            window.clicks = [];
            window.citysplat.viewer.on("click", ({ x: at }) => window.clicks.push(at));
            window.citysplat.viewer.on("unclick", () => window.clicks.pop());
        });
        await page.keyboard.press("m");
        const empty = await page.textContent("#measure-text");
        await pressTwice(page, x, y, 200, size.hasTouch);
        await until(page, (from) => window.target.distanceTo(window.citysplat.viewer.stage.camera.position) < 0.9 * from, before);
        await arrived(page);
        const share = (await distance()) / before;
        assert.ok(Math.abs(share - 0.5) < 0.05, `${share} of the distance`);
        // It was a click that was taken back, and is no point of a measurement. One press is, and two of different places are two.
        assert.deepEqual(await page.evaluate(() => window.clicks), []);
        assert.equal(await page.textContent("#measure-text"), empty);
        // So are two of one place, one after the other.
        await pressTwice(page, x, y, 500, size.hasTouch);
        await until(page, () => window.clicks.length === 2);
        assert.ok(Math.abs((await distance()) / before - share) < 0.01, "it went nearer again");
        await page.evaluate(() => (window.clicks = []));
        const press = (px) => (size.hasTouch ? page.touchscreen.tap(px, y) : page.mouse.click(px, y));
        await press(x);
        await press(x + 60);
        await until(page, () => window.clicks.length === 2);
        assert.deepEqual(await page.evaluate(() => window.clicks.map(Math.round)), [x, x + 60]);
        assert.match(await page.textContent("#measure-text"), / m/);
        // A press that is held and moved is no second one.
        if (!size.hasTouch) {
            await page.mouse.click(x, y);
            await page.mouse.down();
            await page.mouse.move(x + 60, y + 30);
            await page.mouse.move(x + 120, y + 60);
            await page.mouse.up();
            assert.equal(await page.evaluate(() => window.clicks.length), 3);
        }
        await page.keyboard.press("m");
    }
});

// The picture alone, of a page that may not be there yet.
const shot = async (page) => decodePng(await page.screenshot());

for (const colorScheme of ["light", "dark"])
    test(`${colorScheme}: the first seconds show the city, and no picture is followed by a worse one`, skip, async (t) => {
        const proxy = await Proxy.open(source.url);
        t.after(() => proxy.down());
        // Once, so that the server has made it.
        const warm = await openPage(`${source.url}/?ui=off#${hashOf(SOUTH)}`, { ...SIZE, colorScheme });
        const poster = await warm.page.evaluate(() => document.documentElement.dataset.poster);
        assert.ok(poster, "the page knows no picture of the view");
        const { status } = await fetch(poster);
        await waitForViewer(warm.page);
        const last = await shot(warm.page);
        await warm.close();
        if (status === 501 || status === 503) return t.skip("nothing is drawn here");

        proxy.bytesPerSecond = SLOW;
        const { page, close } = await openPage("about:blank", { ...SIZE, colorScheme });
        t.after(close);
        const warnings = [];
        page.on("console", (message) => warnings.push(message.text()));
        await page.goto(`${proxy.url}/?ui=off#${hashOf(SOUTH)}`, { waitUntil: "commit" });
        const series = [];
        const began = Date.now();
        for (let ready = false; !ready && Date.now() - began < 90_000; ) {
            ready = await page.evaluate(() => window.citysplat?.ready ?? false);
            const at = Date.now() - began;
            const png = await shot(page);
            series.push({ at, apart: rmsDifference(png, last), ...measureContent(png), ink: png.mean(SIZE.width / 2, SIZE.height / 2, 2) });
        }
        t.diagnostic(series.map(({ at, apart }) => `${(at / 1000).toFixed(1)} s: ${apart.toFixed(1)}`).join(", "));
        const scripts = await page.evaluate(() => performance.getEntriesByType("resource").find(({ name }) => /assets\/index-.*\.js/.test(name)).responseEnd);
        const early = series.filter(({ at }) => at < scripts);
        assert.ok(early.some(({ colors }) => colors > 50), `nothing is shown before the scripts are there, at ${scripts} ms`);
        for (let i = 1; i < series.length; i++)
            assert.ok(series[i].apart <= series[i - 1].apart + WORSE_RMS, `at ${series[i].at} ms it is ${series[i].apart} of 255 off, ${series[i - 1].apart} before`);
        assert.deepEqual(warnings.filter((line) => /texSubImage2D|TilesRenderer/.test(line)), []);
    });

for (const colorScheme of ["light", "dark"])
    test(`${colorScheme}: before any picture the page has the colours of its scheme, and none of the poster is left below the city`, skip, async (t) => {
        const { page, close } = await openPage("about:blank", { ...SIZE, colorScheme });
        t.after(close);
        // Pictures and scripts of the server wait, but the small one that the page begins with.
        let go = () => {};
        const held = new Promise((resolve) => (go = resolve));
        await page.route(/\/static\/|assets\/index-.*\.js/, async (route) => {
            await held;
            await route.continue();
        });
        await page.goto(`${source.url}/?ui=off#${hashOf(SOUTH)}`, { waitUntil: "commit" });
        await page.waitForFunction(() => document.documentElement.dataset.theme && document.getElementById("view"));
        const [red, green, blue] = (await shot(page)).mean(SIZE.width / 2, SIZE.height / 2, 2);
        const [low, high] = colorScheme === "light" ? [200, 250] : [0, 40];
        assert.ok([red, green, blue].every((v) => v >= low && v <= high), `the first paint is ${[red, green, blue]}`);
        const picture = () => page.evaluate(() => getComputedStyle(document.getElementById("view")).backgroundImage);
        assert.match(await picture(), /static/);
        go();
        await waitForViewer(page);
        assert.equal(await picture(), "none");
    });

const SAME_MEAN = 8;

for (const [name, size] of Object.entries({ desk: { width: 1440, height: 900 }, phone: PHONE }))
    test(`${name}: the first view is the one that its poster showed`, skip, async (t) => {
        const { page, close } = await openPage("about:blank", size);
        t.after(close);
        let go = () => {};
        const held = new Promise((resolve) => (go = resolve));
        await page.route(/assets\/index-.*\.js/, async (route) => {
            await held;
            await route.continue();
        });
        // The panels lie over both alike.
        const bare = async () => {
            await page.evaluate(() => (document.documentElement.dataset.ui = "off"));
            const png = await shot(page);
            await page.evaluate(() => delete document.documentElement.dataset.ui);
            return png;
        };
        await page.goto(source.url, { waitUntil: "commit" });
        await page.waitForFunction(() => document.documentElement.dataset.poster && document.getElementById("embed"));
        // No control without a word or a sign: their words come with the scripts.
        const empty = await page.$$eval("button, summary, select", (all) => all.filter((node) => node.checkVisibility() && !node.textContent.trim() && !node.querySelector("svg")).map((node) => node.outerHTML.slice(0, 60)));
        assert.deepEqual(empty, []);
        const poster = await page.evaluate(() => document.documentElement.dataset.poster);
        const { status } = await fetch(poster);
        if (status === 501 || status === 503) {
            go();
            return t.skip("nothing is drawn here");
        }
        await page.evaluate(async (url) => {
            const image = new Image();
            image.src = url;
            await image.decode();
        }, poster);
        const early = await bare();
        assert.ok(measureContent(early).colors > 50, "no poster");
        go();
        await waitForViewer(page);
        const apart = meanDifference(early, await bare());
        t.diagnostic(`${apart.toFixed(2)} of 255`);
        assert.ok(apart < SAME_MEAN, `${apart} of 255`);
    });

test("a person at a wrong address gets a page, a program its document", skip, async (t) => {
    const wrong = `${source.url}/d/no-such-city/tileset.json`;
    const { page, close } = await openPage("about:blank", SIZE);
    t.after(close);
    const answer = await page.goto(wrong);
    assert.deepEqual([answer.status(), answer.headers()["content-type"]], [404, "text/html; charset=utf-8"]);
    assert.equal(await page.textContent("h1"), "Not Found");
    for (const colorScheme of ["dark", "light"]) {
        await page.emulateMedia({ colorScheme });
        assert.deepEqual(await findFaults(page), [], colorScheme);
    }
    await page.getByRole("link", { name: "To the city" }).click();
    await waitForViewer(page);
    const own = await fetch(wrong);
    assert.equal(own.headers.get("content-type"), "application/problem+json");
    assert.equal((await own.json()).detail, "no dataset has this name");
});
