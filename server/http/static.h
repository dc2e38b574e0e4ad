/* The viewer's files, loaded at the start.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_STATIC_H
#define SERVER_STATIC_H

#include "server/base/body.h"

struct static_file {
    char *path; /* "/assets/x.js" */
    const char *type;
    bool immutable;  /* its name contains a hash of its content */
    char digest[13]; /* 12 hexadecimal digits of a hash of its content */
    struct body *body;
};
struct static_table {         /* {0} is empty */
    struct static_file *file; /* sorted by path */
    size_t n, cap;
};
/* Loads all files below dir (at most 4096 files and 256 MB). Free *out with static_free. ERR_NOENT,
 * ERR_IO, ERR_LIMIT, ERR_MEM. */
enum err_code static_load(const char *dir, struct static_table *out, struct err *e) ERR_USE;
void static_free(struct static_table *t);
const struct static_file *static_find(const struct static_table *t, const char *path, size_t n);
/* The bytes of a file of which only compressed forms are there (its body has no data). NULL: out of
 * memory. */
struct body *static_plain(const struct static_file *f);
/* Finds the viewer if --web-dir is not given: ../../web/dist (a build folder), ../web/dist or
 * ../share/citysplat/web beside the running program. False: it is in none of them. */
bool static_default_dir(char out[FILE_PATH_MAX]);

#endif
