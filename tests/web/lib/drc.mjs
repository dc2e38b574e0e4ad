// Our .drc by Google's decoder: the attributes of the Draco point cloud back to the integers that
// an .spz of the same tile holds (docs/formats.md). Runs in Node.js and in browsers; `draco` is the
// module of draco3d's createDecoderModule.
//
// SPDX-License-Identifier: Apache-2.0

const MAGNITUDE_MAX = 511;
const GREEN_OFFSET = 128;
const POSITION_OFFSET = 2 ** 23;

// The raw attribute of that name: its values, components a row, and how many low bits were left
// out.
function readAttribute(draco, cloud, decoder, querier, name) {
    const id = decoder.GetAttributeIdByMetadataEntry(cloud, "name", name);
    if (id < 0) return null;
    const attribute = decoder.GetAttribute(cloud, id);
    const width = attribute.num_components();
    const length = cloud.num_points() * width;
    const kinds = {
        [draco.DT_UINT8]: ["DT_UINT8", Uint8Array, "HEAPU8"],
        [draco.DT_UINT16]: ["DT_UINT16", Uint16Array, "HEAPU16"],
        [draco.DT_UINT32]: ["DT_UINT32", Uint32Array, "HEAPU32"],
    };
    const [kind, Type, heap] = kinds[attribute.data_type()];
    const bytes = length * Type.BYTES_PER_ELEMENT;
    const at = draco._malloc(bytes);
    if (!decoder.GetAttributeDataArrayForAllPoints(cloud, attribute, draco[kind], bytes, at))
        throw new Error(`attribute ${name} cannot be read`);
    const first = at / Type.BYTES_PER_ELEMENT;
    const values = draco[heap].slice(first, first + length);
    draco._free(at);
    const metadata = decoder.GetAttributeMetadata(cloud, id);
    return { width, values, shift: querier.GetIntEntry(metadata, "shift") };
}

// A step's number to the integer; the last step may reach one beyond the largest.
const widen = (index, shift, largest) => Math.min(largest, index << shift);
const bytes = (a) => Uint8Array.from(a.values, (v) => widen(v, a.shift, 255));

// Green, and red and blue about it, to triples.
function triples(green, others, count) {
    const { width, shift } = green;
    const out = new Uint8Array(3 * count * width);
    for (let i = 0; i < count * width; i++) {
        const g = green.values[i];
        const r = (others.values[2 * i] - GREEN_OFFSET + g) & 255;
        const b = (others.values[2 * i + 1] - GREEN_OFFSET + g) & 255;
        out.set([widen(r, shift, 255), widen(g, shift, 255), widen(b, shift, 255)], 3 * i);
    }
    return out;
}

function rotations(fields, index, count) {
    const zero = (MAGNITUDE_MAX + (1 << fields.shift) - 1) >> fields.shift;
    return Uint32Array.from({ length: count }, (_, i) => {
        let packed = index.values[i];
        for (let k = 0; k < 3; k++) {
            const v = fields.values[3 * i + k];
            const magnitude = widen(Math.abs(v - zero), fields.shift, MAGNITUDE_MAX);
            packed = packed * 1024 + (v < zero ? 512 : 0) + magnitude;
        }
        return packed;
    });
}

function harmonics(read, shDegree, count) {
    const coefs = (shDegree + 1) ** 2 - 1;
    const out = new Uint8Array(3 * coefs * count);
    for (let band = 1, first = 0; band <= shDegree; first += 2 * band + 1, band++) {
        const rgb = triples(read(`sh${band}_g`), read(`sh${band}_rb`), count);
        const width = 3 * (2 * band + 1);
        for (let i = 0; i < count; i++)
            out.set(rgb.subarray(width * i, width * (i + 1)), 3 * (coefs * i + first));
    }
    return out;
}

// Shape of decodeSpz's answer (lib/spz.mjs).
export function decodeDrc(draco, file) {
    const decoder = new draco.Decoder();
    const buffer = new draco.DecoderBuffer();
    const cloud = new draco.PointCloud();
    const querier = new draco.MetadataQuerier();
    try {
        buffer.Init(new Int8Array(file.buffer, file.byteOffset, file.byteLength), file.length);
        const status = decoder.DecodeBufferToPointCloud(buffer, cloud);
        if (!status.ok()) throw new Error(status.error_msg());
        const metadata = decoder.GetMetadata(cloud);
        const count = cloud.num_points();
        const shDegree = querier.GetIntEntry(metadata, "sh_degree");
        const read = (name) => readAttribute(draco, cloud, decoder, querier, name);
        const position = read("position");
        const embedding = read("embedding");
        return {
            format: querier.GetStringEntry(metadata, "format"),
            count,
            shDegree,
            fractionBits: querier.GetIntEntry(metadata, "frac_bits"),
            antialiased: querier.GetIntEntry(metadata, "antialiased") !== 0,
            position: Int32Array.from(
                position.values,
                (v) => (v - POSITION_OFFSET) * 2 ** position.shift,
            ),
            alpha: bytes(read("opacity")),
            color: triples(read("color_g"), read("color_rb"), count),
            scale: bytes(read("scale")),
            rotation: rotations(read("rotation"), read("rotation_index"), count),
            sh: harmonics(read, shDegree, count),
            embedding: embedding ? bytes(embedding) : null,
        };
    } finally {
        [cloud, buffer, querier, decoder].forEach((object) => draco.destroy(object));
    }
}
