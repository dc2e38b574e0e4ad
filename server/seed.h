/* Prefetch lists.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_SEED_H
#define SERVER_SEED_H

#include "server/appearance_api.h"
#include "server/dataset.h"
#include "server/target.h"

/* Append the tiles that t selects, most important first, one JSON line each. form, a: of the entity
 * tags; the addresses have them where t says them. ERR_MEM. */
enum err_code seed_write(const struct dataset *d, const struct target *t, struct form form,
                         const struct appearance_choice *a, struct buf *out, struct err *e) ERR_USE;

#endif
