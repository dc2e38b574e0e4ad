// Reads what web/src/pack.ts writes for the graphics card, by the layout that its head describes.
//
// SPDX-License-Identifier: Apache-2.0
const ROW = 1024;
const WIDTHS = [[], [4, 4, 3], [6, 5, 5], [8, 8, 8]];

// { centres, colors [r g b opacity], scales, rotations, sh }, as many rows as there are Gaussians.
export function loosen({ count, shDegree, base, heads, more }) {
    const width = 3 * ((shDegree + 1) ** 2 - 1);
    const out = {
        centres: new Float32Array(3 * count),
        colors: new Uint8Array(4 * count),
        scales: new Uint8Array(3 * count),
        rotations: new Uint32Array(count),
        sh: new Uint8Array(width * count).fill(128),
    };
    const bits = (word, from, size) => (word >>> from) & (2 ** size - 1);
    for (let i = 0; i < count; i++) {
        const [row, x] = [i >> 10, i % ROW];
        const head = heads.subarray(8 * row, 8 * row + 8);
        const origin = new Float32Array(heads.slice(8 * row, 8 * row + 3).buffer);
        const unit = 2 ** (bits(head[3], 23, 8) - 127);
        const [a, b, c, d] = base.subarray(4 * i, 4 * i + 4);
        const upper = head[3] & 2 ? more[ROW * head[4] + x] : 0;
        const steps = [
            bits(a, 0, 14) + bits(upper, 0, 10) * 2 ** 14,
            bits(a, 28, 4) + bits(b, 0, 8) * 16 + bits(upper, 20, 12) * 2 ** 12,
            bits(a, 14, 14) + bits(upper, 10, 10) * 2 ** 14,
        ];
        steps.forEach((n, k) => (out.centres[3 * i + k] = origin[k] + n * unit));
        for (let k = 0; k < 3; k++) out.scales[3 * i + k] = bits(b, 8 * (k + 1), 8);
        for (let k = 0; k < 4; k++) out.colors[4 * i + k] = bits(d, 8 * k, 8);
        out.rotations[i] = c;
        const kind = head[6] >>> 24;
        for (let k = 0, at = 0; kind && k < width; k++) {
            const band = k < 9 ? 0 : k < 24 ? 1 : 2;
            const size = WIDTHS[kind][band];
            let code = 0;
            for (let n = 0; n < size; n++, at++) code |= bits(more[ROW * (head[5] + (at >> 5)) + x], at & 31, 1) << n;
            out.sh[width * i + k] = bits(head[6], 8 * band, 8) + (code << bits(head[7], 4 * band, 4));
        }
    }
    return out;
}
