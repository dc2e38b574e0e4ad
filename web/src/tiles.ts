// Which tiles to have: 3d-tiles-renderer's choice of level with six rules of our own.
//
// - How coarse a tile is on the screen is measured as the server does.
// - A tile that failed is not "there": the coarser one stays in its place, and it is asked for again
//   after a growing pause.
// - The coarsest tiles come before all others.
// - A tile that no view wants any more is given up, also when it is on its way.
// - A coarsest tile comes as a draft; where the view ends with it, the whole tile follows.
// - A level between the coarsest and the wanted one is left out when the wanted one comes soon, or when it is
//   hardly finer than what is there.
//
// SPDX-License-Identifier: Apache-2.0
import type { LRUCache, Tile } from "3d-tiles-renderer/core";
import { TilesRenderer } from "3d-tiles-renderer/three";
import { Matrix4, Vector3 } from "three";

import type { DecoderPool } from "./decoders";
import type { Block, Piece } from "./block";
import { Gaussians } from "./gaussians";
import type { Link } from "./link";
import type { DecodedSplats } from "./pack";
import { screenError } from "./screenerror";
import { DRAFT, usePackedTiles, useUnfilteredTiles } from "./source";
import type { Tint } from "./tint";
import type { Broken } from "./types";

// States of a tile, as 3d-tiles-renderer numbers them.
const UNLOADED = 0;
const QUEUED = 1;
const LOADING = 2;
const LOADED = 4;
const GIVE_UP_MS = 250; // not wanted for this long: turning the head must not throw work away
const AGAIN_FIRST_MS = 2000;
const AGAIN_MOST_MS = 60_000;
const SOON_S = 6; // levels between are left out when the whole view comes within this time
const TILE_BYTES_FIRST = 200_000; // a tile's size until some have come
const FINISHING_MOST = 3; // asked for at a time where the picture gets better with each

export interface CityTile extends Tile {
  parent: CityTile | null;
  children: CityTile[];
  geometricError: number;
  content?: { uri: string };
  extras?: { core?: unknown };
  internal: Tile["internal"] & {
    loadingState: number;
    depthFromRenderedParent: number;
    hasRenderableContent: boolean;
    basePath: string;
  };
  traversal: Tile["traversal"] & {
    used: boolean;
    error: number;
    visible: boolean;
    inFrustum: boolean;
    lastFrameVisited: number;
  };
  engineData: { transform: Matrix4; transformInverse: Matrix4 };
}

// Runs what uploads to the card: at once, or when the owner of the context draws next.
export type CardTurn = (run: () => void) => void | Promise<void>;

// Members of 3d-tiles-renderer that its type declarations leave out.
interface Base {
  isLoading: boolean;
  frameCount: number;
  stats: Record<string, number>;
  lruCache: LRUCache;
  loadingTiles: Set<CityTile>;
  visibleTiles: Set<CityTile>;
  queueTileForDownload(tile: CityTile): void;
  removeUnusedPendingTiles(): void;
  cameraInfo: { position: Vector3; sseDenominator: number }[];
  calculateTileViewError(tile: CityTile, target: { error: number }): void;
  disposeTile(tile: CityTile): void;
  preprocessTileset(document: { asset: object }, url: string, parent: CityTile | null): void;
  _upRotationMatrix: Matrix4;
}
const BaseTiles = TilesRenderer as unknown as new (url: string) => Omit<TilesRenderer, keyof Base> &
  Base;

function nameOf(tile: CityTile): string {
  return /(\d+\/\d+\/\d+)\.\w+(\?|$)/.exec(tile.content?.uri ?? "")?.[1] ?? tile.content?.uri ?? "?";
}

export class CityTiles extends BaseTiles {
  readonly broken = new Map<CityTile, Broken>();
  readonly blocks = new Map<CityTile, Block>();
  onBlock: (tile: CityTile, block: Block) => void = () => {};
  onCard: CardTurn = (run) => run();
  bytes = 0; // of the tiles that came
  frozen = false; // asks for nothing more: another set of tiles takes its place
  count = 0; // of them
  private before = new Set<Block>(); // on the screen
  private readonly unwanted = new Map<CityTile, number>();
  private readonly drafts = new Set<CityTile>();
  private readonly finishing = new Map<CityTile, AbortController>();
  private readonly decoded = new Map<CityTile, () => void>(); // of them: they wait for the others
  gathers = false; // frames take long: all that is finished is drawn at once
  private document: unknown;

