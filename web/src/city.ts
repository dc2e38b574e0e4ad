// The city on the graphics card: tiles chosen and fetched, Gaussians drawn, sky and ground behind
// them, lines over them.
//
// SPDX-License-Identifier: Apache-2.0
import { LRUCache } from "3d-tiles-renderer/core";
import { TilesRenderer } from "3d-tiles-renderer/three";
import {
  Scene,
  Vector2,
  Vector3,
  WebGLRenderer,
  type Camera,
  type PerspectiveCamera,
} from "three";

import { Backdrop } from "./backdrop";
import { DecoderPool } from "./decoders";
import { Extent } from "./extent";
import { FADE_FRAMES_LEAST, FADE_MS } from "./fade";
import type { Block } from "./block";
import { Gaussians } from "./gaussians";
import type { Frame } from "./geo";
import type { Layers } from "./layers";
import type { Link } from "./link";
import type { Network } from "./network";
import type { Overlay } from "./overlay";
import { CardClock } from "./pace";
import { Preview } from "./preview";
import type { SceneInfo } from "./source";
import type { Surroundings } from "./surroundings";
import { text } from "./strings";
import { CityTiles, type CardTurn, type CityTile } from "./tiles";
import { Tint } from "./tint";
import type { Broken } from "./types";

// What of a city is drawn, and what is on its way.
export interface CityStats {
  tiles: number; // drawn now
  gaussians: number; // drawn now
  bytes: number; // of the tiles of this scene so far
  pending: number; // tiles on their way
  parsing: number; // of them: they came, and are being decoded
  came: number; // tiles of this scene so far
  memory: number; // bytes held, in the page and on the card
  heldBack: boolean; // finer tiles are left out: memory
  broken: Broken[]; // wanted, and not to be had
}

/** @internal */
export const NO_STATS: CityStats = {
  tiles: 0,
  gaussians: 0,
  bytes: 0,
  pending: 0,
  parsing: 0,
  came: 0,
  memory: 0,
  heldBack: false,
  broken: [],
};

// No multisampling: splats have no edges to smooth, and it costs.
function makeRenderer(canvas: HTMLCanvasElement): WebGLRenderer {
  try {
    return new WebGLRenderer({ canvas, antialias: false, powerPreference: "high-performance" });
  } catch {
    throw new Error("no WebGL 2"); // three.js has told the console what the browser says
  }
}

/** @internal */
export class City {
  readonly renderer: WebGLRenderer;
  readonly scene = new Scene();
  readonly backdrop = new Backdrop();
  readonly engine: Gaussians;
  readonly clock: CardClock; // of whole frames
  over: Overlay | null = null; // lines over the city
  layers: Layers | null = null; // models in it, shapes on it
  split: number | null = null; // from this part of the width on, the second appearance
  private ground: Surroundings | null = null; // of what is drawn here alone
  basemap = ""; // address of the tiles of a map on that ground
  private frame: Frame | null = null;
  private groundless = false; // its script was asked for
  private groundComes = false; // and is on its way
  private readonly lines = new Scene();
  private readonly preview: Preview;
  keepsPictures = false; // whole ones, to show appearances from
  takesLong = false; // frames do: what a change of light begins with is drawn ahead
  frameMs = 0; // that they take
  fadeMs = FADE_MS; // that levels take to fade into each other
  onWake: (draw: boolean) => void = () => {}; // something happened; draw: which shows
  onCore: (core: Extent) => void = () => {}; // where most Gaussians of the scene are
  onContext: (lost: boolean) => void = () => {};
  onFailure: (error: Error) => void = () => {};
  onStopped: (error: Error) => void = () => {}; // nothing new can be drawn here
  onCard: CardTurn = (run) => run();
  private readonly shared: boolean; // the context is somebody else's: nothing is cleared, depth is kept
  private readonly decoders: DecoderPool;
  private readonly cache = new LRUCache();
  private active: CityTiles | null = null;
  private next: CityTiles | null = null; // takes the place of the active one when it is complete
  private target = 16;
  private core: Extent | null = null;
  private revision = "";
  private wakeTimer = 0;
  private lost = false;
  private closed = false;
  private sizeKey = "";
  private fresh = false; // the last frame shows the newest order

