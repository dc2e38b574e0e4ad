// A photograph that is zoomed, panned and marked: by mouse, touch or the keys of mark.ts.
//
// SPDX-License-Identifier: Apache-2.0
import type { Place } from "./markdesk";
import type { Parts } from "./markparts";

const SCALE_MAX = 32; // CSS pixels for one of the photograph
const LOUPE_SCALE = 5;
const STILL_PX = 5; // less is a click
const MARGIN_PX = 60; // of the photograph that stays in view
const BLUR = 2; // pixels of the screen for one of the smaller picture, from which on full size is asked for
const COLOURS = { mark: "#ff5ea8", expected: "#ffd23e", edge: "rgb(0 0 0 / 75%)" };

export interface PhotoEvents {
  set(at: Place): void;
  moving(at: Place): void; // while the mark is dragged
}

interface Grip {
  x: number;
  y: number;
}

export class PhotoView {
  mark: Place | null = null;
  expected: Place | null = null;
  aim: Place | null = null; // of the keys, where there is no mark
  private bitmap: ImageBitmap | null = null;
  private parts: Parts | null = null; // of a bitmap that is smaller than the photograph
  private size: Place = [1, 1];
  private scale = 1;
  private origin: Place = [0, 0]; // CSS pixels, of the photograph's corner
  private readonly pointers = new Map<number, Grip>();
  private begin: Grip | null = null; // a press that may be a click
  private held: Place | null = null; // where the dragged mark was
  private hover: Place | null = null;
  private frame = 0;
  private readonly canvas: HTMLCanvasElement;
  private readonly loupe: HTMLCanvasElement;

  constructor(
    canvas: HTMLCanvasElement,
    loupe: HTMLCanvasElement,
    private readonly events: PhotoEvents,
  ) {
    this.canvas = canvas;
    this.loupe = loupe;
    new ResizeObserver(() => this.draw()).observe(canvas);
    canvas.addEventListener("pointerdown", (event) => this.onDown(event));
    canvas.addEventListener("pointermove", (event) => this.onMove(event));
    canvas.addEventListener("pointerup", (event) => this.onUp(event));
    canvas.addEventListener("pointercancel", (event) => this.onCancel(event));
    canvas.addEventListener("pointerleave", () => {
      this.hover = null;
      this.draw();
    });
    canvas.addEventListener("wheel", (event) => this.onWheel(event), { passive: false });
  }

  // bitmap null: it is on its way.
  show(bitmap: ImageBitmap | null, size: Place, parts: Parts | null = null) {
    if (this.parts !== parts) this.parts?.close();
    this.bitmap = bitmap;
    this.parts = parts;
    this.size = size;
    this.begin = this.held = this.aim = null;
    this.draw();
  }

  // What is drawn is as sharp as the photograph is.
  get sharp(): boolean {
    return this.bitmap !== null && (this.parts?.complete ?? true);
  }

  // So that `share` of the photograph's width is in view about a place.
  look(at: Place, share: number) {
    const { clientWidth: w, clientHeight: h } = this.canvas;
    const least = Math.min(w / this.size[0], h / this.size[1]);
    this.scale = Math.min(Math.max(Math.min(w, h) / (this.size[0] * share), least), SCALE_MAX);
    this.origin = [w / 2 - at[0] * this.scale, h / 2 - at[1] * this.scale];
    this.draw();
  }

  fit() {
    const { clientWidth: w, clientHeight: h } = this.canvas;
    this.scale = Math.min(w / this.size[0], h / this.size[1]);
    this.origin = [(w - this.size[0] * this.scale) / 2, (h - this.size[1] * this.scale) / 2];
    this.draw();
  }

  // By a factor about a place of the canvas, or about what is marked or expected, or about the middle.
  zoom(factor: number, about?: Grip) {
    const { clientWidth: w, clientHeight: h } = this.canvas;
    const target = this.mark ?? this.aim ?? this.expected;
    const centre = target ? this.toScreen(target) : [w / 2, h / 2];
    const inside = centre[0]! >= 0 && centre[1]! >= 0 && centre[0]! <= w && centre[1]! <= h;
    const at = about ?? (inside ? { x: centre[0]!, y: centre[1]! } : { x: w / 2, y: h / 2 });
    const least = Math.min(w / this.size[0], h / this.size[1]) / 2;
    const scale = Math.min(Math.max(this.scale * factor, least), SCALE_MAX);
    const place = this.toPhoto(at);
    this.scale = scale;
    this.origin = [at.x - place[0] * scale, at.y - place[1] * scale];
    this.draw();
  }

  // Brings a place into view.
  reveal(at: Place) {
    const { clientWidth: w, clientHeight: h } = this.canvas;
    const [x, y] = this.toScreen(at);
    if (x < MARGIN_PX || x > w - MARGIN_PX) this.origin[0] += w / 2 - x;
    if (y < MARGIN_PX || y > h - MARGIN_PX) this.origin[1] += h / 2 - y;
    this.draw();
  }

