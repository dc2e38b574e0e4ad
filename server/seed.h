/* Prefetch lists.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_SEED_H
#define SERVER_SEED_H

#include "server/appearance_api.h"
#include "server/course.h"
#include "server/dataset.h"
#include "server/target.h"

struct crop_node;

/* Append a page of the tiles that t selects, most important first, one JSON line each, and the
 * address of the next page where there is one. c: NULL, or what a camera needs on its way, soonest
 * first. left: what the target's polygon leaves of the tiles (lod/crop.h), NULL: all. form, a: of
 * the entity tags; the addresses have them where t says them. ERR_MEM, ERR_ARG (a camera). */
enum err_code seed_write(const struct dataset *d, const struct target *t, const struct course *c,
                         const struct crop_node *left, struct form form,
                         const struct appearance_choice *a, struct buf *out, struct err *e) ERR_USE;
/* Bytes of the result, from above. */
size_t seed_room(const struct dataset *d, const struct target *t, const struct course *c);

#endif
