// CesiumJS of its npm package, in a page at another address than the city's.
//
// SPDX-License-Identifier: Apache-2.0
import { dirname, join, normalize } from "node:path";
import { fileURLToPath } from "node:url";

import { openPage } from "./browser.mjs";
import { serveFiles } from "./files.mjs";

const HERE = join(dirname(fileURLToPath(import.meta.url)), "..");
const TIMEOUT_MS = 120000;

// The page of cesium.html with the tileset at that URL. What openPage gives; window.tileset and
// window.widget are there.
export async function openCesium(tileset, size) {
    const files = await serveFiles((path) =>
        path === "/" ? join(HERE, "cesium.html") : join(HERE, "node_modules/cesium/Build", normalize(path).replace(/^\/cesium/, "Cesium")),
    );
    const opened = await openPage(`${files.url}/?tileset=${encodeURIComponent(tileset)}`, size).catch((error) => {
        files.close();
        throw error;
    });
    const close = () => opened.close().finally(files.close);
    await opened.page.waitForFunction(() => window.tileset !== undefined, null, { timeout: TIMEOUT_MS });
    return { ...opened, close };
}

// Looks from a pose of the viewer. Cesium's angle of view is that of the longer side.
export function lookFrom(page, pose) {
    return page.evaluate((p) => {
        const { camera, scene } = window.widget;
        const aspect = scene.drawingBufferWidth / scene.drawingBufferHeight;
        const fovy = Cesium.Math.toRadians(p.fov);
        camera.frustum.fov = aspect > 1 ? 2 * Math.atan(Math.tan(fovy / 2) * aspect) : fovy;
        camera.setView({
            destination: Cesium.Cartesian3.fromDegrees(p.lon, p.lat, p.h),
            orientation: { heading: Cesium.Math.toRadians(p.heading), pitch: Cesium.Math.toRadians(p.pitch), roll: 0 },
        });
    }, pose);
}
