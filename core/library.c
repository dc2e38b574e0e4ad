/* Shared libraries of the program: see library.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/library.h"

#include <dlfcn.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "core/base.h"

/* In a folder that is seen from the program's own. */
static bool library_path(const char *file, const char *folder, char out[FILE_PATH_MAX])
{
    char self[FILE_PATH_MAX];
    ssize_t n = readlink("/proc/self/exe", self, sizeof self - 1);
    if (n <= 0)
        return false;
    self[n] = 0;
    *strrchr(self, '/') = 0;
    return snprintf(out, FILE_PATH_MAX, "%s/%s%s", self, folder, file) < FILE_PATH_MAX &&
           file_exists(out);
}

bool library_find(const char *file, char out[FILE_PATH_MAX])
{
    return library_path(file, "", out) || library_path(file, LIBRARY_FOLDER "/", out);
}

enum err_code library_load(const struct library *l, const void **table, struct err *e)
{
    char path[FILE_PATH_MAX];
    *table = NULL;
    if (!library_find(l->file, path))
        return err_set(e, ERR_NOENT,
                       "%s: %s: is neither beside the program nor in %s: install citysplat whole",
                       l->what, l->file, LIBRARY_FOLDER);
    /* Lazily: all functions of what it needs would take half as long again. */
    void *library = dlopen(path, RTLD_LAZY | RTLD_LOCAL);
    const void *found = library ? dlsym(library, l->symbol) : NULL;
    if (!found)
        return err_set(e, ERR_INTERNAL, "%s: %s: cannot be loaded (%s)", l->what, path, dlerror());
    if (*(const uint32_t *)found != l->version)
        return err_set(e, ERR_INTERNAL,
                       "%s: %s: is of another version of citysplat: install both anew", l->what,
                       path);
    *table = found;
    return ERR_OK;
}
