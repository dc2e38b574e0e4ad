// Wandering through a viewer for some time: jumps and glides to drawn poses, other light, other scenes, with loads that
// are given up on the way. Samples what page, card and processes hold, and says what grew.
//
// SPDX-License-Identifier: Apache-2.0
import { readFileSync } from "node:fs";

import { placeOfEnu } from "./geo.mjs";

const MB = 2 ** 20;
const SETTLE_MS = 60_000;
const HASTE_MS = 1000;
const ON_ITS_WAY = 1.05; // no tile is asked for beyond the limit; those on their way still come
const LIMITS = { heapMb: 32, cardMb: 32 }; // beside the tiles' own limit
const WARM = 0.25; // of the time: everything is used for the first time
const GROWTH = 1.1; // from the first third after that to the last one
const SLACK = { heapMb: 4, textures: 2, geometries: 2, nodes: 60, listeners: 40, rendererMb: 60 };

// Equal steps for equal seeds (mulberry32).
function makeDice(seed) {
    let state = seed >>> 0;
    return () => {
        state = (state + 0x6d2b79f5) >>> 0;
        let t = Math.imul(state ^ (state >>> 15), state | 1);
        t ^= t + Math.imul(t ^ (t >>> 7), t | 61);
        return ((t ^ (t >>> 14)) >>> 0) / 2 ** 32;
    };
}

// A pose over the open scene, by multiples of half of its width: above it, at the street, far off, straight down.
async function drawPose(page, dice) {
    const { origin, half } = await page.evaluate(() => {
        const { frame, extent } = window.citysplat.viewer.stage;
        const { lon, lat } = frame.placeOf(extent.min.clone().add(extent.max).multiplyScalar(0.5));
        const floor = frame.placeOf(extent.min).h;
        return { origin: { lon, lat, h: floor }, half: (extent.max.x - extent.min.x) / 2 };
    });
    const kind = dice();
    const reach = kind < 0.1 ? 5 : 1.2;
    const [e, n] = [dice(), dice()].map((v) => reach * half * (2 * v - 1));
    const up = kind > 0.9 ? 2 : half * (0.15 + 1.2 * dice() ** 2);
    const pitch = kind > 0.9 ? 0 : kind > 0.8 ? -90 : -70 * dice() - 5;
    return { ...placeOfEnu(origin, [e, n, up]), heading: 360 * dice(), pitch, fov: 45 };
}

async function step(page, dice, scenes, lights) {
    const what = dice();
    const { scene } = await page.evaluate(() => window.citysplat.state);
    if (what < 0.08 && scenes.length > 1) {
        const others = scenes.filter((one) => one !== scene);
        const next = others[Math.floor(dice() * others.length)];
        await page.evaluate((id) => window.citysplat.viewer.openScene(id), next);
        return "scene";
    }
    if (what < 0.25 && lights[scene]?.length) {
        const [a, b] = [0, 0].map(() => lights[scene][Math.floor(dice() * lights[scene].length)]);
        const [text, second] = dice() < 0.3 ? [a, b] : [`${a}:0.5,${b}:0.5`, null];
        await page.evaluate(
            ([one, other]) => {
                const { viewer } = window.citysplat;
                return Promise.all([viewer.setAppearance(one), viewer.setSecondAppearance(other)]);
            },
            [text, second],
        );
        return "light";
    }
    const pose = await drawPose(page, dice);
    const glide = dice() < 0.4;
    await page.evaluate(
        ([to, seconds]) => {
            const { viewer } = window.citysplat;
            if (seconds) void viewer.flyTo(to, seconds);
            else viewer.lookAt(to);
        },
        [pose, glide ? 1 : 0],
    );
    return glide ? "glide" : "jump";
}

function residentMb(pid) {
    try {
        return Number(/VmRSS:\s+(\d+)/.exec(readFileSync(`/proc/${pid}/status`, "utf8"))[1]) / 1024;
    } catch {
        return 0; // another user's, or gone
    }
}

