// The city on the graphics card: 3d-tiles-renderer picks and loads tiles, this file turns each glTF
// tile with KHR_gaussian_splatting into a Spark mesh, and one SparkRenderer sorts and draws the
// Gaussians of all tiles together.
//
// SPDX-License-Identifier: Apache-2.0
import { ExtSplats, SparkRenderer, SplatMesh } from "@sparkjsdev/spark";
import type { Tile } from "3d-tiles-renderer/core";
import { TilesRenderer } from "3d-tiles-renderer/three";
import { GLTFExtensionsPlugin } from "3d-tiles-renderer/three/plugins";
import { Group, PerspectiveCamera, Scene, Vector3, WebGLRenderer, type Object3D } from "three";
import type { GLTFLoaderPlugin, GLTFParser } from "three/addons/loaders/GLTFLoader.js";

import { Frame } from "./geo";
import type { DecodedSplats } from "./spz";
import type { SpzRequest } from "./spz.worker";

const EXT = "KHR_gaussian_splatting";
const EXT_SPZ = "KHR_gaussian_splatting_compression_spz_2";
const BLUR_PX2 = 0.3; // low-pass of 3D Gaussian splatting, variance in pixels
const RETRIES = 4;
const RETRY_AFTER_S = 5; // failed tiles are asked for again

// ---- decoding, in two workers -------------------------------------------------------------------

type Reply = { id: number; splats?: DecodedSplats; error?: string };
type Waiter = { resolve: (splats: DecodedSplats) => void; reject: (error: Error) => void };

class DecoderPool {
  private readonly waiting = new Map<number, Waiter>();
  private readonly workers = Array.from({ length: 2 }, () => this.start());
  private next = 0;

  decode(gzip: Uint8Array<ArrayBuffer>): Promise<DecodedSplats> {
    const id = this.next++;
    const request: SpzRequest = { id, gzip };
    return new Promise((resolve, reject) => {
      this.waiting.set(id, { resolve, reject });
      this.workers[id % this.workers.length]!.postMessage(request, [gzip.buffer]);
    });
  }

  dispose() {
    for (const worker of this.workers) worker.terminate();
    this.failAll("closed");
  }

  private start(): Worker {
    const worker = new Worker(new URL("./spz.worker.ts", import.meta.url), { type: "module" });
    worker.onmessage = ({ data }: MessageEvent<Reply>) => {
      const wait = this.waiting.get(data.id);
      this.waiting.delete(data.id);
      if (data.splats) wait?.resolve(data.splats);
      else wait?.reject(new Error(data.error));
    };
    worker.onerror = (event) => this.failAll(event.message);
    return worker;
  }

  private failAll(message: string) {
    for (const wait of this.waiting.values()) wait.reject(new Error(`tile decoder: ${message}`));
    this.waiting.clear();
  }
}

// ---- a glTF primitive -> a mesh -----------------------------------------------------------------

// What is known of a loaded tile, kept in its mesh's userData.
export interface TileFacts {
  gaussians: number;
  fileBytes: number;
  memoryBytes: number;
  antialiased: boolean;
  core: DecodedSplats["core"];
}

interface GltfJson {
  meshes: { primitives: { extensions?: Record<string, SplatExtension> }[] }[];
}
interface SplatExtension {
  extensions?: Record<string, { bufferView: number }>;
}

// GLTFLoader asks for a mesh, so this may only construct it: its arrays are complete before it
// returns.
class SplatPlugin implements GLTFLoaderPlugin {
  readonly name = EXT;

  constructor(
    private readonly parser: GLTFParser,
    private readonly decoders: DecoderPool,
  ) {}

  loadMesh(index: number): Promise<Group> | null {
    const json = this.parser.json as GltfJson;
    const extension = json.meshes[index]?.primitives[0]?.extensions?.[EXT];
    return extension ? this.loadSplats(extension) : null;
  }

  private async loadSplats(extension: SplatExtension): Promise<Group> {
    const view = extension.extensions?.[EXT_SPZ]?.bufferView;
    if (view === undefined)
      throw new Error(`${EXT} without ${EXT_SPZ}: this client reads SPZ tiles`);
    const gzip = new Uint8Array(
      (await this.parser.getDependency("bufferView", view)) as ArrayBuffer,
    );
    const binary = this.parser.extensions["KHR_binary_glTF"] as
      { header: { length: number } } | undefined;
    const fileBytes = binary?.header.length ?? gzip.byteLength;
    const splats = await this.decoders.decode(gzip);
    const extSplats = new ExtSplats({
      extArrays: [splats.extA, splats.extB],
      numSplats: splats.count,
      extra: splats.sh,
    });
    const mesh = new SplatMesh({ extSplats, raycastable: false, editable: false });
    const arrays = [splats.extA, splats.extB, ...Object.values(splats.sh)];
    const facts: TileFacts = {
      gaussians: splats.count,
      fileBytes,
      memoryBytes: arrays.reduce((sum, a) => sum + a.byteLength, 0),
      antialiased: splats.antialiased,
      core: splats.core,
    };
    mesh.userData["facts"] = facts;
    return new Group().add(mesh);
  }
}

