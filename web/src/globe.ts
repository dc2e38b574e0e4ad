// cesium.html: a scene on CesiumJS' globe, without a token and without a third party. The camera is
// that of the viewer's address, both ways. The globe is the ellipsoid, raised or lowered to the
// survey's floor: a city must neither float above it nor lie below it, where Cesium's camera cannot go.
//
// SPDX-License-Identifier: Apache-2.0
import "@cesium/engine/Source/Widget/CesiumWidget.css";

import { formatView, parseView, type View } from "./address";
import {
  Cartesian2,
  Cartesian3,
  Cesium3DTileset,
  CesiumWidget,
  CustomHeightmapTerrainProvider,
  EasingFunction,
  HeadingPitchRange,
  ImageryLayer,
  CesiumMath,
  PerspectiveFrustum,
  ScreenSpaceEventHandler,
  ScreenSpaceEventType,
  TileMapServiceImageryProvider,
  buildModuleUrl,
} from "./cesium";
import { element, setText } from "./dom";
import "./globe.css";
import { FOV_DEG, type Pose } from "./pose";
import "./style.css";
import { getLanguage, setLanguage, text, translate } from "./strings";
import { compass, formatPlace } from "./units";

interface Scene {
  id: string;
  title: string;
  folder: URL; // of the scene: its tileset.json, terrain.json and questions
  heights: string; // above what they are (SceneEntry.heights)
  asks: boolean; // whether somebody answers questions there
}
interface Pick {
  found?: boolean;
  lon?: number;
  lat?: number;
  height_m?: number;
}

const TRIM_MS = 30_000;
const ADDRESS_MS = 300;
const AWAKE_MS = 3000; // frames go on for so long after the last change
const AWAKE_EVERY_MS = 100;
const HEIGHTMAP = 16; // a flat one needs no more
const query = new URLSearchParams(location.search);

function say(problem: string) {
  const box = document.createElement("div");
  box.className = "banner";
  box.append(Object.assign(document.createElement("p"), { textContent: problem }));
  element("banners").replaceChildren(box);
}

async function getJson(url: URL): Promise<unknown> {
  const response = await fetch(url);
  if (!response.ok) throw new Error(`${url.pathname}: ${response.status} ${response.statusText}`);
  return response.json();
}

