// A small PNG reader for screenshots: 8-bit RGB or RGBA, not interlaced.
//
// SPDX-License-Identifier: Apache-2.0
import { inflateSync } from "node:zlib";

function paeth(a, b, c) {
    const p = a + b - c;
    const [pa, pb, pc] = [Math.abs(p - a), Math.abs(p - b), Math.abs(p - c)];
    return pa <= pb && pa <= pc ? a : pb <= pc ? b : c;
}

function unfilter(raw, width, height, bpp) {
    const row = width * bpp;
    const out = Buffer.alloc(row * height);
    for (let y = 0; y < height; y++) {
        const filter = raw[y * (row + 1)];
        for (let i = 0; i < row; i++) {
            const v = raw[y * (row + 1) + 1 + i];
            const left = i >= bpp ? out[y * row + i - bpp] : 0;
            const up = y > 0 ? out[(y - 1) * row + i] : 0;
            const corner = i >= bpp && y > 0 ? out[(y - 1) * row + i - bpp] : 0;
            const guess = [0, left, up, (left + up) >> 1, paeth(left, up, corner)][filter];
            out[y * row + i] = v + guess;
        }
    }
    return out;
}

// PNG bytes -> { width, height, at(x, y) -> [r, g, b], mean(x, y, radius) -> [r, g, b] }.
export function decodePng(bytes) {
    const width = bytes.readUInt32BE(16);
    const height = bytes.readUInt32BE(20);
    const [depth, kind, , , interlace] = bytes.subarray(24, 29);
    if (depth !== 8 || (kind !== 2 && kind !== 6) || interlace)
        throw new Error("png: unsupported kind");
    const parts = [];
    for (let at = 8; at < bytes.length;) {
        const size = bytes.readUInt32BE(at);
        if (bytes.toString("latin1", at + 4, at + 8) === "IDAT")
            parts.push(bytes.subarray(at + 8, at + 8 + size));
        at += 12 + size;
    }
    const bpp = kind === 6 ? 4 : 3;
    const px = unfilter(inflateSync(Buffer.concat(parts)), width, height, bpp);
    const at = (x, y) => {
        const i = (Math.round(y) * width + Math.round(x)) * bpp;
        return [px[i], px[i + 1], px[i + 2]];
    };
    const mean = (x, y, radius = 1) => {
        const sum = [0, 0, 0];
        let n = 0;
        for (let dy = -radius; dy <= radius; dy++) {
            for (let dx = -radius; dx <= radius; dx++) {
                const [cx, cy] = [Math.round(x) + dx, Math.round(y) + dy];
                if (cx < 0 || cy < 0 || cx >= width || cy >= height) continue;
                at(cx, cy).forEach((v, k) => (sum[k] += v));
                n++;
            }
        }
        return sum.map((v) => (n ? v / n : 0));
    };
    return { width, height, at, mean };
}
