// What the viewer draws, in parts: a block is a tile's Gaussians, a piece is what is to be seen of a block.
//
// SPDX-License-Identifier: Apache-2.0
import type { DecodedSplats, Stripe } from "./pack";
import type { Rectangle } from "./sort.worker";
import type { Tint } from "./tint";

// Gaussians of one tile in the textures.
export interface Block {
  readonly id: number;
  readonly splats: DecodedSplats;
  row: number; // the first of its rows; -1 when it is gone
  readonly rows: number;
  line: number; // the first of its lines of `more`
  readonly lines: number;
  readonly stripes: readonly Stripe[]; // of all its rows
  readonly tint: Tint | null; // null: colours are what the tile says
  area: Rectangle; // of the centres
  tinted: [number, number]; // versions of the tint that the card holds; -1 for none
}

// What is to be drawn of a block: all but what others stand on.
export interface Piece {
  block: Block;
  without: readonly Block[];
}
