// The page of `citysplat mark`: points, the photographs of the point of now, one of them large. window.mark is for tests.
//
// SPDX-License-Identifier: Apache-2.0
import { language, theme } from "./choices";
import { element, setText } from "./dom";
import "./style.css";
import "./mark.css";
import { Desk, Refused, type Place, type Point, type Spot } from "./markdesk";
import { Parts } from "./markparts";
import { PhotoView } from "./markphoto";
import { say, translateMark } from "./markwords";
import { getLanguage, setLanguage } from "./strings";

const KEPT_PHOTOS = 4; // decoded: 13 MB each, also of large photographs
const DONE_MARKS = 3;
const AGREE_PX = 3; // residual of marks that agree
const NUDGE_WAIT_MS = 350; // several presses are one change
const STEP_PX = 1;
const SHARE = { nowhere: 2, frame: 0.35, one: 0.2, marks: 0.12 }; // of the photograph's width, in view

class MarkPage {
  readonly desk: Desk;
  readonly view: PhotoView;
  photo = -1;
  pending = 0; // changes on their way
  private asking = 0; // for the survey, or for a point's photographs
  private readonly bitmaps = new Map<number, Promise<ImageBitmap>>();
  private nudged: ReturnType<typeof setTimeout> | undefined;

  constructor(token: string) {
    this.desk = new Desk(token);
    this.view = new PhotoView(element<HTMLCanvasElement>("photo"), element<HTMLCanvasElement>("loupe"), {
      set: (at) => void this.set(at),
      moving: (at) => this.caption(at),
    });
    this.buttons();
    addEventListener("keydown", (event) => this.onKey(event));
    addEventListener("beforeunload", (event) => {
      if (this.pending || this.nudged) event.preventDefault();
    });
  }

  async open(point: number) {
    this.asking++;
    try {
      await this.desk.open();
      setText("saved", say("ready", { file: this.desk.output }));
      if (this.desk.strays) banner(say("strays", { n: this.desk.strays }));
      await this.choose(point);
    } finally {
      this.asking--;
    }
  }

  // ---- what is shown ----

  async choose(point: number) {
    this.asking++;
    try {
      await this.flush();
      await this.desk.choose(point);
      this.lists();
      await this.openPhoto(this.desk.spots[0]?.photo ?? -1);
    } finally {
      this.asking--;
    }
  }

  get ready() {
    return this.pending === 0 && this.asking === 0 && !this.nudged && element("wait").hidden;
  }

  private async openPhoto(photo: number, focus = false) {
    await this.flush();
    this.photo = photo;
    const { desk, view } = this;
    const about = desk.photographs[photo];
    setText("about", this.aboutPoint());
    this.lists();
    if (!about) {
      view.mark = view.expected = null;
      view.show(null, [1, 1]);
      setText("caption", "");
      return;
    }
    this.wait(say("wait", { photo: about.name }));
    view.show(null, [about.width, about.height]);
    try {
      const bitmap = await this.bitmap(photo);
      if (this.photo !== photo) return;
      view.show(bitmap, [about.width, about.height], bitmap.width < about.width ? this.parts(photo) : null);
      this.wait("");
    } catch (error) {
      this.bitmaps.delete(photo);
      if (this.photo === photo) this.wait(say("broken", { photo: about.name, why: (error as Error).message }));
      return;
    }
    this.signs();
    this.aim();
    if (focus) element("photo").focus();
    const next = this.neighbour(1);
    if (next !== undefined) void this.bitmap(next).catch(() => this.bitmaps.delete(next));
  }

  // Looks where the point is.
  private aim() {
    const spot = this.desk.spot(this.photo);
    const at = spot?.mark ?? spot?.expected;
    if (at) this.view.look(at, SHARE[this.desk.points[this.desk.point]!.source]);
    else this.view.fit();
    this.view.aim = at ?? this.view.middle;
    this.view.draw();
  }

  private wait(message: string) {
    setText("wait", message);
    element("wait").hidden = !message;
  }

  private bitmap(photo: number): Promise<ImageBitmap> {
    const known = this.bitmaps.get(photo) ?? this.desk.photograph(photo);
    this.bitmaps.delete(photo);
    this.bitmaps.set(photo, known); // the newest is last
    for (const [old, one] of this.bitmaps) {
      if (this.bitmaps.size <= KEPT_PHOTOS) break;
      if (old === this.photo) continue;
      this.bitmaps.delete(old);
      void one.then((bitmap) => bitmap.close()).catch(() => undefined);
    }
    return known;
  }

  private parts(photo: number): Parts {
    return new Parts(
      this.desk.part,
      (column, row) => this.desk.photographPart(photo, column, row),
      () => this.view.draw(),
      (error) => banner(say("broken", { photo: this.desk.photographs[photo]!.name, why: error.message })),
    );
  }

