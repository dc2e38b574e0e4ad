// Draws Gaussians with WebGL 2: the integers of the tiles (pack.ts) lie in a few large textures, a worker
// sorts the wanted ones from far to near, one pass evaluates their colours for this eye, a second
// one draws a quad for each.
//
// What is drawn changes only when a sorted order arrives: tiles that leave stay on the screen until
// those that replace them can be drawn, so there is no frame without either. Then both are, for the time of a fade.
//
// SPDX-License-Identifier: Apache-2.0
import {
  BufferGeometry,
  CustomBlending,
  DataTexture,
  GLSL3,
  Mesh,
  NearestFilter,
  NoBlending,
  OneFactor,
  OneMinusSrcAlphaFactor,
  OrthographicCamera,
  RawShaderMaterial,
  RedIntegerFormat,
  RGBAIntegerFormat,
  Scene,
  ShortType,
  UnsignedIntType,
  UnsignedShortType,
  Vector2,
  Vector3,
  WebGLRenderTarget,
  type InstancedBufferGeometry,
  type IUniform,
  type PerspectiveCamera,
  type PixelFormat,
  type TextureDataType,
  type WebGLRenderer,
} from "three";

import type { Block, Piece } from "./block";
import { Fade, FadeClock, fadeShare } from "./fade";
import { centresOf, HEAD_WORDS, LANES, ROW, stripesOf, type DecodedSplats } from "./pack";
import { ORDER_ROW, Projection, Projector, type Edge } from "./projection";
import { makeQuads, makeStripes, QUADS } from "./quads";
import {
  COLOR_VERTEX,
  colorFragment,
  PLAIN_FRAGMENT,
  SPLAT_FRAGMENT,
  SPLAT_VERTEX,
} from "./shaders";
import type { Rectangle, SortMessage, SortReply } from "./sort.worker";
import type { Tint } from "./tint";
import { startWorker, WORKER_NEEDS } from "./workers";

const ROWS_FIRST = 128;
const EVERYWHERE: Rectangle[] = [[-Infinity, Infinity, -Infinity, Infinity]];

interface Planes {
  base: DataTexture;
  heads: DataTexture;
  more: DataTexture;
  embed: DataTexture[];
  sides: Side[]; // the second one while the picture is divided
}
// What an appearance looks like from here.
interface Side {
  tints: WebGLRenderTarget | null; // beside embeddings
  colors: WebGLRenderTarget;
  key: string; // what the colours were evaluated for
  projection: Projection; // of the order on the screen, with these colours
}

function makeTarget(type: TextureDataType, internal: string, rows: number): WebGLRenderTarget {
  const target = new WebGLRenderTarget(ROW, rows, {
    format: RGBAIntegerFormat,
    type,
    minFilter: NearestFilter,
    magFilter: NearestFilter,
    depthBuffer: false,
  });
  target.texture.internalFormat = internal as "RGBA16UI";
  return target;
}

function makeTexture(format: PixelFormat, internal: string, rows: number, width = ROW): DataTexture {
  const texture = new DataTexture(null, width, rows, format, UnsignedIntType);
  texture.source.dataReady = false; // room alone: WebGL warns of an upload of nothing
  texture.internalFormat = internal as "RGBA32UI";
  texture.minFilter = texture.magFilter = NearestFilter;
  texture.needsUpdate = true;
  return texture;
}

function makeOrder(order: Uint32Array<ArrayBuffer>): DataTexture {
  const texture = makeTexture(RedIntegerFormat, "R32UI", order.length / ORDER_ROW);
  texture.image.data = order;
  texture.source.dataReady = true;
  return texture;
}

