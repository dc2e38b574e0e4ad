// The server's own rendering of the camera: a stream of video while it moves and a while longer (film.ts). Where that
// cannot be had it is asked for over and over: small pictures while the camera moves, one request on its way at most and
// always for the newest pose; the full one when it rests. The last picture stays until the next one can be shown.
//
// SPDX-License-Identifier: Apache-2.0
import type { Film, FilmPicture } from "./film";
import type { Pose } from "./geo";
import type { Link } from "./link";
import { pictureUrl, type SceneEntry } from "./source";

const SIDE_MAX_PX = 2048; // what a server takes by default
const AREA_MAX_PX = 4e6;
const MOVING_AREA_PX = 60_000; // at first; follows the time that the answers take
const MOVING_AREA_LEAST_PX = 20_000;
const MOVING_AREA_MOST_PX = 500_000;
const MOVING_MS = 100; // an answer's time to keep to while moving
const REST_MS = 180;
const FILM_PAUSE_MS = 10_000; // after a stream that showed nothing, before another one

export interface PictureInfo {
  width: number;
  height: number;
  bytes: number;
  milliseconds: number;
  moving: boolean;
  video: boolean; // a frame of a stream
}

interface Wish {
  entry: SceneEntry;
  appearance: string;
  pose: Pose;
  width: number;
  height: number;
}

/** @internal */
export class Pictures {
  onPicture: (info: PictureInfo) => void = () => {};
  onProblem: (error: unknown) => void = () => {};
  onStart: () => void = () => {};
  onNoVideo: (why: string) => void = () => {}; // once: pictures come one by one
  shownKey = ""; // of the full picture on the screen
  private shownSmall = ""; // of the small one
  drawn = 0;
  private wish: Wish | null = null;
  private wishKey = "";
  private changedAt = 0;
  private moves = false; // the camera did, in the last frame
  private request: AbortController | null = null;
  private requestFull = false;
  private timer = 0;
  private area = MOVING_AREA_PX;
  private failedKey = "";
  private film: Film | null = null;
  private filmFrom = 0; // when one may be opened

