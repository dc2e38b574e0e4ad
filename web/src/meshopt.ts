// meshoptimizer's decoder in a worker, with the interface that three.js' loader asks for. One buffer
// at a time; a worker that does not answer is ended, and only its own buffer fails.
//
// SPDX-License-Identifier: Apache-2.0
import type { MeshoptReply, MeshoptRequest } from "./meshopt.worker";
import { startWorker } from "./workers";

const BUFFER_MS = 30_000;
const BYTES_MAX = 512 * 2 ** 20;

export class MeshoptPool {
  readonly supported = true;
  readonly ready = Promise.resolve();
  private worker: Worker | null = null;
  private last: Promise<unknown> = Promise.resolve();

  decodeGltfBufferAsync(
    count: number,
    size: number,
    source: Uint8Array,
    mode: string,
    filter?: string,
  ): Promise<Uint8Array> {
    const next = this.last.then(() => this.decode({ count, size, source, mode, filter }));
    this.last = next.catch(() => {});
    return next;
  }

  private decode(request: MeshoptRequest): Promise<Uint8Array> {
    if (!(request.count * request.size <= BYTES_MAX)) throw new Error("meshopt: too large");
    this.worker ??= startWorker("meshopt");
    const { worker } = this;
    return new Promise((resolve, reject) => {
      const fail = (why: string) => {
        clearTimeout(timer);
        worker.terminate();
        this.worker = null;
        reject(new Error(`meshopt: ${why}`));
      };
      const timer = setTimeout(() => fail("does not come to an end"), BUFFER_MS);
      worker.onerror = (event) => fail(event.message || "stopped");
      worker.onmessage = ({ data }: MessageEvent<MeshoptReply>) => {
        if (!data.target) return fail(data.error ?? "stopped");
        clearTimeout(timer);
        resolve(data.target);
      };
      worker.postMessage(request);
    });
  }
}