export class Gaussians {
  readonly mesh: Mesh<InstancedBufferGeometry, RawShaderMaterial>;
  onOrder: () => void = () => {}; // a new order is there to be drawn
  drawn = 0; // Gaussians of the order on the screen
  gaussians = 0; // of all that is shown, also behind the camera
  private readonly blocks = new Set<Block>();
  private readonly leaving = new Set<Block>(); // not wanted, but perhaps still on the screen
  fadeMs = 0; // that tiles take to fade into others; 0: they change at once
  private wanted: readonly Piece[] = [];
  private readonly fade = new Fade();
  private clock = new FadeClock(); // of the last fade
  private shownClock: FadeClock | null = null; // of the fade that the order on the screen is of
  private shown: Block[] = []; // those of the order on the screen
  private planes: Planes | null = null;
  private rows = 0;
  private lines = 0; // of `more`
  private tested = false; // against what the depth buffer holds already: models, others' maps
  private embedPlanes = 0;
  private order: DataTexture | null = null;
  private spare: Uint32Array<ArrayBuffer> | null = null;
  onFailure: (error: Error) => void = () => {}; // nothing new can be drawn any more
  private readonly sorter = startWorker("sort");
  private sorting: { ticket: number; blocks: Block[]; key: string; clock: FadeClock | null } | null = null;
  private ticket = 0;
  private nextId = 0;
  private some: { key: string; texture: DataTexture } | null = null; // the order of drawSome
  private sortedKey = "";
  private wantedKey = "";
  private version = 0; // of the wanted set
  private contentVersion = 0;
  private readonly colorScene = new Scene();
  private readonly colorMesh: Mesh<BufferGeometry, RawShaderMaterial>;
  private readonly colorMaterials = new Map<number, RawShaderMaterial>(); // by kind of harmonics
  private readonly colorUniforms: Record<string, IUniform> = {
    base: { value: null },
    heads: { value: null },
    more: { value: null },
    tints: { value: null },
    tinted: { value: false },
    eye: { value: new Vector3() },
    rowCount: { value: 1 },
  };
  private readonly plainMesh: Mesh<BufferGeometry, RawShaderMaterial>; // writes "adds nothing"
  private readonly flat = new OrthographicCamera();
  private readonly projector: Projector;
  private readonly someProjection = new Projection(); // of drawSome
  private readonly noTints: DataTexture; // a sampler of integers must have some texture of integers

  constructor(private readonly renderer: WebGLRenderer) {
    const material = new RawShaderMaterial({
      glslVersion: GLSL3,
      vertexShader: SPLAT_VERTEX,
      fragmentShader: SPLAT_FRAGMENT,
      uniforms: {
        first: { value: null },
        second: { value: null },
        count: { value: 0 },
        viewport: { value: new Vector2(1, 1) },
        near: { value: 0.1 },
        solid: { value: false },
      },
      transparent: true,
      depthTest: false,
      depthWrite: false,
      blending: CustomBlending,
      blendSrc: OneFactor,
      blendDst: OneMinusSrcAlphaFactor,
    });
    this.mesh = new Mesh(makeQuads(), material);
    this.mesh.frustumCulled = false;
    this.mesh.visible = false;
    this.mesh.renderOrder = 1;
    this.colorMesh = new Mesh(new BufferGeometry(), this.rowMaterial(colorFragment(0)));
    this.colorMaterials.set(0, this.colorMesh.material);
    this.plainMesh = new Mesh(new BufferGeometry(), this.rowMaterial(PLAIN_FRAGMENT));
    this.noTints = new DataTexture(new Int16Array(4), 1, 1, RGBAIntegerFormat, ShortType);
    this.noTints.internalFormat = "RGBA16I";
    this.noTints.needsUpdate = true;
    this.colorMesh.frustumCulled = this.plainMesh.frustumCulled = false;
    this.colorScene.add(this.colorMesh);
    this.projector = new Projector(renderer);
    this.sorter.onmessage = ({ data }: MessageEvent<SortReply>) => this.take(data);
    this.sorter.onerror = ({ message }) =>
      this.onFailure(new Error(message ? `sorting: ${message}` : `no worker starts; the page's policy must allow ${WORKER_NEEDS}`));
  }

  // Of a pass over rows of the textures.
  private rowMaterial(fragmentShader: string): RawShaderMaterial {
    return new RawShaderMaterial({
      glslVersion: GLSL3,
      vertexShader: COLOR_VERTEX,
      fragmentShader,
      uniforms: this.colorUniforms,
      depthTest: false,
      depthWrite: false,
      blending: NoBlending,
    });
  }

  // ---- blocks ----

