// The workers of the page: files beside its scripts. The module for other pages carries their text instead, because a
// browser starts no worker of another origin (workers.inline.ts; the build chooses).
//
// SPDX-License-Identifier: Apache-2.0
export type WorkerName = "decode" | "meshopt" | "sort";

// Throws, or fires "error" without a message, where the browser does not let it start.
export function startWorker(name: WorkerName): Worker {
  if (name === "decode") return new Worker(new URL("./decode.worker.ts", import.meta.url), { type: "module" });
  if (name === "sort") return new Worker(new URL("./sort.worker.ts", import.meta.url), { type: "module" });
  return new Worker(new URL("./meshopt.worker.ts", import.meta.url), { type: "module" });
}

// What a page has to allow, for the message.
export const WORKER_NEEDS = "worker-src 'self'";
