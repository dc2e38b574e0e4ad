// What a page owes to everybody: sizes of phones, targets, languages, colours, names for screen
// readers, its own policy kept, no errors, quiet when idle.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { after, before, test } from "node:test";

import { findFaults } from "./lib/axe.mjs";
import { bareBytes, openPage, waitForViewer } from "./lib/browser.mjs";
import { decodePng } from "./lib/png.mjs";
import { openSource } from "./lib/source.mjs";

const TARGET_PX = 44;
const WORDS_PX = 11;

let source;
before(async () => (source = await openSource()));
after(async () => source?.close());

const SIZES = {
    "phone portrait": { width: 390, height: 780, hasTouch: true, isMobile: true },
    "phone landscape": { width: 660, height: 300, hasTouch: true, isMobile: true },
};
for (const [name, size] of Object.entries(SIZES)) {
    test(`${name}: every control can be reached and is large enough`, async () => {
        const { page, log, close } = await openPage(source.url, size);
        await waitForViewer(page);
        // Home depends on what the footer covers, so lines that come and go must not be in its way.
        const footer = (line) =>
            page.evaluate((words) => {
                document.getElementById("progress-text").textContent = words;
                return document.querySelector("footer").getBoundingClientRect().height;
            }, line);
        const heights = [await footer("Tiles: 123 of 1234 · 123.45 MB"), await footer("")];
        assert.equal(heights[0], heights[1], "the footer grows with the progress");
        await page.click("#fold");
        for (const box of await page.$$("#panel details")) await box.evaluate((d) => (d.open = true));
        const faults = await page.evaluate((least) => {
            const out = [];
            const panel = document.getElementById("panel").getBoundingClientRect();
            if (panel.bottom > innerHeight) out.push(`the panel ends at ${panel.bottom}`);
            for (const node of document.querySelectorAll("button, select, summary, input[type=range]")) {
                if (!node.checkVisibility()) continue;
                const { width, height, left, right } = node.getBoundingClientRect();
                const what = node.id || node.textContent;
                if (height < least - 0.5 || width < least - 0.5) out.push(`${what}: ${width} x ${height}`);
                if (left < 0 || right > innerWidth) out.push(`${what}: outside`);
            }
            const tools = document.getElementById("tools").getBoundingClientRect();
            if (tools.bottom > innerHeight) out.push(`the tools end at ${tools.bottom}`);
            if (panel.right > tools.left && panel.bottom > tools.top) out.push("the panel lies over the tools");
            return out;
        }, TARGET_PX);
        assert.deepEqual(faults, []);
        await page.click("#help-button");
        const close_ = page.locator("#help button");
        await close_.scrollIntoViewIfNeeded();
        await close_.click();
        assert.deepEqual(log, []);
        await close();
    });
}

// The largest rectangle of cells that nothing covers, in pixels.
const CELL_PX = 10;
function largestFree({ width, height }, covers) {
    const columns = Math.floor(width / CELL_PX);
    const depth = new Array(columns).fill(0); // free cells above, this one included
    let best = { size: 0 };
    for (let y = CELL_PX; y <= height; y += CELL_PX) {
        for (let i = 0; i < columns; i++) {
            const [left, top] = [i * CELL_PX, y - CELL_PX];
            const hit = covers.some((one) => one.left < left + CELL_PX && one.right > left && one.top < y && one.bottom > top);
            depth[i] = hit ? 0 : depth[i] + 1;
        }
        for (let i = 0; i < columns; i++)
            for (let k = i, least = Infinity; k < columns && (least = Math.min(least, depth[k])) > 0; k++)
                if ((k - i + 1) * least * CELL_PX ** 2 > best.size)
                    best = { size: (k - i + 1) * least * CELL_PX ** 2, width: (k - i + 1) * CELL_PX, height: least * CELL_PX };
    }
    return best;
}

// Where the picture is not black, and which share of that the covers cover.
function drawnBox({ width, height, at }, covers) {
    const box = { left: width, right: 0, top: height, bottom: 0 };
    let [all, covered] = [0, 0];
    for (let y = 0; y < height; y++)
        for (let x = 0; x < width; x++)
            if (Math.max(...at(x, y).slice(0, 3)) > 24) {
                box.left = Math.min(box.left, x);
                box.right = Math.max(box.right, x + 1);
                box.top = Math.min(box.top, y);
                box.bottom = Math.max(box.bottom, y + 1);
                all++;
                covered += covers.some((one) => one.left <= x && x < one.right && one.top <= y && y < one.bottom);
            }
    return { ...box, covered: covered / all };
}

