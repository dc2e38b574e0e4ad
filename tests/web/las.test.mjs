// The point cloud of a store, read by another's reader (the npm package copc): what its header says,
// where its points lie, their colours. Heights are those that `citysplat height` tells.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { mkdtempSync, readFileSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";

import { Las } from "copc";

import { BLUE_TOP, ORIGIN, RED_TOP } from "./lib/city.mjs";
import { BIN, GIVEN_TILES, importCity, MOCK } from "./lib/source.mjs";

const SPACING_M = 0.5;
const STEP_M = 0.001; // of coordinates
const skip = MOCK || GIVEN_TILES ? "what is checked is the test city" : false;

let dir;
let bytes;
let header;
let view;

function run(...args) {
    const ran = spawnSync(BIN, args, { encoding: "utf8" });
    assert.equal(ran.status, 0, `citysplat ${args.join(" ")}\n${ran.stdout}${ran.stderr}`);
    return ran.stdout;
}

before(() => {
    if (skip) return;
    dir = mkdtempSync(join(tmpdir(), "citysplat-las-"));
    const tiles = importCity(dir);
    run("points", tiles, "-o", join(dir, "city.las"), "--gsd-m", `${SPACING_M}`, "-q");
    bytes = readFileSync(join(dir, "city.las"));
    header = Las.Header.parse(bytes);
    const end = header.pointDataOffset + header.pointCount * header.pointDataRecordLength;
    view = Las.View.create(bytes.subarray(header.pointDataOffset, end), header);
});
after(() => dir && rmSync(dir, { recursive: true, force: true }));

const getters = (...names) => names.map((name) => view.getter(name));

test("the header is that of LAS 1.4 with colours", { skip }, () => {
    assert.deepEqual([header.majorVersion, header.minorVersion], [1, 4]);
    assert.equal(header.pointDataRecordFormat, 7);
    assert.equal(header.pointDataRecordLength, 36);
    assert.equal(header.pointCount, header.pointCountByReturn[0]);
    assert.equal(bytes.length, header.pointDataOffset + 36 * header.pointCount);
    assert.ok(header.pointCount > 10000, `${header.pointCount} points`);
    assert.deepEqual(header.scale, [STEP_M, STEP_M, STEP_M]);
    assert.match(header.generatingSoftware, /^citysplat /);
    assert.match(header.systemIdentifier, /^fcity /);
});

test("the coordinate system is a record of WKT", { skip }, async () => {
    const get = async (begin, end) => bytes.subarray(begin, end);
    const records = await Las.Vlr.walk(get, header);
    const found = Las.Vlr.find(records, "LASF_Projection", 2112);
    assert.ok(found, "no WKT");
    const text = (await Las.Vlr.fetch(get, found)).toString("latin1");
    assert.match(text, /^PROJCS\["WGS 84 \/ UTM zone 33N"/);
    assert.match(text, /AUTHORITY\["EPSG","32633"\]\]\0$/);
});

test("points lie within the bounds, which they touch, on a grid", { skip }, () => {
    const low = [Infinity, Infinity, Infinity];
    const high = [-Infinity, -Infinity, -Infinity];
    const at = getters("X", "Y", "Z");
    for (let i = 0; i < header.pointCount; i++) {
        at.forEach((get, k) => {
            low[k] = Math.min(low[k], get(i));
            high[k] = Math.max(high[k], get(i));
        });
        for (const get of at.slice(0, 2)) {
            const cells = get(i) / SPACING_M - 0.5; // pixels' middles
            assert.ok(Math.abs(cells - Math.round(cells)) < 1e-6, `point ${i}: ${get(i)}`);
        }
    }
    for (let k = 0; k < 3; k++) {
        assert.ok(Math.abs(low[k] - header.min[k]) < 1e-6, `min ${low[k]} ${header.min[k]}`);
        assert.ok(Math.abs(high[k] - header.max[k]) < 1e-6, `max ${high[k]} ${header.max[k]}`);
    }
});

// Each tower stands where the city has it, as high as `height` says, in its colour.
test("towers are as high and as coloured as the city's", { skip }, (t) => {
    const [x, y, z] = getters("X", "Y", "Z");
    const rgb = getters("Red", "Green", "Blue");
    const [classes, returns] = getters("Classification", "NumberOfReturns");
    // Flat-earth degrees are good enough for the places of towers 50 m away.
    const lat = ORIGIN.lat + RED_TOP[1] / 111000;
    const lon = ORIGIN.lon + RED_TOP[0] / (111320 * Math.cos((ORIGIN.lat * Math.PI) / 180));
    const told = JSON.parse(run("height", join(dir, "city.tiles"), `${lon},${lat}`, "-q"));
    const red = told.places[0].height_m;
    let tall = 0;
    let colored = 0;
    for (let i = 0; i < header.pointCount; i++) {
        assert.equal(classes(i), 1);
        assert.equal(returns(i), 1);
        if (Math.abs(z(i) - red) > 1) continue;
        tall++;
        const [r, g, b] = rgb.map((get) => get(i) / 65535);
        colored += r > 0.5 && r > 2 * g && r > 2 * b;
    }
    t.diagnostic(`red roof at ${red} m: ${tall} points at that height, ${colored} of them red`);
    assert.ok(tall > 50 && colored > 0.8 * tall, `${colored} of ${tall}`);
    const highest = Math.max(...Array.from({ length: header.pointCount }, (_, i) => z(i)));
    assert.ok(Math.abs(highest - ORIGIN.h - BLUE_TOP[2]) < 3, `${highest}`);
    assert.ok(x(0) > 166000 && x(0) < 834000 && y(0) > 5.8e6 && y(0) < 5.83e6);
});
