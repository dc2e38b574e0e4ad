/* Files of Gaussians by what is in them, for the commands that take any of them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_SPLATS_H
#define CLI_SPLATS_H

#include "codec/ply.h"
#include "core/gauss.h"

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
    struct gauss g;       /* axes as in the file */
    struct ply_info info; /* what a .ply said about its frame */
};

/* By the first bytes; a folder with a scene.json is a scene. ERR_NOENT, ERR_IO. */
enum err_code splats_kind(const char *path, enum splats_kind *out, struct err *e) ERR_USE;
const char *splats_kind_name(enum splats_kind k);
/* Read .ply, .spz, .glb, .drc, .sog, .splat or a checkpoint. ERR_FORMAT for anything else,
 * ERR_LIMIT (lim NULL: the defaults; a checkpoint is ours and has none). splats_free it. */
enum err_code splats_read(const char *path, const struct codec_limits *lim, struct splats *out,
                          struct err *e) ERR_USE;
void splats_free(struct splats *s);
/* "lon,lat,h" in degrees and metres; ERR_ARG names the option. */
enum err_code splats_place(const char *option, const char *text, struct geo_origin *out,
                           struct err *e) ERR_USE;
/* A store's name: the one given by --name, or NULL: out of a path, in lower case, other characters
 * become '-'. ERR_ARG: longer than 63 letters; what else may be wrong with it store_create says. */
enum err_code splats_name(const char *given, const char *path, char out[64], struct err *e) ERR_USE;

#endif
