// Errors whose text is for the person at the screen: a key of the table of strings and its values.
//
// SPDX-License-Identifier: Apache-2.0
import { text, type TextKey } from "./strings";

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
  | "badTour"
  | "noAppearance" // the default light is shown
  | "nothingHere" // beside the page
  | "http";

export class Problem extends Error {
  constructor(
    readonly kind: ProblemKind,
    readonly values: Record<string, string | number> = {},
  ) {
    super(text(`problem.${kind}.text` as TextKey, values));
  }

  get title(): string {
    return text(`problem.${this.kind}.title` as TextKey, this.values);
  }
}
