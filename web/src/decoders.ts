// Tiles are decoded in workers. A job that nobody waits for any more is not started; a worker that
// dies is replaced, and only its own job fails.
//
// SPDX-License-Identifier: Apache-2.0
import type { DecodeReply, DecodeRequest } from "./decode.worker";
import type { DecodedSplats } from "./pack";
import { startWorker } from "./workers";

interface Job {
  request: DecodeRequest;
  signal: AbortSignal;
  resolve: (splats: DecodedSplats) => void;
  reject: (error: Error) => void;
}
interface Seat {
  worker: Worker | null; // the first one at once, others by their first job
  job: Job | null;
}

export class DecoderPool {
  private readonly queue: Job[] = [];
  private readonly seats: Seat[];
  private next = 0;

  constructor(count = 2) {
    this.seats = Array.from({ length: count }, () => ({ worker: null, job: null }));
    this.seats[0]!.worker = this.start(this.seats[0]!); // its script comes before the first tile does
  }

  // Rejects with an AbortError when the signal fires first.
  decode(
    file: ArrayBuffer,
    offset: [number, number, number],
    signal: AbortSignal,
  ): Promise<DecodedSplats> {
    return new Promise((resolve, reject) => {
      const request = { id: this.next++, file, offset };
      this.queue.push({ request, signal, resolve, reject });
      this.feed();
    });
  }

  dispose() {
    for (const seat of this.seats) {
      seat.worker?.terminate();
      seat.worker = null;
      seat.job?.reject(new Error("tile decoder: closed"));
    }
    for (const job of this.queue) job.reject(new Error("tile decoder: closed"));
    this.queue.length = 0;
  }

  private start(seat: Seat): Worker {
    const worker = startWorker("decode");
    worker.onmessage = ({ data }: MessageEvent<DecodeReply>) => {
      const job = seat.job;
      seat.job = null;
      if (job?.request.id === data.id) {
        if (data.splats) job.resolve(data.splats);
        else job.reject(new Error(data.error));
      }
      this.feed();
    };
    worker.onerror = (event) => {
      worker.terminate();
      seat.job?.reject(new Error(`tile decoder: ${event.message || "stopped"}`));
      seat.job = null;
      seat.worker = null; // the next job starts another
      this.feed();
    };
    return worker;
  }

  private feed() {
    for (const seat of this.seats) {
      while (!seat.job && this.queue.length) {
        const job = this.queue.shift()!;
        if (job.signal.aborted) {
          job.reject(new DOMException("not wanted any more", "AbortError"));
          continue;
        }
        seat.job = job;
        seat.worker ??= this.start(seat);
        seat.worker.postMessage(job.request, [job.request.file]);
      }
    }
  }
}
