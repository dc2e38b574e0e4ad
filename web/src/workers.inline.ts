// The workers of the module: their text, which the build puts here, started from a blob. A blob has the origin of the page.
//
// SPDX-License-Identifier: Apache-2.0
import decode from "./decode.worker.ts?text";
import meshopt from "./meshopt.worker.ts?text";
import sort from "./sort.worker.ts?text";

import type { WorkerName } from "./workers";

const TEXTS: Record<WorkerName, string> = { decode, meshopt, sort };

export function startWorker(name: WorkerName): Worker {
  const url = URL.createObjectURL(new Blob([TEXTS[name]], { type: "text/javascript" }));
  try {
    return new Worker(url);
  } finally {
    // The browser reads it after this turn.
    setTimeout(() => URL.revokeObjectURL(url), 10_000);
  }
}

export const WORKER_NEEDS = "worker-src blob:";
