// The extent of most Gaussians of a scene, for a viewer that has no graphics card: the coarsest tile
// is fetched and decoded for its centres alone.
//
// SPDX-License-Identifier: Apache-2.0
import { Matrix4, Vector3 } from "three";

import { DecoderPool } from "./decoders";
import { Extent } from "./extent";
import type { Frame } from "./geo";
import type { Link } from "./link";
import type { SceneInfo } from "./source";

interface Node {
  transform?: number[];
  content?: { uri?: string };
  children?: Node[];
}

// The first tile with splats, and where it is.
function firstContent(node: Node, above: Matrix4): { uri: string; transform: Matrix4 } | null {
  const transform = above.clone();
  if (node.transform) transform.multiply(new Matrix4().fromArray(node.transform));
  const uri = node.content?.uri;
  if (uri && /\.(glb|drc)($|\?)/.test(uri)) return { uri, transform };
  for (const child of node.children ?? []) {
    const found = firstContent(child, transform);
    if (found) return found;
  }
  return null;
}

export async function decodeOnce(link: Link, info: SceneInfo, frame: Frame): Promise<Extent | null> {
  const first = firstContent((info.document as { root: Node }).root, new Matrix4());
  if (!first) return null;
  const up = new Matrix4().makeRotationX(Math.PI / 2);
  const toWorld = frame.worldFromEcef.clone().multiply(first.transform).multiply(up);
  const offset = new Vector3().setFromMatrixPosition(toWorld).toArray();
  const stop = new AbortController();
  const pool = new DecoderPool(1);
  try {
    const file = await link.bytes(new URL(first.uri, info.url), stop.signal);
    const { core } = await pool.decode(file, offset, stop.signal);
    return new Extent(info, frame).add(core);
  } finally {
    pool.dispose();
  }
}