  private signs() {
    const spot = this.desk.spot(this.photo);
    this.view.mark = spot?.mark ?? null;
    this.view.expected = spot?.expected ?? null;
    this.view.draw();
    this.caption(this.view.mark);
    element<HTMLButtonElement>("delete").disabled = !this.view.mark;
    element<HTMLButtonElement>("undo").disabled = !this.desk.canUndo;
    element<HTMLButtonElement>("redo").disabled = !this.desk.canRedo;
  }

  private caption(at: Place | null) {
    const { desk } = this;
    const parts = [desk.points[desk.point]?.name, desk.photographs[this.photo]?.name];
    if (at) parts.push(`${at[0].toFixed(1)}, ${at[1].toFixed(1)}`);
    setText("caption", parts.filter(Boolean).join(" · "));
  }

  private aboutPoint(): string {
    const { desk } = this;
    const point = desk.points[desk.point]!;
    const n = desk.spots.length;
    const parts = [say(n || point.source === "nowhere" ? `source.${point.source}` : "source.unseen", { n })];
    if (point.offPlan !== null && point.offHeight !== null)
      parts.push(say("point.off", { plan: point.offPlan.toFixed(2), height: signed(point.offHeight) }));
    return parts.join(" ");
  }

  private lists() {
    const { desk } = this;
    element("points").replaceChildren(
      ...desk.points.map((point, i) =>
        row(point.name, [...aboutMarks(point)], i === desk.point, () => void this.choose(i)),
      ),
    );
    element("photos").replaceChildren(
      ...desk.spots.map((spot) =>
        row(desk.photographs[spot.photo]!.name, aboutSpot(spot), spot.photo === this.photo, () => void this.openPhoto(spot.photo)),
      ),
    );
    for (const list of ["points", "photos"])
      document.querySelector(`#${list} [aria-current]`)?.scrollIntoView({ block: "nearest" });
    const done = desk.points.filter(isDone).length;
    setText("done", say("done", { done, all: desk.points.length }));
  }

  // ---- what is done ----

  private neighbour(step: number): number | undefined {
    const { spots } = this.desk;
    return spots[spots.findIndex((one) => one.photo === this.photo) + step]?.photo;
  }

  go(step: number) {
    const photo = this.neighbour(step);
    if (photo !== undefined) void this.openPhoto(photo);
  }

  private goPoint(step: number) {
    const point = this.desk.point + step;
    if (point >= 0 && point < this.desk.points.length) void this.choose(point);
  }

  private async set(at: Place | null) {
    clearTimeout(this.nudged);
    this.nudged = undefined;
    const { desk, photo } = this;
    const before = desk.spot(photo)?.mark;
    if (photo < 0 || (!at && !before)) return;
    this.view.mark = at;
    this.view.draw();
    await this.save(async () => {
      await desk.set(photo, at && [round(at[0]), round(at[1])]);
      const names = { point: desk.points[desk.point]!.name, photo: desk.photographs[photo]!.name };
      const residual = desk.spot(photo)?.residual;
      const words = [say(!at ? "said.gone" : before ? "said.moved" : "said.set", names)];
      if (at && residual != null) words.push(say("said.residual", { px: residual.toFixed(1) }));
      setText("said", words.join(", "));
    });
  }

  private async save(change: () => Promise<unknown>) {
    this.pending++;
    setText("saved", say("saving"));
    try {
      await change();
      setText("saved", say("saved", { file: this.desk.output }));
    } catch (error) {
      setText("saved", say("unsaved"));
      this.refused(error as Error);
    } finally {
      this.pending--;
    }
    setText("about", this.aboutPoint());
    this.lists();
    this.signs();
  }

  private refused(error: Error) {
    const conflict = error instanceof Refused && error.status === 409;
    banner(conflict ? `${say("conflict")} ${error.message}` : say("failed", { why: error.message }), say("reload"), () => {
      void this.open(this.desk.point);
    });
  }

  // By steps of the keys: of the mark, or of the cross where there is none yet.
  nudge(dx: number, dy: number) {
    const { view } = this;
    const from = view.mark ?? view.aim ?? view.expected ?? view.middle;
    const at = view.clamp([from[0] + dx, from[1] + dy]);
    view.reveal(at);
    if (!view.mark) view.aim = at;
    else {
      view.mark = at;
      clearTimeout(this.nudged);
      this.nudged = setTimeout(() => void this.set(at), NUDGE_WAIT_MS);
    }
    this.caption(at);
    view.draw();
  }

  // What the keys have moved is saved now.
  private async flush() {
    if (this.nudged) await this.set(this.view.mark);
  }

  enter() {
    if (this.view.mark) this.go(1);
    else void this.set(this.view.clamp(this.view.aim ?? this.view.expected ?? this.view.middle));
  }

  private async step(back: boolean) {
    await this.flush();
    const { desk } = this;
    const point = desk.point;
    let photo = this.photo;
    await this.save(async () => {
      photo = (await (back ? desk.undo() : desk.redo()))?.photo ?? photo;
    });
    if (photo !== this.photo || point !== desk.point) await this.openPhoto(photo);
  }