const SCREENS = [
    { width: 1400, height: 800 },
    { width: 1000, height: 640 },
    { width: 390, height: 844, hasTouch: true, isMobile: true }, // the edge of a city is cut at the sides
    { width: 844, height: 390, hasTouch: true, isMobile: true },
];
const HOME_LEAST = 0.6; // of the area that panels leave free, and of the city
const FIRST_MOST = 0.5; // of its distance, by another direction: the first view is chosen before a Gaussian is there, by the server's outline
const FREE_PX = 6; // that what is covered may differ from what style.css says: lines of text
const COVERED_MOST = 0.02; // strays beyond the outline of most cells

for (const size of SCREENS)
    test(`home fills what the panels leave free at ${size.width} x ${size.height}`, async (t) => {
        const { page, close } = await openPage(source.url, size);
        t.after(close);
        await waitForViewer(page);
        if (process.env.HABITS_SHOTS) await page.screenshot({ path: `${process.env.HABITS_SHOTS}/home-${size.width}x${size.height}.png` });
        // What the first view is fitted into, before there are panels, is what they then leave free.
        const [said, covered] = await page.evaluate(() => {
            const { stage } = window.citysplat.viewer;
            const { left, right, top, bottom } = stage.free();
            const own = [top * innerHeight, (1 - right) * innerWidth, (1 - bottom) * innerHeight, left * innerWidth];
            return [getComputedStyle(document.documentElement).getPropertyValue("--free").trim().split(" ").map(Number), own];
        });
        said.forEach((px, i) => assert.ok(Math.abs(px - covered[i]) <= FREE_PX, `style.css says that ${said} px are covered, ${covered} are`));
        const first = await page.evaluate(() => {
            const { stage } = window.citysplat.viewer;
            const before = stage.camera.position.clone();
            stage.home();
            return stage.camera.position.distanceTo(before) / stage.camera.position.length();
        });
        await waitForViewer(page);
        const covers = await page.evaluate(() =>
            [...document.querySelectorAll("#panel, #tools, footer")]
                .map((node) => node.getBoundingClientRect())
                .map(({ left, right, top, bottom }) => ({ left, right, top, bottom })));
        const drawn = drawnBox(decodePng(await bareBytes(page)), covers);
        const free = largestFree(size, covers);
        const [across, down] = [drawn.right - drawn.left, drawn.bottom - drawn.top];
        const upright = size.height > size.width;
        const filled = (across * down) / free.size;
        const seen = await page.evaluate(() => {
            const { camera, outline } = window.citysplat.viewer.stage;
            const xs = outline.map((point) => point.clone().project(camera).x);
            return Math.min(1, 2 / (Math.max(...xs) - Math.min(...xs)));
        });
        t.diagnostic(`${across} x ${down} px of ${free.width} x ${free.height}: ${(100 * filled).toFixed(0)} % of the area, ${(100 * seen).toFixed(0)} % of the city's width; ${(100 * first).toFixed(0)} % of its distance from the first view`);
        assert.ok(first < FIRST_MOST, `home is ${first} of its distance from the first view`);
        assert.ok(drawn.covered < COVERED_MOST, `panels cover ${(100 * drawn.covered).toFixed(1)} % of the city`);
        const sides = upright || (drawn.left > 0 && drawn.right < size.width);
        assert.ok(sides && drawn.bottom < size.height, `the city is cut: ${JSON.stringify(drawn)}`);
        assert.ok(filled >= HOME_LEAST && seen >= HOME_LEAST, `${filled} of the area, ${seen} of the width`);
    });

