/* Output folders that are renamed when complete. A run that fails, or a full disk, never leaves
 * half a scene that a later command could take for a whole one. An older scene stays until the new
 * one is complete.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/outdir.h"

#include <dirent.h>
#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static bool outdir_is_empty_dir(const char *path)
{
    DIR *d = opendir(path);
    if (!d)
        return false;
    size_t n = 0;
    for (const struct dirent *entry; (entry = readdir(d));)
        n += strcmp(entry->d_name, ".") && strcmp(entry->d_name, "..");
    closedir(d);
    return n == 0;
}

static enum err_code outdir_place_check(const char *path, const char *marker, bool overwrite,
                                        struct err *e)
{
    struct stat st;
    char inside[FILE_PATH_MAX];
    if (lstat(path, &st))
        return errno == ENOENT ? ERR_OK : err_errno(e, ERR_IO, "%s", path);
    if (S_ISDIR(st.st_mode) && outdir_is_empty_dir(path))
        return ERR_OK;
    enum err_code rc = file_join(inside, path, marker, e);
    if (rc)
        return rc;
    if (!S_ISDIR(st.st_mode) || !file_exists(inside))
        return err_set(e, ERR_ARG,
                       "%s: exists and was not made by this command; choose another folder", path);
    if (!overwrite)
        return err_set(e, ERR_ARG,
                       "%s: exists; choose another folder, or replace it with --overwrite", path);
    return ERR_OK;
}

enum err_code outdir_begin(const char *path, const char *marker, bool overwrite, struct outdir *out,
                           struct err *e)
{
    *out = (struct outdir){0};
    size_t n = strlen(path);
    while (n > 1 && path[n - 1] == '/')
        n--;
    if (n + 32 > FILE_PATH_MAX)
        return err_set(e, ERR_LIMIT, "%.200s...: the path is too long", path);
    memcpy(out->path, path, n);
    enum err_code rc = outdir_place_check(out->path, marker, overwrite, e);
    if (rc) {
        *out = (struct outdir){0};
        return rc;
    }
    file_sweep(out->path);
    rc = file_begin(out->path, out->part, e);
    file_remove_tree(out->part); /* of a killed run with the same number */
    if (!rc)
        rc = file_mkdir(out->part, e);
    if (rc)
        *out = (struct outdir){0};
    return rc;
}

enum err_code outdir_commit(struct outdir *d, struct err *e)
{
    char old[FILE_PATH_MAX + 32] = "";
    struct stat st;
    if (!lstat(d->path, &st)) {
        snprintf(old, sizeof old, "%s.old-%ld", d->path, (long)getpid());
        if (rename(d->path, old))
            return err_errno(e, ERR_IO, "%s: cannot be moved aside", d->path);
    }
    if (rename(d->part, d->path)) {
        enum err_code rc = err_errno(e, ERR_IO, "%s: cannot be put in place", d->path);
        if (old[0])
            (void)!rename(old, d->path);
        return rc;
    }
    if (old[0])
        file_remove_tree(old);
    *d = (struct outdir){0};
    return ERR_OK;
}

void outdir_abort(struct outdir *d)
{
    if (d->part[0])
        file_remove_tree(d->part);
    *d = (struct outdir){0};
}
