/* What a client needs that computes colours itself: the appearance network of a dataset, and its
 * photographs with their embeddings (docs/appearance.md, "In a client").
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_APPEARANCE_MODEL_H
#define SERVER_APPEARANCE_MODEL_H

#include "server/dataset.h"

/* The network and the default appearance; d has one. ERR_MEM. */
enum err_code appearance_model_describe(const struct dataset *d, struct body **out,
                                        struct err *e) ERR_USE;
/* Every photograph, in the order of their numbers: embedding, and what the store knows of time,
 * pose and thumbnail. ERR_FORMAT, ERR_IO: a blob of the store cannot be read; ERR_MEM. */
enum err_code appearance_model_photographs(const struct dataset *d, struct body **out,
                                           struct err *e) ERR_USE;
/* The name of photograph number `at`; NULL: there is none. Borrowed from d. */
const char *appearance_model_photograph(const struct dataset *d, size_t at);

#endif
