/* The list of all appearances of a dataset: its photographs, the default, and those that are kept
 * under names.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_APPEARANCE_LIST_H
#define SERVER_APPEARANCE_LIST_H

#include "core/base.h"

struct appearance_rows;
struct body;
struct dataset;
struct named_appearance_table;

/* Reads what is known of the photographs of a dataset with appearance. Free *out with
 * appearance_rows_close. The colour of an appearance is the colour to which its network changes mid
 * grey, averaged over Gaussians of the coarsest tile. It is unknown if that tile cannot be read.
 * ERR_FORMAT, ERR_IO: a blob of the store cannot be read. ERR_MEM. */
enum err_code appearance_list_open(const struct dataset *d, struct appearance_rows **out,
                                   struct err *e) ERR_USE;
/* Appends the list as JSON. kept NULL: no named appearances. A dataset without appearance has none.
 * ERR_MEM. */
enum err_code appearance_list_write(const struct dataset *d,
                                    const struct named_appearance_table *kept, struct buf *out,
                                    struct err *e) ERR_USE;
/* Makes the document of all appearances, without named ones. ERR_MEM. */
enum err_code appearance_list_all(const struct dataset *d, struct body **out,
                                  struct err *e) ERR_USE;
/* Upper limit of the list's bytes. */
size_t appearance_list_room(const struct dataset *d, const struct named_appearance_table *kept);

#endif
