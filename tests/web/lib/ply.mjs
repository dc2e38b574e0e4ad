// The INRIA .ply of 3D Gaussian splatting, written and read. Little-endian float properties; f_rest
// is channel-major, opacity a logit, scale a logarithm, rotation w x y z.
//
// SPDX-License-Identifier: Apache-2.0

const SH_C0 = 0.28209479177387814;

// Gaussians of city.mjs -> bytes. Degree is 1 when any of them has sh1, else 0.
export function writePly(splats, origin, antialiased = false) {
    const rest = splats.some((s) => s.sh1) ? 9 : 0;
    const names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"];
    for (let k = 0; k < rest; k++) names.push(`f_rest_${k}`);
    names.push("opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3");
    const head =
        "ply\nformat binary_little_endian 1.0\n" +
        `comment citysplat origin ${origin.lon} ${origin.lat} ${origin.h}\ncomment axes ENU\n` +
        (antialiased ? "comment antialiased 1\n" : "") +
        `element vertex ${splats.length}\n` +
        names.map((n) => `property float ${n}\n`).join("") +
        "end_header\n";
    const body = Buffer.alloc(splats.length * names.length * 4);
    let at = 0;
    const put = (v) => {
        at = body.writeFloatLE(v, at);
    };
    for (const s of splats) {
        [...s.pos, 0, 0, 0].forEach(put);
        s.rgb.forEach((c) => put((c - 0.5) / SH_C0));
        for (let k = 0; k < rest; k++) {
            const coef = k % 3; // channel-major: all of R, then G, then B
            put(s.sh1 ? s.sh1[coef * 3 + Math.floor(k / 3)] : 0);
        }
        put(Math.log(s.opacity / (1 - s.opacity)));
        s.sigma.forEach((v) => put(Math.log(v)));
        s.quat.forEach(put);
    }
    return Buffer.concat([Buffer.from(head, "latin1"), body]);
}

// Bytes of a float .ply -> { count, names, column(name) }.
export function readPly(bytes) {
    const end = bytes.indexOf("end_header\n", 0, "latin1");
    if (end < 0) throw new Error("ply: no end_header");
    const lines = bytes.subarray(0, end).toString("latin1").split("\n");
    if (lines[0] !== "ply" || lines[1] !== "format binary_little_endian 1.0") {
        throw new Error("ply: not a little-endian binary ply");
    }
    const element = lines.find((l) => l.startsWith("element vertex "));
    const names = lines.filter((l) => l.startsWith("property ")).map((l) => l.split(" "));
    if (!element || names.some((p) => p[1] !== "float")) throw new Error("ply: not all float");
    const count = Number(element.split(" ")[2]);
    const start = end + "end_header\n".length;
    if (bytes.length !== start + count * names.length * 4) throw new Error("ply: wrong length");
    const comments = lines.filter((l) => l.startsWith("comment "));
    const column = (name) => {
        const at = names.findIndex((p) => p[2] === name);
        if (at < 0) throw new Error(`ply: no property ${name}`);
        return Float32Array.from({ length: count }, (_, i) =>
            bytes.readFloatLE(start + (i * names.length + at) * 4),
        );
    };
    return { count, names: names.map((p) => p[2]), comments, column };
}
