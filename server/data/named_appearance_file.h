/* Named appearances in an SQLite file of one server. For named_appearance.c.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_NAMED_APPEARANCE_FILE_H
#define SERVER_NAMED_APPEARANCE_FILE_H

#include "server/data/named_appearance_table.h"

struct named_appearance_file; /* one thread at a time */
/* Opens the file in dir, makes the folder if needed, and reads all names into *table. Errors are
 * those of named_appearance_open. */
enum err_code named_appearance_file_open(const char *dir, struct named_appearance_file **out,
                                         struct named_appearance_table **table,
                                         struct err *e) ERR_USE;
void named_appearance_file_close(struct named_appearance_file **k);
/* Write a row, and remove one. After ERR_OK it is on the disk. ERR_LIMIT: the disk is full. ERR_IO,
 * ERR_FORMAT, ERR_MEM. */
enum err_code named_appearance_file_put(struct named_appearance_file *k,
                                        const struct named_appearance_row *row,
                                        struct err *e) ERR_USE;
enum err_code named_appearance_file_remove(struct named_appearance_file *k, const char *ds,
                                           const char *name, struct err *e) ERR_USE;

#endif