  // tint: computes colours from the embeddings of the tile; null where they are what it says.
  add(splats: DecodedSplats, tint: Tint | null = null): Block {
    const rows = Math.ceil(splats.count / ROW);
    const lines = splats.more.length / (LANES * ROW);
    const own = splats.embedding ? tint : null;
    const centres = centresOf(splats);
    const block: Block = {
      ...{ id: this.nextId++, splats, row: -1, rows, line: -1, lines, stripes: stripesOf(splats) },
      ...{ tint: own, area: areaOf(centres), tinted: [-1, -1] },
    };
    const embed = own ? (splats.embedding?.planes.length ?? 0) : 0;
    if (embed > this.embedPlanes) {
      this.embedPlanes = embed;
      this.rebuild();
    }
    this.findRoom(block);
    this.blocks.add(block);
    this.upload(block);
    const first = block.row * ROW;
    this.post({ kind: "add", block: block.id, first, centres }, [centres.buffer]);
    return block;
  }

  // The block's rows are free again as soon as nothing on the screen needs them.
  remove(block: Block) {
    if (!this.blocks.has(block)) return;
    this.wanted = this.wanted.filter((other) => other.block !== block);
    if (this.fade.drop(block)) this.version++;
    this.leaving.add(block);
    this.sweep();
  }

  // What is to be drawn.
  want(pieces: readonly Piece[]) {
    this.wanted = pieces;
  }

  // Ends a fade whose time is over, and begins one where others are wanted than are drawn.
  private step() {
    const { fade, clock } = this;
    const over = fade.from && (clock.spent >= 1 || !this.fadeMs);
    if (over) fade.from = null;
    const before = fade.from;
    const changed = fade.want(this.wanted, this.fadeMs > 0);
    if (over || changed) this.version++;
    if (fade.from && !before) this.clock = new FadeClock();
  }

  // Levels are fading into each other.
  get fading(): boolean {
    return this.fade.from !== null;
  }

  // What a Gaussian takes: on the card, and once more in the page's own memory.
  static bytesOf(splats: DecodedSplats): number {
    const embed = splats.embedding?.planes ?? [];
    const arrays = [splats.base, splats.heads, splats.more, ...embed];
    const texels = arrays.reduce((sum, a) => sum + a.byteLength, 0); // colours, centres, order, place on the screen
    return 2 * texels + splats.count * (8 + 12 + 4 + 32 + (embed.length ? 8 : 0));
  }

  // What the card holds of Gaussians: the rows that there are, whether tiles fill them or not. They are not given back
  // while the viewer lives, so this is what its fullest moment took.
  get cardBytes(): number {
    const sides = this.planes?.sides.length ?? 0;
    const tints = this.embedPlanes ? 8 : 0;
    const each = 16 + 16 * this.embedPlanes + sides * (8 + tints);
    const packed = 4 * HEAD_WORDS * this.rows + 4 * LANES * ROW * this.lines;
    return this.rows * ROW * each + packed + (this.order?.image.data?.byteLength ?? 0);
  }

  // The order on the screen is the one for this camera and for the wanted blocks.
  get settled(): boolean {
    return this.sortedKey === this.wantedKey && !this.sorting && !this.fading;
  }

  get visibleBlocks(): readonly Block[] {
    return this.shown;
  }

  private sweep() {
    for (const block of this.leaving) {
      if (this.shown.includes(block) || this.sorting?.blocks.includes(block)) continue;
      this.leaving.delete(block);
      this.blocks.delete(block);
      block.row = block.line = -1;
      this.post({ kind: "remove", block: block.id });
    }
  }

  // First-fit among the rows and lines in use; the textures grow by half where nothing fits.
  private findRoom(block: Block) {
    const all = [...this.blocks];
    block.row = firstFit(all.map((other) => [other.row, other.rows]), block.rows);
    block.line = firstFit(all.map((other) => [other.line, other.lines]), block.lines);
    const most = this.renderer.capabilities.maxTextureSize;
    const grown = (size: number, end: number, least: number) => {
      if (end <= size) return size;
      if (end > most) throw new Error("the graphics card has no room for more Gaussians");
      return Math.min(most, Math.max(least, end, Math.ceil(size * 1.5)));
    };
    const rows = grown(this.rows, block.row + block.rows, ROWS_FIRST);
    const lines = grown(this.lines, block.line + block.lines, ROWS_FIRST);
    if (rows !== this.rows || lines !== this.lines) this.rebuild(rows, lines);
  }