  // surface: a canvas of its own, or the renderer of a context that others draw into as well. Throws
  // when the browser has no WebGL 2 or starts no worker.
  constructor(
    surface: HTMLCanvasElement | WebGLRenderer,
    private readonly camera: PerspectiveCamera,
    private readonly link: Link,
    memoryBytes: number,
  ) {
    this.shared = surface instanceof WebGLRenderer;
    this.renderer = surface instanceof WebGLRenderer ? surface : makeRenderer(surface);
    const canvas = this.renderer.domElement;
    this.renderer.setClearColor(0x000000, 1);
    try {
      this.engine = new Gaussians(this.renderer);
      this.decoders = new DecoderPool();
    } catch (error) {
      if (!this.shared) this.renderer.dispose();
      throw error;
    }
    this.engine.onFailure = (error) => this.onStopped(error);
    this.clock = new CardClock(this.renderer.getContext() as WebGL2RenderingContext);
    this.engine.setTested(this.shared);
    this.preview = new Preview(this.renderer, this.engine);
    this.engine.onOrder = () => {
      this.fresh = false;
      this.onWake(true);
    };
    this.scene.add(this.backdrop.mesh, this.engine.mesh);
    this.cache.unloadPriorityCallback = new TilesRenderer("").lruCache.unloadPriorityCallback;
    this.setMemory(memoryBytes);
    canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      this.lost = true;
      this.preview.drop();
      this.onContext(true);
    });
    canvas.addEventListener("webglcontextrestored", () => {
      this.lost = false;
      this.engine.restore();
      this.clock.restore();
      this.onContext(false);
      this.onWake(true);
    });
  }

  setOverlay(over: Overlay, layers: Layers) {
    this.over = over;
    this.lines.add(over.group);
    this.layers = layers;
    this.scene.add(layers.models);
  }

  setMemory(bytes: number) {
    this.cache.maxBytesSize = bytes;
    this.cache.minBytesSize = 0.75 * bytes;
    this.onWake(false);
  }

  // Screen-space error in pixels at which a tile is replaced by finer ones.
  set errorTarget(pixels: number) {
    this.target = pixels;
    for (const tiles of [this.active, this.next]) if (tiles) tiles.errorTarget = pixels;
    this.onWake(false);
  }

  canTint(network: Network): boolean {
    return Tint.fits(network, this.renderer);
  }

  // Another scene, or the same in another light: then what is drawn stays until all of the new one
  // is there.
  // tint: has its appearance already; null where the tiles' colours are final.
  open(info: SceneInfo, frame: Frame, keep: boolean, tint: Tint | null) {
    this.frame = frame;
    const tiles = new CityTiles(
      info.url,
      info.document,
      frame.worldFromEcef,
      this.link,
      this.decoders,
      this.engine,
      tint,
      info.packed,
    );
    tiles.errorTarget = this.target;
    tiles.lruCache = this.cache;
    frame.worldFromEcef.decompose(tiles.group.position, tiles.group.quaternion, tiles.group.scale);
    tiles.group.updateMatrixWorld(true);
    tiles.setCamera(this.camera);
    tiles.onCard = this.onCard;
    tiles.onBlock = (tile, block) => this.measure(tile, block);
    for (const name of ["needs-update", "tiles-load-end", "load-error"] as const)
      tiles.addEventListener(name, () => this.onWake(false));
    tiles.addEventListener("load-error", ({ tile, error }) => {
      if (!tile) this.onFailure(error as Error);
    });
    this.retire(this.next);
    this.next = null;
    if (keep && this.active) {
      this.active.frozen = true;
      this.next = tiles;
    } else {
      this.retire(this.active);
      this.active = tiles;
      this.ground?.forget();
    }
    if (this.active === tiles || this.revision !== info.revision) this.core = new Extent(info, frame);
    this.revision = info.revision;
    this.fresh = false;
    this.onWake(false);
  }

  private retire(tiles: CityTiles | null) {
    tiles?.dispose();
    tiles?.tint?.dispose();
  }

  // The tileset's box holds every stray Gaussian; most of them make a better frame. Only the
  // coarsest tiles count: they hold all of the scene.
  private measure(tile: CityTile, { splats }: Block) {
    this.onWake(false);
    if (tile.internal.depthFromRenderedParent > 1) return;
    if (this.core) this.onCore(this.core.add(splats.core));
  }

  resize(width: number, height: number, ratio: number) {
    const key = `${width} ${height} ${ratio}`;
    if (key === this.sizeKey) return;
    this.sizeKey = key;
    this.renderer.setPixelRatio(ratio);
    this.renderer.setSize(width, height, false); // and the canvas is empty
  }

  // Which tiles this camera wants, and in which order they are to be drawn; draws nothing.
  choose() {
    if (this.lost) return;
    const { camera, engine } = this;
    camera.updateMatrixWorld();
    const calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
    const least = engine.fading ? FADE_FRAMES_LEAST / 2 : FADE_FRAMES_LEAST; // frames of a fade draw both levels
    engine.fadeMs = least * this.frameMs <= this.fadeMs && !calm ? this.fadeMs : 0;
    for (const tiles of [this.active, this.next]) {
      if (!tiles) continue;
      tiles.gathers = this.takesLong;
      tiles.setResolutionFromRenderer(camera as Camera, this.renderer);
      tiles.update();
      this.wakeFor(tiles);
    }
    (this.next ?? this.active)?.finishTiles();
    if (this.next?.root && !this.next.loading && this.next.shows) {
      this.retire(this.active);
      this.active = this.next;
      this.next = null;
    }
    if (this.active && (this.active.shows || !this.active.loading))
      engine.want(this.active.pieces(!this.takesLong || !this.active.loading));
    this.layers?.step(camera, this.renderer);
    engine.update(camera);
    if (!engine.settled) this.fresh = false;
  }

  draw() {
    if (this.lost) return;
    const begun = performance.now();
    this.choose();
    this.surround();
    this.preview.drop();
    this.paint();
    this.fresh = this.engine.settled;
    if (this.keepsPictures && this.settled && this.split === null) this.keep();
    if (this.engine.fading) this.onWake(true);
    if (!this.shared) this.clock.start(begun);
  }

  // Ground around the city, in its light of now. Its script comes when the first tile is on the screen.
  private surround() {
    const { active, backdrop, core, engine, ground } = this;
    const blocks = active?.coarsest ?? [];
    if (!backdrop.visible || !this.shows || !blocks.length || !core || core.box.isEmpty()) return;
    if (ground) {
      ground.follow(blocks, core.box);
      if (this.frame) ground.lay(this.basemap, this.frame);
      return;
    }
    if (this.groundless) return;
    this.groundless = this.groundComes = true;
    void import("./surroundings").then(
      (module) => {
        if (this.closed) return;
        this.ground = new module.Surroundings(this.renderer, engine, backdrop);
        this.ground.onChange = () => this.onWake(true);
        this.scene.add(this.ground.mesh);
        this.onWake(true);
      },
      () => {}, // the line is gone, or the server has another page now: level ground does
    ).finally(() => {
      this.groundComes = false;
      this.onWake(false);
    });
  }

  // Height of the ground at a place, in world metres; null where it is not known.
  groundAt({ x, z }: Vector3): number | null {
    return this.ground?.ready ? this.ground.heightAt(x, z) : null;
  }

  // The picture, and the coarse one in the same light: a change of light draws one more of these.
  private keep() {
    this.preview.keep();
    if (this.takesLong) this.preview.begin(this.active?.coarsest ?? [], this.camera);
  }

  private paint() {
    const { camera, engine } = this;
    this.backdrop.update(camera);
    const ground = this.backdrop.visible && this.ground?.ready ? this.ground : null;
    if (this.ground) this.ground.shown = ground !== null;
    engine.setEdge(ground);
    engine.prepare(camera, this.split !== null);
    this.render();
  }

  // Another appearance of what is drawn, roughly but at once: `change` makes it so. False where there is
  // no whole picture to begin with: then nothing was done.
  showRoughly(change: () => void): boolean {
    const { preview, camera, active } = this;
    const blocks = active?.coarsest ?? [];
    if (this.lost || this.split !== null || !preview.begin(blocks, camera)) return false;
    change();
    preview.show(blocks, camera);
    return true;
  }

  // Draws the same picture once more, for whoever reads the canvas at once.
  redraw() {
    this.paint();
  }

  // The view at another size, of the tiles that are there, for whoever reads the canvas in `use`. The
  // canvas is as before when that is done.
  drawOnce<T>(width: number, height: number, sky: boolean, use: () => Promise<T>): Promise<T> {
    const { renderer, camera, backdrop } = this;
    const canvas = renderer.domElement;
    const gl = renderer.getContext();
    const [across, down] = gl.getParameter(gl.MAX_VIEWPORT_DIMS) as Int32Array;
    const most = Math.min(across!, down!, gl.getParameter(gl.MAX_RENDERBUFFER_SIZE) as number);
    const kept = {
      ...{ size: renderer.getSize(new Vector2()), ratio: renderer.getPixelRatio() },
      ...{ aspect: camera.aspect, visible: backdrop.visible },
    };
    const paint = () => {
      camera.updateProjectionMatrix();
      this.paint();
    };
    try {
      if (this.lost || Math.max(width, height) > most) throw new Error(text("shot.browser", { most }));
      renderer.setPixelRatio(1);
      renderer.setSize(width, height, false);
      if (gl.drawingBufferWidth !== width || gl.drawingBufferHeight !== height)
        throw new Error(text("shot.memory"));
      camera.aspect = width / height;
      backdrop.visible = sky;
      this.over?.resize(width, height);
      paint();
      return use(); // the canvas is read when that is asked for, not when it is there
    } finally {
      renderer.setPixelRatio(kept.ratio);
      renderer.setSize(kept.size.x, kept.size.y, false);
      camera.aspect = kept.aspect;
      backdrop.visible = kept.visible;
      this.over?.resize(canvas.clientWidth, canvas.clientHeight);
      paint();
      this.onWake(true);
    }
  }

  // Splats leave no depth behind. Where lines are to hide behind the city, or shapes to lie on it, a
  // second pass writes the depth of all but the faint rims. Models come before the splats, which are
  // tested against them: so what is half transparent in front of a model is seen as such.
  private render() {
    const { renderer, scene, camera, engine, over, layers } = this;
    renderer.autoClear = !this.shared;
    engine.setTested(this.shared || (layers?.models.children.length ?? 0) > 0);
    if (this.split === null) renderer.render(scene, camera);
    else this.renderSides(this.split);
    renderer.autoClear = false;
    const lines = (over?.group.children.length ?? 0) > 0;
    if (layers && !layers.drape.empty) layers.drape.draw(renderer, camera, () => this.renderDepth());
    else if (this.shared || (lines && over!.needsDepth)) this.renderDepth();
    if (lines) renderer.render(this.lines, camera);
    renderer.autoClear = true;
  }

  private renderDepth() {
    const { renderer, camera, engine } = this;
    engine.setSolid(true);
    renderer.render(engine.mesh, camera);
    engine.setSolid(false);
  }

  private renderSides(share: number) {
    const { renderer, scene, camera, engine } = this;
    const { x: width, y: height } = renderer.getSize(new Vector2());
    const line = Math.round(share * width);
    renderer.setScissorTest(true);
    for (const side of [0, 1] as const) {
      engine.useSide(side);
      renderer.setScissor(side ? line : 0, 0, side ? width - line : line, height);
      renderer.render(scene, camera);
    }
    renderer.setScissorTest(false);
    engine.useSide(0);
  }

  // Broken tiles are asked for again, and unwanted requests given up, also while nothing moves.
  private wakeFor(tiles: CityTiles) {
    const ms = Math.min(tiles.nextAttempt, tiles.hasUnwanted ? 300 : Infinity);
    if (!Number.isFinite(ms)) return;
    clearTimeout(this.wakeTimer);
    this.wakeTimer = window.setTimeout(() => this.onWake(false), Math.max(50, ms));
  }

  // Asks at once for what failed.
  retry() {
    for (const tiles of [this.active, this.next])
      for (const broken of tiles?.broken.values() ?? []) broken.again = 0;
    this.onWake(false);
  }

  // Nothing more will come by itself for this view, and the screen shows all that came.
  get settled(): boolean {
    return !this.lost && this.fresh && !this.groundComes && !this.next && this.active !== null && !this.active.loading;
  }

  // Something of the scene is on the screen.
  get shows(): boolean {
    return !this.lost && this.engine.visibleBlocks.length > 0;
  }

  // A new appearance is on its way.
  get changing(): boolean {
    return this.next !== null;
  }

  stats(): CityStats {
    const stats = this.active?.stats ?? {};
    const on = this.next ?? this.active;
    const coming = on?.stats ?? {};
    const { queued = 0, downloading = 0, parsing = 0 } = coming;
    const broken = [...(on?.broken ?? [])].filter(([tile]) => tile.traversal.used);
    return {
      tiles: this.engine.visibleBlocks.length,
      gaussians: this.engine.gaussians,
      bytes: (this.active?.bytes ?? 0) + (this.next?.bytes ?? 0),
      pending: queued + downloading + parsing + (on?.finishingCount ?? 0),
      parsing,
      came: on?.count ?? 0,
      memory: (this.cache as unknown as { cachedBytes: number }).cachedBytes,
      heldBack: (stats["refused"] ?? 0) > 0,
      broken: broken.map(([, one]) => one),
    };
  }

  dispose() {
    clearTimeout(this.wakeTimer);
    this.retire(this.active);
    this.retire(this.next);
    this.decoders.dispose();
    this.preview.dispose();
    this.engine.dispose();
    this.backdrop.dispose();
    this.ground?.dispose();
    this.lost = this.closed = true; // nothing is drawn any more
    this.onContext = () => {};
    this.renderer.dispose();
    // A page has few contexts, and the canvas may be held by others.
    if (!this.shared) this.renderer.forceContextLoss();
  }
}
