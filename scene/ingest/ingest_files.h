/* The photographs below a folder.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SCENE_INGEST_INGEST_FILES_H
#define SCENE_INGEST_INGEST_FILES_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"

struct ingest_files { /* {0} is empty; ingest_files_free */
    char **names;     /* [n] paths below the folder, sorted by name without regard to case */
    size_t n, cap;
};
/* Lists the photographs below a folder. Scenes and masks in it are left out. ERR_LIMIT, ERR_MEM. */
enum err_code ingest_files_list(const char *root, struct ingest_files *out, struct err *e) ERR_USE;
void ingest_files_free(struct ingest_files *f);
/* Returns the file of a name. Case, the direction of slashes and the form of letters with accents
 * may differ if only one file fits. NULL: there is none. */
const char *ingest_files_find(const struct ingest_files *f, const char *name);

#endif
