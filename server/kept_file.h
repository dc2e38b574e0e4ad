/* Named appearances in an SQLite file of one server. For kept.c.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_KEPT_FILE_H
#define SERVER_KEPT_FILE_H

#include "server/kept_table.h"

struct kept_file; /* one thread at a time */
/* Opens the file in dir, makes the folder if needed, and reads all names into *table. Errors are
 * those of kept_open. */
enum err_code kept_file_open(const char *dir, struct kept_file **out, struct kept_table **table,
                             struct err *e) ERR_USE;
void kept_file_close(struct kept_file **k);
/* Write a row, and remove one. After ERR_OK it is on the disk. ERR_LIMIT: the disk is full. ERR_IO,
 * ERR_FORMAT, ERR_MEM. */
enum err_code kept_file_put(struct kept_file *k, const struct kept_row *row, struct err *e) ERR_USE;
enum err_code kept_file_remove(struct kept_file *k, const char *ds, const char *name,
                               struct err *e) ERR_USE;

#endif
