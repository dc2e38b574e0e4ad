/* A polygon in a query.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_PARAM_CLIP_H
#define SERVER_PARAM_CLIP_H

#include "server/route/target.h"

struct clip;
struct text;

/* Reads the text after "clip=" into a struct target_tiles. ERR_NOENT: it is no such text. ERR_DATA:
 * it is no valid polygon. */
enum err_code param_clip_read(struct text *one, void *tiles, struct err *e) ERR_USE;
/* Makes a clip of the polygon. Free it with clip_free. ERR_DATA, ERR_MEM. */
enum err_code param_clip_open(const struct target_clip *c, struct clip *out, struct err *e) ERR_USE;
/* Writes "lon,lat,lon,lat,...", its only spelling. Returns its end. */
char *param_clip_text(const struct target_clip *c, char out[TARGET_CLIP_TEXT]);

#endif
