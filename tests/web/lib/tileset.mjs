// 3D Tiles 1.1 documents: the mock server's tileset, and the rules a served tileset must keep.
//
// SPDX-License-Identifier: Apache-2.0
import { EXT, EXT_SPZ } from "./glb.mjs";

const IDENTITY = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];

export function makeTileset(rootTransform, root, credit) {
    return {
        asset: {
            version: "1.1",
            tilesetVersion: "1",
            extras: { cesium: { credits: [{ html: credit, showOnScreen: true }] } },
        },
        extensionsUsed: ["3DTILES_content_gltf"],
        extensions: {
            "3DTILES_content_gltf": {
                extensionsUsed: [EXT, EXT_SPZ],
                extensionsRequired: [EXT, EXT_SPZ],
            },
        },
        geometricError: 400,
        root: { transform: rootTransform, refine: "REPLACE", ...root },
    };
}

export function multiply(a, b) {
    const out = new Array(16).fill(0);
    for (let c = 0; c < 4; c++) {
        for (let r = 0; r < 4; r++) {
            for (let k = 0; k < 4; k++) out[4 * c + r] += a[4 * k + r] * b[4 * c + k];
        }
    }
    return out;
}

// Every broken rule of a root document as a line of text; none when the tileset is good.
export function checkTileset(doc) {
    const faults = [];
    const need = (ok, text) => ok || faults.push(text);
    need(doc.asset?.version === "1.1", "asset.version is not 1.1");
    const ext = doc.extensions?.["3DTILES_content_gltf"];
    for (const list of ["extensionsUsed", "extensionsRequired"]) {
        for (const name of [EXT, EXT_SPZ]) {
            need(
                ext?.[list]?.includes(name),
                `extensions.3DTILES_content_gltf.${list} lacks ${name}`,
            );
        }
    }
    need(
        !doc.extensionsRequired?.includes("3DTILES_content_gltf"),
        "extensionsRequired names 3DTILES_content_gltf",
    );
    need(
        doc.geometricError >= (doc.root?.geometricError ?? Infinity),
        "geometricError below the root's",
    );
    if (!doc.root) return [...faults, "no root"];
    need(doc.root.transform?.length === 16, "root.transform missing");
    need(doc.root.refine === "REPLACE", "root.refine is not REPLACE");
    checkRotation(doc.root.transform ?? IDENTITY, need);
    checkTile(doc.root, "root", need, true);
    return faults;
}

// The root's axes must be east, north, up of an orthonormal frame on the ellipsoid.
function checkRotation(m, need) {
    const axis = (c) => m.slice(4 * c, 4 * c + 3);
    const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    for (let i = 0; i < 3; i++) {
        for (let j = i; j < 3; j++) {
            const want = i === j ? 1 : 0;
            need(
                Math.abs(dot(axis(i), axis(j)) - want) < 1e-12,
                `root.transform: axes ${i},${j} not orthonormal`,
            );
        }
    }
    const up = m.slice(12, 15);
    need(
        dot(axis(2), up) / Math.hypot(...up) > 0.99,
        "root.transform: third axis does not point up",
    );
}

function checkTile(tile, name, need, isRoot) {
    const m = tile.transform ?? IDENTITY;
    if (!isRoot) {
        need(
            m.every((v, i) => (i >= 12 && i < 15 ? Number.isFinite(v) : v === IDENTITY[i])),
            `${name}: transform is not a pure translation`,
        );
        need(
            tile.refine === undefined || tile.refine === "REPLACE",
            `${name}: refine is not REPLACE`,
        );
    }
    const { box, region } = tile.boundingVolume ?? {};
    need(box?.length === 12 || region?.length === 6, `${name}: no box or region`);
    need(tile.contents === undefined, `${name}: more than one content`);
    if (tile.content) {
        need(
            /^[A-Za-z0-9_\-./]+$/.test(tile.content.uri),
            `${name}: content.uri ${tile.content.uri}`,
        );
        need(/\.(glb|json)$/.test(tile.content.uri), `${name}: content is neither glb nor json`);
    }
    const children = tile.children ?? [];
    if (children.length === 0 && /\.glb$/.test(tile.content?.uri ?? "")) {
        need(tile.geometricError === 0, `${name}: leaf with geometricError ${tile.geometricError}`);
    }
    children.forEach((child, i) => {
        const id = `${name}.${i}`;
        need(child.geometricError < tile.geometricError, `${id}: geometricError does not fall`);
        checkTile(child, id, need, false);
    });
}

// All glb contents: { url, transform (to ECEF), tile }. Follows external documents through
// getJson(url).
export async function listContents(url, getJson) {
    const out = [];
    const visit = async (tile, base, parent) => {
        const transform = multiply(parent, tile.transform ?? IDENTITY);
        if (tile.content) {
            const target = new URL(tile.content.uri, base).href;
            if (new URL(target).pathname.endsWith(".json"))
                await visit((await getJson(target)).root, target, transform);
            else out.push({ url: target, transform, tile });
        }
        for (const child of tile.children ?? []) await visit(child, base, transform);
    };
    const doc = await getJson(url);
    await visit(doc.root, url, IDENTITY);
    return out;
}
