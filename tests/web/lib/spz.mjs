// SPZ version 3, encoder and decoder, written from the format's description alone: an independent
// check of codec/splat/spz.c. Positions 24-bit fixed point, smallest-three rotations, one byte for
// everything else.
//
// SPDX-License-Identifier: Apache-2.0
import { gunzipSync, gzipSync } from "node:zlib";

const MAGIC = 0x5053474e; // "NGSP"
const FRACTION_BITS = 12;
const SH_C0 = 0.28209479177387814;
const clamp8 = (v) => Math.max(0, Math.min(255, Math.round(v)));
const shCoefs = (degree) => (degree + 1) ** 2 - 1;

function packRotation([w, x, y, z]) {
    const q = [x, y, z, w];
    const norm = Math.hypot(...q);
    let largest = 0;
    for (let i = 1; i < 4; i++) if (Math.abs(q[i]) > Math.abs(q[largest])) largest = i;
    const sign = q[largest] < 0 ? -1 : 1;
    let packed = largest;
    for (let i = 0; i < 4; i++) {
        if (i === largest) continue;
        const c = (sign * q[i]) / norm;
        const magnitude = Math.min(511, Math.floor(511 * Math.abs(c) * Math.SQRT2 + 0.5));
        packed = packed * 1024 + (c < 0 ? 512 : 0) + magnitude;
    }
    return packed;
}

// Packed rotation -> [x, y, z, w].
export function unpackRotation(packed) {
    const largest = packed >>> 30;
    const q = [0, 0, 0, 0];
    let sum = 0;
    let shift = 20;
    for (let i = 0; i < 4; i++) {
        if (i === largest) continue;
        const field = (packed >>> shift) & 1023;
        const v = ((field & 511) / 511) * Math.SQRT1_2 * (field & 512 ? -1 : 1);
        q[i] = v;
        sum += v * v;
        shift -= 10;
    }
    q[largest] = Math.sqrt(Math.max(0, 1 - sum));
    return q;
}

// Gaussians (as city.mjs makes them, but already in glTF axes) -> .spz bytes.
export function encodeSpz(splats, shDegree, antialiased = false) {
    const n = splats.length;
    const coefs = shCoefs(shDegree);
    const raw = Buffer.alloc(16 + n * (20 + 3 * coefs));
    raw.writeUInt32LE(MAGIC, 0);
    raw.writeUInt32LE(3, 4);
    raw.writeUInt32LE(n, 8);
    raw[12] = shDegree;
    raw[13] = FRACTION_BITS;
    raw[14] = antialiased ? 1 : 0;
    let at = 16;
    for (const s of splats) for (const p of s.pos) at = raw.writeIntLE(Math.round(p * 4096), at, 3);
    for (const s of splats) raw[at++] = clamp8(255 * s.opacity);
    for (const s of splats) {
        for (const c of s.rgb) raw[at++] = clamp8(((c - 0.5) / SH_C0) * 0.15 * 255 + 127.5);
    }
    for (const s of splats) for (const v of s.sigma) raw[at++] = clamp8((Math.log(v) + 10) * 16);
    for (const s of splats) at = raw.writeUInt32LE(packRotation(s.quat), at);
    for (const s of splats) {
        for (let k = 0; k < coefs * 3; k++) {
            const bucket = k < 9 ? 8 : 16;
            const q = Math.round(128 * (s.sh1?.[k] ?? 0)) + 128;
            raw[at++] = clamp8(Math.floor((q + bucket / 2) / bucket) * bucket);
        }
    }
    return gzipSync(raw, { level: 9 });
}

// .spz bytes (version 3) -> the integers as they are stored, one typed array a field.
export function decodeSpz(bytes) {
    const raw = gunzipSync(bytes);
    if (raw.readUInt32LE(0) !== MAGIC) throw new Error("spz: bad magic");
    const version = raw.readUInt32LE(4);
    if (version !== 3) throw new Error(`spz: version ${version}, want 3`);
    const count = raw.readUInt32LE(8);
    const shDegree = raw[12];
    const coefs = shCoefs(shDegree);
    if (raw.length !== 16 + count * (20 + 3 * coefs)) throw new Error("spz: wrong length");
    let at = 16;
    const take = (size) => raw.subarray(at, (at += size));
    const pos = take(9 * count);
    const position = Int32Array.from({ length: 3 * count }, (_, i) => pos.readIntLE(3 * i, 3));
    const alpha = take(count);
    const color = take(3 * count);
    const scale = take(3 * count);
    const rot = take(4 * count);
    const rotation = Uint32Array.from({ length: count }, (_, i) => rot.readUInt32LE(4 * i));
    const sh = take(3 * coefs * count);
    return {
        version,
        count,
        shDegree,
        fractionBits: raw[13],
        antialiased: (raw[14] & 1) === 1,
        position,
        alpha,
        color,
        scale,
        rotation,
        sh,
    };
}
