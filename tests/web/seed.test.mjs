// `citysplat seed`: every tile of the list is asked for, in its order and no faster than told;
// a server that is busy is asked again, an old copy is a failure, and so is a list that is none.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { createServer } from "node:http";
import { after, before, test } from "node:test";

import { BIN, firstDataSet, GIVEN_TILES, MOCK, openSource } from "./lib/source.mjs";

const skip = { skip: MOCK ? "the mock has no lists" : false };

let source;
let name;
before(async () => {
    if (skip.skip) return;
    source = await openSource({ signed: true });
    name = await firstDataSet(source.url);
});
after(() => source?.close());

function seed(...args) {
    return new Promise((done) => {
        const child = spawn(BIN, ["seed", ...args], { stdio: ["ignore", "pipe", "pipe"] });
        let [out, err] = ["", ""];
        child.stdout.on("data", (chunk) => (out += chunk));
        child.stderr.on("data", (chunk) => (err += chunk));
        child.once("exit", (status) => done({ status, out, err }));
    });
}

async function listOf(query) {
    const text = await (await fetch(`${source.url}/d/${name}/seed.ndjson${query}`)).text();
    return text.trim().split("\n").map((line) => JSON.parse(line));
}

// A cache between: what passes is written down; `answer` may reply by itself.
async function openCache(answer = () => false) {
    const seen = [];
    const server = createServer(async (request, response) => {
        seen.push({ url: request.url, at: Date.now(), purpose: request.headers["sec-purpose"] });
        if (answer(request, response, seen)) return;
        const from = await fetch(source.url + request.url, { headers: { "Sec-Purpose": "prefetch" } });
        response.writeHead(from.status, { ETag: from.headers.get("etag"), Age: "7" });
        response.end(Buffer.from(await from.arrayBuffer()));
    });
    await new Promise((done) => server.listen(0, "127.0.0.1", done));
    const url = `http://127.0.0.1:${server.address().port}/d/${name}`;
    return { url, seen, close: () => server.close() };
}

test("what all clients ask for of a dataset, in the list's order", skip, async () => {
    const { url, seen, close } = await openCache();
    const run = await seed(url, "--connections", "1", "--rate", "1000");
    const want = (await listOf("?for=all")).map((line) => `/d/${name}/${line.url}`);
    assert.equal(run.status, 0, run.err);
    assert.match(run.out, new RegExp(`^${want.length} tiles, [\\d.]+ MB in [\\d.]+ s, 0 failed, ${want.length} were`));
    assert.deepEqual(seen.map((one) => one.url), [`/d/${name}/seed.ndjson?for=all`, ...want]);
    assert.ok(seen.every((one) => one.purpose === "prefetch"));
    close();
});

// ---- private data ----

// All addresses in a document, as they stand there: of links, templates and tiles.
function addressesIn(text, type) {
    if (/xml/.test(type)) return [...text.matchAll(/(?:template|xlink:href)="([^"]+)"/g)].map((m) => m[1]);
    const found = [];
    const visit = (value, key) => {
        const isAddress = typeof value === "string" && /^(href|uri|url|next|tiles|data|tileTemplate|viewTemplate|thumbnail)$/.test(key);
        if (isAddress) found.push(value);
        else if (value && typeof value === "object")
            for (const [name, one] of Object.entries(value)) visit(one, Array.isArray(value) ? key : name);
    };
    for (const line of /ndjson/.test(type) ? text.trim().split("\n") : [text]) visit(JSON.parse(line), "");
    return found;
}

test("one signed address opens all that its documents name", { skip: MOCK || GIVEN_TILES ? "needs a private city" : false }, async (t) => {
    const city = source;
    const run = await seed(`${city.url}/d/fcity`, "--rate", "1000");
    assert.equal(run.status, 0, run.err);
    const open = [`${city.url}/`, `${city.url}/collections`];
    const seen = new Set(open);
    const kinds = {};
    const values = { TileMatrix: 1, TileCol: 1, TileRow: 1, tileMatrix: 1, tileCol: 1, tileRow: 1, z: 1, x: 1, y: 1 };
    const camera = { lon: 8, lat: 50, height: 300, heading: 0, pitch: -30, fov: 60, w: 64, h: 48, fmt: "jpg", ext: "glb" };
    while (open.length) {
        const url = open.pop();
        const response = await fetch(url, { headers: { accept: "application/json" } });
        assert.ok(![401, 403].includes(response.status), `${url}: ${response.status}`);
        assert.ok(response.url.startsWith(city.url), `${url} leads to ${response.url}`);
        const type = response.headers.get("content-type") ?? "";
        kinds[type] = (kinds[type] ?? 0) + 1;
        if (!/json|xml/.test(type) || !response.ok) continue;
        for (const address of addressesIn(await response.text(), type)) {
            const filled = address.replace(/{(\w+)}/g, (_, name) => values[name] ?? camera[name]);
            const next = new URL(filled, url).href;
            if (/^https?:\/\/www\.(opengis\.net|apache\.org)/.test(next) || seen.has(next)) continue;
            assert.ok(next.startsWith(`${city.url}/`), `${url} names ${address}`);
            seen.add(next);
            open.push(next);
        }
    }
    t.diagnostic(`${seen.size} addresses: ${JSON.stringify(kinds)}`);
    assert.ok(seen.size > 30);
    const unsigned = city.url.replace(/\/signed\/.*/, "");
    assert.equal((await fetch(`${unsigned}/d/fcity/tileset.json`)).status, 401);
    assert.doesNotMatch(city.said(), new RegExp(city.url.split(".").at(-1))); // of the log
});