test("every control has a name, in both languages, and the choice is kept", async () => {
    const { page, log, close } = await openPage(`${source.url}/?lang=en`, { width: 900, height: 700 });
    await waitForViewer(page);
    const nameless = () =>
        page.evaluate(() =>
            [...document.querySelectorAll("button, select, input, [role]")]
                .filter((node) => {
                    const own = node.getAttribute("aria-label") ?? node.textContent?.trim();
                    const labelled = node.labels?.[0]?.textContent.trim();
                    return !own && !labelled && !node.matches("[role=status], [role=alert]");
                })
                .map((node) => node.outerHTML.slice(0, 80)),
        );
    assert.deepEqual(await nameless(), []);
    const empty = () =>
        page.$$eval("[data-t]", (all) => all.filter((n) => !n.textContent.trim()).map((n) => n.dataset.t));
    assert.deepEqual(await empty(), []);
    assert.equal(await page.textContent("#share"), "Share link");
    await page.click("#settings summary");
    await page.selectOption("#language", "de");
    await page.waitForFunction(() => document.documentElement.lang === "de");
    assert.equal(await page.textContent("#share"), "Link teilen");
    assert.equal(await page.getAttribute("html", "lang"), "de");
    assert.deepEqual([...(await nameless()), ...(await empty())], []);
    await page.goto(source.url);
    await waitForViewer(page);
    assert.equal(await page.textContent("#share"), "Link teilen");
    assert.deepEqual(log, []);
    await close();
});

test("axe finds nothing, whatever is open, dark and light", async () => {
    const size = { width: 1100, height: 800 };
    const { page, close } = await openPage(`${source.url}/?developer`, size);
    await waitForViewer(page);
    for (const summary of await page.$$("#panel summary:visible")) await summary.click();
    await page.keyboard.press("m");
    const ground = [770, 330]; // between two towers: what lies in the middle was not surveyed
    await page.mouse.click(...ground);
    await page.mouse.click(ground[0] + 40, ground[1] + 30);
    await page.click("#measure-profile");
    await page.waitForSelector("#profile-chart svg");
    // Its words are as large on a phone as at a desk.
    await page.setViewportSize({ width: 390, height: 844 });
    await page.$eval("#measure-profile", (node) => node.click());
    await page.waitForFunction((least) => {
        const words = [...document.querySelectorAll("#profile-chart text")].map((node) => node.getBoundingClientRect().height);
        return words.length > 0 && Math.min(...words) >= least;
    }, WORDS_PX, { timeout: 10000 }).catch(() => assert.fail("the chart's words are small on a phone"));
    await page.setViewportSize(size);
    for (const theme of ["dark", "light"]) {
        await page.selectOption("#theme", theme);
        assert.deepEqual(await findFaults(page), [], theme);
    }
    await page.click("#measure-close");
    await page.click("#help-button");
    assert.deepEqual(await findFaults(page), [], "help");
    await close();
});

test("dark and light, by the system and by choice", async () => {
    for (const colorScheme of ["dark", "light"]) {
        const { page, close } = await openPage(source.url, { width: 900, height: 700, colorScheme });
        await waitForViewer(page);
        assert.equal(await page.getAttribute("html", "data-theme"), colorScheme);
        const other = colorScheme === "dark" ? "light" : "dark";
        await page.click("#settings summary");
        await page.selectOption("#theme", other);
        const ink = await page.$eval("#panel", (node) => getComputedStyle(node).color);
        const bright = ink.match(/\d+/g).slice(0, 3).reduce((sum, v) => sum + Number(v), 0) > 382;
        assert.equal(bright, other === "dark", `ink ${ink} on ${other}`);
        await close();
    }
});

test("with reduced motion nothing spins and nothing flies", async () => {
    const size = { width: 640, height: 480, reducedMotion: "reduce" };
    const { page, close } = await openPage(source.url, size);
    await waitForViewer(page);
    const turned = await page.evaluate(async () => {
        const { viewer } = window.citysplat;
        const to = { ...viewer.pose, heading: 123 };
        const started = performance.now();
        await viewer.flyTo(to, 5);
        return [viewer.pose.heading, performance.now() - started];
    });
    assert.ok(Math.abs(turned[0] - 123) < 0.01 && turned[1] < 500, String(turned));
    const motion = await page.$eval("#progress span", (node) => getComputedStyle(node).animationName);
    assert.equal(motion, "none");
    await close();
});

// Turns of the page's loop, timers and frames, and the time of the page's process, for some milliseconds.
async function watchRest(page, ms) {
    const client = await page.context().newCDPSession(page);
    await client.send("Performance.enable");
    const spent = async () => {
        const { metrics } = await client.send("Performance.getMetrics");
        return 1000 * metrics.find((one) => one.name === "TaskDuration").value;
    };
    await page.evaluate(() => (window.counts = { frame: 0, timer: 0, drawn: 0 }));
    const before = await spent();
    await page.waitForTimeout(ms);
    const busyMs = (await spent()) - before;
    const counts = await page.evaluate(() => window.counts);
    await client.detach();
    return { ...counts, busyMs: Math.round(busyMs) };
}

