// A small PNG reader: RGB or RGBA of 8 bits, grey of 16, not interlaced.
//
// SPDX-License-Identifier: Apache-2.0
import { inflateSync } from "node:zlib";

function paeth(a, b, c) {
    const p = a + b - c;
    const [pa, pb, pc] = [Math.abs(p - a), Math.abs(p - b), Math.abs(p - c)];
    return pa <= pb && pa <= pc ? a : pb <= pc ? b : c;
}

// What each filter guesses of a byte from the ones left of it, above it, and left of that.
const GUESSES = [
    () => 0,
    (left) => left,
    (_, up) => up,
    (left, up) => (left + up) >> 1,
    paeth,
];

function unfilter(raw, width, height, bpp) {
    const row = width * bpp;
    const out = Buffer.alloc(row * height);
    for (let y = 0; y < height; y++) {
        const from = y * (row + 1) + 1;
        const to = y * row;
        const filter = raw[from - 1];
        const guess = GUESSES[filter];
        if (filter === 0) raw.copy(out, to, from, from + row);
        else
            for (let i = 0; i < row; i++) {
                const left = i >= bpp ? out[to + i - bpp] : 0;
                const up = y > 0 ? out[to + i - row] : 0;
                const corner = i >= bpp && y > 0 ? out[to + i - row - bpp] : 0;
                out[to + i] = raw[from + i] + guess(left, up, corner);
            }
    }
    return out;
}

// PNG bytes -> { width, height, at(x, y) -> [r, g, b], mean(x, y, radius) -> [r, g, b], alpha(x, y), grey(x, y),
// text }: grey of 16 bits, text by keyword.
export function decodePng(bytes) {
    const width = bytes.readUInt32BE(16);
    const height = bytes.readUInt32BE(20);
    const [depth, kind, , , interlace] = bytes.subarray(24, 29);
    const known = (depth === 8 && (kind === 2 || kind === 6)) || (depth === 16 && kind === 0);
    if (!known || interlace) throw new Error("png: unsupported kind");
    const parts = [];
    const text = {};
    for (let at = 8; at < bytes.length;) {
        const size = bytes.readUInt32BE(at);
        if (bytes.toString("latin1", at + 4, at + 8) === "IDAT")
            parts.push(bytes.subarray(at + 8, at + 8 + size));
        if (bytes.toString("latin1", at + 4, at + 8) === "tEXt") {
            const [key, value] = bytes.toString("latin1", at + 8, at + 8 + size).split("\0");
            text[key] = value;
        }
        at += 12 + size;
    }
    const bpp = { 0: 2, 2: 3, 6: 4 }[kind];
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
    const alpha = (x, y) => (kind === 6 ? px[(y * width + x) * 4 + 3] : 255);
    const grey = (x, y) => px.readUInt16BE((y * width + x) * 2);
    return { width, height, at, mean, alpha, grey, text };
}
