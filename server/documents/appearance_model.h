/* Documents for clients that compute colours themselves: the appearance network of a dataset, and
 * its photographs with their embeddings (docs/appearance.md, "In a client").
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_APPEARANCE_MODEL_H
#define SERVER_APPEARANCE_MODEL_H

#include "server/data/dataset.h"

/* Describes the network and the default appearance. d must have appearance. ERR_MEM. */
enum err_code appearance_model_describe(const struct dataset *d, struct body **out,
                                        struct err *e) ERR_USE;
/* Describes every photograph, in the order of numbers: its embedding, and time, pose and thumbnail
 * if the store has them. Writes the first and the last day to `taken`, if there are any.
 * ERR_FORMAT, ERR_IO: a blob of the store cannot be read. ERR_MEM. */
enum err_code appearance_model_photographs(const struct dataset *d, struct body **out,
                                           char taken[2][11], struct err *e) ERR_USE;
/* The name of photograph number `at`, borrowed from d. NULL: there is none. */
const char *appearance_model_photograph(const struct dataset *d, size_t at);

#endif
