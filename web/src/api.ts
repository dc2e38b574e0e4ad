// What the client asks of a citysplat server: the data sets, their looks, a tileset document, rendered
// views.
//
// SPDX-License-Identifier: Apache-2.0
import { Matrix4, Vector3 } from "three";

import { formatPose, type Pose } from "./geo";

export interface DataSet {
  id: string;
  title: string;
  attribution: string;
  looks: URL | null; // the list of its looks; null where it was trained without appearance
}

export interface SceneInfo {
  url: string;
  attribution: string;
  transform: Matrix4; // east-north-up metres -> ECEF
  center: Vector3; // of the bounding box, ENU
  half: Vector3; // half its size along east, north, up
}

// An error whose text is for the person at the screen.
export class Problem extends Error {
  constructor(
    readonly title: string,
    detail: string,
  ) {
    super(detail);
  }
}

async function getJson(url: URL): Promise<unknown> {
  let response: Response;
  try {
    response = await fetch(url);
  } catch {
    throw new Problem(
      "The server does not answer",
      `No reply from ${url.origin}. Is "citysplat serve" running?`,
    );
  }
  if (!response.ok) throw new Problem(`Error ${response.status}`, await describe(response, url));
  try {
    return await response.json();
  } catch {
    throw new Problem("Not a citysplat server", `${url.pathname} is not JSON.`);
  }
}

// The detail of an RFC 9457 problem document, or the status line.
async function describe(response: Response, url: URL): Promise<string> {
  const text = await response.text().catch(() => "");
  try {
    const problem = JSON.parse(text) as { detail?: string; title?: string };
    const detail = problem.detail ?? problem.title;
    if (detail) return detail;
  } catch {
    // not JSON: say it ourselves
  }
  return `${url.pathname}: ${response.status} ${response.statusText}`;
}

// Credits may be HTML; the client shows their text.
function plainText(html: string): string {
  return new DOMParser().parseFromString(html, "text/html").body.textContent?.trim() ?? "";
}

export class Server {
  private constructor(readonly base: URL) {}

  // ?server=URL, else the folder of the page, its parent, or the root of the host.
  static async find(page: URL): Promise<{ server: Server; dataSets: DataSet[] }> {
    const wanted = page.searchParams.get("server");
    const bases = wanted ? [wanted.replace(/\/*$/, "/")] : ["./", "../", "/"];
    let first: unknown;
    for (const base of bases) {
      try {
        const server = new Server(new URL(base, page));
        return { server, dataSets: await server.dataSets() };
      } catch (error) {
        first ??= error;
      }
    }
    throw first;
  }

  private async dataSets(): Promise<DataSet[]> {
    const at = new URL("collections", this.base);
    const body = (await getJson(at)) as { collections?: Collection[] };
    if (!Array.isArray(body?.collections))
      throw new Problem("Not a citysplat server", "It lists no collections.");
    return body.collections.map((c) => {
      const looks = c.links?.find((link) => link.rel === "appearances")?.href;
      return {
        id: String(c.id),
        title: c.title || String(c.id),
        attribution: plainText(c.attribution ?? ""),
        looks: looks ? new URL(looks, at) : null,
      };
    });
  }

  // Names of the looks of a scene.
  async lights(set: DataSet): Promise<string[]> {
    if (!set.looks) return [];
    const body = (await getJson(set.looks)) as { appearances?: { name?: string }[] };
    return (body.appearances ?? []).map((look) => String(look.name));
  }

  // light: a look as the server takes it, "" for the default one
  async scene(set: DataSet, light: string): Promise<SceneInfo> {
    const url = new URL(`d/${set.id}/tileset.json`, this.base);
    if (light) url.searchParams.set("appearance", light);
    const doc = (await getJson(url)) as TilesetDocument;
    const { transform, boundingVolume } = doc.root ?? {};
    const box = boundingVolume?.box;
    if (transform?.length !== 16 || box?.length !== 12) {
      throw new Problem(
        "Unreadable tileset",
        `${url.pathname} has no root transform or bounding box.`,
      );
    }
    const extent = (axis: number) =>
      Math.abs(box[3 + axis]!) + Math.abs(box[6 + axis]!) + Math.abs(box[9 + axis]!);
    const credits = doc.asset?.extras?.cesium?.credits ?? [];
    return {
      url: url.href,
      attribution: set.attribution || credits.map((c) => plainText(c.html ?? "")).join(" · "),
      transform: new Matrix4().fromArray(transform),
      center: new Vector3(box[0], box[1], box[2]),
      half: new Vector3(extent(0), extent(1), extent(2)),
    };
  }

  viewUrl(id: string, light: string, pose: Pose, width: number, height: number): URL {
    const url = new URL(`d/${id}/static/${formatPose(pose)}/${width}x${height}.jpg`, this.base);
    if (light) url.searchParams.set("appearance", light);
    return url;
  }

  // The rendered view as a picture, and how long the server says it took.
  async view(url: URL, signal: AbortSignal): Promise<{ blob: Blob; milliseconds: number }> {
    const started = performance.now();
    let response: Response;
    try {
      response = await fetch(url, { signal });
    } catch (error) {
      if (signal.aborted) throw error;
      throw new Problem("The server does not answer", `No reply from ${url.origin}.`);
    }
    if (!response.ok) throw new Problem(`Error ${response.status}`, await describe(response, url));
    const blob = await response.blob();
    return { blob, milliseconds: performance.now() - started };
  }
}

interface Collection {
  id?: string;
  title?: string;
  attribution?: string;
  links?: { rel?: string; href?: string }[];
}
interface TilesetDocument {
  asset?: { extras?: { cesium?: { credits?: { html?: string }[] } } };
  root?: { transform?: number[]; boundingVolume?: { box?: number[] } };
}
