// For pages in React 19 with TypeScript: `import type {} from "citysplat-viewer/react"` makes <city-splat> an element of JSX.
// types.mjs copies it beside the declarations that are made of src/.
//
// SPDX-License-Identifier: Apache-2.0
import type { Attribute, CitySplatElement, CitySplatEvents } from "./embed.js";

/** What <city-splat> takes in JSX: its attributes, and handlers of its events by name, as onready and onproblem. */
export type CitySplatProps = { [Name in Attribute]?: string } & {
  [Name in keyof CitySplatEvents as `on${Name}`]?: (event: CitySplatEvents[Name]) => void;
} & { ref?: unknown; key?: string | number | null; id?: string; class?: string; className?: string; hidden?: boolean; style?: object };

declare module "react" {
  namespace JSX {
    interface IntrinsicElements {
      /** A city of 3D Gaussians. */
      "city-splat": CitySplatProps;
    }
  }
}

export type { CitySplatElement };
