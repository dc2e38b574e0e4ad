/* The page that says how to use a dataset.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_USE_PAGE_H
#define SERVER_USE_PAGE_H

#include "server/base/body.h"

struct dataset;

/* Fills the words in braces of `page`, which web/use.mjs makes of docs/clients.md. origin: of the
 * service, as clients see it. viewer: the address of its module, below origin. The caller owns
 * *out. ERR_MEM. ERR_NOENT: the dataset has no Gaussians. */
enum err_code use_page_write(const struct body *page, const struct dataset *d, const char *origin,
                             const char *viewer, struct body **out, struct err *e) ERR_USE;

#endif