test("a page at rest costs nothing, and wakes for everything that shows", async (t) => {
    const { page, log, close } = await openPage("about:blank", { width: 760, height: 500 });
    await page.addInitScript(() => {
        window.counts = { frame: 0, timer: 0, drawn: 0 };
        const count = (name, kind) => {
            const own = window[name].bind(window);
            window[name] = (run, ...rest) => own((...given) => (window.counts[kind]++, run(...given)), ...rest);
        };
        count("requestAnimationFrame", "frame");
        count("setTimeout", "timer");
        count("setInterval", "timer");
    });
    await page.goto(`${source.url}/?developer`);
    await waitForViewer(page);
    await page.click("#statistics summary"); // its numbers are what changes most
    await page.evaluate(() => window.citysplat.viewer.on("frame", () => window.counts.drawn++));
    await page.waitForTimeout(2500);
    const rest = await watchRest(page, 2000);
    t.diagnostic(`two seconds at rest: ${JSON.stringify(rest)}`);
    assert.ok(rest.frame <= 3 && rest.timer <= 3 && rest.drawn === 0, JSON.stringify(rest));
    assert.ok(rest.busyMs < 40, `${rest.busyMs} ms of work`);

    const wakes = {
        wheel: async () => (await page.mouse.move(320, 300), page.mouse.wheel(0, 60)),
        key: () => page.keyboard.press("ArrowLeft", { delay: 60 }),
        pose: () => page.evaluate(() => window.citysplat.viewer.home()),
        size: () => page.setViewportSize({ width: 720, height: 500 }),
        sky: () => page.click("#backdrop"),
        walk: async () => (await page.click("#walk"), await page.click("#walk")), // flies, then walks
        overlay: () =>
            page.evaluate(() => {
                const { viewer } = window.citysplat;
                const { lon, lat, h } = viewer.pose;
                viewer.overlay.add({ kind: "point", places: [{ lon, lat, h }], color: "#f00" });
            }),
        context: () =>
            page.evaluate(async () => {
                const own = window.citysplat.viewer.city.renderer.getContext().getExtension("WEBGL_lose_context");
                own.loseContext();
                await new Promise((done) => setTimeout(done, 50));
                own.restoreContext();
            }),
    };
    await page.click("#settings summary");
    for (const [name, run] of Object.entries(wakes)) {
        await page.waitForTimeout(400);
        await page.evaluate(() => (window.counts.drawn = 0));
        await run();
        await page.waitForFunction(() => window.counts.drawn > 0, null, { timeout: 5000, polling: 50 }).catch(() => {
            throw new Error(`${name} did not wake the page`);
        });
        await waitForViewer(page);
    }
    await page.waitForTimeout(2500);
    const again = await watchRest(page, 1000);
    assert.ok(again.frame <= 3 && again.timer <= 3 && again.drawn === 0, `after that: ${JSON.stringify(again)}`);
    assert.deepEqual(log.filter((line) => !/CONTEXT_LOST|Context Lost/.test(line)), []);
    await close();
});

test("the page keeps its own policy, asks nobody else, and is quiet when idle", async () => {
    const { page, log, close } = await openPage("about:blank", { width: 640, height: 480 });
    const hosts = new Set();
    page.on("request", (request) => {
        const { protocol, host } = new URL(request.url());
        if (protocol.startsWith("http")) hosts.add(host);
    });
    await page.goto(source.url);
    await waitForViewer(page);
    const policy = await page.getAttribute('meta[http-equiv="Content-Security-Policy"]', "content");
    assert.match(policy, /script-src 'self';/);
    assert.doesNotMatch(policy, /unsafe/);
    assert.deepEqual([...hosts], [new URL(source.url).host]);
    await page.waitForTimeout(1200);
    const changes = await page.evaluate(async () => {
        let n = 0;
        const watch = new MutationObserver((list) => (n += list.length));
        watch.observe(document, { subtree: true, childList: true, attributes: true, characterData: true });
        await new Promise((done) => setTimeout(done, 1500));
        watch.disconnect();
        return n;
    });
    assert.equal(changes, 0, `${changes} changes of an idle page`);
    assert.deepEqual(log, []);
    await close();
});
