// The OpenAPI description is valid, describes addresses that exist, and they answer with the status, the media type
// and the shape that it says. Three readers look at it: a validator of the schema, swagger-parser and Redocly's linter.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { mkdtempSync, readFileSync, rmSync, symlinkSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { after, before, test } from "node:test";
import { fileURLToPath } from "node:url";

import SwaggerParser from "@apidevtools/swagger-parser";
import { Validator } from "@seriousme/openapi-schema-validator";
import Ajv from "ajv";

import { firstDataSet, getJson, MOCK, openLitCity, openSource } from "./lib/source.mjs";

const REDOCLY = join(dirname(fileURLToPath(import.meta.url)), "node_modules/@redocly/cli/bin/cli.js");

let source;
let api;
let check; // of a value against a schema of the description
async function awaitDevice(url) {
    for (let k = 0; k < 300 && (await getJson(`${url}/version`)).pictures?.state === "starting"; k++)
        await new Promise((done) => setTimeout(done, 200));
}

before(async () => {
    source = await openSource();
    await awaitDevice(source.url);
    api = await getJson(`${source.url}/api`);
    const ajv = new Ajv({ strict: false });
    ajv.addFormat("binary", true);
    ajv.addSchema(api, "api");
    check = (schema, value) => {
        const validate = ajv.compile({ $ref: `api${schema.$ref}` });
        assert.ok(validate(value), JSON.stringify(validate.errors));
    };
});
after(() => source?.close());

test("the description is valid OpenAPI 3.0", async () => {
    const { valid, errors } = await new Validator().validate(structuredClone(api));
    assert.ok(valid, JSON.stringify(errors, null, 1));
    assert.match(api.openapi, /^3\.0\./);
});

test("swagger-parser reads the description", async () => {
    const read = await SwaggerParser.validate(structuredClone(api));
    assert.equal(read.info.title, "citysplat");
});

test("Redocly's linter has nothing against it", (t) => {
    const dir = mkdtempSync(join(tmpdir(), "citysplat-api-"));
    t.after(() => rmSync(dir, { recursive: true, force: true }));
    writeFileSync(join(dir, "api.json"), JSON.stringify(api));
    const env = { ...process.env, REDOCLY_TELEMETRY: "off", REDOCLY_SUPPRESS_UPDATE_NOTICE: "true" }; // no network
    const run = spawnSync(process.execPath, [REDOCLY, "lint", "api.json", "--format=json"], { cwd: dir, env, encoding: "utf8" });
    const { totals, problems } = JSON.parse(run.stdout);
    t.diagnostic(`${totals.warnings} warnings: ${[...new Set(problems.map((p) => p.ruleId))]}`);
    assert.equal(totals.errors, 0, JSON.stringify(problems.filter((p) => p.severity === "error"), null, 1));
});

test("parameters are those of the path, operations have names of their own", () => {
    const names = new Set();
    for (const [path, methods] of Object.entries(api.paths)) {
        assert.doesNotMatch(path, /[[\]]/, path);
        for (const operation of Object.values(methods)) {
            const inPath = operation.parameters.filter((p) => p.in === "path").map((p) => p.name);
            const inText = [...path.matchAll(/{(\w+)}/g)].map((m) => m[1]);
            assert.deepEqual(inPath, inText, path);
            assert.equal(new Set(inText).size, inText.length, path);
            assert.ok(!names.has(operation.operationId), operation.operationId);
            names.add(operation.operationId);
        }
    }
});

test("documents that need no more than a dataset and a place, a problem and seed lines have the shapes that are said", async (t) => {
    const ds = await firstDataSet(source.url);
    const { splats } = await getJson(`${source.url}/collections/${ds}`);
    let looked = 0;
    for (const [path, methods] of Object.entries(api.paths)) {
        const content = methods.get?.responses["200"]?.content?.["application/json"];
        const url = path.replace("{ds}", ds).replace("{rev}", splats.revision);
        if (!content || url.includes("{")) continue;
        const asksForPlace = methods.get.parameters.some((p) => p.name === "lon");
        const [lon, lat] = splats.origin;
        const query = asksForPlace ? `?lon=${lon.toFixed(6)}&lat=${lat.toFixed(6)}` : "";
        const response = await fetch(source.url + url + query);
        if (response.status === 404) continue; // a part that this dataset does not have
        assert.equal(response.status, 200, url);
        assert.match(response.headers.get("content-type"), /^application\/json/, url);
        check(content.schema, await response.json());
        looked++;
    }
    assert.ok(looked >= 10, `${looked}`);
    const problem = await fetch(`${source.url}/d/${ds}/t/0/0/0.exe`);
    assert.equal(problem.status, 404);
    check({ $ref: "#/components/schemas/Problem" }, await problem.json());
    const seed = await (await fetch(`${source.url}/d/${ds}/seed.ndjson`)).text();
    for (const line of seed.trim().split("\n"))
        check({ $ref: "#/components/schemas/SeedLine" }, JSON.parse(line));
    t.diagnostic(`${looked} documents`);
});

