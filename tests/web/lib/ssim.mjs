// Structural similarity (Wang 2004) of two pictures: windows of 11 x 11 pixels, Gaussian of sigma 1.5, at every second
// pixel of every second row.
//
// SPDX-License-Identifier: Apache-2.0
const SIGMA = 1.5;
const RADIUS = 5;
const STEP = 2; // pixels from window to window
const C1 = (0.01 * 255) ** 2;
const C2 = (0.03 * 255) ** 2;
const COVERED = 2; // of 255: a brighter channel is not background

const TAPS = Array.from({ length: 2 * RADIUS + 1 }, (_, i) => Math.exp(-((i - RADIUS) ** 2) / (2 * SIGMA ** 2)));
const WHOLE = TAPS.reduce((sum, v) => sum + v, 0);

// How many windows lie whole in the picture.
function windowsOf(pixels) {
    return Math.ceil((pixels - 2 * RADIUS) / STEP);
}

// Means under the windows.
function blur(plane, width, height) {
    const [w, h] = [windowsOf(width), windowsOf(height)];
    const rows = new Float64Array(w * height);
    for (let y = 0; y < height; y++)
        for (let x = 0; x < w; x++) {
            let sum = 0;
            for (let k = 0; k < TAPS.length; k++) sum += TAPS[k] * plane[y * width + STEP * x + k];
            rows[y * w + x] = sum / WHOLE;
        }
    const out = new Float64Array(w * h);
    for (let y = 0; y < h; y++)
        for (let x = 0; x < w; x++) {
            let sum = 0;
            for (let k = 0; k < TAPS.length; k++) sum += TAPS[k] * rows[(STEP * y + k) * w + x];
            out[y * w + x] = sum / WHOLE;
        }
    return out;
}

function planeOf({ width, height, at }, channel) {
    const out = new Float64Array(width * height);
    for (let y = 0; y < height; y++) for (let x = 0; x < width; x++) out[y * width + x] = at(x, y)[channel];
    return out;
}

function mapOf(a, b, width, height) {
    const product = (p, q) => blur(p.map((v, i) => v * q[i]), width, height);
    const [ma, mb] = [blur(a, width, height), blur(b, width, height)];
    const [aa, bb, ab] = [product(a, a), product(b, b), product(a, b)];
    return ma.map((m, i) => {
        const n = mb[i];
        const [va, vb, cov] = [aa[i] - m * m, bb[i] - n * n, ab[i] - m * n];
        return ((2 * m * n + C1) * (2 * cov + C2)) / ((m * m + n * n + C1) * (va + vb + C2));
    });
}

// Of pictures as decodePng gives them, of one size: { whole, covered, share }. covered: the mean over windows
// whose middle is not background in either, so that empty sky, where any two are equal, does not count; share of
// them.
export function ssim(a, b) {
    const { width, height } = a;
    if (b.width !== width || b.height !== height) throw new Error("ssim: pictures of two sizes");
    const [w, h] = [windowsOf(width), windowsOf(height)];
    const sums = { whole: 0, covered: 0, windows: 0 };
    const planes = [0, 1, 2].map((channel) => [planeOf(a, channel), planeOf(b, channel)]);
    const maps = planes.map(([p, q]) => mapOf(p, q, width, height));
    for (let i = 0; i < w * h; i++) {
        const middle = (STEP * ((i / w) | 0) + RADIUS) * width + STEP * (i % w) + RADIUS;
        const value = (maps[0][i] + maps[1][i] + maps[2][i]) / 3;
        sums.whole += value;
        if (!planes.some(([p, q]) => p[middle] > COVERED || q[middle] > COVERED)) continue;
        sums.covered += value;
        sums.windows++;
    }
    const { windows } = sums;
    return { whole: sums.whole / (w * h), covered: windows ? sums.covered / windows : 1, share: windows / (w * h) };
}
