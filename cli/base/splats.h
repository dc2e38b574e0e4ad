/* Reads any file of Gaussians, recognised by its content, for commands that accept all formats.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_SPLATS_H
#define CLI_SPLATS_H

#include "codec/splat/ply.h"
#include "core/splat/gauss.h"

struct codec_limits;

enum splats_kind {
    SPLATS_UNKNOWN,
    SPLATS_PLY,
    SPLATS_SPZ,
    SPLATS_GLB,
    SPLATS_DRC,
    SPLATS_SOG,
    SPLATS_SPLAT,
    SPLATS_STORE,
    SPLATS_CKPT,
    SPLATS_SCENE
};

struct splats { /* {0} is empty */
    enum splats_kind kind;
    struct gauss g;       /* in the axes of the file */
    struct ply_info info; /* frame of a .ply, from its comments */
};

/* Recognises a file by its first bytes. A folder with a scene.json is a scene. ERR_NOENT, ERR_IO.
 */
enum err_code splats_kind(const char *path, enum splats_kind *out, struct err *e) ERR_USE;
/* Returns whether a path is that of the meta.json of a SOG that is files of a folder. */
bool splats_is_sog_meta(const char *path);
const char *splats_kind_name(enum splats_kind k);
/* Reads .ply, .spz, .glb, .drc, .sog, .splat or a checkpoint. lim NULL: default limits; checkpoints
 * have no limit. Free *out with splats_free. ERR_FORMAT: any other file. ERR_LIMIT, ERR_NOENT,
 * ERR_IO, ERR_MEM. */
enum err_code splats_read(const char *path, const struct codec_limits *lim, struct splats *out,
                          struct err *e) ERR_USE;
void splats_free(struct splats *s);
/* Parses "lon,lat,h" in degrees and metres. ERR_ARG names the option. */
enum err_code splats_place(const char *option, const char *text, struct geo_origin *out,
                           struct err *e) ERR_USE;
/* Gives a store's name: `given`, or if that is NULL, the name of `path` in lower case with '-' for
 * other characters. ERR_ARG: the name is longer than 63 letters. store_create checks everything
 * else. */
enum err_code splats_name(const char *given, const char *path, char out[64], struct err *e) ERR_USE;

#endif
