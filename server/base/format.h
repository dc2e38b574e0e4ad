/* Formats of tiles and pictures: extension and media type.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_FORMAT_H
#define SERVER_FORMAT_H

/* X(id, extension, media type): tiles, then pictures. */
#define FORMAT_LIST(X)                                                                             \
    X(GLB, "glb", "model/gltf-binary")                                                             \
    X(SPZ, "spz", "application/octet-stream")                                                      \
    X(DRC, "drc", "application/octet-stream")                                                      \
    X(PLY, "ply", "application/octet-stream")                                                      \
    X(GLB_PLAIN, "plain.glb", "model/gltf-binary")                                                 \
    X(GLB_LOWPASS, "lowpass.glb", "model/gltf-binary")                                             \
    X(PLY_PACKED, "compressed.ply", "application/octet-stream")                                    \
    X(SOG, "sog", "application/zip")                                                               \
    X(JPG, "jpg", "image/jpeg")                                                                    \
    X(PNG, "png", "image/png")                                                                     \
    X(WEBP, "webp", "image/webp")                                                                  \
    X(NPY, "npy", "application/octet-stream")

enum format {
#define FORMAT_ENUM(id, ext, type) FORMAT_##id,
    FORMAT_LIST(FORMAT_ENUM)
#undef FORMAT_ENUM
        FORMAT_COUNT
};
const char *format_ext(enum format f);
const char *format_type(enum format f);

#endif
