// A stream of the server's pictures that follow a camera (docs/http.md#streams): frames of VP9 while it moves, a sharp
// JPEG where it rests. Cameras go to the server in requests of their own.
//
// SPDX-License-Identifier: Apache-2.0
import type { Pose } from "./geo";
import { BUSY, describe, type Link } from "./link";
import { formatPose, parsePose } from "./pose";

const CODEC = "vp09.00.41.08"; // as docs/http.md says
const FRAME = "video/vp9";
const POSE_MS = 33; // between two cameras
const POSES_MOST = 4; // on their way: a browser has six connections to a server
const QUEUE_MOST = 2; // frames that wait for the decoder; a slow one must not show old ones
const REST_MS = 10_000; // without another camera the stream is given up, and its encoder with it
const ANSWER_MS = 8000;
const HEAD_MOST = 4096;
const PART_MOST = 64e6;

/** @internal */
export interface FilmWish {
  key: string; // of what is to be seen
  appearance: string;
  pose: Pose;
  width: number; // in full
  height: number;
  sky: boolean;
}

/** @internal */
export interface FilmPicture {
  image: VideoFrame | ImageBitmap; // closed when the call returns
  width: number;
  height: number;
  key: string; // of the wish that it shows
  full: boolean;
  video: boolean;
  bytes: number;
  milliseconds: number; // since that was sent
}

interface Part {
  type: string;
  number: number;
  full: boolean;
  key: boolean;
  data: Uint8Array<ArrayBuffer>;
}

// Why it cannot be had here at all; other errors may pass.
class Never extends Error {}

// Pictures of the stream as they come; ends where it does.
async function* partsOf(body: ReadableStream<Uint8Array>, count: (bytes: number) => void): AsyncGenerator<Part> {
  const reader = body.getReader();
  let held = new Uint8Array(0);
  const more = async () => {
    const { done, value } = await reader.read();
    if (done) return false;
    count(value.length);
    const both = new Uint8Array(held.length + value.length);
    both.set(held);
    both.set(value, held.length);
    held = both;
    return true;
  };
  const text = new TextDecoder("latin1");
  for (;;) {
    let end: number;
    let head: string;
    while ((end = (head = text.decode(held.subarray(0, HEAD_MOST))).indexOf("\r\n\r\n")) < 0)
      if (held.length >= HEAD_MOST || !(await more())) return;
    const field = (name: string) => new RegExp(`^${name}: *(.*)\r`, "im").exec(head)?.[1] ?? "";
    const [from, length] = [end + 4, Number(field("Content-Length") || NaN)];
    if (!(length > 0 && length <= PART_MOST)) throw new Error("a part of the stream has no length");
    while (held.length < from + length) if (!(await more())) return;
    yield {
      type: field("Content-Type").toLowerCase(),
      number: Number(field("Pose")),
      full: field("Rest") === "1",
      key: field("Key") === "1",
      data: held.slice(from, from + length),
    };
    held = held.subarray(from + length);
  }
}

/** @internal */
export class Film {
  shown = 0; // pictures
  // It is over, by itself. never: why there is no use in another one; "": that may pass.
  onEnd: (never: string) => void = () => {};
  private readonly stopped = new AbortController();
  private url: URL | null = null; // null: it is not open yet
  private decoder: VideoDecoder | null = null;
  private readonly decoding = new Map<number, Part>(); // by what the decoder calls time: the part's place in the stream
  private came = 0; // parts
  private newest = 0; // of these, on the screen
  private wish: FilmWish | null = null;
  private sentKey = "";
  private number = 0; // of the newest camera that was sent
  private readonly sent = new Map<number, { key: string; at: number }>();
  private sending = 0; // cameras on their way
  private sentAt = 0;
  private timer = 0;

  // folder: of the data set.
  constructor(
    folder: URL,
    private readonly link: Link,
    private readonly onPicture: (picture: FilmPicture) => void,
  ) {
    void this.run(folder);
  }

  // What is to be seen now.
  want(wish: FilmWish) {
    this.wish = wish;
    this.steer();
  }

  close() {
    this.stopped.abort();
    clearTimeout(this.timer);
    if (this.decoder?.state === "configured") this.decoder.close();
    this.url = null;
  }