  // document: the parsed tileset of this URL, so that it is not fetched twice.
  constructor(
    url: string,
    document: unknown,
    private readonly worldFromEcef: Matrix4,
    private readonly link: Link,
    private readonly decoders: DecoderPool,
    private readonly engine: Gaussians,
    readonly tint: Tint | null, // computes the colours of the tiles
    private readonly packed: boolean, // further documents of the tileset are to be read as the first was
  ) {
    super(url);
    this.document = document;
    this.addEventListener("load-error", ({ tile, error }) => {
      if (tile) this.fail(tile as CityTile, error as Error);
    });
  }

  // ---- requests ----

  // The library warns of 3D Tiles 1.1, whose new parts these tilesets do not have.
  override preprocessTileset(document: { asset: object }, url: string, parent: CityTile | null) {
    super.preprocessTileset({ ...document, asset: { ...document.asset, version: "1.0" } }, url, parent);
  }

  fetchData(url: string, options: RequestInit): Promise<unknown> {
    if (this.document) {
      const document = this.document;
      this.document = null;
      return Promise.resolve(document);
    }
    const signal = options.signal ?? null;
    if (/\.json($|\?)/.test(url)) return this.part(url, signal);
    return this.link.bytes(url, signal);
  }

  // The rest of a large tileset, an external one.
  private async part(url: string, signal: AbortSignal | null): Promise<unknown> {
    const document = (await this.link.json(url, signal)) as object;
    if (this.packed) usePackedTiles(document, false);
    else useUnfilteredTiles(document);
    return document;
  }

  override calculateTileViewError(tile: CityTile, target: { error: number }) {
    super.calculateTileViewError(tile, target);
    const [eye] = this.cameraInfo; // there is one
    target.error = (eye && screenError(tile, eye.position, eye.sseDenominator)) ?? target.error;
  }

  override queueTileForDownload(tile: CityTile) {
    if (this.frozen || tile.internal.loadingState !== UNLOADED) return;
    const broken = this.broken.get(tile);
    if (broken && performance.now() < broken.again) return;
    if (tile.internal.hasRenderableContent && this.mayWait(tile)) return;
    super.queueTileForDownload(tile);
  }

  private mayWait(tile: CityTile): boolean {
    if (tile.internal.depthFromRenderedParent <= 1) return false;
    let first = tile;
    for (let up = tile.parent; up; up = up.parent) if (up.internal.hasRenderableContent) first = up;
    const there = first.internal.loadingState === LOADED || this.broken.has(first);
    if (!there) return true;
    // Of a tile that is wanted for its neighbours' sake, beside the picture, no finer one will come.
    return this.wantedOf(tile).length > 0 && tile.traversal.error > this.errorTarget && (!this.isMuchFiner(tile) || this.comesSoon());
  }

  // Whether it is at least twice as fine as what stands there: a level that is hardly finer only delays the wanted one.
  private isMuchFiner(tile: CityTile): boolean {
    let up = tile.parent;
    while (up && up.internal.loadingState === UNLOADED) up = up.parent;
    return !up || tile.geometricError <= 0.5 * up.geometricError;
  }

  private comesSoon(): boolean {
    const { speed } = this.link;
    if (!speed) return true;
    const each = this.count > 2 ? this.bytes / this.count : TILE_BYTES_FIRST;
    return (this.missing * each) / speed < SOON_S;
  }

  // Tiles on their way.
  get missing(): number {
    const { queued = 0, downloading = 0 } = this.stats;
    return queued + downloading;
  }

