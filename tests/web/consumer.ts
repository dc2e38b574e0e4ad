// A page of somebody else in TypeScript: compiled by reach.test.mjs against the declarations that the
// module ships, with nothing of ours but the package. Every option, event and method of docs/viewer.md.
//
// SPDX-License-Identifier: Apache-2.0
import {
    createMapLayer,
    createViewer,
    version,
    type Appearance,
    type MapLayer,
    type Mode,
    type Place,
    type Pose,
    type Problem,
    type Viewer,
    type ViewerOptions,
    type ViewerState,
} from "citysplat-viewer";
import { Map as MapView } from "maplibre-gl";

const pose: Pose = { lon: 13.4, lat: 52.5, h: 200, heading: 0, pitch: -40, fov: 45 };
const options: ViewerOptions = {
    url: ["https://city.example/", new URL("https://city.example/tileset.json")],
    scene: "town",
    pose,
    appearance: "",
    mode: "auto",
    colours: "here",
    memoryMb: 256,
    detail: 1.5,
    backdrop: true,
    theme: "light",
    keyboard: "focus",
};
const viewer: Viewer = createViewer(document.body, options);
const ends: (() => void)[] = [
    viewer.on("scene", (scene) => scene.title.toUpperCase()),
    viewer.on("ready", (state: ViewerState) => state.gaussians.toFixed()),
    viewer.on("move", (to: Pose) => to.heading.toFixed()),
    viewer.on("click", ({ x, y, place }) => [x.toFixed(), y.toFixed(), place?.lon.toFixed()]),
    viewer.on("link", (link) => link === "away"),
    viewer.on("problem", (problem: Problem) => [problem.kind === "no3d", problem.title, problem.requestId?.length]),
    viewer.on("mode", (mode: Mode) => mode === "pictures"),
    viewer.on("appearance", (name) => name.length),
    viewer.on("preview", (name) => name.length),
    viewer.on("slow", (framesPerSecond) => framesPerSecond.toFixed()),
    viewer.on("context", (lost) => !lost),
    viewer.on("frame", () => undefined),
    viewer.on("touch", () => undefined),
    viewer.on("picture", (info) => info.moving),
];
// @ts-expect-error: no such event
viewer.on("nothing", () => undefined);
// @ts-expect-error: a number
createViewer(document.body, { memoryMb: "much" });

export async function use(): Promise<string> {
    const place: Place | null = viewer.pick(10, 20);
    const height: number | null = viewer.heightOf({ lon: 13.4, lat: 52.5 });
    const photographs: Appearance[] = await viewer.appearances();
    viewer.lookAt({ ...viewer.pose, heading: 90 });
    await viewer.flyTo(pose, 2);
    viewer.home();
    await viewer.openScene(viewer.scenes[0]?.id ?? "", pose, photographs[0]?.name);
    await viewer.setAppearance("");
    await viewer.setSecondAppearance(null);
    viewer.splitAt(viewer.secondAppearance === null ? null : 0.5);
    const line = viewer.overlay.add({ kind: "line", places: [pose, pose], color: "#f00", label: "way", behind: true });
    viewer.overlay.change(line, { kind: "point", places: [pose] });
    viewer.overlay.remove(line);
    viewer.setMode("splats");
    viewer.setTheme("dark");
    viewer.retry();
    const png: Blob = await viewer.snapshot();
    const picture: URL | null = viewer.serverPicture(800, 600);
    const bytes: ArrayBuffer = await viewer.get("https://city.example/collections");
    const tiles = await viewer.mapTiles();
    for (const end of ends) end();
    viewer.dispose();
    return [version, place?.h, height, png.size, picture?.href, bytes.byteLength, tiles?.maxZoom].join();
}

export function onMap(container: HTMLElement): MapLayer {
    const map = new MapView({ container, style: { version: 8, sources: {}, layers: [] } });
    const layer = createMapLayer({ url: "https://city.example/", lower: "ground", id: "town" });
    layer.on("scene", ({ title, bounds }) => void [title.length, map.fitBounds(bounds, { pitch: 55 })]);
    layer.on("problem", ({ kind, requestId }) => void (kind === "http" && requestId?.length));
    layer.on("ready", (state) => state.tiles.toFixed());
    map.addLayer(layer);
    map.on("click", ({ point }) => layer.pick(point)?.h.toFixed());
    return layer;
}

export function asElement(): string {
    const city = document.querySelector("city-splat")!;
    city.view = "13.4,52.5,200,0,-40";
    city.viewer?.on("problem", (problem) => problem.kind === "no3d");
    city.addEventListener("ready", ({ detail }) => detail.gaussians.toFixed());
    city.addEventListener("problem", ({ detail }) => void (detail.kind === "http" && detail.requestId?.length));
    city.addEventListener("click", (event) => event.detail.place?.lon.toFixed());
    city.addEventListener("pointerdown", (event) => event.preventDefault());
    // @ts-expect-error: a viewer's state has no such member
    city.addEventListener("ready", ({ detail }) => detail.nothing);
    return [city.src, city.scene, city.appearance, city.viewer?.mode].join();
}