function findSplats(root: Object3D): SplatMesh | null {
  let found: SplatMesh | null = null;
  root.traverse((node) => {
    if (node instanceof SplatMesh) found = node;
  });
  return found;
}

function factsOf(root: Object3D | null | undefined): TileFacts | null {
  return root ? ((findSplats(root)?.userData["facts"] as TileFacts | undefined) ?? null) : null;
}

// Is there a coarser tile of the same place?
function hasCoarser(tile: Tile): boolean {
  for (let up = tile.parent; up; up = up.parent) if (up.internal.hasRenderableContent) return true;
  return false;
}

// Asks again when the server is busy (429, 503) after the time it names.
async function fetchPatiently(url: string, options: RequestInit): Promise<Response> {
  for (let attempt = 0; ; attempt++) {
    const response = await fetch(url, options);
    if ((response.status !== 503 && response.status !== 429) || attempt === RETRIES)
      return response;
    const seconds = Number(response.headers.get("retry-after")) || 1;
    await new Promise((resolve) => setTimeout(resolve, 1000 * Math.min(seconds, 10)));
    options.signal?.throwIfAborted();
  }
}

// Members of 3d-tiles-renderer that its type declarations leave out.
type Tiles = TilesRenderer & {
  isLoading: boolean;
  stats: { queued: number; downloading: number; parsing: number; failed: number };
};
type TileEngine = { engineData?: { scene: Object3D | null } };

// ---- the layer ----------------------------------------------------------------------------------

export interface LayerStats {
  tiles: number; // drawn now
  gaussians: number; // drawn now
  bytes: number; // fetched for this scene so far
  pending: number; // tiles on their way
  failed: number;
}

export class SplatLayer {
  readonly renderer: WebGLRenderer;
  private readonly scene = new Scene();
  private readonly spark: SparkRenderer;
  private readonly decoders = new DecoderPool();
  private tiles: Tiles | null = null;
  private bytes = 0;
  private error: Error | null = null;
  private retryTimer = 0;
  private quietFrames = 0;
  private target = 16;

  onWake: () => void = () => {};
  onCore: (min: Vector3, max: Vector3) => void = () => {};

