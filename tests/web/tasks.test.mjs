// Five things that somebody does who sees the page for the first time, at a desk and on a phone: only what is visible is
// pressed, by the name that it shows, and presses are counted. They are done one after the other, at one page a screen.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { after, before, test } from "node:test";

import { closeAll, openPage, waitForViewer } from "./lib/browser.mjs";
import { BLUE_TOP, ORIGIN, RED_TOP } from "./lib/city.mjs";
import { openForeign } from "./lib/foreign.mjs";
import { project } from "./lib/geo.mjs";
import { GIVEN_TILES, MOCK, openLitCity } from "./lib/source.mjs";

const PRESSES_MOST = 6;
const SCREENS = {
    desk: { width: 1000, height: 640 },
    phone: { width: 390, height: 844, hasTouch: true, isMobile: true },
};
const skip = { skip: MOCK || GIVEN_TILES ? "needs cities that tests make" : false };

let source;
before(async () => {
    if (!skip.skip) source = await openLitCity();
});
after(() => closeAll(source));

// Somebody at a page: presses what has a name, and points at the city.
class Newcomer {
    static async at(screen) {
        const one = new Newcomer();
        one.screen = SCREENS[screen];
        one.touch = screen === "phone";
        Object.assign(one, await openPage("about:blank", { ...one.screen, permissions: ["clipboard-read", "clipboard-write"] }));
        await one.visit("plain");
        return one;
    }

    async visit(scene) {
        await this.go(`${source.url}/?scene=${scene === "plain" ? source.plain : scene}`);
        await waitForViewer(this.page);
    }

    // To a fresh page.
    async go(url) {
        await this.page.goto("about:blank");
        await this.page.goto(url);
    }

    // Does a task, and counts.
    async does(t, task) {
        this.presses = 0;
        await task(this);
        t.diagnostic(`${this.presses} presses`);
        assert.ok(this.presses <= PRESSES_MOST, `${this.presses} presses`);
        assert.deepEqual(this.log, []);
    }

    // A control by its name. It fails where something lies over it or it is not on the screen.
    async press(name, within = this.page) {
        const control = within.getByRole("button", { name, exact: true }).or(within.getByRole("radio", { name, exact: true }));
        await this.pressOn(control);
    }

    async pressOn(control) {
        const radio = await control.evaluate((node) => node.matches("input"));
        const seen = radio ? control.locator("xpath=..") : control; // the label is what is seen
        assert.ok(await seen.isVisible(), `${control} is not to be seen`);
        await (this.touch ? seen.tap({ timeout: 10000 }) : seen.click({ timeout: 10000 }));
        this.presses++;
    }

    // On a phone the panel is folded.
    async openPanel() {
        if (this.touch) await this.press("Show panel");
    }

    // A place in the city, east-north-up from its middle. Nothing of the page may lie over it.
    async pointAt(enu) {
        const pose = await this.page.evaluate(() => window.citysplat.pose());
        const [x, y] = project(ORIGIN, pose, enu, this.screen.width, this.screen.height);
        const free = await this.page.evaluate(([a, b]) => document.elementFromPoint(a, b)?.closest("#view") !== null, [x, y]);
        assert.ok(free, `something lies over ${enu} at ${x.toFixed(0)}, ${y.toFixed(0)}`);
        await (this.touch ? this.page.touchscreen.tap(x, y) : this.page.mouse.click(x, y));
        this.presses++;
    }

    text(selector) {
        return this.page.textContent(selector);
    }
}

const TASKS = {
    "the tallest roof": async (one) => {
        const heights = [];
        for (const top of [RED_TOP, BLUE_TOP]) {
            await one.pointAt(top);
            await one.page.waitForFunction((n) => document.querySelector("#place-text").textContent !== n, heights.at(-1)?.text ?? "");
            const text = await one.text("#place-text");
            heights.push({ text, up: Number(/(-?[\d.]+) m above the ground/.exec(text)?.[1]) });
        }
        const [red, blue] = heights.map(({ up }) => up);
        assert.ok(Math.abs(red - RED_TOP[2]) < 5 && Math.abs(blue - BLUE_TOP[2]) < 5, `${red} m and ${blue} m above the ground`);
    },

    "a courtyard is measured": async (one) => {
        await one.press("Measure");
        await one.press("Area");
        for (const corner of [[-50, 20, 0], [-15, 20, 0], [-15, 55, 0], [-50, 55, 0]]) await one.pointAt(corner);
        const text = await one.text("#measure-text");
        const area = Number(/^([\d.,]+) m²/.exec(text)?.[1].replace(",", ""));
        assert.ok(Math.abs(area - 35 ** 2) < 0.06 * 35 ** 2, text);
    },

    "the view is shared": async (one) => {
        const pose = await one.page.evaluate(() => window.citysplat.viewer.lookAt({ ...window.citysplat.pose(), heading: 77, pitch: -31 }) ?? window.citysplat.pose());
        await waitForViewer(one.page);
        await one.openPanel();
        await one.press("Share link");
        await one.page.waitForSelector("#toast:not([hidden])");
        const link = await one.page.evaluate(() => navigator.clipboard.readText());
        await one.go(link);
        await waitForViewer(one.page);
        const again = await one.page.evaluate(() => window.citysplat.pose());
        for (const key of ["heading", "pitch", "h"]) assert.ok(Math.abs(again[key] - pose[key]) < 0.02, `${key}: ${again[key]}, was ${pose[key]}`);
    },

    "the city in a page of one's own": async (one) => {
        await one.openPanel();
        await one.press("Embed");
        await one.press("Copy", one.page.locator("#embed"));
        const code = await one.page.evaluate(() => navigator.clipboard.readText());
        assert.equal(code, await one.page.inputValue("#embed-code"));
        const pose = await one.page.evaluate(() => window.citysplat.pose());
        const other = await openForeign({ "/": { body: `<!doctype html><title>x</title><link rel="icon" href="data:,">${code}` } });
        try {
            await one.go(other.url);
            await one.page.waitForFunction(() => document.querySelector("city-splat")?.viewer?.state.ready);
            const again = await one.page.evaluate(() => {
                const { viewer } = document.querySelector("city-splat");
                return { ...viewer.pose, scene: viewer.scene.id };
            });
            assert.equal(again.scene, source.plain);
            assert.ok(Math.abs(again.lon - pose.lon) < 1e-6 && Math.abs(again.heading - pose.heading) < 0.01, JSON.stringify(again));
        } finally {
            await other.close();
        }
    },

    "another season": async (one) => {
        await one.visit("lit");
        await one.page.waitForSelector("#photos-button", { state: "attached" });
        await one.page.waitForFunction(() => !document.getElementById("photos-button").hidden);
        const before = await one.page.evaluate(() => window.citysplat.state.appearance);
        await one.openPanel();
        await one.press("Photographs");
        assert.ok(!one.touch || (await one.page.getAttribute("#fold", "aria-expanded")) === "false", "the panel lies over the picture");
        const photograph = one.page.locator("#photo-list input").nth(2);
        await one.pressOn(photograph);
        await one.page.waitForFunction((old) => window.citysplat.state.appearance !== old, before);
        assert.ok(await photograph.isChecked());
    },
};

for (const screen of Object.keys(SCREENS))
    test(screen, skip, async (t) => {
        const one = await Newcomer.at(screen);
        for (const [name, task] of Object.entries(TASKS)) await t.test(name, (inner) => one.does(inner, task));
        await one.close();
    });
