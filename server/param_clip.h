/* A polygon in a query.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_PARAM_CLIP_H
#define SERVER_PARAM_CLIP_H

#include "server/target.h"

struct clip;
struct text;

/* What follows "clip=". ERR_NOENT: it is no such text. ERR_DATA: it is no polygon. */
enum err_code param_clip_read(struct text *one, struct target_clip *out, struct err *e) ERR_USE;
/* The polygon for use: clip_free it. ERR_DATA, ERR_MEM. */
enum err_code param_clip_open(const struct target_clip *c, struct clip *out, struct err *e) ERR_USE;
/* "lon,lat,lon,lat,...", the one spelling of it. */
void param_clip_text(const struct target_clip *c, char out[TARGET_CLIP_TEXT]);

#endif
