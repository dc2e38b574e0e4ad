// The short form of wander.mjs: jumps, glides and other scenes for some seconds over a city of which the limit of memory
// holds a part. The bounds are those of the long one.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { test } from "node:test";

import { openPage, waitForViewer } from "./lib/browser.mjs";
import { makeCity, manyCities } from "./lib/city.mjs";
import { GIVEN_TILES, MOCK, openScenes } from "./lib/source.mjs";
import { beyond, growthOf, wander } from "./lib/wander.mjs";

const MEMORY_MB = 4; // less than half of what nine cities take
const SECONDS = 16;

test("memory stays below its limit while somebody wanders", { skip: MOCK || GIVEN_TILES ? "needs test cities" : false }, async (t) => {
    const source = await openScenes({ many: manyCities(3, 180), fcity: makeCity() });
    t.after(() => source.close());
    const { page, log, close } = await openPage(`${source.url}/?memory=${MEMORY_MB}`, { width: 400, height: 260 });
    t.after(close);
    await waitForViewer(page);
    const { samples, steps } = await wander(page, { seconds: SECONDS, every: 1 });
    const most = (key) => Math.max(...samples.map((one) => one[key])).toFixed(2);
    t.diagnostic(`${JSON.stringify(steps)}, ${samples.length} samples: tiles ${most("memoryMb")} MB of ${MEMORY_MB}, card ${most("cardMb")}, heap ${most("heapMb")}`);
    assert.ok(samples.length > 4 && steps.jump + steps.glide > 4, "hardly a step");
    assert.deepEqual([...growthOf(samples), ...beyond(samples, MEMORY_MB)], []);
    assert.deepEqual(log, []);
});
