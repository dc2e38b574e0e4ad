// The line to the server. One place knows whether it answers: while it does not, requests wait
// instead of failing, one probe asks again with growing pauses, and all go on when it is back.
//
// SPDX-License-Identifier: Apache-2.0
import { Problem } from "./problem";

// Whether the server answers: ok, busy (it asks to wait), or away.
export type LinkState = "ok" | "busy" | "away";

const PROBE_FIRST_MS = 500;
const PROBE_MOST_MS = 1500; // and a fifth of it: who waits is back within two seconds of the server
const PROBE_TIMEOUT_MS = 3000; // of the answer's head
const BUSY_MOST_MS = 10_000; // that a server may ask us to wait
const SILENCE_MS = 20_000; // without a byte
/** @internal */
export const BUSY = new Set([429, 502, 503, 504]);
const WINDOW_MS = 4000; // of the speed measured
const TELLING_BYTES = 50_000; // fewer say nothing of a line's speed
const ENOUGH_BYTES = 500_000; // after these our own answers say it best

// An answer that is not there and will not come by waiting.
export class HttpError extends Error {
  constructor(
    readonly status: number,
    readonly url: string,
    detail: string,
    readonly requestId: string | null = null,
  ) {
    super(detail);
  }
}

// What a page is told of an error.
/** @internal */
export function problemOf(error: unknown): Problem {
  if (error instanceof Problem) return error;
  if (error instanceof HttpError) return new Problem("http", { status: error.status, text: error.message }, error.requestId);
  return new Problem("other", { why: error instanceof Error ? error.message : String(error) });
}

function pause(ms: number, signal: AbortSignal | null): Promise<void> {
  return new Promise((resolve, reject) => {
    const stop = () => {
      clearTimeout(timer);
      reject(signal!.reason as Error);
    };
    const timer = setTimeout(() => {
      signal?.removeEventListener("abort", stop);
      resolve();
    }, ms);
    if (signal?.aborted) stop();
    else signal?.addEventListener("abort", stop, { once: true });
  });
}

// The detail of an RFC 9457 problem document, or the status line.
export async function describe(response: Response): Promise<string> {
  const text = await response.text().catch(() => "");
  try {
    const problem = JSON.parse(text) as { detail?: string; title?: string };
    const detail = problem.detail ?? problem.title;
    if (detail) return detail;
  } catch {
    // not JSON: say it ourselves
  }
  return `${new URL(response.url).pathname}: ${response.status} ${response.statusText}`;
}

// It was asked for by a name that the server does not have.
export function isGone(error: unknown): boolean {
  return error instanceof HttpError && [400, 404, 410, 422].includes(error.status);
}

// Of the larger answers that the page got so far, its scripts too, while they flowed: what the line
// carries is known before the first tile. 0 where all came from the browser's store.
function speedOfPage(): number {
  const all = performance.getEntriesByType("resource") as PerformanceResourceTiming[];
  const large = all.filter(({ transferSize, responseStart }) => transferSize >= TELLING_BYTES && responseStart);
  let [bytes, ms, end] = [0, 0, 0];
  for (const { transferSize, responseStart, responseEnd } of large.sort((a, b) => a.responseStart - b.responseStart)) {
    bytes += transferSize;
    ms += Math.max(0, responseEnd - Math.max(responseStart, end)); // answers side by side share the line
    end = Math.max(end, responseEnd);
  }
  return bytes && (1000 * bytes) / Math.max(1, ms);
}

export class Link {
  state: LinkState = "ok";
  received = 0; // bytes
  onState: (state: LinkState, before: LinkState) => void = () => {};
  private probeUrl: URL | null = null;
  private waiting: (() => void)[] = [];
  private readonly stopped = new AbortController();
  private awake: () => void = () => {};
  private running = 0;
  private busySince = 0;
  private marks: { at: number; bytes: number }[] = [];
  private busyMs = 0;
  private readonly online = () => this.awake();

  constructor() {
    window.addEventListener("online", this.online);
  }

  // A small document that is there whenever the server is.
  watch(url: URL) {
    this.probeUrl = url;
  }

  // Bytes a second while something was on its way; 0 until there is something to tell.
  get speed(): number {
    const bytes = this.marks.reduce((sum, mark) => sum + mark.bytes, 0);
    const ms = this.busyMs + (this.running ? performance.now() - this.busySince : 0);
    const own = bytes > TELLING_BYTES && ms > 0 ? (1000 * bytes) / ms : 0;
    return this.received > ENOUGH_BYTES ? own : Math.max(own, speedOfPage());
  }

  async bytes(url: string | URL, signal: AbortSignal | null): Promise<ArrayBuffer> {
    return (await this.get(url, signal)).body;
  }