  // ---- textures ----

  // Makes the textures anew and fills them: they grew, or the context was lost.
  rebuild(rows = this.rows, lines = this.lines) {
    this.rows = rows;
    this.lines = lines;
    if (!rows) return;
    this.dropPlanes();
    this.planes = {
      base: makeTexture(RGBAIntegerFormat, "RGBA32UI", rows),
      heads: makeTexture(RGBAIntegerFormat, "RGBA32UI", rows, HEAD_WORDS / 4),
      more: makeTexture(RedIntegerFormat, "R32UI", Math.max(1, lines), LANES * ROW),
      embed: Array.from({ length: this.embedPlanes }, () => makeTexture(RGBAIntegerFormat, "RGBA32UI", rows)),
      sides: [this.makeSide()],
    };
    const { base, heads, more, embed } = this.planes;
    for (const texture of [base, heads, more, ...embed]) this.renderer.initTexture(texture);
    const color = this.colorUniforms;
    [color["base"]!.value, color["heads"]!.value, color["more"]!.value] = [base, heads, more];
    color["rowCount"]!.value = rows;
    for (const block of this.blocks) this.upload(block);
  }

  private makeSide(): Side {
    const tints = this.embedPlanes ? makeTarget(ShortType, "RGBA16I", this.rows) : null;
    const colors = makeTarget(UnsignedShortType, "RGBA16UI", this.rows);
    return { tints, colors, key: "", projection: new Projection() };
  }

  private dropSide({ tints, colors, projection }: Side) {
    tints?.dispose();
    colors.dispose();
    projection.dispose();
  }

  private dropPlanes() {
    const { base, heads, more, embed = [], sides = [] } = this.planes ?? {};
    for (const one of [base, heads, more, ...embed]) one?.dispose();
    for (const side of sides) this.dropSide(side);
    this.planes = null;
  }

  private upload(block: Block) {
    const planes = this.planes;
    if (!planes || block.row < 0) return;
    const put = (target: DataTexture, data: Uint32Array<ArrayBuffer>, height: number, at: number) => {
      const width = target.image.width;
      const from = new DataTexture(data, width, height, target.format as PixelFormat, target.type);
      from.internalFormat = target.internalFormat;
      from.needsUpdate = true;
      this.renderer.copyTextureToTexture(from, target, null, new Vector2(0, at));
      from.dispose();
    };
    const { splats, row, rows, line, lines } = block;
    put(planes.base, splats.base, rows, row);
    const heads = splats.heads.slice();
    for (let i = 4; i < heads.length; i += HEAD_WORDS) {
      heads[i]! += LANES * line;
      heads[i + 1]! += LANES * line;
    }
    put(planes.heads, heads, rows, row);
    if (lines) put(planes.more, splats.more, lines, line);
    if (block.tint) splats.embedding?.planes.forEach((data, k) => put(planes.embed[k]!, data, rows, row));
    block.tinted = [-1, -1];
    this.contentVersion++;
  }

  // ---- sorting ----

  private post(message: SortMessage, transfer: Transferable[] = []) {
    this.sorter.postMessage(message, transfer);
  }

  // Before every frame: asks for an order where the last one is not of this camera and these blocks.
  update(camera: PerspectiveCamera) {
    this.step();
    const eye = camera.position;
    const ahead = new Vector3(0, 0, -1).applyQuaternion(camera.quaternion);
    const digits = [...eye.toArray(), ...ahead.toArray()].map((v) => v.toFixed(4));
    this.wantedKey = `${this.version} ${digits.join(" ")}`;
    if (this.sorting || this.wantedKey === this.sortedKey) return;
    const { from, to } = this.fade;
    const blocks = [...new Set([...to, ...(from ?? [])].map(({ block }) => block))];
    const left = (pieces: readonly Piece[]) => {
      const withouts = new Map([...pieces].reverse().map(({ block, without }) => [block, without]));
      return blocks.map((block) => {
        const without = withouts.get(block);
        if (!without) return EVERYWHERE;
        return without.length ? without.map(({ area }) => area) : null;
      });
    };
    this.sorting = { ticket: ++this.ticket, blocks, key: this.wantedKey, clock: from && this.clock };
    const spare = this.spare;
    this.spare = null;
    this.post(
      {
        kind: "sort",
        ticket: this.ticket,
        blocks: blocks.map(({ id }) => id),
        without: left(to),
        before: from && left(from),
        eye: eye.toArray(),
        ahead: ahead.toArray(),
        spare,
      },
      spare ? [spare.buffer] : [],
    );
  }

