// The viewer in pages of another host than its server's: the examples of docs/viewer.md as printed, under the policy that it
// names; what a page is told where 3D cannot start; the package of npm, by itself, in React and in Vue.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { execFileSync, spawnSync } from "node:child_process";
import { cpSync, mkdirSync, mkdtempSync, readFileSync, rmSync, statSync, symlinkSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { dirname, join, normalize } from "node:path";
import { after, before, test } from "node:test";
import { fileURLToPath } from "node:url";

import { findFaults } from "./lib/axe.mjs";
import { closeAll, openPage } from "./lib/browser.mjs";
import { measureContent } from "./lib/checks.mjs";
import { serveFiles } from "./lib/files.mjs";
import { installPackage } from "./lib/package.mjs";
import { decodePng } from "./lib/png.mjs";
import { hostedBy, snippets } from "./lib/snippets.mjs";
import { Proxy } from "./lib/proxy.mjs";
import { openSource } from "./lib/source.mjs";

const HERE = dirname(fileURLToPath(import.meta.url));
const WEB = join(HERE, "../../web");
const SIZE = { width: 400, height: 300 };
const TIMEOUT_MS = 60000;
const COLOURS_LEAST = 10; // of a picture of the city

let source;
let dir; // what the other host serves
let other;
let packed;
before(async () => {
    source = await openSource();
    dir = mkdtempSync(join(tmpdir(), "citysplat-reach-"));
    packed = installPackage(dir);
    other = await serveFiles((path) => join(dir, normalize(path)));
});
after(async () => {
    other?.close();
    if (dir) rmSync(dir, { recursive: true, force: true });
    await closeAll(source);
});

// A page of the other host, under a policy; host: that of the examples.
async function openOther(name, body, { policy = "", host = source.url, prepare = null } = {}) {
    const meta = policy && `<meta http-equiv="Content-Security-Policy" content="${hostedBy(policy.trim(), host)}">`;
    const html = `<!doctype html><html lang="en"><head><meta charset="utf-8"><title>x</title><link rel="icon" href="data:,">${meta}</head><body>${hostedBy(body, host)}</body></html>`;
    writeFileSync(join(dir, `${name}.html`), html);
    if (!prepare) return openPage(`${other.url}/${name}.html`, SIZE);
    const opened = await openPage("about:blank", SIZE);
    await opened.page.addInitScript(prepare);
    await opened.page.goto(`${other.url}/${name}.html`);
    return opened;
}

// The viewer of the page's element, or the one that the page calls so. A policy forbids texts as scripts.
const ready = (page) =>
    page.waitForFunction(() => (window.viewer ?? document.querySelector("city-splat")?.viewer)?.state.ready, null, { timeout: TIMEOUT_MS });
const drawn = async (page, what) => {
    const { colors } = measureContent(decodePng(await page.locator(what).screenshot()));
    assert.ok(colors >= COLOURS_LEAST, `${what} has ${colors} colours`);
};
const modeOf = (page) => page.evaluate(() => (window.viewer ?? document.querySelector("city-splat").viewer).mode);

const [LINE, MODULE] = [snippets("viewer.md", "## In other pages", "html"), snippets("viewer.md", "### The module", "html")];
const [POLICY] = snippets("viewer.md", "### Content Security Policy");
const TOLD = "<script>addEventListener('problem', (event) => (window.told ??= []).push(event.detail), true);</script>";

test("one line shows the city, under the documented policy", async (t) => {
    const opened = await openOther("line", LINE[0], { policy: POLICY });
    t.after(() => opened.close());
    const { page, log } = opened;
    await page.waitForFunction(() => customElements.get("city-splat"));
    await ready(page);
    assert.equal(await modeOf(page), "splats");
    await drawn(page, "city-splat");
    const { width, height } = await page.locator("city-splat").boundingBox();
    assert.ok(Math.abs(width / height - 16 / 9) < 0.02, `${width} x ${height}`);
    assert.deepEqual(log, []);
});

test("the element tells what happens, and follows its attributes", async (t) => {
    const [body] = snippets("viewer.md", "### The element", "html");
    const opened = await openOther("element", body);
    t.after(() => opened.close());
    const { page, log } = opened;
    await ready(page);
    await page.waitForFunction(() => /^\d+ Gaussians$/.test(document.getElementById("out").textContent));
    await page.evaluate(() => {
        window.heard = [];
        for (const name of ["move", "scene", "click", "problem"])
            document.getElementById("city").addEventListener(name, ({ detail }) => window.heard.push([name, detail]));
        document.addEventListener("click", (event) => window.heard.push(["document", event.target.id]));
    });
    const box = await page.locator("#city").boundingBox();
    await page.mouse.click(box.x + box.width / 2, box.y + box.height / 2);
    await page.waitForFunction(() => / m$/.test(document.getElementById("out").textContent));
    const heard = () => page.evaluate(() => window.heard.map(([name, detail]) => [name, detail?.place?.h ?? detail]));
    const clicks = (await heard()).filter(([name]) => name !== "move");
    assert.deepEqual(clicks.map(([name]) => name), ["click", "document"], "one click, which rises");
    assert.equal(typeof clicks[0][1], "number");
    // Attributes change the view; keys that are for the page stay the page's.
    const view = await page.evaluate(() => {
        const city = document.getElementById("city");
        const { lon, lat, h } = city.viewer.pose;
        city.view = [lon, lat, h + 20, 90, -45].join();
        document.activeElement.blur();
        return city.view;
    });
    const pose = () => page.evaluate(() => document.getElementById("city").viewer.pose);
    assert.ok(Math.abs((await pose()).heading - 90) < 1e-6 && Math.abs((await pose()).pitch + 45) < 1e-6, view);
    await page.keyboard.press("e");
    await page.waitForTimeout(100);
    assert.ok(Math.abs((await pose()).heading - 90) < 1e-6, "a key of the page turned the city");
    await page.waitForFunction(() => window.heard.some(([name]) => name === "move"));
    await page.evaluate(() => document.getElementById("city").setAttribute("view", "nonsense"));
    await page.waitForFunction(() => window.heard.some(([name, detail]) => name === "problem" && /"nonsense" is not/.test(detail.message)));
    // Moved in the document it lives on; removed, it ends.
    assert.equal(await page.evaluate(() => {
        const city = document.getElementById("city");
        const before = city.viewer;
        document.body.append(city);
        return city.viewer === before;
    }), true);
    await page.evaluate(() => document.getElementById("city").remove());
    await page.waitForFunction(() => document.getElementById("city") === null);
    // The browser tells of their end a moment later.
    for (let i = 0; page.workers().length && i < 50; i++) await page.waitForTimeout(100);
    assert.equal(page.workers().length, 0, "workers are left");
    assert.deepEqual(log, []);
});

test("in an article it is named, credits whose it is, and leaves the page its wheel and its finger", async (t) => {
    const body = `${LINE[0]}<p style="height:3000px">Much to read</p>`;
    const opened = await openOther("article", body, { policy: `${POLICY.trim()}; style-src 'unsafe-inline'` });
    t.after(() => opened.close());
    const { page, log } = opened;
    await ready(page);
    const surface = page.getByRole("application");
    assert.match(await surface.getAttribute("aria-label"), /^City view/);
    assert.equal(await page.locator("city-splat .citysplat-credit").textContent(), "Test city, drawn by code");
    const look = () => page.evaluate(() => [scrollY, document.querySelector("city-splat").viewer.pose.h]);
    const box = await page.locator("city-splat").boundingBox();
    await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
    // The first view is the poster's; the whole scene may fill the frame more.
    const whole = async () => {
        await page.getByRole("button", { name: "Whole scene" }).click();
        await page.evaluate(() => (window.rests = 0));
        await page.waitForFunction(() => {
            const { h } = document.querySelector("city-splat").viewer.pose;
            return ((window.rests = h === window.lastHeight ? window.rests + 1 : 0), (window.lastHeight = h), window.rests > 20);
        }, null, { polling: 50 });
        await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
    };
    await whole();
    const [, high] = await look();
    await page.mouse.wheel(0, 40);
    await page.waitForFunction(() => scrollY === 40);
    await page.waitForFunction(() => /Ctrl|⌘/.test(document.querySelector("city-splat").shadowRoot.querySelector("output.on")?.textContent));
    assert.equal((await look())[1], high, "the wheel moved the camera");
    await page.keyboard.down("Control");
    await page.mouse.wheel(0, -200);
    await page.keyboard.up("Control");
    await page.waitForFunction((h) => document.querySelector("city-splat").viewer.pose.h < h - 1, high);
    assert.equal((await look())[0], 40, "the page scrolled as well");
    const near = (await look())[1];
    await page.getByRole("button", { name: "Farther" }).click();
    await page.waitForFunction((h) => document.querySelector("city-splat").viewer.pose.h > h + 1, near);
    await whole();
    assert.ok(Math.abs((await look())[1] - high) < 0.1, "not the whole scene");
    // Where nothing scrolls the wheel is the city's.
    await page.evaluate(() => document.querySelector("p").remove());
    await page.mouse.move(box.x + box.width / 3, box.y + box.height / 2);
    await page.mouse.wheel(0, -200);
    await page.waitForFunction((h) => document.querySelector("city-splat").viewer.pose.h < h - 1, high);
    assert.deepEqual(log, []);
});

test("one finger scrolls the article, two move the city", async (t) => {
    const opened = await openPage("about:blank", { ...SIZE, hasTouch: true, isMobile: true });
    t.after(() => opened.close());
    const { page } = opened;
    writeFileSync(join(dir, "touch.html"), `<!doctype html><meta name="viewport" content="width=device-width"><title>x</title>${hostedBy(LINE[0], source.url)}<p style="height:3000px">Much to read</p>`);
    await page.goto(`${other.url}/touch.html`);
    await ready(page);
    const look = () => page.evaluate(() => [scrollY, JSON.stringify(document.querySelector("city-splat").viewer.pose)]);
    const client = await page.context().newCDPSession(page);
    const drag = async (...fingers) => {
        const at = (k) => fingers.map(([x, y, dx, dy], id) => ({ id, x: x + k * dx, y: y + k * dy }));
        await client.send("Input.dispatchTouchEvent", { type: "touchStart", touchPoints: at(0) });
        for (let k = 1; k <= 8; k++) await client.send("Input.dispatchTouchEvent", { type: "touchMove", touchPoints: at(k) });
        await client.send("Input.dispatchTouchEvent", { type: "touchEnd", touchPoints: [] });
    };
    const before = await look();
    await drag([200, 150, 0, -12]);
    await page.waitForFunction(() => scrollY > 20);
    const scrolled = await look();
    assert.equal(scrolled[1], before[1], "one finger moved the city");
    // It slides on for a moment.
    await page.waitForFunction(() => ((window.rests = scrollY === window.lastY ? (window.rests ?? 0) + 1 : 0), (window.lastY = scrollY), window.rests > 20), null, { polling: 50 });
    await page.evaluate(() => scrollTo(0, 0));
    await drag([180, 100, -6, 0], [220, 100, 6, 0]);
    await page.waitForFunction((pose) => JSON.stringify(document.querySelector("city-splat").viewer.pose) !== pose, before[1]);
    assert.equal((await look())[0], 0, "two fingers scrolled the page");
});

test("a dead server is said in the element, and it comes when the server does", async (t) => {
    const proxy = await Proxy.open(source.url);
    await proxy.down();
    const opened = await openOther("dead", `<script type="module" src="${source.url}/viewer.js"></script><city-splat src="${proxy.url}/"></city-splat>`);
    t.after(() => opened.close());
    const { page } = opened;
    const said = page.getByRole("alert");
    await said.waitFor();
    assert.match(await said.textContent(), /No reply from .*Try again$/);
    const farther = page.getByRole("button", { name: "Farther" });
    assert.equal(await farther.isVisible(), false, "buttons lie below the words");
    assert.deepEqual((await findFaults(page)).filter((fault) => fault.includes("city-splat")), []);
    await page.getByRole("button", { name: "Try again" }).click();
    assert.equal(await said.isVisible(), true, "silent while it is still dead");
    await proxy.up();
    await ready(page);
    assert.equal(await said.isVisible(), false);
    assert.equal(await farther.isVisible(), true);
    await drawn(page, "city-splat");
    // Gone while the city is there: the picture stays, and it says so.
    await proxy.down();
    await page.evaluate(() => void document.querySelector("city-splat").viewer.get(new URL("collections/none", document.querySelector("city-splat").src)).catch(() => {}));
    await said.waitFor();
    assert.match(await said.textContent(), /does not answer.*Try now$/);
    await proxy.up();
    await said.waitFor({ state: "hidden" });
    await proxy.down();
});

test("the module in a page of another host", async (t) => {
    const opened = await openOther("module", MODULE[0].replace("const viewer", "const viewer = window.viewer"));
    t.after(() => opened.close());
    await ready(opened.page);
    assert.equal(await modeOf(opened.page), "splats");
    await drawn(opened.page, "#city");
    assert.deepEqual(opened.log, []);
});

// What a page hears, and what is shown, where something is missing.
const MISSING = [
    ["workers", "no3d", /worker-src blob:/, { policy: POLICY.replace("blob:", "'none'") }],
    ["webgl", "no3d", /no WebGL 2/, { prepare: () => {
        const own = HTMLCanvasElement.prototype.getContext;
        HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
            return /webgl/.test(kind) ? null : own.call(this, kind, ...more);
        };
    } }],
    ["connect", "noAnswer", /connect-src/, { policy: POLICY.replace(/connect-src .*/, "connect-src 'none'") }],
];
for (const [name, kind, words, how] of MISSING)
    test(`a page is told why there is no 3D: ${name}`, async (t) => {
        const policy = how.policy?.replace("script-src", "script-src 'unsafe-inline'") ?? "";
        const opened = await openOther(`missing-${name}`, TOLD + LINE[0], { ...how, policy });
        t.after(() => opened.close());
        const { page } = opened;
        const said = [];
        page.on("console", (message) => said.push(message.text()));
        await page.waitForFunction(() => window.told?.length, null, { timeout: TIMEOUT_MS });
        const [problem] = await page.evaluate(() => window.told.map(({ kind, message }) => ({ kind, message })));
        assert.equal(problem.kind, kind, problem.message);
        assert.match(problem.message, words);
        if (kind !== "no3d") return;
        // The server's pictures come instead.
        assert.equal(await modeOf(page), "pictures");
        await page.waitForFunction(() => document.querySelector("city-splat").viewer.hasPicture, null, { timeout: TIMEOUT_MS });
        await drawn(page, "city-splat");
    });