// What is held after a collection, MB and counts. renderer and gpu: resident memory of these processes.
async function sample(page, sessions) {
    const { own, all } = sessions;
    await own.send("HeapProfiler.collectGarbage");
    const { metrics } = await own.send("Performance.getMetrics");
    const metric = (name) => metrics.find((one) => one.name === name)?.value ?? 0;
    const heap = await own.send("Runtime.getHeapUsage");
    const held = await page.evaluate(() => {
        const { viewer } = window.citysplat;
        const { engine, renderer } = viewer.city;
        const { scene, memory, heldBack, error, received, gaussians } = viewer.state;
        const { textures, geometries } = renderer.info.memory;
        return { scene, memory, heldBack, error, received, gaussians, card: engine.cardBytes, textures, geometries };
    });
    const { processInfo } = await all.send("SystemInfo.getProcessInfo");
    const resident = (kind) =>
        Math.max(0, ...processInfo.filter(({ type }) => type === kind).map(({ id }) => residentMb(id)));
    return {
        ...held,
        memoryMb: held.memory / MB,
        cardMb: held.card / MB,
        heapMb: (metric("JSHeapUsedSize") + (heap.backingStorageSize ?? 0)) / MB,
        nodes: metric("Nodes"),
        listeners: metric("JSEventListeners"),
        rendererMb: resident("renderer"),
        gpuMb: resident("GPU"),
    };
}

function median(values) {
    return values.toSorted((a, b) => a - b)[values.length >> 1];
}

// What grew without end, as lines of text: medians of the first and of the last third after everything was used once.
export function growthOf(samples) {
    const rest = samples.slice(Math.floor(WARM * samples.length));
    const third = Math.max(1, Math.floor(rest.length / 3));
    const faults = [];
    for (const [key, slack] of Object.entries(SLACK)) {
        const [early, late] = [rest.slice(0, third), rest.slice(-third)].map((part) => median(part.map((one) => one[key])));
        if (late > GROWTH * early + slack) faults.push(`${key}: ${early.toFixed(1)}, at the end ${late.toFixed(1)}`);
    }
    return faults;
}

// What passed its bounds, as lines of text; memoryMb: the viewer's limit, which must have been reached.
export function beyond(samples, memoryMb) {
    const most = (key) => Math.max(...samples.map((one) => one[key]));
    const bounds = { memoryMb: ON_ITS_WAY * memoryMb, ...LIMITS };
    const high = Object.entries(bounds).filter(([key, bound]) => most(key) > bound);
    const errors = new Set(samples.map(({ error }) => error).filter(Boolean));
    return [
        ...high.map(([key, bound]) => `${key}: ${most(key).toFixed(1)} of at most ${bound.toFixed(1)}`),
        ...errors,
        ...(samples.some(({ heldBack }) => heldBack) ? [] : ["the limit of memory was never reached"]),
    ];
}

// Wanders for some seconds and samples every few. { samples, steps: { jump, glide, light, scene } }
export async function wander(page, { seconds, every, seed = 1, onSample = () => {} }) {
    const own = await page.context().newCDPSession(page);
    const all = await page.context().browser().newBrowserCDPSession();
    await own.send("Performance.enable");
    await own.send("HeapProfiler.enable");
    const dice = makeDice(seed);
    const { scenes, lights } = await page.evaluate(async () => {
        const { viewer } = window.citysplat;
        const names = await Promise.all(viewer.scenes.map(async (one) => [one.id, (await viewer.appearances(one)).map(({ name }) => name)]));
        return { scenes: viewer.scenes.map(({ id }) => id), lights: Object.fromEntries(names) };
    });
    const samples = [];
    const steps = { jump: 0, glide: 0, light: 0, scene: 0 };
    const began = Date.now();
    for (let next = began; Date.now() - began < 1000 * seconds; ) {
        steps[await step(page, dice, scenes, lights)]++;
        // Half of the views are waited for, the others are left while their tiles come.
        const patience = dice() < 0.5 ? SETTLE_MS : 50 + HASTE_MS * dice();
        await page
            .waitForFunction(() => window.citysplat.settled, null, { timeout: patience, polling: 100 })
            .catch(() => {});
        if (Date.now() < next) continue;
        samples.push(await sample(page, { own, all }));
        onSample((Date.now() - began) / 1000, samples.at(-1), steps);
        next = Date.now() + 1000 * every;
    }
    await own.detach();
    await all.detach();
    return { samples, steps };
}