  override removeUnusedPendingTiles() {
    const now = performance.now();
    const coming = [...this.loadingTiles, ...this.finishing.keys()];
    // Where nothing of it is wanted the camera has jumped, and nobody will turn back.
    const patience = coming.some((tile) => this.lruCache.isUsed(tile)) ? GIVE_UP_MS : 0;
    for (const tile of coming) {
      const state = tile.internal.loadingState;
      if (this.lruCache.isUsed(tile)) {
        this.unwanted.delete(tile);
      } else if (state === QUEUED) {
        this.lruCache.remove(tile);
      } else if (state <= LOADING || this.finishing.has(tile)) {
        const since = this.unwanted.get(tile) ?? now;
        this.unwanted.set(tile, since);
        if (now - since >= patience) {
          this.unwanted.delete(tile);
          if (state <= LOADING) this.lruCache.remove(tile); // aborts the request
          this.finishing.get(tile)?.abort();
        }
      }
    }
    for (const tile of this.unwanted.keys())
      if (!this.loadingTiles.has(tile) && !this.finishing.has(tile)) this.unwanted.delete(tile);
  }

  // Requests that may be given up soon: somebody has to look again.
  get hasUnwanted(): boolean {
    return this.unwanted.size > 0;
  }

  private fail(tile: CityTile, error: Error) {
    this.remember(tile, error);
    // Out of the cache, or the library refuses to ask for it ever again.
    this.stats["failed"]!--;
    this.lruCache.remove(tile);
  }

  private remember(tile: CityTile, error: Error) {
    const before = this.broken.get(tile)?.tries ?? 0;
    const ms = Math.min(AGAIN_MOST_MS, AGAIN_FIRST_MS * 2 ** before);
    this.broken.set(tile, {
      name: nameOf(tile),
      why: error.message,
      tries: before + 1,
      again: performance.now() + ms,
    });
  }

  // When the next broken tile is due, in milliseconds; Infinity without one.
  get nextAttempt(): number {
    let next = Infinity;
    for (const { again } of this.broken.values()) next = Math.min(next, again);
    return next - performance.now();
  }

  // ---- contents ----

  async parseTile(
    buffer: ArrayBuffer,
    tile: CityTile,
    _extension: string,
    _url: string,
    signal: AbortSignal,
  ) {
    const { byteLength } = buffer;
    const block = await this.put(await this.read(buffer, tile, signal), byteLength, tile, signal);
    if (!block) return;
    if (tile.content?.uri.includes(DRAFT)) this.drafts.add(tile);
    this.count++;
    this.onBlock(tile, block);
  }

  private read(file: ArrayBuffer, tile: CityTile, signal: AbortSignal): Promise<DecodedSplats> {
    const toWorld = this.worldFromEcef
      .clone()
      .multiply(tile.engineData.transform)
      .multiply(this._upRotationMatrix);
    const e = toWorld.elements;
    const turned = [e[0]! - 1, e[5]! - 1, e[10]! - 1].some((v) => Math.abs(v) > 1e-6);
    if (turned) throw new Error("is turned or scaled against its tileset");
    const offset = new Vector3().setFromMatrixPosition(toWorld).toArray();
    return this.decoders.decode(file, offset, signal);
  }

  private async put(splats: DecodedSplats, size: number, tile: CityTile, signal: AbortSignal): Promise<Block | null> {
    let block = null as Block | null;
    await this.onCard(() => {
      if (signal.aborted) return;
      block = this.engine.add(splats, this.tint);
      this.blocks.set(tile, block);
      this.broken.delete(tile);
      this.bytes += size;
    });
    return block;
  }

  // Where nothing else comes for this view, drafts on the screen are made whole.
  finishTiles() {
    if (this.frozen || this.missing) return;
    const room = this.gathers ? Infinity : Math.max(0, FINISHING_MOST - this.finishing.size);
    for (const tile of this.unfinished.slice(0, room)) void this.finish(tile);
  }

  // Those that may be made whole now: what has most Gaussians comes first.
  private get unfinished(): CityTile[] {
    if (!this.drafts.size || this.coming) return [];
    const now = performance.now();
    const may = (tile: CityTile) =>
      this.drafts.has(tile) && !this.finishing.has(tile) && now >= (this.broken.get(tile)?.again ?? 0);
    const size = (tile: CityTile) => this.blocks.get(tile)?.splats.count ?? 0;
    return this.standing.filter(may).sort((a, b) => size(b) - size(a));
  }

  // Tiles of this view, and the finer ones that are drawn in the place of some of them.
  private get standing(): CityTile[] {
    const out: CityTile[] = [];
    const visit = (tile: CityTile) => {
      out.push(tile);
      if (tile.traversal.error > this.errorTarget) this.wantedOf(tile).forEach(visit);
    };
    this.visibleTiles.forEach(visit);
    return out;
  }

