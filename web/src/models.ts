// Models and 3D Tiles of others over the city, by three.js' loaders. A file of its own: nothing of it is
// loaded before the first of them is asked for.
//
// SPDX-License-Identifier: Apache-2.0
import { GLTFCesiumRTCExtension } from "3d-tiles-renderer/src/three/plugins/gltf/GLTFCesiumRTCExtension.js";
import { TilesRenderer } from "3d-tiles-renderer/three";
import {
  Box3,
  FileLoader,
  Group,
  ImageBitmapLoader,
  LoadingManager,
  Matrix4,
  Mesh,
  Sphere,
  Texture,
  Vector3,
  type Material,
  type Object3D,
  type PerspectiveCamera,
  type WebGLRenderer,
} from "three";
import { DRACOLoader } from "three/addons/loaders/DRACOLoader.js";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";

import { checkGltf, GltfFault, readGltfJson, sizeOfImage } from "./gltfcheck";
import { MeshoptPool } from "./meshopt";

const IMAGE_BYTES_MAX = 64 * 2 ** 20;
const IMAGE_SIDE_MAX = 16_384;
const IMAGE_AREA_MAX = 64e6;
const TILE_BYTES_MAX = 64 * 2 ** 20;
const TILES_HELD_BYTES = 256 * 2 ** 20;
const PARSE_MS = 60_000; // damaged meshes may keep a decoder busy for ever
const ON_EARTH_M = [6.2e6, 6.6e6] as const; // from its centre

// Images say how large they are before they are unpacked.
class CheckedImages extends ImageBitmapLoader {
  override load(
    url: string,
    onLoad?: (image: ImageBitmap) => void,
    _onProgress?: unknown,
    onError?: (error: unknown) => void,
  ) {
    const loader = new FileLoader(this.manager).setResponseType("arraybuffer");
    const done = async (file: ArrayBuffer) => {
      const size = sizeOfImage(new Uint8Array(file));
      const [width, height] = size ?? [0, 0];
      if (!size || file.byteLength > IMAGE_BYTES_MAX) throw new GltfFault("an image cannot be read");
      if (Math.max(width, height) > IMAGE_SIDE_MAX || width * height > IMAGE_AREA_MAX)
        throw new GltfFault(`an image of ${width} x ${height}`);
      const blob = new Blob([file]);
      return createImageBitmap(blob, { colorSpaceConversion: "none", premultiplyAlpha: "none" });
    };
    loader.load(
      url,
      (file) => void done(file as ArrayBuffer).then(onLoad, onError),
      undefined,
      onError,
    );
  }
}

let draco: DRACOLoader | null = null;
const meshopt = new MeshoptPool();

// The decoder without WebAssembly, which the page's policy does not allow; fetched with the first mesh
// that needs it.
function dracoLoader(): DRACOLoader {
  if (!draco) {
    draco = new DRACOLoader().setDecoderPath(new URL(/* @vite-ignore */ __ASSETS__, import.meta.url).href);
    (draco as unknown as { decoderConfig: object }).decoderConfig = { type: "js" };
    draco.setWorkerLimit(2);
  }
  return draco;
}

class CheckedGltf extends GLTFLoader {
  constructor(
    manager: LoadingManager,
    private readonly base: URL | null,
  ) {
    super(manager);
    this.setDRACOLoader(dracoLoader());
    this.setMeshoptDecoder(meshopt as unknown as Parameters<GLTFLoader["setMeshoptDecoder"]>[0]);
    this.register((parser) => {
      parser.textureLoader = new CheckedImages(manager) as unknown as typeof parser.textureLoader;
      return { name: "checked-images" };
    });
    this.register(() => new GLTFCesiumRTCExtension());
  }

  override parse(
    data: ArrayBuffer | string,
    path: string,
    onLoad: Parameters<GLTFLoader["parse"]>[2],
    onError?: (event: ErrorEvent) => void,
  ) {
    try {
      const file = typeof data === "string" ? new TextEncoder().encode(data).buffer : data;
      const base = this.base && new URL(path || ".", this.base);
      checkGltf(readGltfJson(file), base);
    } catch (error) {
      onError?.(error as ErrorEvent);
      return;
    }
    super.parse(data, path, onLoad, onError);
  }
}

function dropOf(object: Object3D) {
  object.traverse((node) => {
    const { geometry, material } = node as Partial<Mesh>;
    geometry?.dispose();
    for (const one of [material ?? []].flat() as Material[]) {
      for (const value of Object.values(one)) if (value instanceof Texture) value.dispose();
      one.dispose();
    }
  });
}

export interface Model {
  object: Group; // x east, y up, z south, metres about its own origin; or ECEF
  box: Box3;
  onEarth: boolean; // its coordinates are ECEF, turned as glTF in 3D Tiles is
  dispose: () => void;
}