  // Throws when the browser has no WebGL 2.
  constructor(
    readonly canvas: HTMLCanvasElement,
    private readonly camera: PerspectiveCamera,
  ) {
    // No multisampling: splats have no edges to smooth, and it costs.
    this.renderer = new WebGLRenderer({
      canvas,
      antialias: false,
      powerPreference: "high-performance",
    });
    this.renderer.setClearColor(0x000000); // as in the server's pictures
    // Extended accumulators: float32 centres and half-float colours also between decode and draw.
    this.spark = new SparkRenderer({
      renderer: this.renderer,
      accumExtSplats: true,
      enableLod: false,
      maxStdDev: 3,
      maxPixelRadius: 2048,
      onDirty: () => this.onWake(),
    });
    this.scene.add(this.spark);
    canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      this.error = new Error(
        "The graphics card dropped this page (out of memory?). Reload to continue.",
      );
      this.onWake();
    });
  }

  get failure(): Error | null {
    return this.error;
  }

  get errorTarget(): number {
    return this.target;
  }

  // Screen-space error in pixels at which a tile is replaced by finer ones.
  set errorTarget(pixels: number) {
    this.target = pixels;
    if (this.tiles) this.tiles.errorTarget = pixels;
    this.onWake();
  }

  open(url: string, frame: Frame, memoryBytes: number) {
    this.close();
    const tiles = new TilesRenderer(url) as Tiles;
    this.tiles = tiles;
    this.quietFrames = 0; // what was settled is gone
    tiles.errorTarget = this.target;
    tiles.lruCache.minBytesSize = memoryBytes / 2;
    tiles.lruCache.maxBytesSize = memoryBytes;
    tiles.registerPlugin(
      new GLTFExtensionsPlugin({
        metadata: false,
        rtc: false,
        plugins: [
          (parser: GLTFParser) => new SplatPlugin(parser, this.decoders),
          () => ({ name: EXT_SPZ }), // known, so that GLTFLoader does not warn at each tile
        ],
      }),
    );
    tiles.registerPlugin({
      name: "CITYSPLAT_TILES",
      fetchData: fetchPatiently,
      calculateBytesUsed: (_tile: Tile, scene: Object3D | null) => factsOf(scene)?.memoryBytes ?? 0,
    });
    // Tiles near the frame's origin: float32 matrices at the distance of the Earth's centre would
    // shake.
    frame.worldFromEcef.decompose(tiles.group.position, tiles.group.quaternion, tiles.group.scale);
    tiles.group.updateMatrixWorld(true);
    tiles.setCamera(this.camera);
    this.listen(tiles);
    this.scene.add(tiles.group);
    this.onWake();
  }

  private listen(tiles: Tiles) {
    tiles.addEventListener("load-model", ({ scene, tile }: { scene: Object3D; tile: Tile }) => {
      const facts = factsOf(scene);
      if (!facts) return;
      this.bytes += facts.fileBytes;
      this.spark.blurAmount = facts.antialiased ? BLUR_PX2 : 0;
      this.spark.preBlurAmount = facts.antialiased ? 0 : BLUR_PX2;
      if (!hasCoarser(tile)) this.reportCore(tiles, scene, facts);
      this.onWake();
    });
    tiles.addEventListener("dispose-model", ({ scene }: { scene: Object3D }) => {
      const mesh = findSplats(scene);
      mesh?.extSplats?.dispose();
      mesh?.dispose();
    });
    tiles.addEventListener("load-error", ({ tile, error }: { tile: Tile | null; error: Error }) => {
      if (!tile) this.error = error;
      clearTimeout(this.retryTimer);
      this.retryTimer = window.setTimeout(() => this.retry(), 1000 * RETRY_AFTER_S);
      this.onWake();
    });
    for (const name of ["needs-update", "tiles-load-end", "tile-visibility-change"]) {
      tiles.addEventListener(name, () => this.onWake());
    }
  }

  private reportCore(tiles: Tiles, scene: Object3D, facts: TileFacts) {
    const mesh = findSplats(scene)!;
    const parent = scene.parent;
    scene.parent = tiles.group;
    scene.updateMatrixWorld(true);
    const a = new Vector3(...facts.core.min).applyMatrix4(mesh.matrixWorld);
    const b = new Vector3(...facts.core.max).applyMatrix4(mesh.matrixWorld);
    scene.parent = parent;
    this.onCore(a.clone().min(b), a.clone().max(b));
  }

  private retry() {
    this.tiles?.resetFailedTiles();
    this.onWake();
  }

  close() {
    clearTimeout(this.retryTimer);
    if (!this.tiles) return;
    this.scene.remove(this.tiles.group);
    this.tiles.dispose();
    this.tiles = null;
    this.bytes = 0;
    this.error = null;
  }

  resize(width: number, height: number, ratio: number) {
    this.renderer.setPixelRatio(ratio);
    this.renderer.setSize(width, height, false);
    this.onWake();
  }

  draw() {
    const calm = !this.busy();
    this.camera.updateMatrixWorld();
    if (this.tiles) {
      this.tiles.setResolutionFromRenderer(this.camera, this.renderer);
      this.tiles.update();
    }
    this.renderer.render(this.scene, this.camera);
    // Sorting ends between frames: a frame shows the final order if nothing was under way before
    // and after it.
    this.quietFrames = calm && !this.busy() ? this.quietFrames + 1 : 0;
  }

  // Everything the current view needs is loaded, sorted and on the screen.
  get settled(): boolean {
    return this.quietFrames >= 2;
  }

  private busy(): boolean {
    const { spark, tiles } = this;
    if (!tiles?.root) return true;
    const { queued, downloading, parsing } = tiles.stats;
    if (queued + downloading + parsing > 0 || tiles.isLoading) return true;
    if (spark.sorting || spark.sortDirty || spark.display !== spark.current) return true;
    return spark.display.mapping.length !== this.drawnFacts().length;
  }

  private drawnFacts(): TileFacts[] {
    const visible = [...(this.tiles?.visibleTiles ?? [])] as (Tile & TileEngine)[];
    return visible.map((tile) => factsOf(tile.engineData?.scene)).filter((facts) => facts !== null);
  }

  stats(): LayerStats {
    const drawn = this.drawnFacts();
    const { queued = 0, downloading = 0, parsing = 0, failed = 0 } = this.tiles?.stats ?? {};
    return {
      tiles: drawn.length,
      gaussians: drawn.reduce((sum, facts) => sum + facts.gaussians, 0),
      bytes: this.bytes,
      pending: queued + downloading + parsing,
      failed,
    };
  }

  dispose() {
    this.close();
    this.decoders.dispose();
    this.renderer.dispose();
  }
}