  private end(error: unknown) {
    if (this.stopped.signal.aborted) return;
    this.close();
    this.onEnd(error instanceof Never ? error.message : "");
  }

  private async run(folder: URL) {
    try {
      await this.openDecoder();
      const url = new URL(`motion/${crypto.randomUUID()}`, folder);
      const late = setTimeout(() => this.end(null), ANSWER_MS);
      const response = await fetch(`${url.href}?video=vp9`, { signal: this.stopped.signal }).finally(() => clearTimeout(late));
      if (!response.ok) {
        const may = BUSY.has(response.status) || response.status === 409;
        throw new (may ? Error : Never)(await describe(response));
      }
      this.url = url;
      this.steer();
      for await (const part of partsOf(response.body!, (bytes) => this.link.count(bytes))) this.take(part);
      this.end(null);
    } catch (error) {
      this.end(error);
    }
  }

  private async openDecoder() {
    if (!globalThis.VideoDecoder) throw new Never(isSecureContext ? "VideoDecoder" : "https");
    const config: VideoDecoderConfig = { codec: CODEC, optimizeForLatency: true };
    if (!(await VideoDecoder.isConfigSupported(config)).supported) throw new Never(CODEC);
    this.stopped.signal.throwIfAborted();
    this.decoder = new VideoDecoder({
      output: (frame) => this.show(frame, frame.timestamp),
      error: (error) => this.end(new Never(error.message)),
    });
    this.decoder.configure(config);
  }

  // ---- pictures ----

  private take(part: Part) {
    const place = ++this.came;
    this.decoding.set(place, part);
    if (part.type === FRAME) {
      const { data, key } = part;
      this.decoder!.decode(new EncodedVideoChunk({ type: key ? "key" : "delta", timestamp: place, data }));
    } else
      createImageBitmap(new Blob([part.data])).then(
        (bitmap) => this.show(bitmap, place),
        (error: unknown) => this.end(error),
      );
  }

  // A picture is decoded. One that a later part has overtaken is not shown.
  private show(image: VideoFrame | ImageBitmap, place: number) {
    const part = this.decoding.get(place);
    const camera = part && this.sent.get(part.number);
    this.decoding.delete(place);
    if (camera && place > this.newest && !this.stopped.signal.aborted) {
      this.newest = place;
      this.shown++;
      for (const number of this.sent.keys()) if (number < part.number) this.sent.delete(number);
      const video = "displayWidth" in image;
      const [width, height] = video ? [image.displayWidth, image.displayHeight] : [image.width, image.height];
      const milliseconds = performance.now() - camera.at;
      const { full, data } = part;
      this.onPicture({ image, width, height, key: camera.key, full, video, bytes: data.length, milliseconds });
    }
    image.close();
  }

  // ---- cameras ----

  private steer() {
    clearTimeout(this.timer);
    const { url, wish } = this;
    if (!url || !wish) return;
    if (wish.key === this.sentKey) {
      this.timer = window.setTimeout(() => this.end(null), REST_MS);
      return;
    }
    const wait = this.sentAt + POSE_MS - performance.now();
    const busy = this.sending >= POSES_MOST || this.decoder!.decodeQueueSize > QUEUE_MOST;
    if (busy || wait > 0) this.timer = window.setTimeout(() => this.steer(), busy ? POSE_MS : wait);
    else void this.send(url, wish);
  }

  private async send(url: URL, { key, pose, sky, ...view }: FilmWish) {
    const number = ++this.number;
    this.sentAt = performance.now();
    this.sent.set(number, { key, at: this.sentAt });
    this.sentKey = key;
    this.sending++;
    this.steer();
    const { h: height, ...rest } = parsePose(formatPose(pose)) ?? pose; // as in the address of a single picture
    const background = sky ? "sky" : "000000";
    const body = JSON.stringify({ number, pose: { ...rest, height }, background, ...view });
    const signal = AbortSignal.any([this.stopped.signal, AbortSignal.timeout(ANSWER_MS)]);
    try {
      const response = await fetch(url, { method: "POST", body, signal });
      if (!response.ok) throw new Error(await describe(response));
    } catch (error) {
      this.end(error);
    }
    this.sending--;
  }
}
