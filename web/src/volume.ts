// The volume over an area, above and below the plane of its rim: a question to the server.
//
// SPDX-License-Identifier: Apache-2.0
import type { Place } from "./geo";
import type { Viewer } from "./viewer";

const TIMEOUT_MS = 20_000;

export interface Volume {
  above: number; // cubic metres
  below: number;
  error: number; // of both
}

// A text says why there is none, say for a rim that was not surveyed.
export async function askVolume(viewer: Viewer, places: Place[], signal: AbortSignal): Promise<Volume | string> {
  const body = JSON.stringify({ polygon: places.map(({ lon, lat }) => [lon, lat]) });
  const both = AbortSignal.any([signal, AbortSignal.timeout(TIMEOUT_MS)]);
  try {
    const response = await fetch(new URL("measure", viewer.scene!.questions!), { method: "POST", body, signal: both });
    const answer = (await response.json()) as { detail?: string } & Record<`volume_${keyof Volume}_m3`, number>;
    if (!response.ok) return answer.detail ?? `Error ${response.status}`;
    return { above: answer.volume_above_m3, below: answer.volume_below_m3, error: answer.volume_error_m3 };
  } catch (error) {
    return String(error);
  }
}