// ---- every route in every method ----

const isLike = (said, got) => said.split(";")[0] === got.split(";")[0];

// One request, held against what the description says of it.
async function ask(origin, path, url, method, operation, init = {}) {
    const abort = new AbortController(); // a stream of pictures has no end
    const response = await fetch(origin + url, { method, redirect: "manual", signal: abort.signal, ...init });
    const type = response.headers.get("content-type") ?? "";
    const what = `${method} ${path} ${url}: ${response.status} ${type}`;
    const said = operation.responses[response.status] ?? operation.responses[`${Math.floor(response.status / 100)}XX`];
    assert.ok(said, what);
    const media = Object.keys(said.content ?? {});
    if (media.length) assert.ok(media.some((one) => isLike(one, type)), `${what}: ${media} are said`);
    else if (response.status !== 304) assert.equal(type, "", what); // 304 repeats the fields of a 200
    const allow = response.headers.get("allow");
    if (!media.length || /multipart/.test(type)) abort.abort();
    else await response.arrayBuffer();
    return { status: response.status, etag: response.headers.get("etag"), allow };
}

// The values of parameters, such that there is something at each address.
async function valuesOf(url, ds) {
    const { splats } = await getJson(`${url}/collections/${ds}`);
    const [lon, lat, h] = splats.origin;
    const seed = JSON.parse((await (await fetch(`${url}/d/${ds}/seed.ndjson`)).text()).split("\n")[0]);
    const [rev, z, x, y] = /r\/([^/]+)\/t\/(\d+)\/(\d+)\/(\d+)\.glb/.exec(seed.url).slice(1);
    const map = await getJson(`${url}/d/${ds}/map.json`);
    const zoom = map.minzoom;
    const turn = (lat * Math.PI) / 180;
    const at = [((lon + 180) / 360) * 2 ** zoom, ((1 - Math.asinh(Math.tan(turn)) / Math.PI) / 2) * 2 ** zoom];
    const place = { lon: lon.toFixed(6), lat: lat.toFixed(6) };
    return {
        path: { ds, rev, z, x, y, ext: "glb", row: "0", name: "evening", stream: "0123456789abcdef0123", seal: "k.1.b.lit.x", rest: "/d/lit", digest: "0123456789ab", fmt: "spz" },
        map: { z: String(zoom), x: String(Math.floor(at[0])), y: String(Math.floor(at[1])), fmt: "webp" },
        view: { ...place, height: (h + 60).toFixed(1), heading: "0", pitch: "-60", fov: "50", roll: "0", w: "64", h: "48", s: "1", fmt: "png" },
        place,
        bodies: {
            Render: { pose: { lon, lat, height: h + 60, heading: 0, pitch: -60 }, width: 64, height: 48 },
            Pick: { pose: { lon, lat, height: h + 60, heading: 0, pitch: -60 }, width: 64, height: 48, x: 30, y: 20 },
            Steer: { number: 1, pose: { lon, lat, height: h + 60, heading: 0, pitch: -60 }, width: 64, height: 48 },
            Places: { places: [[lon, lat]] },
            Profile: { line: [[lon, lat], [lon + 1e-4, lat]] },
            Measure: { line: [[lon, lat], [lon + 1e-4, lat]] },
            Visible: { from: { lon, lat, above: 50 }, to: { lon: lon + 2e-4, lat, above: 2 } },
            Mix: { appearance: "IMG_0001.jpg" },
            Token: { token: "none" },
        },
    };
}

function addressOf(path, values) {
    const of = path.includes("/static/") ? values.view : /\/(map|terrain)\/\{z}/.test(path) ? values.map : {};
    return path.replace(/{(\w+)}/g, (_, name) => of[name] ?? values.path[name]);
}

// The program says it after the address that everybody opens.
async function operatorsOf(city) {
    for (let n = 0; n < 200; n++) {
        const said = /operators: port (\d+)\n/.exec(city.said());
        if (said) return `http://127.0.0.1:${said[1]}`;
        await new Promise((done) => setTimeout(done, 50));
    }
    throw new Error(`no port for operators: ${city.said()}`);
}