  private buttons() {
    const on = (id: string, act: () => void) => element(id).addEventListener("click", act);
    on("previous", () => this.go(-1));
    on("next", () => this.go(1));
    on("in", () => this.view.zoom(1.5));
    on("out", () => this.view.zoom(1 / 1.5));
    on("fit", () => this.view.fit());
    on("left", () => this.nudge(-STEP_PX / 2, 0));
    on("right", () => this.nudge(STEP_PX / 2, 0));
    on("up", () => this.nudge(0, -STEP_PX / 2));
    on("down", () => this.nudge(0, STEP_PX / 2));
    on("set", () => this.enter());
    on("delete", () => void this.set(null));
    on("undo", () => void this.step(true));
    on("redo", () => void this.step(false));
  }

  private onKey(event: KeyboardEvent) {
    const command = event.ctrlKey || event.metaKey;
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    const pressed = document.activeElement instanceof HTMLButtonElement && (key === "Enter" || key === " ");
    if (event.altKey || pressed) return;
    const size = event.shiftKey ? STEP_PX / 10 : STEP_PX;
    const acts: Record<string, () => void> = command
      ? { z: () => void this.step(!event.shiftKey), y: () => void this.step(false) }
      : {
          "ArrowLeft": () => this.nudge(-size, 0),
          "ArrowRight": () => this.nudge(size, 0),
          "ArrowUp": () => this.nudge(0, -size),
          "ArrowDown": () => this.nudge(0, size),
          "Enter": () => this.enter(),
          "Delete": () => void this.set(null),
          "Backspace": () => void this.set(null),
          "n": () => this.go(1),
          "p": () => this.go(-1),
          "]": () => this.goPoint(1),
          "[": () => this.goPoint(-1),
          "+": () => this.view.zoom(1.25),
          "=": () => this.view.zoom(1.25),
          "-": () => this.view.zoom(0.8),
          "0": () => this.view.fit(),
        };
    const act = acts[key];
    if (!act) return;
    event.preventDefault();
    act();
  }
}

function round(v: number): number {
  return Math.round(v * 1000) / 1000;
}

function signed(v: number): string {
  return `${v < 0 ? "−" : "+"}${Math.abs(v).toFixed(2)}`;
}

function isDone(point: Point): boolean {
  return point.marks >= DONE_MARKS && !point.suspects && point.worst !== null && point.worst <= AGREE_PX;
}

type Note = { text: string; kind?: "warn" | "good" };

function aboutMarks(point: Point): Note[] {
  const { marks, worst } = point;
  const notes: Note[] = [{ text: marks === 1 ? say("point.mark") : marks ? say("point.marks", { n: marks }) : say("point.none") }];
  if (worst !== null) notes.push({ text: say("point.worst", { px: worst.toFixed(1) }), ...(worst > AGREE_PX && { kind: "warn" }) });
  if (point.suspects) notes.push({ text: say("point.suspect"), kind: "warn" });
  if (isDone(point)) notes.push({ text: `✓ ${say("point.done")}`, kind: "good" });
  return notes;
}

function aboutSpot(spot: Spot): Note[] {
  if (!spot.mark) return [];
  const px = spot.residual;
  if (spot.lost) return [{ text: say("spot.lost"), kind: "warn" }];
  if (px === null) return [{ text: say("spot.marked"), kind: "good" }];
  const text = say("spot.residual", { px: px.toFixed(1) });
  if (spot.suspect) return [{ text: `${text}, ${say("spot.suspect")}`, kind: "warn" }];
  return [{ text, kind: px > AGREE_PX ? "warn" : "good" }];
}

function row(name: string, notes: Note[], current: boolean, act: () => void): HTMLLIElement {
  const item = document.createElement("li");
  const button = document.createElement("button");
  const title = document.createElement("span");
  title.textContent = name;
  button.append(title);
  for (const note of notes) {
    const small = document.createElement("small");
    small.textContent = note.kind === "warn" ? `⚠ ${note.text}` : note.text;
    if (note.kind) small.className = note.kind;
    button.append(small);
  }
  if (current) button.setAttribute("aria-current", "true");
  button.addEventListener("click", act);
  item.append(button);
  return item;
}

function banner(message: string, label = say("close"), act?: () => void) {
  const box = document.createElement("div");
  const words = document.createElement("p");
  const button = document.createElement("button");
  box.className = "banner";
  words.textContent = message;
  button.textContent = label;
  button.addEventListener("click", () => {
    box.remove();
    act?.();
  });
  box.append(words, button);
  element("banners").replaceChildren(box);
}

async function main() {
  await setLanguage(new URLSearchParams(location.search).get("lang") ?? language());
  document.documentElement.lang = getLanguage();
  document.documentElement.dataset["theme"] = theme();
  translateMark(document);
  const page = new MarkPage(location.hash.slice(1));
  Object.assign(window, { mark: page });
  await page.open(0);
}

main().catch((error: Error) => banner(error.message));