// base: the file's own address; null where it was dropped. Rejects with what is wrong.
export async function loadModel(file: ArrayBuffer, base: URL | null): Promise<Model> {
  const loader = new CheckedGltf(new LoadingManager(), base);
  const path = base ? new URL(".", base).href : "";
  const late = new Promise<never>((_, reject) =>
    setTimeout(() => reject(new GltfFault("it takes too long to read")), PARSE_MS),
  );
  const { scene, parser } = await Promise.race([loader.parseAsync(file, path), late]);
  if (!scene) throw new GltfFault("it has no scene");
  const { extensions } = parser.json as { extensions?: { CESIUM_RTC?: { center?: number[] } } };
  const [x, y, z] = extensions?.CESIUM_RTC?.center ?? [];
  if (z !== undefined) scene.position.set(x!, z, -y!); // it is ECEF, without a turn
  const object = new Group();
  object.add(scene);
  object.updateMatrixWorld(true);
  const box = new Box3().setFromObject(object);
  const corners = [...box.min.toArray(), ...box.max.toArray()];
  if (box.isEmpty() || !corners.every(Number.isFinite)) {
    dropOf(object);
    throw new GltfFault("there is nothing to draw in it");
  }
  const away = box.getCenter(new Vector3()).length();
  const onEarth = away > ON_EARTH_M[0] && away < ON_EARTH_M[1];
  return { object, box, onEarth, dispose: () => dropOf(object) };
}

// A tileset of somebody else. Call update() before a frame is drawn.
export class ForeignTiles extends TilesRenderer {
  onChange: () => void = () => {};
  onProblem: (error: Error) => void = () => {};
  private document: unknown;
  private failed = 0;
  private loaded = 0;

  // document: the parsed tileset of this address.
  constructor(
    private readonly address: URL,
    document: unknown,
    worldFromEcef: Matrix4,
    camera: PerspectiveCamera,
  ) {
    super(address.href);
    this.document = document;
    const manager = this.manager as LoadingManager;
    manager.addHandler(/\.(gltf|glb)$/i, new CheckedGltf(manager, address));
    this.lruCache.maxBytesSize = TILES_HELD_BYTES;
    this.lruCache.minBytesSize = 0.75 * TILES_HELD_BYTES;
    this.setCamera(camera);
    this.stand(worldFromEcef);
    for (const name of ["needs-update", "tiles-load-end"] as const)
      this.addEventListener(name, () => this.onChange());
    this.addEventListener("load-model", () => {
      this.loaded++;
      this.onChange();
    });
    this.addEventListener("load-error", ({ tile, error }) => {
      this.failed++;
      if (!tile || !this.loaded) this.onProblem(error);
    });
  }

  stand(worldFromEcef: Matrix4, up = 0) {
    worldFromEcef.decompose(this.group.position, this.group.quaternion, this.group.scale);
    this.group.position.y += up;
    this.group.updateMatrixWorld(true);
  }

  // Where it is, in the scene's metres; null where the tileset was not read, or has no place on the earth.
  where(): Sphere | null {
    const sphere = new Sphere();
    if (!this.root || !this.getBoundingSphere(sphere)) return null;
    const away = sphere.center.length();
    if (!(away + sphere.radius > ON_EARTH_M[0]) || !Number.isFinite(sphere.radius)) return null;
    return sphere.applyMatrix4(this.group.matrixWorld);
  }

  // Never throws: a hostile tileset must not stop the frame.
  step(camera: PerspectiveCamera, renderer: WebGLRenderer) {
    try {
      this.setResolutionFromRenderer(camera, renderer);
      this.update();
    } catch (error) {
      this.onProblem(error instanceof Error ? error : new Error(String(error)));
    }
  }

  get loading(): boolean {
    const { stats } = this as unknown as { stats: Record<string, number> };
    const { queued = 0, downloading = 0, parsing = 0 } = stats;
    return !this.root || queued + downloading + parsing > 0;
  }

  async fetchData(url: string, options: RequestInit): Promise<unknown> {
    if (this.document) {
      const document = this.document;
      this.document = null;
      return document;
    }
    if (!/^https?:$/.test(new URL(url, this.address).protocol)) throw new Error(`${url.slice(0, 80)}: not asked for`);
    const response = await fetch(url, { ...options, credentials: "omit" });
    if (!response.ok) throw new Error(`${new URL(url).pathname}: ${response.status}`);
    const file = await response.arrayBuffer();
    if (file.byteLength > TILE_BYTES_MAX) throw new Error(`${new URL(url).pathname}: too large`);
    return /\.json($|\?)/.test(url) ? JSON.parse(new TextDecoder().decode(file)) : file;
  }
}
