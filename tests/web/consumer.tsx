// A page of somebody else in React 19 with TypeScript: compiled by reach.test.mjs as consumer.ts is.
//
// SPDX-License-Identifier: Apache-2.0
import { createMapLayer, type MapLayer } from "citysplat-viewer/map";
import type {} from "citysplat-viewer/react";
import type { CitySplatElement } from "citysplat-viewer";
import { useRef, type ReactElement } from "react";

export function City(): ReactElement {
    const city = useRef<CitySplatElement>(null);
    return (
        <city-splat
            ref={city}
            src="https://city.example/"
            view="13.4,52.5,200,0,-40"
            theme="dark"
            basemap-credit="somebody"
            style={{ height: 300 }}
            onready={({ detail }) => detail.gaussians.toFixed()}
            onproblem={({ detail }) => void (detail.kind === "no3d" && detail.requestId)}
        />
    );
}

// @ts-expect-error: no such attribute
export const wrong = <city-splat nothing="1" />;

export const layer: MapLayer = createMapLayer({ url: "https://city.example/" });