  private take({ ticket, order, count, left }: SortReply) {
    if (this.sorting?.ticket !== ticket) return;
    this.gaussians = this.sorting.blocks.reduce((sum, { splats }) => sum + splats.count, -left);
    this.sortedKey = this.sorting.key;
    this.shown = this.sorting.blocks;
    this.shownClock = this.sorting.clock;
    this.sorting = null;
    const height = order.length / ORDER_ROW;
    if (this.order && this.order.image.height === height) {
      this.spare = this.order.image.data as Uint32Array<ArrayBuffer>;
      this.order.image.data = order;
    } else {
      this.spare = null;
      this.order?.dispose();
      this.order = makeOrder(order);
    }
    this.order.needsUpdate = true;
    this.drawn = count;
    this.mesh.material.uniforms["count"]!.value = count;
    this.mesh.geometry.instanceCount = Math.ceil(count / QUADS);
    this.mesh.visible = count > 0;
    this.sweep();
    this.onOrder();
  }

  // ---- drawing ----

  // Evaluates the colours for this eye, finds the place of each Gaussian on the screen, and sets what
  // the mesh needs; the caller renders the scene, of a divided picture each side after useSide().
  prepare(camera: PerspectiveCamera, divided = false) {
    const { planes, order, shownClock } = this;
    shownClock?.tick(performance.now(), this.fadeMs);
    if (!planes || !order || !this.mesh.visible) return;
    const share = shownClock && fadeShare(shownClock.spent);
    const shares = new Vector3(1, share ?? 1, 1 - (share ?? 1));
    const uniforms = this.mesh.material.uniforms;
    this.renderer.getDrawingBufferSize(uniforms["viewport"]!.value as Vector2);
    uniforms["near"]!.value = camera.near;
    if (divided && planes.sides.length < 2) {
      planes.sides.push(this.makeSide());
      for (const block of this.blocks) block.tinted[1] = -1;
    }
    if (!divided && planes.sides.length > 1) this.dropSide(planes.sides.pop()!);
    const { renderer } = this;
    const target = renderer.getRenderTarget();
    const clear = renderer.autoClear;
    renderer.autoClear = false;
    const { base, heads, more } = planes;
    const viewport = uniforms["viewport"]!.value as Vector2;
    planes.sides.forEach((side, k) => {
      this.evaluate(planes, side, k as 0 | 1, camera.position);
      const all = { order, count: this.drawn, base, heads, more, colors: side.colors.texture, shares };
      this.projector.run(side.projection, all, camera, viewport);
    });
    renderer.setRenderTarget(target);
    renderer.autoClear = clear;
    this.useSide(0);
  }

  useSide(k: 0 | 1) {
    const side = this.planes?.sides[k];
    if (side) this.read(side.projection);
  }

  private read({ textures: [first, second] }: Projection) {
    const { uniforms } = this.mesh.material;
    [uniforms["first"]!.value, uniforms["second"]!.value] = [first ?? null, second ?? null];
    this.mesh.material.uniformsNeedUpdate = true;
  }

  private evaluate(planes: Planes, side: Side, k: 0 | 1, eye: Vector3) {
    const tinted = this.applyTints(planes, side, k, this.shown);
    const rows = this.shown.map((block) => block.row).join();
    const key = `${this.contentVersion} ${rows} ${eye.toArray().join()}`;
    if (key === side.key && !tinted) return;
    side.key = key;
    this.evaluateBlocks(side, this.shown, eye);
  }