  get middle(): Place {
    return this.clamp(this.toPhoto({ x: this.canvas.clientWidth / 2, y: this.canvas.clientHeight / 2 }));
  }

  clamp(at: Place): Place {
    return [Math.min(Math.max(at[0], 0), this.size[0]), Math.min(Math.max(at[1], 0), this.size[1])];
  }

  toScreen(at: Place): Place {
    return [this.origin[0] + at[0] * this.scale, this.origin[1] + at[1] * this.scale];
  }

  private toPhoto(at: Grip): Place {
    return [(at.x - this.origin[0]) / this.scale, (at.y - this.origin[1]) / this.scale];
  }

  draw() {
    cancelAnimationFrame(this.frame);
    this.frame = requestAnimationFrame(() => this.paint());
  }

  // ---- pointers ----

  private grip(event: PointerEvent | WheelEvent): Grip {
    const box = this.canvas.getBoundingClientRect();
    return { x: event.clientX - box.left, y: event.clientY - box.top };
  }

  private onDown(event: PointerEvent) {
    if (event.button !== 0 || !this.bitmap) return;
    const at = this.grip(event);
    this.canvas.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, at);
    this.hover = null;
    const alone = this.pointers.size === 1;
    this.begin = alone ? at : null;
    const reach = event.pointerType === "mouse" ? 12 : 26;
    const near = alone && this.mark !== null && distance(this.toScreen(this.mark), [at.x, at.y]) < reach;
    this.held = near ? this.mark : null;
    this.draw();
  }

  private onMove(event: PointerEvent) {
    const at = this.grip(event);
    const before = this.pointers.get(event.pointerId);
    if (!before) {
      this.hover = event.pointerType === "mouse" ? this.toPhoto(at) : null;
      return this.draw();
    }
    if (this.begin && distance([this.begin.x, this.begin.y], [at.x, at.y]) < STILL_PX) return;
    const dx = at.x - before.x;
    const dy = at.y - before.y;
    if (this.pointers.size === 2) this.pinch(event.pointerId, before, at);
    else if (this.held && this.mark) {
      const full = this.begin ? [at.x - this.begin.x, at.y - this.begin.y] : [dx, dy];
      const from = this.begin ? this.held : this.mark;
      this.mark = this.clamp([from[0] + full[0]! / this.scale, from[1] + full[1]! / this.scale]);
      this.events.moving(this.mark);
    } else this.origin = [this.origin[0] + dx, this.origin[1] + dy];
    this.begin = null;
    this.pointers.set(event.pointerId, at);
    this.keepInView();
    this.draw();
  }

  // Two fingers: both stay on what they hold.
  private pinch(id: number, before: Grip, at: Grip) {
    const other = [...this.pointers].find(([one]) => one !== id)![1];
    const factor = distance([at.x, at.y], [other.x, other.y]) / Math.max(distance([before.x, before.y], [other.x, other.y]), 1);
    this.zoom(factor, other);
  }

  private onUp(event: PointerEvent) {
    const { begin, held, mark } = this;
    const known = this.pointers.delete(event.pointerId);
    if (!known) return;
    this.begin = this.held = null;
    if (held && !begin && mark) this.events.set(mark);
    else if (begin && this.pointers.size === 0) {
      const at = this.toPhoto(begin);
      const inside = at[0] >= 0 && at[1] >= 0 && at[0] <= this.size[0] && at[1] <= this.size[1];
      if (inside) this.events.set(at);
    }
    this.draw();
  }

  private onCancel(event: PointerEvent) {
    if (this.held) this.mark = this.held;
    this.pointers.delete(event.pointerId);
    this.begin = this.held = null;
    this.draw();
  }

  private onWheel(event: WheelEvent) {
    event.preventDefault();
    const lines = event.deltaMode === 1 ? 33 : 1;
    this.zoom(Math.exp((-event.deltaY * lines) / 300), this.grip(event));
    this.keepInView();
  }

  private keepInView() {
    const { clientWidth: w, clientHeight: h } = this.canvas;
    for (const [k, room] of [w, h].entries()) {
      const least = MARGIN_PX - this.size[k]! * this.scale;
      this.origin[k] = Math.min(Math.max(this.origin[k]!, least), room - MARGIN_PX);
    }
  }

  // ---- drawing ----

  private paint() {
    const c = prepare(this.canvas);
    const { clientWidth: w, clientHeight: h } = this.canvas;
    c.clearRect(0, 0, w, h);
    this.parts?.begin();
    if (this.bitmap) {
      this.copy(c, this.origin, this.scale, w, h);
      this.signs(c, (at) => this.toScreen(at), 1);
    }
    this.paintLoupe();
  }

  private copy(c: CanvasRenderingContext2D, origin: Place, scale: number, w: number, h: number) {
    const bitmap = this.bitmap!;
    const unit = bitmap.width / this.size[0]; // it may be smaller than the photograph
    const [x0, y0] = [Math.max(-origin[0] / scale, 0), Math.max(-origin[1] / scale, 0)];
    const [x1, y1] = [Math.min((w - origin[0]) / scale, this.size[0]), Math.min((h - origin[1]) / scale, this.size[1])];
    if (x1 <= x0 || y1 <= y0) return;
    c.imageSmoothingEnabled = scale < 2;
    c.imageSmoothingQuality = scale < 0.5 ? "high" : "low";
    const [sx, sy] = [Math.floor(x0), Math.floor(y0)]; // whole pixels, so that they lie where they are
    const [ex, ey] = [Math.min(Math.ceil(x1), this.size[0]), Math.min(Math.ceil(y1), this.size[1])];
    c.drawImage(
      bitmap,
      ...([sx * unit, sy * unit, (ex - sx) * unit, (ey - sy) * unit] as const),
      ...([origin[0] + sx * scale, origin[1] + sy * scale, (ex - sx) * scale, (ey - sy) * scale] as const),
    );
    if (this.parts && scale * window.devicePixelRatio >= BLUR * unit) this.copyParts(c, origin, scale, [sx, sy, ex, ey]);
  }

  // Over the smaller picture, what is here at full size of the pixels sx, sy to ex, ey.
  private copyParts(c: CanvasRenderingContext2D, origin: Place, scale: number, [sx, sy, ex, ey]: [number, number, number, number]) {
    const { size } = this.parts!;
    for (let row = Math.floor(sy / size); row * size < ey; row++)
      for (let column = Math.floor(sx / size); column * size < ex; column++) {
        const part = this.parts!.get(column, row);
        if (!part) continue;
        const [x0, y0] = [Math.max(column * size, sx), Math.max(row * size, sy)];
        const [w, h] = [Math.min(column * size + part.width, ex) - x0, Math.min(row * size + part.height, ey) - y0];
        c.drawImage(
          part,
          ...([x0 - column * size, y0 - row * size, w, h] as const),
          ...([origin[0] + x0 * scale, origin[1] + y0 * scale, w * scale, h * scale] as const),
        );
      }
  }

  private signs(c: CanvasRenderingContext2D, where: (at: Place) => Place, size: number) {
    if (this.expected) this.sign(c, where(this.expected), COLOURS.expected, () => ring(c, where(this.expected!), 14 * size));
    if (!this.mark && this.aim) this.sign(c, where(this.aim), COLOURS.expected, () => cross(c, where(this.aim!), 4, 18));
    if (this.mark) this.sign(c, where(this.mark), COLOURS.mark, () => cross(c, where(this.mark!), 3, 16));
  }

  private sign(c: CanvasRenderingContext2D, _: Place, colour: string, path: () => void) {
    for (const [width, stroke] of [[4, COLOURS.edge], [1.8, colour]] as const) {
      c.lineWidth = width;
      c.strokeStyle = stroke;
      c.beginPath();
      path();
      c.stroke();
    }
  }

  private paintLoupe() {
    const at = (this.held && this.mark) || (this.begin && this.toPhoto(this.begin)) || this.hover || this.mark || this.aim;
    const { loupe, canvas } = this;
    loupe.hidden = !this.bitmap || !at;
    if (loupe.hidden || !at) return;
    const [x, y] = this.toScreen(at);
    loupe.classList.toggle("other", x > canvas.clientWidth - loupe.clientWidth - 40 && y < loupe.clientHeight + 40);
    const c = prepare(loupe);
    const w = loupe.clientWidth;
    const h = loupe.clientHeight;
    const scale = Math.max(LOUPE_SCALE, this.scale * 2);
    const origin: Place = [w / 2 - at[0] * scale, h / 2 - at[1] * scale];
    c.clearRect(0, 0, w, h);
    this.copy(c, origin, scale, w, h);
    this.signs(c, (p) => [origin[0] + p[0] * scale, origin[1] + p[1] * scale], 0.6);
    this.sign(c, [w / 2, h / 2], "#fff", () => cross(c, [w / 2, h / 2], 6, 12));
  }
}

function distance(a: Place, b: Place): number {
  return Math.hypot(a[0] - b[0], a[1] - b[1]);
}

function ring(c: CanvasRenderingContext2D, at: Place, r: number) {
  c.arc(at[0], at[1], r, 0, 2 * Math.PI);
}

function cross(c: CanvasRenderingContext2D, [x, y]: Place, from: number, to: number) {
  for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]] as const) {
    c.moveTo(x + dx * from, y + dy * from);
    c.lineTo(x + dx * to, y + dy * to);
  }
}

// Its pixels are those of the screen; one unit is a CSS pixel.
function prepare(canvas: HTMLCanvasElement): CanvasRenderingContext2D {
  const ratio = window.devicePixelRatio;
  const [w, h] = [Math.round(canvas.clientWidth * ratio), Math.round(canvas.clientHeight * ratio)];
  if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
  const c = canvas.getContext("2d")!;
  c.setTransform(ratio, 0, 0, ratio, 0, 0);
  return c;
}