test("the package holds what it says, and can be imported without a document", () => {
    const { packed: { name, files, size }, folder } = packed;
    const names = files.map(({ path }) => path);
    assert.equal(name, "citysplat-viewer");
    for (const one of ["README.md", "package.json", "dist/viewer.js", "dist/LICENSES.txt", "dist/types/module.d.ts", "dist/assets/draco_decoder.js"])
        assert.ok(names.includes(one), `${one} is not in it`);
    assert.deepEqual(names.filter((one) => !/^(README\.md|package\.json|require\.cjs|dist\/((viewer|map)\.js|LICENSES\.txt|assets\/draco_decoder\.js|types\/\w+\.d\.ts))$/.test(one)), []);
    assert.ok(size < 650_000, `${size} bytes`); // two entries, each whole with its workers
    const about = JSON.parse(readFileSync(join(folder, "package.json"), "utf8"));
    assert.equal(about.private, undefined);
    assert.deepEqual([about.dependencies, about.license], [undefined, "Apache-2.0"]);
    const licences = readFileSync(join(folder, "dist/LICENSES.txt"), "utf8");
    for (const one of ["citysplat-viewer", "three", "3d-tiles-renderer", "meshoptimizer"])
        assert.match(licences, new RegExp(`^${one}( [\\d.]+)? \\(`, "m"));
    const text = "const { createViewer, version } = await import('citysplat-viewer'); console.log(typeof createViewer, version)";
    const said = execFileSync(process.execPath, ["--input-type=module", "-e", text], { cwd: dir, encoding: "utf8" });
    assert.equal(said.trim(), `function ${about.version}`);
});