test("the tiles of one client by the dataset's address", skip, async () => {
    const { url, seen, close } = await openCache();
    const run = await seed(`${url}?for=viewer`, "--connections", "1", "--rate", "1000");
    const want = (await listOf("?for=viewer")).map((line) => `/d/${name}/${line.url}`);
    assert.equal(run.status, 0, run.err);
    assert.deepEqual(seen.slice(1).map((one) => one.url), want);
    assert.ok(want.length && want.every((path) => path.includes(".drc")));
    assert.equal((await fetch(`${source.url}/d/${name}/seed.ndjson?for=nobody`)).status, 400);
    close();
});

test("an area, zooms and a format by the list's address; no faster than told", skip, async () => {
    const { url, seen, close } = await openCache();
    const run = await seed(`${url}/seed.ndjson?f=drc&preset=preview`, "--rate", "10", "--connections", "8");
    const want = await listOf("?f=drc&preset=preview");
    assert.equal(run.status, 0, run.err);
    const tiles = seen.slice(1);
    assert.equal(tiles.length, want.length);
    assert.ok(tiles.every((one) => /\.drc\?preset=preview$/.test(one.url)));
    const seconds = (tiles.at(-1).at - tiles[0].at) / 1000;
    assert.ok(seconds > (tiles.length - 2) / 10, `${tiles.length} tiles in ${seconds} s`);
    close();
});

test("a list of several pages", skip, async () => {
    const { url, seen, close } = await openCache();
    const query = "?f=spz&limit=3";
    const whole = (await listOf(query.replace(/&limit=\d/, ""))).map((line) => line.url);
    const run = await seed(`${url}/seed.ndjson${query}`, "--connections", "1", "--rate", "1000");
    assert.equal(run.status, 0, run.err);
    const [pages, tiles] = [/seed\.ndjson/, /\/t\//].map((kind) => seen.filter((one) => kind.test(one.url)));
    assert.deepEqual(tiles.map((one) => one.url), whole.map((tile) => `/d/${name}/${tile}`));
    assert.equal(pages.length, Math.ceil(whole.length / 3));
    assert.ok(pages.length > 1 && pages.slice(1).every((one) => /\/r\/\w+-\w+\/seed/.test(one.url)));
    close();
});

test("who is busy is asked again; who fails for good is named", skip, async () => {
    const times = new Map();
    const { url, close } = await openCache((request, response) => {
        if (/seed/.test(request.url)) return false;
        const n = (times.get(request.url) ?? 0) + 1;
        times.set(request.url, n);
        if (n > 1) return false;
        response.writeHead(503, { "Retry-After": "1" }).end();
        return true;
    });
    const run = await seed(url, "--rate", "1000");
    assert.equal(run.status, 0, run.err);
    assert.ok([...times.values()].every((n) => n === 2));
    close();
    let broken = "";
    const bad = await openCache((request, response, seen) => {
        if (seen.length !== 3) return false;
        broken = request.url;
        response.writeHead(404).end();
        return true;
    });
    const failed = await seed(bad.url, "--rate", "1000", "--connections", "1");
    assert.equal(failed.status, 1);
    assert.ok(failed.err.includes(broken) && /status 404/.test(failed.err), failed.err);
    assert.match(failed.out, / 1 failed/);
    bad.close();
});

test("an old copy, a list that is none, a server that is not there", skip, async () => {
    const old = await openCache((request, response) => {
        if (/seed/.test(request.url)) return false;
        response.writeHead(200, { ETag: '"old"' }).end("old");
        return true;
    });
    const stale = await seed(old.url, "--rate", "1000");
    assert.equal(stale.status, 1);
    assert.match(stale.err, /another ETag/);
    old.close();
    const page = await seed(`${source.url}/seed.ndjson`);
    assert.equal(page.status, 1);
    assert.match(page.err, /status 404/);
    const gone = await seed("http://127.0.0.1:9/d/x");
    assert.equal(gone.status, 1);
    assert.match(gone.err, /127\.0\.0\.1:9/);
    const file = await seed("file:///etc/passwd?seed.ndjson");
    assert.equal(file.status, 1);
    assert.match(file.err, /[Pp]rotocol/);
});