  // Where frames take long, all that is finished is put on the screen at once: resolves when all others are decoded.
  private together(tile: CityTile): Promise<void> {
    if (!this.gathers) return Promise.resolve();
    return new Promise((resolve) => {
      this.decoded.set(tile, resolve);
      this.release();
    });
  }

  private release() {
    if (this.decoded.size < this.finishing.size) return;
    const waiting = [...this.decoded.values()];
    this.decoded.clear();
    for (const resolve of waiting) resolve();
  }

  private async finish(tile: CityTile) {
    const stop = new AbortController();
    const before = this.blocks.get(tile)!;
    const { uri } = tile.content!;
    const own = uri.replace(new RegExp(`[?&]${DRAFT}`), "");
    this.finishing.set(tile, stop);
    try {
      const file = await this.link.bytes(new URL(own, `${tile.internal.basePath}/`), stop.signal);
      const { byteLength } = file;
      const splats = await this.read(file, tile, stop.signal);
      await this.together(tile);
      if (!(await this.put(splats, byteLength, tile, stop.signal))) return;
      this.drafts.delete(tile);
      this.engine.remove(before);
      this.lruCache.setMemoryUsage(tile, this.calculateBytesUsed(tile));
    } catch (error) {
      if (!stop.signal.aborted) this.remember(tile, error as Error);
    } finally {
      this.finishing.delete(tile);
      this.decoded.delete(tile);
      this.release();
      this.finishTiles(); // frames may take long, and the line is free
      this.dispatchEvent({ type: "needs-update" });
    }
  }

  override disposeTile(tile: CityTile) {
    super.disposeTile(tile);
    this.finishing.get(tile)?.abort();
    this.drafts.delete(tile);
    const block = this.blocks.get(tile);
    if (block) this.engine.remove(block);
    this.blocks.delete(tile);
  }

  calculateBytesUsed(tile: CityTile): number {
    const block = this.blocks.get(tile);
    return block ? Gaussians.bytesOf(block.splats) : 0;
  }

  // The blocks of the tiles that are there before all others, and hold all of the scene.
  get coarsest(): Block[] {
    const first = [...this.blocks].filter(([tile]) => tile.internal.depthFromRenderedParent <= 1);
    return first.map(([, block]) => block);
  }

  // What the view shows now. Where a tile stands in for finer ones, those of them that are there are drawn,
  // and the rest of it: else one tile that is missing would take the detail off all that lie around it.
  // news: also those that were not on the screen before, so detail comes tile by tile.
  pieces(news: boolean): Piece[] {
    const out: Piece[] = [];
    for (const tile of this.visibleTiles) this.cover(tile, news, out);
    this.before = new Set(out.map(({ block }) => block));
    return out;
  }

  // Children that this view wants. One that the library has not walked to has no traversal yet.
  private wantedOf({ children }: CityTile): CityTile[] {
    return children.filter(({ traversal }) => traversal?.used && traversal.lastFrameVisited === this.frameCount);
  }

  // Returns the blocks that now lie where this tile is.
  private cover(tile: CityTile, news: boolean, out: Piece[]): Block[] {
    const block = this.blocks.get(tile);
    const { traversal } = tile;
    const finer: Block[] = [];
    if (traversal.error > this.errorTarget)
      for (const child of this.wantedOf(tile)) finer.push(...this.cover(child, news, out));
    const may = news || traversal.visible || (block && this.before.has(block));
    if (!block || !may || !traversal.inFrustum) return finer;
    out.push({ block, without: finer });
    return [block];
  }

  // Some tile is there for this view.
  get shows(): boolean {
    return this.visibleTiles.size > 0;
  }

  // Something that this view needs is not there yet, and is on its way or queued.
  get loading(): boolean {
    return !this.root || this.coming || this.isLoading || this.finishing.size > 0 || this.unfinished.length > 0;
  }

  private get coming(): boolean {
    const { queued = 0, downloading = 0, parsing = 0 } = this.stats;
    return queued + downloading + parsing > 0;
  }

  // Drafts of which the whole is on its way.
  get finishingCount(): number {
    return this.finishing.size;
  }
}