  private evaluateBlocks(side: Side, blocks: readonly Block[], eye: Vector3) {
    const uniforms = this.colorUniforms;
    (uniforms["eye"]!.value as Vector3).copy(eye);
    uniforms["tints"]!.value = side.tints?.texture ?? this.noTints;
    uniforms["tinted"]!.value = side.tints !== null;
    const stripes = new Map<number, { row: number; rows: number }[]>();
    for (const block of blocks)
      for (const { kind, row, rows } of block.stripes) {
        if (!stripes.has(kind)) stripes.set(kind, []);
        stripes.get(kind)!.push({ row: block.row + row, rows });
      }
    this.renderer.setRenderTarget(side.colors);
    for (const [kind, rows] of stripes) {
      if (!this.colorMaterials.has(kind)) this.colorMaterials.set(kind, this.rowMaterial(colorFragment(kind)));
      this.colorMesh.material = this.colorMaterials.get(kind)!;
      this.colorMesh.material.uniformsNeedUpdate = true;
      this.colorMesh.geometry.dispose();
      this.colorMesh.geometry = makeStripes(rows);
      this.renderer.render(this.colorScene, this.flat);
    }
  }

  // What the appearance adds to the tiles on the screen, where that is not there yet.
  private applyTints(
    { embed }: Planes,
    { tints }: Side,
    k: 0 | 1,
    blocks: readonly Block[],
  ): boolean {
    if (!tints) return false;
    const versionOf = (block: Block) => block.tint?.versions[k] || block.tint?.versions[0] || 0;
    const stale = blocks.filter((block) => block.tinted[k] !== versionOf(block));
    if (!stale.length) return false;
    const { renderer } = this;
    renderer.setRenderTarget(tints);
    for (const block of stale) {
      const { tint, row, rows, splats } = block;
      const side = tint?.versions[k] ? k : 0;
      if (tint && splats.embedding)
        tint.draw(renderer, side, embed, splats.embedding, row, rows, this.rows);
      else {
        this.plainMesh.geometry.dispose();
        this.plainMesh.geometry = makeStripes([block]);
        renderer.render(this.plainMesh, this.flat);
      }
      block.tinted[k] = versionOf(block);
    }
    return true;
  }

  // A few blocks alone, in the appearance of now, into a target of its own size. What the mesh draws
  // stays as it is. The camera is that of the last frame: colours of these blocks hold for both.
  drawSome(blocks: readonly Block[], camera: PerspectiveCamera, target: WebGLRenderTarget) {
    const { planes, renderer, mesh } = this;
    const side = planes?.sides[0];
    if (!planes || !side) return;
    const clear = renderer.autoClear;
    renderer.autoClear = false;
    this.applyTints(planes, side, 0, blocks);
    this.evaluateBlocks(side, blocks, camera.position);
    const { visible } = mesh;
    mesh.visible = true;
    const { uniforms } = mesh.material;
    const names = ["count", "viewport", "first", "second"] as const;
    const kept = names.map((name) => uniforms[name]!.value as unknown);
    const { instanceCount } = mesh.geometry;
    const count = blocks.reduce((sum, block) => sum + block.splats.count, 0);
    const viewport = new Vector2(target.width, target.height);
    const order = this.orderSome(blocks, camera);
    const { base, heads, more } = planes;
    const all = { order, count, base, heads, more, colors: side.colors.texture, shares: new Vector3(1, 1, 1) };
    this.projector.run(this.someProjection, all, camera, viewport);
    const now = [count, viewport, ...this.someProjection.textures];
    names.forEach((name, i) => (uniforms[name]!.value = now[i]));
    mesh.geometry.instanceCount = Math.ceil(count / QUADS);
    mesh.material.uniformsNeedUpdate = true;
    renderer.autoClear = true;
    renderer.setRenderTarget(target);
    renderer.render(mesh, camera);
    renderer.setRenderTarget(null);
    renderer.autoClear = clear;
    names.forEach((name, i) => (uniforms[name]!.value = kept[i]));
    mesh.geometry.instanceCount = instanceCount;
    mesh.material.uniformsNeedUpdate = true;
    mesh.visible = visible;
  }