  async json(url: string | URL, signal: AbortSignal | null = null): Promise<unknown> {
    const { body } = await this.get(url, signal);
    try {
      return JSON.parse(new TextDecoder().decode(body));
    } catch {
      throw new Problem("notCitysplat", { url: new URL(url, location.href).pathname });
    }
  }

  // Resolves with the whole answer, however long that takes; rejects with HttpError when the
  // server says no, and with the signal's reason.
  async get(
    url: string | URL,
    signal: AbortSignal | null,
  ): Promise<{ body: ArrayBuffer; headers: Headers }> {
    for (let attempt = 0; ; attempt++) {
      await this.untilThere(signal);
      const quiet = new AbortController();
      const both = AbortSignal.any([quiet.signal, this.stopped.signal, ...(signal ? [signal] : [])]);
      let timer = setTimeout(() => quiet.abort(), SILENCE_MS);
      const heard = () => {
        clearTimeout(timer);
        timer = setTimeout(() => quiet.abort(), SILENCE_MS);
      };
      this.begin();
      try {
        const response = await fetch(url, { signal: both });
        heard();
        if (BUSY.has(response.status)) {
          const seconds = Number(response.headers.get("retry-after")) || 0;
          if (attempt >= 1) this.turn("busy");
          await response.body?.cancel();
          await pause(Math.min(BUSY_MOST_MS, Math.max(1000 * seconds, 300 * 2 ** attempt)), signal);
          continue;
        }
        if (!response.ok)
          throw new HttpError(response.status, response.url, await describe(response), response.headers.get("x-request-id"));
        const body = await this.read(response, heard);
        if (this.state === "busy") this.turn("ok");
        return { body, headers: response.headers };
      } catch (error) {
        signal?.throwIfAborted();
        this.stopped.signal.throwIfAborted();
        if (error instanceof HttpError) throw error;
        this.lose(); // no answer, or one that broke off
      } finally {
        clearTimeout(timer);
        this.end();
      }
    }
  }

  // Asks at once where the next attempt is waited for.
  tryNow() {
    this.awake();
  }

  dispose() {
    window.removeEventListener("online", this.online);
    this.stopped.abort(new DOMException("the viewer is closed", "AbortError"));
    this.awake();
  }

  private async read(response: Response, heard: () => void): Promise<ArrayBuffer> {
    const reader = response.body!.getReader();
    const parts: Uint8Array[] = [];
    let length = 0;
    for (let part = await reader.read(); !part.done; part = await reader.read()) {
      heard();
      parts.push(part.value);
      length += part.value.length;
      this.count(part.value.length);
    }
    const out = new Uint8Array(length);
    let at = 0;
    for (const part of parts) {
      out.set(part, at);
      at += part.length;
    }
    return out.buffer;
  }

  private begin() {
    if (this.running++ === 0) this.busySince = performance.now();
  }

  private end() {
    if (--this.running === 0) this.busyMs += performance.now() - this.busySince;
  }

  // Bytes of an answer.
  count(bytes: number) {
    this.received += bytes;
    const now = performance.now();
    this.marks.push({ at: now, bytes });
    if (this.marks.length > 4096 || now - this.marks[0]!.at > WINDOW_MS) {
      // A fresh window: the speed of a minute ago tells little.
      if (this.marks.length > 16) {
        this.marks = this.marks.slice(-16);
        this.busyMs = 0;
        this.busySince = this.marks[0]!.at;
      }
    }
  }

  private turn(state: LinkState) {
    const before = this.state;
    if (before === state) return;
    this.state = state;
    this.onState(state, before);
  }

  private async untilThere(signal: AbortSignal | null) {
    this.stopped.signal.throwIfAborted();
    while (this.state === "away") {
      await new Promise<void>((resolve, reject) => {
        this.waiting.push(resolve);
        signal?.addEventListener("abort", () => reject(signal.reason as Error), { once: true });
      });
      this.stopped.signal.throwIfAborted();
    }
    signal?.throwIfAborted();
  }

  private lose() {
    if (this.state === "away") return;
    this.turn("away");
    void this.probe();
  }

  private async probe() {
    for (let ms = PROBE_FIRST_MS; ; ms = Math.min(2 * ms, PROBE_MOST_MS)) {
      await new Promise<void>((resolve) => {
        const timer = setTimeout(resolve, ms * (0.8 + 0.4 * Math.random()));
        this.awake = () => {
          clearTimeout(timer);
          resolve();
        };
      });
      if (this.stopped.signal.aborted) break;
      try {
        const signal = AbortSignal.timeout(PROBE_TIMEOUT_MS);
        const response = await fetch(this.probeUrl ?? location.href, { signal, cache: "no-store" });
        void response.body?.cancel().catch(() => {}); // that it answers is enough
        if (!BUSY.has(response.status)) break;
      } catch {
        // still away
      }
    }
    this.turn("ok");
    const waiting = this.waiting;
    this.waiting = [];
    for (const resolve of waiting) resolve();
  }
}