// As the viewer looks for scenes: what the address says, else a catalogue in this folder, above it or
// at the root of the host.
async function findScenes(): Promise<Scene[]> {
  const given = query.get("url") ?? query.get("server");
  const places = given ? [given] : ["./", "../", "/"];
  let first: unknown;
  for (const place of places) {
    const base = new URL(place, location.href);
    if (/\.json$/.test(base.pathname)) {
      const id = decodeURIComponent(base.pathname.split("/").at(-2) ?? "") || "city";
      return [{ id, title: id, folder: new URL("./", base), heights: "ellipsoid", asks: false }];
    }
    base.pathname = base.pathname.replace(/\/*$/, "/");
    try {
      const body = (await getJson(new URL("collections", base))) as {
        collections?: { id: string; title?: string; splats?: { heights?: string } }[];
      };
      if (!body.collections?.length) throw new Error(text("problem.noScenes.text"));
      return body.collections.map(({ id, title, splats }) => {
        const folder = new URL(`d/${encodeURIComponent(id)}/`, base);
        return { id, title: title || id, folder, heights: splats?.heights ?? "ellipsoid", asks: true };
      });
    } catch (error) {
      first ??= error;
    }
  }
  throw first;
}

// Height of the ground around a scene: what the server's terrain has where nothing was surveyed.
async function floorOf(scene: Scene): Promise<number> {
  if (!scene.asks) return 0;
  const terrain = (await getJson(new URL("terrain.json", scene.folder))) as { voidHeight?: number };
  return terrain.voidHeight ?? 0;
}

class Globe {
  readonly widget: CesiumWidget;
  tileset: Cesium3DTileset | null = null;
  private scene: Scene | null = null;
  private appearance = "";
  private opened = 0;
  private addressTimer = 0;
  private awakeUntil = 0;

  constructor(private readonly scenes: Scene[]) {
    const earth = TileMapServiceImageryProvider.fromUrl(
      buildModuleUrl("Assets/Textures/NaturalEarthII"),
    );
    this.widget = new CesiumWidget("globe", {
      baseLayer: ImageryLayer.fromProviderAsync(earth, {}),
      scene3DOnly: true,
      requestRenderMode: true,
      maximumRenderTimeChange: Infinity,
    });
    const { scene, camera } = this.widget;
    scene.renderError.addEventListener((_: unknown, error: unknown) =>
      say(text("globe.stopped", { why: String(error) })),
    );
    (camera.frustum as PerspectiveFrustum).near = 0.5;
    camera.percentageChanged = 0.001;
    const moved = () => {
      this.wake();
      this.showPlace();
    };
    camera.changed.addEventListener(moved);
    camera.moveEnd.addEventListener(moved);
    // Tiles that came and splats that were sorted are seen in the frames after that.
    window.setInterval(() => performance.now() < this.awakeUntil && scene.requestRender(), AWAKE_EVERY_MS);
    new ScreenSpaceEventHandler(scene.canvas).setInputAction(
      (click: ScreenSpaceEventHandler.PositionedEvent) => void this.pick(click.position),
      ScreenSpaceEventType.LEFT_CLICK,
    );
    // Cesium 1.145 counts tiles of splats as 0 bytes: its cache never forgets one by itself.
    window.setInterval(() => this.tileset?.trimLoadedTiles(), TRIM_MS);
    window.addEventListener("hashchange", () => {
      const view = parseView(location.hash);
      if (view) void this.show(view);
    });
  }

  async open(scene: Scene, view: View | null) {
    const turn = ++this.opened;
    this.scene = scene;
    this.appearance = view?.appearance ?? "";
    setText("title", scene.title);
    setText("place-text", "");
    document.title = `${scene.title} – citysplat`;
    const floor = await floorOf(scene);
    if (turn !== this.opened) return;
    const flat = new Float32Array(HEIGHTMAP * HEIGHTMAP).fill(floor);
    this.widget.terrainProvider = new CustomHeightmapTerrainProvider({
      width: HEIGHTMAP,
      height: HEIGHTMAP,
      callback: () => flat.slice(),
    }) as unknown as CesiumWidget["terrainProvider"];
    if (!(await this.load(turn))) return;
    if (view) this.look(view.pose);
    else this.home();
  }

  private async load(turn: number): Promise<boolean> {
    const url = new URL("tileset.json", this.scene!.folder);
    if (this.appearance) url.searchParams.set("appearance", this.appearance);
    const tileset = await Cesium3DTileset.fromUrl(url.href); // its own 16 px shows the server's tiles
    if (turn !== this.opened) {
      tileset.destroy();
      return false;
    }
    tileset.tileFailed.addEventListener(({ url: at, message }: { url: string; message: string }) =>
      say(`${new URL(at, location.href).pathname}: ${message}`),
    );
    const { primitives } = this.widget.scene;
    if (this.tileset) primitives.remove(this.tileset);
    this.tileset = primitives.add(tileset) as Cesium3DTileset;
    tileset.loadProgress.addEventListener(() => this.wake());
    this.wake();
    return true;
  }

  // A view of the address: the camera at once, another appearance when it is there.
  private async show(view: View) {
    this.look(view.pose);
    if (view.appearance === this.appearance) return;
    this.appearance = view.appearance;
    await this.load(++this.opened).catch((error: Error) => say(error.message));
  }

  private wake() {
    this.awakeUntil = performance.now() + AWAKE_MS;
  }

  home() {
    const { boundingSphere } = this.tileset!;
    this.widget.camera.flyToBoundingSphere(boundingSphere, {
      duration: 0,
      easingFunction: EasingFunction.LINEAR_NONE,
      offset: new HeadingPitchRange(0.35, -0.66, 1.4 * boundingSphere.radius),
    });
  }

  // Cesium's angle of view is that of the longer side.
  look({ lon, lat, h, heading, pitch, fov }: Pose) {
    const { camera, scene } = this.widget;
    const frustum = camera.frustum as PerspectiveFrustum;
    const aspect = scene.drawingBufferWidth / scene.drawingBufferHeight;
    const tall = CesiumMath.toRadians(fov);
    frustum.fov = aspect > 1 ? 2 * Math.atan(Math.tan(tall / 2) * aspect) : tall;
    camera.setView({
      destination: Cartesian3.fromDegrees(lon, lat, h),
      orientation: {
        heading: CesiumMath.toRadians(heading),
        pitch: CesiumMath.toRadians(pitch),
        roll: 0,
      },
    });
  }

  get pose(): Pose {
    const { camera } = this.widget;
    const { longitude, latitude, height } = camera.positionCartographic;
    return {
      lon: CesiumMath.toDegrees(longitude),
      lat: CesiumMath.toDegrees(latitude),
      h: height,
      heading: CesiumMath.toDegrees(camera.heading),
      pitch: CesiumMath.toDegrees(camera.pitch),
      fov: CesiumMath.toDegrees((camera.frustum as PerspectiveFrustum).fovy ?? 0) || FOV_DEG,
    };
  }

  private showPlace() {
    const { pose } = this;
    setText("where", `${formatPlace(pose, this.scene?.heights ?? "", 5)} · ${compass(pose.heading)}`);
    clearTimeout(this.addressTimer);
    this.addressTimer = window.setTimeout(() => {
      if (!this.tileset) return;
      const url = new URL(location.href);
      if (this.scenes.length > 1) url.searchParams.set("scene", this.scene!.id);
      url.hash = formatView({ pose: this.pose, appearance: this.appearance });
      history.replaceState(null, "", url);
      element<HTMLAnchorElement>("back").href = `./${url.search}${url.hash}`;
    }, ADDRESS_MS);
  }

  // Splats write no depth that Cesium could read: the server says what a pixel shows.
  private async pick(at: Cartesian2) {
    const { scene, pose } = this;
    if (!scene?.asks) return;
    const { clientWidth: width, clientHeight: height } = this.widget.scene.canvas;
    const { lon, lat, h, heading, pitch, fov } = pose;
    const body = { pose: { lon, lat, height: h, heading, pitch, fov }, width, height, x: at.x, y: at.y };
    const response = await fetch(new URL("pick", scene.folder), {
      method: "POST",
      body: JSON.stringify(body),
    }).catch(() => null);
    const place = response?.ok ? ((await response.json()) as Pick) : {};
    setText(
      "place-text",
      place.found
        ? formatPlace({ lat: place.lat!, lon: place.lon!, h: place.height_m! }, scene.heights)
        : text("place.none"),
    );
  }
}

async function main() {
  await setLanguage(query.get("lang") ?? navigator.language);
  document.documentElement.lang = getLanguage();
  const light = matchMedia("(prefers-color-scheme: light)").matches;
  document.documentElement.dataset["theme"] = light ? "light" : "dark";
  translate(document);
  const scenes = await findScenes();
  const wanted = query.get("scene");
  const scene = wanted === null ? scenes[0] : scenes.find((one) => one.id === wanted);
  if (!scene) throw new Error(text("problem.noScene.text", { id: wanted ?? "" }));
  const globe = new Globe(scenes);
  Object.assign(window, { globe });
  const select = element<HTMLSelectElement>("dataset");
  select.replaceChildren(...scenes.map((one) => new Option(one.title, one.id, false, one === scene)));
  select.onchange = () =>
    void globe
      .open(scenes.find((one) => one.id === select.value)!, null)
      .catch((error: Error) => say(error.message));
  element("chooser").hidden = scenes.length < 2;
  await globe.open(scene, parseView(location.hash));
}

main().catch((error: Error) => say(error.message));