test("every route answers every method with a status and a type that is said", { skip: MOCK }, async (t) => {
    const lit = await openLitCity({ serveWith: ["--admin", "127.0.0.1:0", "--state-dir", "DIR/state"] });
    t.after(() => lit.close());
    const operators = await operatorsOf(lit);
    const values = await valuesOf(lit.url, "lit");
    const appearances = await getJson(`${lit.url}/d/lit/appearances`);
    values.bodies.Mix = { appearance: appearances.appearances[0].name };
    await awaitDevice(lit.url);
    const counts = {};
    const count = ({ status }) => (counts[status] = (counts[status] ?? 0) + 1);
    const order = ["get", "put", "post", "delete"];
    for (const [path, methods] of Object.entries(api.paths)) {
        const url = addressOf(path, values);
        const declared = order.filter((verb) => methods[verb]);
        for (const verb of [...declared, ...(methods.put ? ["get"] : [])]) {
            const operation = methods[verb];
            const origin = operation.tags[0] === "operators" || verb === "put" || verb === "delete" || path === "/metrics" ? operators : lit.url;
            const ref = operation.requestBody?.content["application/json"].schema.$ref.split("/").at(-1);
            const init = ref ? { body: JSON.stringify(values.bodies[ref]), headers: { "content-type": "application/json" } } : {};
            const place = operation.parameters.some((p) => p.in === "query" && p.name === "lon");
            const asked = place ? `${url}?lon=${values.place.lon}&lat=${values.place.lat}` : url;
            const first = await ask(origin, path, asked, verb.toUpperCase(), operation, init);
            count(first);
            const absent = path.includes("/tileset/{z}") || (path.endsWith("{name}") && verb !== "put") || verb === "post" && path.includes("/motion/");
            const open = verb === "post" && path.startsWith("/session") || path.startsWith("/signed/"); // everything is public here
            assert.ok(first.status < 400 || absent || open, `${verb} ${path} ${asked}: ${first.status}`);
            if (verb !== "get" || first.status !== 200 || !operation.responses["206"]) continue;
            for (const headers of [{ range: "bytes=0-0" }, { range: "bytes=999999999-" }, { "if-none-match": first.etag ?? '"-"' }])
                count(await ask(origin, path, asked, "GET", operation, { headers }));
            const head = await fetch(origin + asked, { method: "HEAD", redirect: "manual" });
            assert.equal(head.status, 200, `HEAD ${asked}`);
        }
        const verbs = declared.map((verb) => verb.toUpperCase());
        const other = await fetch((methods.post?.tags[0] === "operators" || path === "/metrics" ? operators : lit.url) + url, { method: "PATCH" });
        assert.equal(other.status, 405, path);
        const allow = other.headers.get("allow").split(", ").filter((one) => one !== "HEAD" && one !== "OPTIONS");
        assert.deepEqual(allow.toSorted(), verbs.toSorted(), path);
    }
    t.diagnostic(JSON.stringify(counts));
    for (const status of [200, 201, 204, 206, 304, 307, 416]) assert.ok(counts[status], `${status} was never answered`);
});

// ---- a generated client ----

test("a generated client compiles under --strict, calls every operation, and is answered as its types say", { skip: MOCK }, async (t) => {
    const made = await import("openapi-typescript").catch(() => null);
    if (!made) return t.skip("openapi-typescript is not among the packages of tests/web: run `npm ci` there");
    const { default: describe, astToString } = made;
    const dir = mkdtempSync(join(tmpdir(), "citysplat-client-"));
    t.after(() => rmSync(dir, { recursive: true, force: true }));
    const HERE = dirname(fileURLToPath(import.meta.url));
    const text = readFileSync(join(HERE, "api_client.ts"), "utf8");
    writeFileSync(join(dir, "api.ts"), astToString(await describe(structuredClone(api))));
    writeFileSync(join(dir, "client.ts"), text);
    symlinkSync(join(HERE, "node_modules"), join(dir, "node_modules"));
    const tsc = spawnSync(process.execPath, [
        join(HERE, "node_modules/typescript/bin/tsc"), "--strict", "--noEmit", "--skipLibCheck", "--target", "es2022",
        "--lib", "es2023,dom,dom.iterable", "--moduleResolution", "bundler", "--module", "esnext", "client.ts",
    ], { cwd: dir, encoding: "utf8" });
    assert.equal(tsc.status, 0, tsc.stdout);
    const called = new Set([...text.matchAll(/note\("(\w+ [^"]+)"/g)].map((m) => m[1]));
    const described = Object.entries(api.paths).flatMap(([path, of]) => Object.keys(of).map((verb) => `${verb.toUpperCase()} ${path}`));
    assert.deepEqual([...called].sort(), described.sort());
    const { buildSync } = createRequire(join(HERE, "../../web/package.json"))("esbuild");
    buildSync({ entryPoints: [join(dir, "client.ts")], bundle: true, format: "esm", platform: "node", logLevel: "error", outfile: join(dir, "client.mjs") });
    const { callAll } = await import(join(dir, "client.mjs"));
    const lit = await openLitCity({ serveWith: ["--admin", "127.0.0.1:0", "--state-dir", "DIR/state"] });
    t.after(() => lit.close());
    await awaitDevice(lit.url);
    const operators = await operatorsOf(lit);
    const statuses = await callAll(lit.url, operators, "lit");
    // No sessions and seals without --auth; a small tileset has no parts.
    const without = /session|\/signed\/|tileset\/\{z\}/;
    for (const [what, status] of Object.entries(statuses)) assert.ok(status < 400 || without.test(what), `${what}: ${status}`);
    t.diagnostic(`${described.length} operations`);
});