test("its declarations compile with nothing beside them, as Node.js finds them", () => {
    const ts = createRequire(join(WEB, "package.json"))("typescript");
    const pages = ["consumer.ts", "consumer.tsx"].map((name) => join(dir, name));
    for (const page of pages) cpSync(join(HERE, page.slice(dir.length + 1)), page);
    for (const name of ["maplibre-gl", "@types", "csstype"]) symlinkSync(join(HERE, "node_modules", name), join(dir, "node_modules", name));
    const program = ts.createProgram(pages, {
        jsx: ts.JsxEmit.ReactJSX,
        target: ts.ScriptTarget.ES2022,
        module: ts.ModuleKind.NodeNext,
        moduleResolution: ts.ModuleResolutionKind.NodeNext,
        lib: ["lib.es2023.d.ts", "lib.dom.d.ts", "lib.dom.iterable.d.ts"],
        strict: true,
        noEmit: true,
        types: [],
    });
    // Our files alone: those of other packages are theirs to check.
    const mine = program.getSourceFiles().filter(({ fileName }) => /consumer\.tsx?$|citysplat-viewer\//.test(fileName));
    const of = (file) => [...program.getSyntacticDiagnostics(file), ...program.getSemanticDiagnostics(file)];
    const wrong = [...program.getOptionsDiagnostics(), ...mine.flatMap(of)].map(({ file, start, messageText }) => {
        const line = file ? file.getLineAndCharacterOfPosition(start).line + 1 : 0;
        return `${file?.fileName}:${line}: ${ts.flattenDiagnosticMessageText(messageText, " ")}`;
    });
    assert.deepEqual(wrong, []);
    assert.ok(mine.length > 10, "the declarations were not read");
});

test("require is refused with words, the map's entry is smaller, and npm publishes without a warning", () => {
    const run = (code) => spawnSync(process.execPath, ["--input-type=commonjs", "-e", code], { cwd: dir, encoding: "utf8" });
    for (const name of ["citysplat-viewer", "citysplat-viewer/map"]) {
        const { status, stderr } = run(`require("${name}")`);
        assert.equal(status, 1);
        assert.match(stderr, /citysplat-viewer is an ES module.*import/);
    }
    const loads = run('import("citysplat-viewer/map").then(({ createMapLayer }) => console.log(typeof createMapLayer))');
    assert.equal(loads.stdout.trim(), "function", loads.stderr);
    const size = (name) => statSync(join(packed.folder, "dist", name)).size;
    assert.ok(size("map.js") < 0.9 * size("viewer.js"), `${size("map.js")} of ${size("viewer.js")} bytes`);
    const publish = spawnSync("npm", ["publish", "--dry-run", "--ignore-scripts", "--offline"], { cwd: WEB, encoding: "utf8" });
    assert.equal(publish.status, 0, publish.stderr);
    const warnings = publish.stderr.split("\n").filter((line) => /npm warn/i.test(line) && !line.includes("requires you to be logged in"));
    assert.deepEqual(warnings, []);
});

// A script of the other host, built as people build theirs: the package from its folder, the framework from npm.
function build(name, files, entry) {
    const { buildSync } = createRequire(join(WEB, "package.json"))("esbuild");
    mkdirSync(join(dir, name), { recursive: true });
    for (const [file, text] of Object.entries(files)) writeFileSync(join(dir, name, file), hostedBy(text, source.url));
    for (const one of ["react", "react-dom", "scheduler", "vue", "@vue"]) {
        const link = join(dir, "node_modules", one);
        rmSync(link, { force: true });
        symlinkSync(join(HERE, "node_modules", one), link);
    }
    buildSync({
        entryPoints: [join(dir, name, entry)],
        bundle: true,
        format: "esm",
        jsx: "automatic",
        outfile: join(dir, `${name}.js`),
        preserveSymlinks: true,
        define: { "process.env.NODE_ENV": '"development"', __VUE_OPTIONS_API__: "true", __VUE_PROD_DEVTOOLS__: "false", __VUE_PROD_HYDRATION_MISMATCH_DETAILS__: "false" },
    });
}

async function runFramework(t, name) {
    const opened = await openOther(name, `<div id="root"></div><script type="module" src="./${name}.js"></script>`);
    t.after(() => opened.close());
    const { page, log } = opened;
    await page.waitForFunction(() => /^\d+ Gaussians$/.test(document.querySelector("output")?.textContent ?? ""), null, { timeout: TIMEOUT_MS });
    await drawn(page, "city-splat");
    assert.deepEqual(log, []);
}

test("React, as the documents show it", async (t) => {
    const [component] = snippets("viewer.md", "### From npm", "jsx");
    const start = `import { createRoot } from "react-dom/client";
import { City } from "./city.jsx";
createRoot(document.getElementById("root")).render(<City appearance="default" />);
`;
    build("react", { "city.jsx": component, "start.jsx": start }, "start.jsx");
    await runFramework(t, "react");
});

test("Vue, as the documents show it", async (t) => {
    const { compileScript, parse } = createRequire(join(HERE, "node_modules/vue/package.json"))("vue/compiler-sfc");
    const [component] = snippets("viewer.md", "### From npm", "vue");
    const { descriptor, errors } = parse(component);
    assert.deepEqual(errors, []);
    const templateOptions = { compilerOptions: { isCustomElement: (tag) => tag === "city-splat" } };
    const { content } = compileScript(descriptor, { id: "city", inlineTemplate: true, templateOptions });
    const start = `import { createApp } from "vue";
import City from "./city.js";
createApp(City).mount("#root");
`;
    build("vue", { "city.js": content, "start.js": start }, "start.js");
    await runFramework(t, "vue");
});