  sky: boolean; // with sky and ground behind the city
  // moving: draw pictures while the camera moves; else only those of a resting one.
  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly link: Link,
    private readonly moving: boolean,
  ) {
    this.sky = moving; // these stand for the city; the others lie over the viewer's own picture
  }

  // What is to be seen now; called in every frame. moves: the camera does, so another pose follows, be it after a
  // long frame: the full picture waits for a frame in which it rests.
  want(entry: SceneEntry, appearance: string, pose: Pose, width: number, height: number, moves = false) {
    const moved = this.moves;
    this.moves = moves;
    if (entry.id !== this.wish?.entry.id) this.closeFilm();
    const { lon, lat, h, heading, pitch, fov } = pose;
    const digits = [lon, lat].map((v) => v.toFixed(8));
    const turn = [h, heading, pitch, fov].map((v) => v.toFixed(3));
    const key = [entry.id, appearance, ...digits, ...turn, width, height, this.sky].join(" ");
    if (key === this.wishKey) {
      if (moved && !moves) this.next();
      return;
    }
    this.wish = { entry, appearance, pose, width, height };
    this.wishKey = key;
    this.changedAt = performance.now();
    // A full picture of a pose that is no longer the newest is not worth its time.
    if (this.requestFull) this.request?.abort();
    if (moved && moves) void this.openFilm(entry); // a jump is no film
    this.next();
  }

  get settled(): boolean {
    return this.shownKey !== "" && this.shownKey === this.wishKey;
  }

  // The picture on the screen is of the newest wish, full or small.
  get pending(): boolean {
    return this.wish !== null && !this.settled && this.failedKey !== this.wishKey;
  }

  // Asks again where the last answer was a refusal.
  retry() {
    this.failedKey = "";
    this.next();
  }

  // Nobody looks; retry() goes on.
  pause() {
    this.closeFilm();
    this.moves = false;
  }

  stop() {
    this.closeFilm();
    clearTimeout(this.timer);
    this.request?.abort();
    this.request = null;
    this.wish = null;
    this.wishKey = this.shownKey = this.shownSmall = this.failedKey = "";
    this.moves = false;
  }

  // Its script comes with the first one. Where that does not come, pictures come one by one.
  private async openFilm({ id, questions }: SceneEntry) {
    const may = this.moving && this.link.state !== "away" && performance.now() >= this.filmFrom;
    if (this.film || !questions || !may) return;
    this.filmFrom = Infinity;
    const module = await import("./film").catch(() => null);
    if (!module) return;
    this.filmFrom = 0;
    if (this.film || !this.moves || document.hidden || this.wish?.entry.id !== id) return;
    const film = new module.Film(questions, this.link, (picture) => this.take(picture));
    film.onEnd = (never) => {
      this.film = null;
      if (never) this.filmFrom = Infinity;
      else if (!film.shown) this.filmFrom = performance.now() + FILM_PAUSE_MS;
      if (never) this.onNoVideo(never);
      this.next();
    };
    this.film = film;
  }

  private closeFilm() {
    this.film?.close();
    this.film = null;
  }

  private take({ image, key, full, ...info }: FilmPicture) {
    this.show(image, info.width, info.height);
    this.tell(key, full, info);
  }

  // A picture is on the screen.
  private tell(key: string, full: boolean, info: Omit<PictureInfo, "moving">) {
    this.shownKey = full ? key : "";
    this.shownSmall = full ? "" : key;
    this.drawn++;
    this.onPicture({ ...info, moving: !full });
  }

  private next() {
    clearTimeout(this.timer);
    if (!this.wish || this.settled || this.failedKey === this.wishKey) return;
    if (this.film) {
      const [width, height] = this.sizeOf(this.wish, true);
      const { appearance, pose } = this.wish;
      return this.film.want({ key: this.wishKey, appearance, pose, width, height, sky: this.sky });
    }
    if (this.request) return;
    const rested = performance.now() - this.changedAt;
    const full = rested >= REST_MS && !this.moves;
    if (!full && (!this.moving || this.shownSmall === this.wishKey)) {
      // Where the camera still moves, the frame in which it rests goes on.
      if (!this.moves) this.timer = window.setTimeout(() => this.next(), Math.max(0, REST_MS - rested));
      return;
    }
    void this.fetch(this.wish, this.wishKey, full);
  }

  private async fetch(wish: Wish, key: string, full: boolean) {
    const request = new AbortController();
    this.request = request;
    this.requestFull = full;
    const [width, height] = this.sizeOf(wish, full);
    if (full) this.onStart();
    const started = performance.now();
    try {
      const url = pictureUrl(wish.entry, wish.appearance, wish.pose, width, height, this.sky);
      const { body } = await this.link.get(url, request.signal);
      const milliseconds = performance.now() - started;
      const bitmap = await createImageBitmap(new Blob([body]));
      if (!request.signal.aborted && !this.film?.shown) {
        this.show(bitmap, bitmap.width, bitmap.height);
        if (!full) this.adapt(milliseconds);
        this.tell(key, full, { width, height, bytes: body.byteLength, milliseconds, video: false });
      }
      bitmap.close();
    } catch (error) {
      if (request.signal.aborted) return;
      this.failedKey = key;
      this.onProblem(error);
    } finally {
      if (this.request === request) this.request = null;
      if (this.wish) {
        const rested = performance.now() - this.changedAt;
        clearTimeout(this.timer);
        // A small picture of the resting camera is followed by the full one.
        this.timer = window.setTimeout(
          () => this.next(),
          this.wishKey === key && !full ? Math.max(0, REST_MS - rested) : 0,
        );
      }
    }
  }

  private adapt(milliseconds: number) {
    const factor = Math.min(1.3, Math.max(0.5, MOVING_MS / milliseconds));
    this.area = Math.min(
      MOVING_AREA_MOST_PX,
      Math.max(MOVING_AREA_LEAST_PX, this.area * factor),
    );
  }

  private sizeOf({ width, height }: Wish, full: boolean): [number, number] {
    const shrink = Math.min(
      1,
      SIDE_MAX_PX / Math.max(width, height),
      Math.sqrt((full ? AREA_MAX_PX : this.area) / (width * height)),
    );
    return [Math.max(16, Math.round(width * shrink)), Math.max(16, Math.round(height * shrink))];
  }

  private show(image: CanvasImageSource, width: number, height: number) {
    const { canvas } = this;
    if (canvas.width !== width || canvas.height !== height) {
      canvas.width = width;
      canvas.height = height;
    }
    canvas.getContext("2d")!.drawImage(image, 0, 0);
  }
}
