// A filmstrip of the server's pictures while the camera moves: what is on the screen as each picture arrives, and the full
// one when the camera rests.
//
//   CITYSPLAT_BIN=build/release/citysplat node lab/web/film.mjs STORE.tiles OUT.png [--frames 5]
//
// Pictures of the moving camera are drawn out to the size of the screen, as the page shows them.
//
// SPDX-License-Identifier: Apache-2.0
import { writeFileSync } from "node:fs";
import { resolve } from "node:path";
import { parseArgs } from "node:util";

import { openPage, waitForViewer } from "../../tests/web/lib/browser.mjs";

const { values, positionals } = parseArgs({
    allowPositionals: true,
    options: { frames: { type: "string", default: "5" } },
});
const [store, out] = positionals;
if (!store || !out) {
    console.error("usage: node film.mjs STORE.tiles OUT.png [--frames N]");
    process.exit(2);
}
process.env.CITYSPLAT_TILES = resolve(store);
const { openSource } = await import("../../tests/web/lib/source.mjs");
const SIZE = { width: 480, height: 300 };
const TURN_DEG = 3; // a frame

const source = await openSource();
const viewer = await openPage(`${source.url}/?thin&lang=en`, SIZE);
try {
    await waitForViewer(viewer.page, 300_000);
    const { png, told } = await viewer.page.evaluate(
        async ([frames, { width, height }, turn]) => {
            const { viewer } = window.citysplat;
            const from = viewer.pose;
            const across = Math.ceil((frames + 1) / 2);
            const strip = Object.assign(document.createElement("canvas"), { width: across * width, height: 2 * height });
            const draw = strip.getContext("2d");
            const told = [];
            const began = performance.now();
            const keep = (info) => {
                const at = told.length;
                const [x, y] = [(at % across) * width, Math.floor(at / across) * height];
                draw.drawImage(viewer.surface.querySelector(".citysplat-picture"), x, y, width, height);
                draw.fillStyle = "#000b";
                draw.fillRect(x, y + height - 24, width, 24);
                draw.fillStyle = "#fff";
                draw.font = "14px sans-serif";
                const size = `${info.width} × ${info.height} px, ${Math.round(info.bytes / 1e3)} kB`;
                draw.fillText(`${info.moving ? "moving" : "at rest"}: ${size}`, x + 8, y + height - 8);
                told.push({ ...info, at: Math.round(performance.now() - began) });
            };
            let rested = () => {};
            const full = new Promise((done) => (rested = done));
            viewer.on("picture", (info) => {
                const moving = told.length < frames;
                if (info.moving === moving && told.length <= frames) keep(info);
                if (!info.moving && !moving) rested();
            });
            // Round the middle of the city.
            const { frame, extent } = viewer.stage;
            const middle = frame.placeOf(extent.min.clone().add(extent.max).multiplyScalar(0.5));
            const narrow = Math.cos((middle.lat * Math.PI) / 180);
            const [east, north] = [(from.lon - middle.lon) * narrow, from.lat - middle.lat];
            for (let i = 1; told.length < frames; i++) {
                const [sin, cos] = [Math.sin((turn * i * Math.PI) / 180), Math.cos((turn * i * Math.PI) / 180)];
                const lon = middle.lon + (east * cos + north * sin) / narrow;
                const lat = middle.lat + north * cos - east * sin;
                viewer.lookAt({ ...from, lon, lat, heading: from.heading + turn * i });
                await new Promise(requestAnimationFrame);
            }
            await full;
            return { png: strip.toDataURL("image/png").split(",")[1], told };
        },
        [Number(values.frames), SIZE, TURN_DEG],
    );
    writeFileSync(out, Buffer.from(png, "base64"));
    for (const { width, height, bytes, milliseconds, moving, at } of told)
        console.log(
            `${(at / 1000).toFixed(1)} s  ${width} x ${height} px  ${(bytes / 1e3).toFixed(1)} kB  ` +
                `asked ${Math.round(milliseconds)} ms ago  ${moving ? "moving" : "at rest"}`,
        );
} finally {
    await viewer.close();
    await source.close();
}
