// Where the tests' tiles come from: a given tile store (CITYSPLAT_TILES), the mock server
// (CITYSPLAT_MOCK=1), or, as a rule, the test city written as .ply, imported and served by the real
// program (CITYSPLAT_BIN).
//
// SPDX-License-Identifier: Apache-2.0
import { spawn, spawnSync } from "node:child_process";
import { randomBytes } from "node:crypto";
import { mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

import { makeCity, ORIGIN } from "./city.mjs";
import { startMock } from "./mock.mjs";
import { writePly } from "./ply.mjs";

const WEB_DIST = join(dirname(fileURLToPath(import.meta.url)), "../../../web/dist");
const START_TIMEOUT_MS = 60000; // kernels may have to be compiled
const DEADLINE_S = 120; // of an answer: a busy machine must not turn a picture into an error

export const BIN = process.env.CITYSPLAT_BIN;
export const GIVEN_TILES = process.env.CITYSPLAT_TILES;
export const MOCK = process.env.CITYSPLAT_MOCK === "1";

export const ATTRIBUTION = "Test city, drawn by code";

// edgeM: of the finest tiles. city: Gaussians about ORIGIN. antialiased: as trained with a low-pass filter.
export function importCity(dir, edgeM = 60, name = "fcity", city = makeCity(), antialiased = false) {
    const file = name === "fcity" ? "city" : name;
    const ply = join(dir, `${file}.ply`);
    const tiles = join(dir, `${file}.tiles`);
    writeFileSync(ply, writePly(city, ORIGIN, antialiased));
    const args = [
        "import",
        ply,
        "--output",
        tiles,
        "--overwrite",
        "--name",
        name,
        "--tile-edge-m",
        String(edgeM),
        "--attribution",
        ATTRIBUTION,
    ];
    const run = spawnSync(BIN, args, { encoding: "utf8" });
    if (run.status !== 0)
        throw new Error(`citysplat ${args.join(" ")}\n${run.stdout}${run.stderr}`);
    return tiles;
}

// Starts `citysplat serve` on a free port; resolves with its address and a function that ends it.
export function serve(...argv) {
    const args = ["serve", ...argv, "--port", "0", "--web-dir", WEB_DIST, "--deadline-s", String(DEADLINE_S)];
    const child = spawn(BIN, args, { stdio: ["ignore", "pipe", "pipe"] });
    let said = "";
    const close = () =>
        new Promise((done) => {
            if (child.exitCode !== null || child.signalCode !== null) return done();
            child.once("exit", done);
            child.kill("SIGTERM");
        });
    return new Promise((resolve, reject) => {
        const timer = setTimeout(() => fail("no address after a minute"), START_TIMEOUT_MS);
        const fail = (why) => {
            clearTimeout(timer);
            child.kill("SIGKILL");
            reject(new Error(`citysplat ${args.join(" ")}: ${why}\n${said}`));
        };
        const listen = (chunk) => {
            said += chunk;
            const match = /: open (http:\/\/[\w.[\]:]+:\d+)/.exec(said); // the log may name a store's address before
            if (!match) return;
            clearTimeout(timer);
            resolve({ url: match[1], close, said: () => said });
        };
        child.stdout.on("data", listen);
        child.stderr.on("data", listen);
        child.once("error", (e) => fail(e.message));
        child.once("exit", (code) => fail(`exit ${code}`));
    });
}

// Options of a server whose data are private, in a folder.
function privateOptions(dir) {
    const file = join(dir, "auth.jsonc");
    const text = JSON.stringify({ keys: { k: randomBytes(32).toString("base64") } });
    writeFileSync(file, text, { mode: 0o600 });
    return ["--auth", file];
}

// The address that opens a private data set: all that a client of it asks for lies below.
function signedUrl(dir, url, name = "fcity") {
    const args = ["sign", name, "--auth", join(dir, "auth.jsonc"), "--url", url];
    const run = spawnSync(BIN, args, { encoding: "utf8" });
    if (run.status !== 0) throw new Error(`citysplat ${args.join(" ")}\n${run.stderr}`);
    return run.stdout.trim().replace(/\/$/, "");
}

// { url, city, dir, close, said }: a running server; city tells whether it holds the test city, in tiles of
// edgeM; dir has it as city.tiles. signed: the city is private, and url is a signed address. gaussians: others than its own.
export async function openSource({ edgeM, signed = false, gaussians, antialiased } = {}) {
    if (MOCK) return { ...(await startMock()), city: true };
    if (GIVEN_TILES) return { ...(await serve(GIVEN_TILES)), city: false };
    const dir = mkdtempSync(join(tmpdir(), "citysplat-web-"));
    const clean = () => rmSync(dir, { recursive: true, force: true });
    try {
        const server = await serve(importCity(dir, edgeM, undefined, gaussians, antialiased), ...(signed ? privateOptions(dir) : []));
        const url = signed ? signedUrl(dir, server.url) : server.url;
        return { ...server, url, city: true, dir, close: () => server.close().finally(clean) };
    } catch (error) {
        clean();
        throw error;
    }
}

// Scenes of Gaussians about ORIGIN, by name (fcity: the test city's), imported and served.
export async function openScenes(scenes) {
    const dir = mkdtempSync(join(tmpdir(), "citysplat-scenes-"));
    const clean = () => rmSync(dir, { recursive: true, force: true });
    try {
        const server = await serve(...Object.entries(scenes).map(([name, city]) => importCity(dir, 60, name, city)));
        return { ...server, close: () => server.close().finally(clean) };
    } catch (error) {
        clean();
        throw error;
    }
}

// The test city, and what is to be another date of it: `later`, with red and blue exchanged.
export function openTwoDates() {
    return openScenes({ fcity: makeCity(), later: makeCity().map((one) => ({ ...one, rgb: one.rgb.toReversed() })) });
}

function run(args, program = BIN) {
    const done = spawnSync(program, args, { encoding: "utf8" });
    if (done.status !== 0)
        throw new Error(`citysplat ${args.join(" ")}\n${done.stdout}${done.stderr}`);
}

// A small city under changing light, trained with appearance in a few seconds and served, beside the
// test city. Gaussians stay thick (--solid-flat 0): at the rim of thin ones a pixel differs by 21 of 255
// between the page's colours and tiles that the server baked. Exposures are left to the network
// (--no-exposure): appearances then differ strongly.
// The test city, which has none (`plain` is its name). many: Gaussians of a third scene, `many`.
// serveWith: options of `citysplat serve`, beside; "DIR" in them is a folder of its own.
export async function openLitCity({ many = null, serveWith = [] } = {}) {
    const dir = mkdtempSync(join(tmpdir(), "citysplat-lit-"));
    const at = (name) => join(dir, name);
    const clean = () => rmSync(dir, { recursive: true, force: true });
    const options = (text) => text.split(" ");
    try {
        run([
            ...options("synth -q --photos 16 --extent-m 40 --width-px 96 --height-px 72 --seed 3"),
            ...options("--points 3000 --exposure-ev 0.8 --sun-variation 0.5 -o"),
            at("photos"),
        ], `${BIN}-lab`);
        run([
            ...["ingest", at("photos/images"), at("photos/sparse")],
            ...options("--no-exposure -q -o"),
            at("scene"),
        ]);
        run([
            ...["train", at("scene"), "-o", at("trained")],
            ...options("-q --level-count 1 --iterations 200 --budget 3000"),
            ...options("--appearance --appearance-warmup 50 --solid-flat 0"),
        ]);
        run(["tile", at("scene"), "--trained", at("trained"), "-o", at("lit.tiles"), "-q"]);
        const more = many ? [importCity(dir, 60, "many", many)] : [];
        const besides = serveWith.map((word) => word.replace("DIR", dir));
        const server = await serve(at("lit.tiles"), importCity(dir), ...more, ...besides);
        return { ...server, plain: "fcity", close: () => server.close().finally(clean) };
    } catch (error) {
        clean();
        throw error;
    }
}

export async function getJson(url) {
    const response = await fetch(url);
    if (!response.ok) throw new Error(`${url}: ${response.status} ${await response.text()}`);
    return response.json();
}

// A kept connection may have idled out while another program ran: then once more on a new one.
export async function getBytes(url) {
    const response = await fetch(url).catch(() => fetch(url));
    if (!response.ok) throw new Error(`${url}: ${response.status} ${await response.text()}`);
    return Buffer.from(await response.arrayBuffer());
}

// Name of the first data set.
export async function firstDataSet(url) {
    return (await getJson(`${url}/collections`)).collections[0].id;
}