  // The same by a camera of its own, before nothing, with all of its edges.
  drawAbove(blocks: readonly Block[], camera: PerspectiveCamera, target: WebGLRenderTarget) {
    const { renderer, projector } = this;
    const { edge } = projector;
    const alpha = renderer.getClearAlpha();
    projector.edge = null;
    renderer.setClearAlpha(0);
    this.drawSome(blocks, camera, target);
    renderer.setClearAlpha(alpha);
    projector.edge = edge;
    for (const side of this.planes?.sides ?? []) side.key = ""; // colours of these blocks are for that eye
  }

  // What is left of opacities, by place; null: all.
  setEdge(edge: Edge | null) {
    this.projector.edge = edge;
  }

  // From far to near. One camera asks for it again and again.
  private orderSome(blocks: readonly Block[], camera: PerspectiveCamera): DataTexture {
    const ids = blocks.map(({ id, row }) => `${id}@${row}`);
    const key = [...ids, ...camera.position.toArray(), ...camera.quaternion.toArray()].join();
    if (this.some?.key !== key) {
      this.some?.texture.dispose();
      const order = sortNow(blocks, camera);
      this.some = { key, texture: makeOrder(order) };
    }
    return this.some.texture;
  }

  // Depth alone, or colour alone.
  setSolid(on: boolean) {
    const { material } = this.mesh;
    material.uniforms["solid"]!.value = on;
    material.colorWrite = !on;
    material.depthWrite = on;
    material.depthTest = on || this.tested;
    material.uniformsNeedUpdate = true;
  }

  // Hidden by what was drawn before: models of others.
  setTested(on: boolean) {
    this.tested = this.mesh.material.depthTest = on;
  }

  // Everything on the card is gone.
  restore() {
    this.rebuild();
    if (this.order) this.order.needsUpdate = true;
    this.some = null;
    this.someProjection.dispose();
  }

  dispose() {
    this.sorter.terminate();
    this.dropPlanes();
    this.order?.dispose();
    this.some?.texture.dispose();
    this.mesh.geometry.dispose();
    this.mesh.material.dispose();
    this.noTints.dispose();
    this.someProjection.dispose();
    this.projector.dispose();
    for (const mesh of [this.colorMesh, this.plainMesh]) mesh.geometry.dispose();
    for (const material of [...this.colorMaterials.values(), this.plainMesh.material]) material.dispose();
  }
}

// Where a length fits between spans [from, length].
function firstFit(spans: [number, number][], length: number): number {
  let at = 0;
  for (const [from, size] of spans.sort((a, b) => a[0] - b[0])) {
    if (from - at >= length) break;
    at = Math.max(at, from + size);
  }
  return at;
}

function areaOf(centres: Float32Array): Rectangle {
  let [left, right, far, near] = [Infinity, -Infinity, Infinity, -Infinity];
  for (let i = 0; i < centres.length; i += 3) {
    left = Math.min(left, centres[i]!);
    right = Math.max(right, centres[i]!);
    far = Math.min(far, centres[i + 2]!);
    near = Math.max(near, centres[i + 2]!);
  }
  return [left, right, far, near];
}

// Gaussians of few blocks from far to near, without the worker.
function sortNow(blocks: readonly Block[], camera: PerspectiveCamera): Uint32Array<ArrayBuffer> {
  const count = blocks.reduce((sum, block) => sum + block.splats.count, 0);
  const at = new Uint32Array(count);
  const far = new Float32Array(count);
  const { x, y, z } = camera.position;
  const ahead = new Vector3(0, 0, -1).applyQuaternion(camera.quaternion);
  let n = 0;
  for (const { splats, row } of blocks) {
    const centres = centresOf(splats);
    for (let i = 0; i < splats.count; i++, n++) {
      at[n] = row * ROW + i;
      far[n] =
        (centres[3 * i]! - x) * ahead.x + (centres[3 * i + 1]! - y) * ahead.y + (centres[3 * i + 2]! - z) * ahead.z;
    }
  }
  const order = new Uint32Array(Math.ceil(count / ORDER_ROW) * ORDER_ROW);
  order.set(Uint32Array.from(at.keys()).sort((a, b) => far[b]! - far[a]!).map((i) => at[i]!));
  return order;
}
