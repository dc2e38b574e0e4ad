// Errors whose text is for the person at the screen: a key of the table of strings and its values.
//
// SPDX-License-Identifier: Apache-2.0
import { text, type TextKey } from "./strings";

// Kinds of problems.
export type ProblemKind =
  | "noAnswer"
  | "notCitysplat"
  | "noScenes"
  | "noScene"
  | "badTileset"
  | "noPictures"
  | "no3d" // this browser does not draw, and the server may
  | "nothingDraws" // nor does the server
  | "noVideo" // the server's pictures come one by one
  | "badView"
  | "badBasemap"
  | "noAppearance" // the default light is shown
  | "nothingHere" // beside the page
  | "http" // an answer of the server: requestId says which
  | "other";

// An error whose message is for the person at the screen.
export class Problem extends Error {
  // requestId: of the answer that says it, as the server's log has it; null where no answer does.
  constructor(
    // Which problem it is, for programs.
    readonly kind: ProblemKind,
    // What stands in the words.
    readonly values: Record<string, string | number> = {},
    // Of the answer that says it, as the server's log has it; null where no answer does.
    readonly requestId: string | null = null,
  ) {
    super(text(`problem.${kind}.text` as TextKey, values));
  }

  // A few words, for a heading; `message` has the rest.
  get title(): string {
    return text(`problem.${this.kind}.title` as TextKey, this.values);
  }
}
